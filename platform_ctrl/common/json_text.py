"""Results as JSON: plain types, a key a line and a row of a matrix a line, so that files can be read and compared."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.common.files import write_whole


def plain_types(item: Any) -> Any:
    """Return data in plain types; a number that is not finite is None."""
    match item:
        case Mapping():
            return {str(key): plain_types(entry) for key, entry in item.items()}
        case np.ndarray():
            return plain_types(item.tolist())
        case list() | tuple():
            return [plain_types(entry) for entry in item]
        case bool() | np.bool_():
            return bool(item)
        case int() | np.integer():
            return int(item)
        case float() | np.floating():
            return float(item) if math.isfinite(item) else None
    return item


def json_text(item: Any, indent: str = "") -> str:
    """Return data as JSON text; numbers that are not finite are null."""
    return _laid_out(plain_types(item), indent)


def write_json(item: Any, path: str | os.PathLike[str]) -> Path:
    """Write data as a JSON file, whole or not at all."""
    return write_whole(path, json_text(item) + "\n")


def _laid_out(item: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(item, dict) and item:
        lines = [f"{inner}{json.dumps(key)}: {_laid_out(entry, inner)}" for key, entry in item.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(item, list) and any(isinstance(entry, list | dict) for entry in item):
        return "[\n" + ",\n".join(inner + _laid_out(entry, inner) for entry in item) + f"\n{indent}]"
    return json.dumps(item, allow_nan=False)
