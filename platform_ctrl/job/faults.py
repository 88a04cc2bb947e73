"""Faults of simulated runs: the value, and a registry with one entry for each kind.

The job's reader, campaigns, reports, the simulation and the documentation are made from the registry.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import Misfit, given, missing, takes, useless, wrong
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.tables import record_value, shape

# What fails; None: the controllers.
PartKind = Literal["rotor", "torquer", "pick-off", "gimbal"]
PART_WORDS: dict[PartKind, str] = {
    "rotor": "a rotor",
    "torquer": "a torquer",
    "pick-off": "a pick-off or rate sensor, by its signal",
    "gimbal": "a gimbal",
}


@record_value
class Fault:
    """A part that fails at a given time.

    Attributes
    ----------
    name
        Its name in tables.
    kind
        One of `FAULT_KINDS`.
    part
        Name of the rotor, torquer, pick-off or rate sensor (its signal) or gimbal that fails; controllers need none.
    at
        When it begins, s.
    until
        When the part is sound again, s; default never.
    share
        What remains of L or of the torque; 1 is all.
    time_constant
        Of the exponential between nominal and `share`, s.
    amplitude, frequency_hz
        Of the ripple, relative to L, and Hz.
    rate
        Of the drift, rad/s; of a rate sensor, rad/s².
    probability
        That a sample is lost.
    impulse
        N m s; positive: towards the upper stop.
    """

    name: fields.Text
    kind: Annotated[str, fields.one_of(FAULT_KINDS)]
    part: fields.Text | None = None
    at: fields.NotNegative
    until: fields.Positive = math.inf
    share: fields.NotNegative = 0.0
    time_constant: fields.Positive = 0.0
    amplitude: fields.Positive = 0.0
    frequency_hz: fields.Positive = 0.0
    rate: fields.NotZero = 0.0
    probability: fields.SomePart = 1.0
    impulse: fields.NotZero = 0.0

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if table["at"] >= table.get("until", math.inf):
            yield wrong(table, "until", f"after at = {given(table['at'])}")
        kind, of = FAULT_KINDS[table["kind"]], f"kind = {given(table['kind'])}"
        numbers = shape(Fault).keys.keys() - {"name", "kind", "part", "at"}
        yield from takes(table, of, kind.needed, kind.optional, sorted(numbers))
        if kind.part is None and "part" in table:
            yield useless(table, "part", f"with {of}, which is of all controllers; leave the key out")
        elif kind.part is not None and "part" not in table:
            yield missing("part", f"{of} needs the name of {PART_WORDS[kind.part]}")

    @property
    def numbers(self) -> tuple[float, float]:
        """What the kernel takes: how large the fault is, and its time constant, s, or frequency, rad/s."""
        keys = FAULT_KINDS[self.kind].keys
        sizes = (getattr(self, key) for key in ("share", "amplitude", "rate", "probability", "impulse") if key in keys)
        return next(sizes, 0.0), self.time_constant or 2.0 * math.pi * self.frequency_hz

    @property
    def _needed(self) -> tuple[str, ...]:
        return FAULT_KINDS[self.kind].needed if self.kind in FAULT_KINDS else ()


class FaultKind(NamedTuple):
    """A kind of fault.

    Attributes
    ----------
    name
        What ``kind`` is in the job file.
    part
        What fails; None: the controllers.
    action
        What the kernel does.
    effect
        What that is, in words.
    needed, optional
        Names of the numbers that it must and may have beside `Fault.at`.
    """

    name: str
    part: PartKind | None
    action: str
    effect: str
    needed: tuple[str, ...] = ()
    optional: tuple[str, ...] = ("until",)

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of all numbers that it may have beside `at`."""
        return (*self.needed, *self.optional)


_RIPPLE = "L (1 + amplitude sin(2π frequency_hz (t − at)))"
_LOST = "a lost sample is replaced by the one before"
_MISSED = "at a missed sample commands and controller states do not change"
_PUSH = "an impulse at the joint drives it towards its stop"
_SPEED = (("time_constant",), ("share",))  # the numbers of a rotor that runs down or up
FAULT_KINDS: dict[str, FaultKind] = {
    kind.name: kind
    for kind in (
        FaultKind("rotor run-down", "rotor", "run-down", "L falls from nominal to share from at on", *_SPEED),
        FaultKind("rotor run-up", "rotor", "run-up", "L is at share before at, then rises to nominal", *_SPEED),
        FaultKind("speed ripple", "rotor", "ripple", _RIPPLE, ("amplitude", "frequency_hz")),
        FaultKind("torquer dead", "torquer", "no torque", "no torque"),
        FaultKind("torquer stuck", "torquer", "constant torque", "the torque stays as it was at the time at"),
        FaultKind("torquer weak", "torquer", "share of torque", "share of the commanded torque", ("share",)),
        FaultKind("pick-off dead", "pick-off", "no reading", "reads 0"),
        FaultKind("pick-off stuck", "pick-off", "last reading", "the last reading before at stays"),
        FaultKind("pick-off drift", "pick-off", "drift", "reads rate (t − at) too much", ("rate",)),
        FaultKind("pick-off dropout", "pick-off", "lost readings", _LOST, ("probability",)),
        FaultKind("controller overrun", None, "missed samples", _MISSED, (), ("until", "probability")),
        FaultKind("stop contact", "gimbal", "impulse", _PUSH, ("impulse",), ()),
    )
}


def part_names(platform: Platform, kind: PartKind) -> list[str]:
    """Return the names of the parts of a plant that a fault may happen to."""
    kinds: dict[str, Sequence[Any]]
    kinds = {"rotor": platform.rotors, "torquer": platform.torquers, "pick-off": platform.sensors}
    return [one.name for one in kinds.get(kind, platform.gimbals)]
