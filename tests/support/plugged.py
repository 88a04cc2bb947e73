"""Pytest runs inside tests, with the package's plugin as an installation registers it."""

from __future__ import annotations

import os
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import platform_ctrl as pc

PLUGIN = "platform_ctrl.cli.testing.plugin"


def installed() -> bool:
    """Whether pytest finds the plugin by itself: the package is installed, and not on the path alone."""
    return any(one.value == PLUGIN for one in entry_points(group="pytest11"))


def plugged_in(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """Make pytest find the plugin by its entry point; the package may not be installed, but on the path alone."""
    paths = [Path(pc.__file__).parents[1]]
    if not installed():
        info = pytester.mkdir("site") / "stand_in-0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stand-in\nVersion: 0\n", encoding="utf-8")
        (info / "entry_points.txt").write_text(f"[pytest11]\nplatform_ctrl = {PLUGIN}\n", encoding="utf-8")
        paths.append(info.parent)
    for path in paths:
        monkeypatch.syspath_prepend(path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, paths)))
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:cacheprovider")
    return pytester
