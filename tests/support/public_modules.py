"""The public names, and the classes that users receive without one: as the reference pages of the site have them."""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_SPEC = importlib.util.spec_from_file_location(
    "names", Path(__file__).resolve().parents[2] / "docs" / "site" / "names.py"
)
assert _SPEC is not None
assert _SPEC.loader is not None
names = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(names)


def public() -> dict[str, Any]:
    """Return the public classes and functions, each once, by module and name."""
    return dict(names.public())


def described() -> dict[str, Any]:
    """Return the public classes and functions, and the classes that users receive, by module and name."""
    return public() | names.results()


def methods(cls: type) -> Iterator[tuple[str, Any]]:
    """Yield the public functions and properties that a class itself defines."""
    for name, item in vars(cls).items():
        if name[0] != "_":
            if isinstance(item, classmethod | staticmethod):
                yield name, item.__func__
            elif inspect.isfunction(item) or isinstance(item, property):
                yield name, item
