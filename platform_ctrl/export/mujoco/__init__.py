"""MJCF, the model files of MuJoCo: a platform out of it and into it."""

from __future__ import annotations

from platform_ctrl.export.mujoco.reading import read_mjcf
from platform_ctrl.export.mujoco.writing import write_mjcf

__all__ = ["read_mjcf", "write_mjcf"]
