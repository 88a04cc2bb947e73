"""What a loop must do: one object that tunes, verifies, tests and reports.

A requirement turns a measured value into a ratio that is at most 1 when it is met, whatever its sense.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from platform_ctrl.analysis.plant_set import LoopMeasures
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.job import LoopLimits

Sense = Literal["at least", "at most"]
Stage = Literal["decoupled", "coupled", "simulated"]
Kind = Literal["stability", "bandwidth", "disk margin", "damping", "torque noise"]


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
    """

    name: str
    limit: float
    unit: str
    sense: Sense

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
        )


# Stable, and by more than rounding: every disturbance of the loop has died away in a minute or two.
STABLE = Requirement(name="slowest decay", limit=0.05, unit="1/s", sense="at least")


@value
class LoopRequirement(Requirement):
    """A bound on a figure of one loop, nominal or over the parameter spread.

    Attributes
    ----------
    kind
        Which figure of `LoopMeasures`.
    over_spread
        Whether it is asked of every plant of the set, the nominal one among them, or of the nominal one alone.
    """

    kind: Kind
    over_spread: bool = False

    def figures(self, measures: LoopMeasures) -> FloatArray:
        """Return the figures that this bound is held against, one or several."""
        chosen = slice(None) if self.over_spread else slice(0, 1)
        if self.kind == "bandwidth":
            return np.array([measures.bandwidth / (2.0 * np.pi)])
        if self.kind == "torque noise":
            return measures.torque_noise
        by_plant = {"stability": measures.decay, "disk margin": measures.disk_margin, "damping": measures.damping}
        return by_plant[self.kind][chosen]

    def ratios(self, measures: LoopMeasures) -> FloatArray:
        """Return a ratio for every figure."""
        return np.array([self.ratio(float(figure)) for figure in self.figures(measures)])


def loop_requirements(limits: LoopLimits) -> tuple[LoopRequirement, ...]:
    """Return what `limits` ask of a loop; stability of every plant is always asked."""
    asked: list[LoopRequirement] = []

    def ask(name: str, limit: float | None, unit: str, sense: Sense, kind: Kind, over_spread: bool = False) -> None:
        if limit is not None:
            asked.append(
                LoopRequirement(name=name, limit=limit, unit=unit, sense=sense, kind=kind, over_spread=over_spread)
            )

    ask("slowest decay", STABLE.limit, STABLE.unit, STABLE.sense, "stability")
    ask("slowest decay over the spread", STABLE.limit, STABLE.unit, STABLE.sense, "stability", True)
    ask("bandwidth", limits.bandwidth_hz, "Hz", "at least", "bandwidth")
    ask("disk margin", limits.disk_margin, "", "at least", "disk margin")
    ask("damping", limits.damping, "", "at least", "damping")
    ask("torque noise, rms", limits.torque_noise, "N m", "at most", "torque noise")
    ask("disk margin over the spread", limits.disk_margin_spread, "", "at least", "disk margin", True)
    ask("damping over the spread", limits.damping_spread, "", "at least", "damping", True)
    return tuple(asked)
