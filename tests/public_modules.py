"""The modules that users import from: what their names are documented by, and where the site has them."""

from __future__ import annotations

import functools
import importlib
import inspect
import sys
from collections.abc import Iterator
from typing import Any

# Behind platform_ctrl; a module without `__all__` is public with all that it defines.
MODULES = (
    "",
    "analysis",
    "analysis.certificates",
    "campaign",
    "cli.testing",
    "design",
    "design.measured",
    "errors",
    "export",
    "job.job",
    "job.parameters",
    "job.reading",
    "job.requirements",
    "job.scenario",
    "job.variation",
    "mechanics.equations",
    "mechanics.forces",
    "mechanics.matrices",
    "mechanics.rotors",
    "mechanics.linearisation",
    "mechanics.parameter_varying",
    "mechanics.precession",
    "mechanics.state_space",
    "mechanics.symbolic.equations",
    "mechanics.term_table",
    "mechanics.terms",
    "plant.force_elements",
    "plant.platform",
    "plant.reading",
    "plant.source",
    "report",
    "report.figures",
    "simulation",
    "verification",
    "verification.baselines",
)


@functools.cache
def public() -> dict[str, Any]:
    """Return the objects that the public names stand for, each once, by module and name."""
    found: dict[str, Any] = {}
    known = set()
    for part in MODULES:
        name = f"platform_ctrl.{part}".rstrip(".")
        importlib.import_module(name)
        module = sys.modules[name]
        own = [n for n, o in vars(module).items() if n[0] != "_" and getattr(o, "__module__", None) == name]
        for public_name in getattr(module, "__all__", own):
            item = getattr(module, public_name)
            if (inspect.isclass(item) or inspect.isroutine(item)) and id(item) not in known:
                known.add(id(item))
                found[f"{name}.{public_name}"] = item
    return found


def methods(cls: type) -> Iterator[tuple[str, Any]]:
    """Yield the public functions and properties that a class itself defines."""
    for name, item in vars(cls).items():
        if name[0] != "_":
            if isinstance(item, classmethod | staticmethod):
                yield name, item.__func__
            elif inspect.isfunction(item) or isinstance(item, property):
                yield name, item
