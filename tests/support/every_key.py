"""A job and a plant file with every key that there is, and what was read as plain values."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parents[1] / "data" / "fuzz"


def every_plant_key() -> dict[str, Any]:
    """Return the plant file with every key."""
    return tomllib.loads((HERE / "every_plant_key.toml").read_text(encoding="utf-8"))


def every_job_key() -> dict[str, Any]:
    """Return the job file with every key; its files are in `HERE`."""
    return tomllib.loads((HERE / "every_job_key.toml").read_text(encoding="utf-8"))


def meaning(item: Any) -> Any:
    """Return what was read in plain types, which can be compared."""
    if dataclasses.is_dataclass(item):
        return {field.name: meaning(getattr(item, field.name)) for field in dataclasses.fields(item)}
    if isinstance(item, np.ndarray):
        return item.tolist()
    if isinstance(item, tuple | list):
        return [meaning(entry) for entry in item]
    return {key: meaning(entry) for key, entry in item.items()} if isinstance(item, dict) else item
