"""Public names that are loaded on first use (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names its ``__init__.pyi`` lists.

    Each line of it is ``from .module import name as name``, or ``from . import module as module``: one list for users,
    the type checker and the documentation.
    """
    lines = Path(file).with_suffix(".pyi").read_text(encoding="utf-8").splitlines()
    home = {words[3]: words[1] for words in map(str.split, lines) if words[:1] == ["from"]}

    def get(name: str) -> Any:
        module = sys.modules[package]
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=module)
        found = import_module(home[name] + name if home[name] == "." else home[name], package)
        item = found if home[name] == "." else getattr(found, name)
        setattr(module, name, item)
        return item

    return get, lambda: sorted({*vars(sys.modules[package]), *home}), sorted(home)
