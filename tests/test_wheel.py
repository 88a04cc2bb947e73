"""The built wheel, seen from outside the checkout: what users get is what is tested."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import platform_ctrl as pc

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = (".py", ".pyi", ".typed", ".toml", ".html", ".css", ".j2", ".js", ".mplstyle", ".svg", ".txt")


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the sources: a build folder left over in the checkout must not get into the wheel."""
    source = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy2(ROOT / name, source)
    for name in ("platform_ctrl", "models", "examples"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    return source


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", out, source, cwd=source)
    [built] = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel alone; its dependencies come from the environment."""
    target = tmp_path_factory.mktemp("site")
    run(sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", target, wheel, cwd=target)
    return target


def test_the_wheel_holds_every_file_of_the_package_and_of_models_and_no_other(wheel: Path) -> None:
    expected = {
        f"{inside}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, inside in (("platform_ctrl", "platform_ctrl"), ("models", "platform_ctrl/models"))
        for path in (ROOT / folder).rglob("*")
        if path.suffix in SHIPPED or path.name == "py.typed"
    }
    expected |= {f"platform_ctrl/examples/{path.name}" for path in (ROOT / "examples").glob("*.toml")}
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == expected


def test_the_installed_package_is_complete_and_finds_its_models(site: Path, tmp_path: Path) -> None:
    code = (
        "import sys, json\n"
        "import importlib.metadata as metadata, importlib.resources as resources\n"
        "import platform_ctrl as pc\n"
        "models = resources.files('platform_ctrl.models')\n"
        "platform = pc.read_platform('three_gyro_platform')\n"
        "[distribution] = metadata.distributions(name='platform_ctrl', path=[sys.argv[1]])\n"
        "print(json.dumps({\n"
        "    'file': pc.__file__,\n"
        "    'typed': resources.files('platform_ctrl').joinpath('py.typed').is_file(),\n"
        "    'models': sorted(m.name for m in models.iterdir() if m.name.endswith('.toml') and m.read_text('utf-8')),\n"
        "    'angles': platform.angle_names,\n"
        "    'commands': [entry.name for entry in distribution.entry_points if callable(entry.load())],\n"
        "    'version': distribution.version,\n"
        "    'licence': distribution.metadata['License-Expression'],\n"
        "}))\n"
    )
    new = "import sys; from platform_ctrl.cli import main; sys.exit(main(['new', 'mine', '--kind', 'camera-gimbal']))"
    run(sys.executable, "-c", new, cwd=tmp_path, PYTHONPATH=str(site))
    assert sorted(path.name for path in tmp_path.glob("mine*")) == ["mine.toml", "mine_plant.toml"]
    seen = json.loads(run(sys.executable, "-c", code, site, cwd=tmp_path, PYTHONPATH=str(site)))
    assert Path(seen["file"]).is_relative_to(site)
    assert seen["typed"]
    assert seen["models"] == sorted(path.name for path in (ROOT / "models").glob("*.toml"))
    assert seen["angles"] == ["alpha4", "beta5", "beta7", "alpha9", "beta10"]
    assert seen["commands"] == ["platform-ctrl"]
    assert seen["version"] == pc.__version__
    assert seen["licence"] == "BSD-3-Clause"
