"""Names of earlier versions: keys of job files with ``schema = 1``, and rows of kept results. Read, not written."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from platform_ctrl.plant.mistakes import Mistake, Path, given, tables

# Of the whole file, and of [loop.limits] and [loop.soft].
TABLES = {"spread": "uncertainty"}
LIMITS = {
    "disk_margin_spread": "disk_margin_worst_case",
    "sensitivity_peak_spread": "sensitivity_peak_worst_case",
    "complementary_peak": "complementary_sensitivity_peak",
    "complementary_peak_spread": "complementary_sensitivity_peak_worst_case",
    "damping_spread": "damping_worst_case",
    "controller_poles": "fastest_controller_pole",
}
# In the order in which they are replaced.
ROWS = (
    (r"\bslowest decay\b", "minimum decay rate"),
    (r"\bclaims proved\b", "certified properties"),
    (r"\bcomplementary peak\b", "complementary sensitivity peak"),
    (r"\bsurvived (Omega[123])", r"largest \1 without saturation"),
    (r" over the spread\b", ", worst case"),
    (r"\bthe run that was flown\b", "the run that was simulated"),
    (r"\brad s/rad\b", "rad/(rad/s)"),
)


def current_name(name: str) -> str:
    """Return the name, or the unit, that a row has in this version."""
    for old, new in ROWS:
        name = re.sub(old, new, name)
    return name


def _old_keys(data: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Path, str, str]]:
    """Walk the old keys of a job file: the table that has it and its place, the key, and its new name."""
    yield from ((data, (), old, new) for old, new in TABLES.items() if old in data)
    for k, loop in tables(data, "loop"):
        for name in ("limits", "soft"):
            limits = loop.get(name)
            if isinstance(limits, dict):
                yield from ((limits, ("loop", k, name), old, new) for old, new in LIMITS.items() if old in limits)


def renamed(data: dict[str, Any]) -> tuple[list[str], list[Mistake]]:
    """Give the old keys of a ``schema = 1`` file their new names, in place; return which, and which are mistakes."""
    found, mistakes = [], []
    for table, path, old, new in [*_old_keys(data)]:
        if data.get("schema") != 1 or isinstance(data["schema"], bool):
            text = f"{given(old)} is called {given(new)} in files with schema = 2; write the new name"
            mistakes.append(Mistake((*path, old), text))
        elif new in table:
            mistakes.append(
                Mistake((*path, old), f"{given(old)} is the old name of {given(new)}; leave one of them out")
            )
        else:
            found.append(f"{old} is now {new}")
            items = [(new if key == old else key, item) for key, item in table.items()]
            table.clear()
            table.update(items)
    return list(dict.fromkeys(found)), mistakes
