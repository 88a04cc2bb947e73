# Everything else stands in pyproject.toml, which cannot say "all packages found, and this one from elsewhere".
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

# Stop here: an installer that only reads requires-python may search for hours before it says why nothing fits.
if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit(f"platform_ctrl: python3 is {sys.version.split()[0]}; expected 3.11 or newer")


class BuildWithStaticPath(build_py):
    """Adds the checkout as a path to an editable install, for type checkers and editors.

    Because models/ is mapped into the package, setuptools installs an import hook, which they cannot follow.
    """

    def run(self):
        super().run()
        if not self.editable_mode:
            # What `platform-ctrl new` copies: the jobs of examples/, inside the package.
            inside = Path(self.build_lib) / "platform_ctrl" / "examples"
            inside.mkdir(parents=True, exist_ok=True)
            for job in Path("examples").glob("*.toml"):
                self.copy_file(str(job), str(inside / job.name))
        else:
            wheel = Path(self.distribution.get_command_obj("install").install_purelib)
            wheel.mkdir(parents=True, exist_ok=True)
            (wheel / "platform_ctrl.pth").write_text(f"{Path(__file__).resolve().parent}\n", encoding="utf-8")


setup(
    packages=[*find_packages(include=["platform_ctrl", "platform_ctrl.*"]), "platform_ctrl.models"],
    cmdclass={"build_py": BuildWithStaticPath},
)
