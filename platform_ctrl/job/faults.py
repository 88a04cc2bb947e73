"""Faults of simulated runs: the value, and a registry with one entry for each kind.

The job's reader, campaigns, reports, the simulation and the documentation are made from the registry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Literal

from platform_ctrl.common.values import value
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
        A name in `FAULT_KINDS`.
    part
        Name of the rotor, torquer, pick-off or rate sensor (its signal) or gimbal that fails; None for the controllers.
    at, until
        When it begins and when the part is sound again, s.
    share, time_constant, amplitude, frequency_hz, rate, probability, impulse
        Numbers that its kind needs or may have: 1, s, 1, Hz, rad/s (rad/s² on a rate sensor), 1, N m s.
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
    def _needed(self) -> tuple[str, ...]:
        return FAULT_KINDS[self.kind].needed if self.kind in FAULT_KINDS else ()


@value
class FaultKind:
    """A kind of fault.

    Attributes
    ----------
    name
        `Fault.kind`, in job files too.
    effect
        What happens, as the documentation says it.
    part
        The kind of part that fails; None for the controllers.
    needed, optional
        Names of the numbers that it needs beside `at`, and of those it may have.
    action
        Which action of the compiled kernel it is: a name in `platform_ctrl.simulation.kernel.arrays.ACTIONS`.
    numbers
        The two numbers of the action, from a fault.
    """

    name: str
    effect: str
    part: PartKind | None
    needed: tuple[str, ...] = ()
    optional: tuple[str, ...] = ("until",)
    action: str
    numbers: Callable[[Fault], tuple[float, float]] = lambda fault: (0.0, 0.0)

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of all numbers that it may have beside `at`."""
        return (*self.needed, *self.optional)


FAULT_KINDS: dict[str, FaultKind] = {
    kind.name: kind
    for kind in (
        FaultKind(
            name="rotor run-down",
            effect="L falls from nominal to share from at on",
            part="rotor",
            needed=("time_constant",),
            optional=("share",),
            action="run-down",
            numbers=lambda fault: (fault.share, fault.time_constant),
        ),
        FaultKind(
            name="rotor run-up",
            effect="L is at share before at, then rises to nominal",
            part="rotor",
            needed=("time_constant",),
            optional=("share",),
            action="run-up",
            numbers=lambda fault: (fault.share, fault.time_constant),
        ),
        FaultKind(
            name="speed ripple",
            effect="L (1 + amplitude sin(2π frequency_hz (t − at)))",
            part="rotor",
            needed=("amplitude", "frequency_hz"),
            action="ripple",
            numbers=lambda fault: (fault.amplitude, 2.0 * math.pi * fault.frequency_hz),
        ),
        FaultKind(name="torquer dead", effect="no torque", part="torquer", action="no torque"),
        FaultKind(
            name="torquer stuck",
            effect="the torque stays as it was at the time at",
            part="torquer",
            action="constant torque",
        ),
        FaultKind(
            name="torquer weak",
            effect="share of the commanded torque",
            part="torquer",
            needed=("share",),
            action="share of torque",
            numbers=lambda fault: (fault.share, 0.0),
        ),
        FaultKind(name="pick-off dead", effect="reads 0", part="pick-off", action="no reading"),
        FaultKind(
            name="pick-off stuck", effect="the last reading before at stays", part="pick-off", action="last reading"
        ),
        FaultKind(
            name="pick-off drift",
            effect="reads rate (t − at) too much",
            part="pick-off",
            needed=("rate",),
            action="drift",
            numbers=lambda fault: (fault.rate, 0.0),
        ),
        FaultKind(
            name="pick-off dropout",
            effect="a lost sample is replaced by the one before",
            part="pick-off",
            needed=("probability",),
            action="lost readings",
            numbers=lambda fault: (fault.probability, 0.0),
        ),
        FaultKind(
            name="controller overrun",
            effect="at a missed sample commands and controller states do not change",
            part=None,
            optional=("until", "probability"),
            action="missed samples",
            numbers=lambda fault: (fault.probability, 0.0),
        ),
        FaultKind(
            name="stop contact",
            effect="an impulse at the joint drives it towards its stop",
            part="gimbal",
            needed=("impulse",),
            optional=(),
            action="impulse",
            numbers=lambda fault: (fault.impulse, 0.0),
        ),
    )
}


def part_names(platform: Platform, kind: PartKind) -> list[str]:
    """Return the names of the parts of a plant that a fault may happen to."""
    return {
        "rotor": [rotor.name for rotor in platform.rotors],
        "torquer": [torquer.name for torquer in platform.torquers],
        "pick-off": [sensor.name for sensor in platform.sensors],
        "gimbal": list(platform.gimbal_names),
    }[kind]
