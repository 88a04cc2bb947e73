"""The public names, and the classes that users receive without one: as the reference pages of the site have them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

_SPEC = importlib.util.spec_from_file_location(
    "names", Path(__file__).resolve().parents[2] / "docs" / "site" / "names.py"
)
assert _SPEC is not None
assert _SPEC.loader is not None
names = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(names)


def described() -> dict[str, Any]:
    """Return the public classes and functions, and the classes that users receive, by module and name."""
    return dict(names.public()) | names.results()
