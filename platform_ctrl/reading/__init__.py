"""TOML or dict -> frozen values: the only place where input is judged and units are converted."""

from __future__ import annotations

from platform_ctrl.reading.job import read_job
from platform_ctrl.reading.plant import read_platform
from platform_ctrl.reading.source import platform_source, shipped_models

__all__ = ["platform_source", "read_job", "read_platform", "shipped_models"]
