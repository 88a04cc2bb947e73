"""Comparison with an accepted result: two contents of result.json, value by value."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np

from platform_ctrl.analysis.metrics import COUPLED_METRICS, METRICS, RUN_METRICS, Quantity, Sense
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import value
from platform_ctrl.verification.coupled import ALL_LOOPS

State = Literal["within", "worse", "better", "missing", "new"]
Record = Mapping[str, Any]

# A difference of two margins lies near zero: its tolerance is no share of it.
_DIFFERENCES = (COUPLED_METRICS["coupling cost"].name,)
# Values that differ by less are zero, in any unit.
_ZERO = 1e-12
# The same loop on another machine.
_ROUNDING = 1e-6


@value
class Compared:
    """One value, accepted and now.

    Attributes
    ----------
    subject, name, unit, sense
        Loop, manoeuvre or ``all loops closed``; the name that a requirement on it has; SI, and Hz for bandwidths;
        ``"at least"``: more is better.
    before, now
        In `unit`; not finite where there is none (an unstable loop, a run that diverged), None where it is not listed.
    allowed
        How far `now` may be worse than `before`, in `unit`.
    state
        ``"within"`` the tolerance, ``"worse"`` or ``"better"`` by more than it, ``"missing"``: accepted and no longer
        measured, ``"new"``: not in the accepted result.
    limit
        The limit in the job, in `unit`; None without one.
    """

    subject: str
    name: str
    unit: str
    sense: Sense
    before: float | None
    now: float | None
    allowed: float = 0.0
    state: State
    limit: float | None = None

    @property
    def share(self) -> float:
        """The change as a share of the accepted value, with its sign; not a number where it cannot be said."""
        if self.before is None or self.now is None or not math.isfinite(self.before) or self.before == 0.0:
            return math.nan
        return (self.now - self.before) / abs(self.before)


@value
class Comparison:
    """A result compared with an accepted one.

    Attributes
    ----------
    changes
        One for every value: those of the result in its order, then those that are missing.
    differing
        What the two do not have in common, in words: another plant, another job, the controller of a loop.
    """

    changes: tuple[Compared, ...]
    differing: tuple[str, ...]

    def of(self, *states: State) -> tuple[Compared, ...]:
        """Return the changes in one of a few states, in their order."""
        return tuple(change for change in self.changes if change.state in states)

    @property
    def passed(self) -> bool:
        """Whether nothing is worse and nothing missing; what is better or new is no failure."""
        return not self.of("worse", "missing")


def compare(result: Record, accepted: Record, tolerance: float) -> Comparison:
    """Compare the content of a result.json with that of an accepted one.

    Parameters
    ----------
    result, accepted
        From `result_file.result_record` and `result_file.read_record`.
    tolerance
        Share of the accepted value by which a value may be worse. A value that is no longer finite is worse
        whatever the tolerance.
    """
    before, now = _values(accepted), _values(result)
    changes = [_change(now[key], before.get(key), tolerance) for key in now]
    missing = [one for key, one in before.items() if key not in now]
    changes += [dataclasses.replace(one, before=one.now, now=None, state="missing", limit=None) for one in missing]
    return Comparison(changes=tuple(changes), differing=tuple(_differing(result, accepted)))


def _change(now: Compared, before: Compared | None, tolerance: float) -> Compared:
    accepted = None if before is None else before.now
    allowed, state = 0.0, "new"
    if accepted is not None and now.now is not None:
        finite = math.isfinite(accepted)
        allowed = max(tolerance * (1.0 if now.name in _DIFFERENCES else abs(accepted)), _ZERO) if finite else 0.0
        sign = -1.0 if now.sense == "at least" else 1.0
        was, found = (sign * x if math.isfinite(x) else math.inf for x in (accepted, now.now))
        loss = 0.0 if was == found else found - was
        # A value at its tolerance is within it, whatever the last bit says.
        edge = allowed * (1.0 + 1e-9) + (1e-9 * abs(accepted) if finite else 0.0)
        state = "worse" if loss > edge else "better" if loss < -edge else "within"
    return dataclasses.replace(now, before=accepted, allowed=allowed, state=state)  # type: ignore[arg-type]


def _values(record: Record) -> dict[tuple[str, ...], Compared]:
    """Return the values of a result, each once, by what they are recognised by; a value in another unit is another."""
    found: dict[tuple[str, ...], Compared] = {}
    # Values of requirements first, with their stages, as others may repeat them.
    required = [
        (one["stage"], _of(one["subject"], one["name"], one["unit"], one["sense"], one["value"], one["limit"]))
        for one in record["requirements"]
    ]
    for stage, one in (*required, *(("", one) for one in _others(record))):
        # What is no requirement may repeat one; a loop and the line of sight may have one name.
        if stage or not any(key[:2] == (one.subject, one.name) for key in found):
            found.setdefault((one.subject, one.name, one.unit, one.sense, stage), one)
    return found


def _others(record: Record) -> Iterator[Compared]:
    for K in record["controllers"]:
        for goal in K.get("goals", ()):
            yield _of(K["name"], goal["name"], goal["unit"], goal["sense"], goal["value"])
        for kind in ("disk margin", "damping"):
            if kind.replace(" ", "_") in K["claims"]:
                yield _measured(K["name"], METRICS[kind], K["claims"][kind.replace(" ", "_")])
    coupled = record["coupled"]
    if "simultaneous_disk_margin" in coupled:
        quantity = COUPLED_METRICS["simultaneous disk margin"]
        yield _measured(ALL_LOOPS, quantity, coupled["simultaneous_disk_margin"]["lower"])
    for one in coupled.get("loop_by_loop", ()):
        for kind, key in (("disk margin", "coupled"), ("torque noise", "torque_noise")):
            yield _measured(ALL_LOOPS, METRICS[kind], one[key], f"{kind}, {one['channel']}")
    for run in record["runs"]:
        for key, largest in run["largest"].items():
            yield _measured(run["name"], RUN_METRICS[key], largest["value"])


def _measured(subject: str, quantity: Quantity, number: float | None, name: str = "") -> Compared:
    return _of(subject, name or quantity.name, quantity.unit, quantity.sense, number)


def _of(subject: str, name: str, unit: str, sense: Sense, now: float | None, limit: float | None = None) -> Compared:
    number = math.nan if now is None else float(now)
    return Compared(
        subject=subject, name=name, unit=unit, sense=sense, before=None, now=number, state="new", limit=limit
    )


def _differing(result: Record, accepted: Record) -> Iterator[str]:
    """Yield what two results do not have in common, as far as both say it."""
    for key, words in (("plant", "another plant"), ("job", "another job")):
        before, now = accepted["sha256"].get(key), result["sha256"].get(key)
        if before != now and not (key == "job" and accepted["sha256"].get("plant") != result["sha256"].get("plant")):
            yield words
    known = {K["name"]: K for K in accepted["controllers"]}
    for K in result["controllers"]:
        before = known.get(K["name"])
        if before is not None:
            matrices = [[np.array(one[name], dtype=np.float64) for name in "ABCD"] for one in (K, before)]
            a, b = (System(A, B, C, D) for A, B, C, D in matrices)
            if not a.alike(b, _ROUNDING):
                yield f"another controller of {K['name']}"
