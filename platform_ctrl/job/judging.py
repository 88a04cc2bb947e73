"""A requirement on a measured value, and the verdict on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from platform_ctrl.analysis.metrics import METRICS, Quantity, Sense, over_limit
from platform_ctrl.common.values import input_value, value

Stage = Literal["decoupled", "coupled", "simulated"]
# How a value is found: "exact", of the plants of the set, to rounding or to 1e-9 from the worse side; "bound", one
# that is guaranteed not to be better than the true value; "proved", in interval arithmetic; "refined", the worst on a
# grid that is refined to 0.1 % around it; "sampled", the worst at the frequencies of a grid; "simulated", the worst at
# the samples of one run.
Method = Literal["exact", "bound", "proved", "refined", "sampled", "simulated"]


@value
class CheckResult:
    """A requirement held against a measured value.

    Attributes
    ----------
    name
        Name of the requirement, with the loop or run and the design that it is for.
    subject, design
        Loop or manoeuvre; name of the design, empty where all closed loops are meant.
    value, limit, unit, sense
        Measured value and its limit, both in `unit`.
    ratio
        Dimensionless; at most 1 when met.
    passed
        Whether it is.
    stage
        Stage of the check at which it was measured.
    evidence
        How the value can be recomputed.
    where
        Plant, torquer or controller of which the value is, as the evidence says it; empty where that names none.
    hard
        Whether the verdict rests on it; a goal that is missed is no failure.
    method
        How the value is found: ``"exact"``, ``"bound"``, ``"proved"``, ``"refined"``, ``"sampled"``, ``"simulated"``.
    reason
        Why the value is not better, where that is known; the evidence has it too.
    valid
        Whether the value can judge the limit: none is met by one that cannot.
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
    method: Method = "sampled"
    reason: str = ""
    valid: bool = True
    where: str = ""

    @property
    def title(self) -> str:
        """Loop or manoeuvre that it is about, and its design."""
        return f"{self.subject}, {self.design}" if self.design else self.subject

    def because(self, reason: str) -> CheckResult:
        """Return the result with a reason, or as it is without one."""
        return replace(self, reason=reason, evidence=f"{self.evidence}, {reason}") if reason else self

    @property
    def margin(self) -> float:
        """Distance to the limit, relative to the limit, positive when met; infinite where that is no number."""
        distance = self.value - self.limit if self.sense == "at least" else self.limit - self.value
        if not self.valid:
            return float("-inf")
        if distance == 0.0:
            return 0.0
        if not np.isfinite(self.value) or not np.isfinite(self.limit) or self.limit == 0.0:
            return float("inf") if self.passed else float("-inf")
        return distance / abs(self.limit)


@input_value
class Requirement:
    """A bound on one value.

    Attributes
    ----------
    name
        The value, in the field's words.
    limit, unit, sense
        The bound, > 0, in `unit`, and whether it is one from above or below.
    hard
        Whether it has to be met; a soft one is a goal, made as small as the hard ones allow.
    """

    name: str
    limit: float
    unit: str
    sense: Sense
    hard: bool = True

    @classmethod
    def of(cls, quantity: Quantity, limit: float, name: str = "") -> Requirement:
        """Return the limit on a quantity, under its name or another one."""
        return cls(name=name or quantity.name, limit=limit, unit=quantity.unit, sense=quantity.sense)

    def ratio(self, measured: float) -> float:
        """Return a number that is at most 1 when the bound is met."""
        return float(over_limit(measured, self.limit, self.sense))

    def judge(
        self,
        measured: float,
        *,
        subject: str,
        stage: Stage,
        evidence: str,
        design: str = "",
        method: Method | None = None,
        where: str = "",
    ) -> CheckResult:
        """Compare a measured value with the bound: met where the ratio is at most 1."""
        ratio, method = self.ratio(measured), method or ("simulated" if stage == "simulated" else "sampled")
        return CheckResult(
            name=self.name,
            subject=subject,
            design=design,
            value=float(measured),
            limit=self.limit,
            unit=self.unit,
            sense=self.sense,
            ratio=ratio,
            passed=ratio <= 1.0,
            stage=stage,
            evidence=evidence,
            hard=self.hard,
            method=method,
            where=where,
        )


# Stable, and by more than rounding: what decays more slowly takes an hour.
STABLE = Requirement.of(METRICS["stability"], 1e-3)
# Share of the claims of stability and disk margins that are proved.
PROVED = Requirement(name="certified properties", limit=1.0, unit="", sense="at least")


def tells_nothing(one: CheckResult) -> bool:
    """Whether a requirement that is met says nothing of how tight a design is.

    That is how slow the slowest pole is, if it decays at all, and that everything is proved.
    """
    return one.passed and one.name.startswith((STABLE.name, PROVED.name))


def severity(one: CheckResult) -> tuple[bool, bool, float]:
    """Return by what results are sorted: missed requirements, then met ones by their distance, then goals."""
    return not one.hard, one.passed, one.margin


def tightest(results: Sequence[CheckResult]) -> CheckResult | None:
    """Return the requirement that is missed by most, or met by least; None where nothing has a margin."""
    return min((one for one in results if not tells_nothing(one)), key=severity, default=None)


def drifting(angles: Sequence[str]) -> list[str]:
    """Return the condition under which a loop is stable that leaves angles free, in words; none without any."""
    if not angles:
        return []
    more, moves = ("s", "they drift") if len(angles) > 1 else ("", "it drifts")
    return [f"nothing holds the angle{more} {', '.join(angles)}: {moves}"]
