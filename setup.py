# Everything else stands in pyproject.toml, which cannot say "all packages found, and this one from elsewhere".
from setuptools import find_packages, setup

setup(packages=[*find_packages(include=["platform_ctrl", "platform_ctrl.*"]), "platform_ctrl.models"])
