# Everything else stands in pyproject.toml, which cannot say "all packages found, and this one from elsewhere".
import sys

from setuptools import find_packages, setup

# Stop here: an installer that only reads requires-python may search for hours before it says why nothing fits.
if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit(f"platform_ctrl: python3 is {sys.version.split()[0]}; expected 3.11 or newer")

setup(packages=[*find_packages(include=["platform_ctrl", "platform_ctrl.*"]), "platform_ctrl.models"])
