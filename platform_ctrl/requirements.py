"""What a loop must do: one object that tunes, verifies, tests and reports.

A requirement turns a measured value into a ratio that is at most 1 when it is met, whatever its sense.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from platform_ctrl.analysis.plant_set import Group, LoopMeasures
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.job import LoopLimits

Sense = Literal["at least", "at most"]
Stage = Literal["decoupled", "coupled", "simulated"]
Kind = Literal[
    "stability",
    "damping",
    "fastest pole",
    "bandwidth",
    "disk margin",
    "sensitivity peak",
    "complementary peak",
    "tracking",
    "Omega rejection",
    "torque rejection",
    "torque noise",
    "torque limit",
    "H-infinity norm",
    "H2 norm",
    "controller poles",
    "controller gain",
]
NOMINAL: tuple[Group, ...] = ("nominal",)
SPREAD: tuple[Group, ...] = ("nominal", "spread", "Omega")
FAULTS: tuple[Group, ...] = ("nominal", "faults")


@value
class CheckResult:
    """A requirement held against a measured value.

    Attributes
    ----------
    name
        What is asked, with the loop or run and the design it is asked of.
    subject, design
        Loop or manoeuvre; name of the design, empty where all closed loops are meant.
    value, limit, unit, sense
        As measured and as asked.
    ratio
        At most 1 when met.
    passed
        Whether it is.
    stage
        Where in the chain it was measured.
    evidence
        What recomputes the value.
    hard
        Whether the verdict rests on it; a goal that is missed is no failure.
    """

    name: str
    subject: str
    design: str
    value: float
    limit: float
    unit: str
    sense: Sense
    ratio: float
    passed: bool
    stage: Stage
    evidence: str
    hard: bool = True

    @property
    def margin(self) -> float:
        """Relative distance to the limit, positive when met."""
        return 1.0 - self.ratio


@value
class Requirement:
    """A bound on one figure.

    Attributes
    ----------
    name
        The figure, in the field's words.
    limit, unit, sense
        The bound.
    hard
        Whether it has to be met; a soft one is a goal, made as small as the hard ones allow.
    """

    name: str
    limit: float
    unit: str
    sense: Sense
    hard: bool = True

    def ratio(self, measured: float) -> float:
        """Return a number that is at most 1 when `measured` meets the bound; infinite when it is no number."""
        if not np.isfinite(measured):
            return float("inf")
        if self.sense == "at most":
            return measured / self.limit
        return self.limit / measured if measured > 0.0 else float("inf")

    def judge(self, measured: float, *, subject: str, stage: Stage, evidence: str, design: str = "") -> CheckResult:
        """Hold `measured` against the bound."""
        passed = bool(np.isfinite(measured)) and (
            measured <= self.limit if self.sense == "at most" else measured >= self.limit
        )
        return CheckResult(
            name=self.name,
            subject=subject,
            design=design,
            value=float(measured),
            limit=self.limit,
            unit=self.unit,
            sense=self.sense,
            ratio=self.ratio(measured),
            passed=passed,
            stage=stage,
            evidence=evidence,
            hard=self.hard,
        )


# Stable, and by more than rounding: every disturbance of the loop has died away in a minute or two.
STABLE = Requirement(name="slowest decay", limit=0.05, unit="1/s", sense="at least")


@value
class LoopRequirement(Requirement):
    """A bound on a figure of one loop, of the nominal plant or of several plants of a set.

    Attributes
    ----------
    kind
        Which figure.
    over
        Of which groups of plants it is asked.
    frequency
        "tracking": up to which frequency, rad/s. "controller gain": from which frequency on; None: from a tenth of the
        nutation frequency.
    """

    kind: Kind
    over: tuple[Group, ...] = NOMINAL
    frequency: float | None = None

    @property
    def over_spread(self) -> bool:
        """Whether it is asked of more than the nominal plant."""
        return any(group != "nominal" for group in self.over)

    def figures(self, measures: LoopMeasures) -> FloatArray:
        """Return the figures that this bound is held against, one or several."""
        chosen = measures.of(self.over)
        if self.kind == "bandwidth":
            return np.array([measures.bandwidth / (2.0 * np.pi)])
        if self.kind == "torque noise":
            return measures.torque_noise
        by_plant: dict[str, FloatArray] = {
            "stability": measures.decay,
            "disk margin": measures.disk_margin,
            "damping": measures.damping,
        }
        out: FloatArray = by_plant[self.kind][chosen]
        return out

    def ratios(self, measures: LoopMeasures) -> FloatArray:
        """Return a ratio for every figure."""
        return np.array([self.ratio(float(figure)) for figure in self.figures(measures)])


def loop_requirements(limits: LoopLimits) -> tuple[LoopRequirement, ...]:
    """Return what `limits` ask of a loop; stability of every plant is always asked."""
    asked: list[LoopRequirement] = []

    def ask(
        name: str, limit: float | None, unit: str, sense: Sense, kind: Kind, over: tuple[Group, ...] = NOMINAL
    ) -> None:
        if limit is not None:
            asked.append(LoopRequirement(name=name, limit=limit, unit=unit, sense=sense, kind=kind, over=over))

    ask("slowest decay", STABLE.limit, STABLE.unit, STABLE.sense, "stability")
    ask("slowest decay over the spread", STABLE.limit, STABLE.unit, STABLE.sense, "stability", SPREAD)
    ask("bandwidth", limits.bandwidth_hz, "Hz", "at least", "bandwidth")
    ask("disk margin", limits.disk_margin, "", "at least", "disk margin")
    ask("damping", limits.damping, "", "at least", "damping")
    ask("torque noise, rms", limits.torque_noise, "N m", "at most", "torque noise")
    ask("disk margin over the spread", limits.disk_margin_spread, "", "at least", "disk margin", SPREAD)
    ask("damping over the spread", limits.damping_spread, "", "at least", "damping", SPREAD)
    return tuple(asked)
