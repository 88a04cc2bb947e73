"""Requirements: a limit on a metric of a loop, and the verdict on a measured value.

A requirement turns a measured value into a ratio that is at most 1 when it is met, whatever its sense. It is checked on
a plant set and a controller (`LoopRequirement.check`), or on metrics that were measured already
(`LoopRequirement.ratios`). The metrics are `platform_ctrl.analysis.metrics.METRICS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import get_args

import numpy as np

from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.metrics import METRICS, Metric, over_limit
from platform_ctrl.analysis.plant_set import Group, PlantSet
from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.common.arguments import known_name, nearest, one_of, positive
from platform_ctrl.common.values import FloatArray, input_value, replaced
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.judging import STABLE, CheckResult, Method, Requirement, drifting
from platform_ctrl.job.resolve import KEYHOLE
from platform_ctrl.plant.mistakes import Misfit, missing, wrong
from platform_ctrl.plant.tables import unknown_key

__all__ = ["requirement"]

# Metrics of steps, which count between samples as well.
BETWEEN_SAMPLES = ("overshoot", "settling time")
NOMINAL: tuple[Group, ...] = ("nominal",)
WORST_CASE: tuple[Group, ...] = ("nominal", "uncertainty", "Omega", "angles", "friction")
FAULTS: tuple[Group, ...] = ("nominal", "faults")
# Groups of plants by the ending of a limit's key, and how a name says them.
SCOPES: dict[str, tuple[Group, ...]] = {"": NOMINAL, "worst_case": WORST_CASE, "faults": FAULTS}
# How the name of a goal begins.
GOAL = "goal: "
SCOPE_WORDS = {"": "", "worst_case": ", worst case", "faults": " with a fault"}


@input_value
class LoopRequirement(Requirement):
    """A limit on a metric of one loop, of the nominal plant or of several plants of a set; see `requirement`.

    Attributes
    ----------
    name, limit, unit, sense, hard
        As of `Requirement`.
    kind
        Key of the metric in `METRICS`.
    over
        Groups of plants that it is about.
    frequency
        Edge of the metric's band, rad/s; None: no edge ("controller gain": a tenth of the nutation frequency).
    lowest
        Where a band that ends at `frequency` begins, rad/s.
    """

    kind: str
    over: tuple[Group, ...] = NOMINAL
    frequency: float | None = None
    lowest: float = 0.0

    @property
    def metric(self) -> Metric:
        """What is measured: an entry of `METRICS`."""
        return METRICS[self.kind]

    @property
    def beyond_nominal(self) -> bool:
        """Whether it is about more than the nominal plant."""
        return any(group != "nominal" for group in self.over)

    def values(self, metrics: LoopMetrics) -> FloatArray:
        """Return the measured values that this requirement is about, one or several.

        Parameters
        ----------
        metrics
            From `measure`, with this requirement among the requests.

        Returns
        -------
        (k,)
            In the requirement's unit.

        Raises
        ------
        ArgumentError
            `metrics` were measured without this requirement.
        """
        return self.metric.in_unit(metrics.values(self))

    def ratios(self, metrics: LoopMetrics) -> FloatArray:
        """Return a ratio for every measured value.

        Parameters
        ----------
        metrics
            From `measure`, with this requirement among the requests.

        Returns
        -------
        (k,)
            Dimensionless; at most 1 where the limit is met.

        Raises
        ------
        ArgumentError
            `metrics` were measured without this requirement.
        """
        return over_limit(self.values(metrics), self.limit, self.sense)

    def result(self, plants: PlantSet, metrics: LoopMetrics, *, subject: str = "", design: str = "") -> CheckResult:
        """Judge the worst value; the evidence names the plant, or the torquer, that it is from.

        Parameters
        ----------
        plants
            The plants that were measured.
        metrics
            From `measure`, with this requirement among the requests.
        subject, design
            Names for the result.

        Returns
        -------
        CheckResult
            Of the worst value.

        Raises
        ------
        ArgumentError
            `metrics` were measured without this requirement.
        """
        values = self.values(metrics)
        worst = int(values.argmax() if self.sense == "at most" else values.argmin())
        if self.metric.of == "controller":
            where = "controller"
        elif self.kind == "torque noise" and not self.beyond_nominal:
            where = f"torquer {plants.torques[worst]}"
        elif self.beyond_nominal:
            where = plants.labels[np.flatnonzero(plants.of(self.over))[worst]]
        else:
            where = "nominal plant"
        # Of the nominal plant and of the controller there is one.
        number, found = len(values) if self.beyond_nominal else 1, float(values[worst])
        if self.metric.of_sight:
            where = ""
            evidence = (
                "linear budget of all loops closed, at the worst gimbal angles, with dry friction where there is some"
            ) + ("; sines count as Gaussian" if self.metric.key == "contrast" else "")
        else:
            norm = "; exact H-infinity norm" if metrics.exact and self.kind == "disk margin" else ""
            evidence = f"{where}; {number} plant{'' if number == 1 else 's'}, sampled with delay and torquer lag{norm}"
            evidence += self._conditions(plants, metrics.free_angles, found)
        method: Method = "refined" if self._between_samples else "exact"
        method = method if metrics.exact or not (self._between_samples or self.metric.searched) else "sampled"
        about = {"subject": subject, "design": design, "evidence": evidence, "where": where}
        judged = self.judge(found, stage="decoupled", method=method, **about)
        if not self.metric.of_sight or 0.0 < found < np.inf:
            return judged
        words = "no linear budget holds: all loops together are unstable, or bearings stick: platform-ctrl budget says"
        return judged.because(words)

    @property
    def _between_samples(self) -> bool:
        return self.kind in BETWEEN_SAMPLES or bool(self.metric.disturbed_by)

    def _conditions(self, plants: PlantSet, free: Sequence[str], value: float) -> str:
        """Return further assumptions of a value: held gimbals, free angles, dry friction, times between samples."""
        words = []
        if self._between_samples:
            words.append("between samples, by a grid refined to 0.1 %")
        if self.metric.of != "controller":
            if plants.held:
                words.append(f"held: {', '.join(plants.held)}")
            if plants.tilted and "Omega" in self.metric.disturbed_by:
                words.append("gravity fixed in space, tilts of at most 1 rad")
            if plants.limited:
                words.append(f"{KEYHOLE} at {'; '.join(plants.limited)}")
            if self.kind == "stability":
                words += drifting(free)
            if self.kind == "torque noise" and free:
                words.append("with an hour of that drift")
            if self.kind == "torque noise" and plants.quantised:
                words.append(f"quantisation of {', '.join(plants.quantised)} not counted")
            if plants.dry_friction:
                has = np.any(plants.of(self.over) & plants.of(("friction",)))
                words.append("with dry friction" if has else "without dry friction")
        if np.isinf(value) and self.metric.disturbed_by and self.lowest == 0.0:
            words.append("infinite where the loop is not stable, or grows without bound towards zero frequency")
            if key := self.metric.lowest_key:
                words.append(f"where that is meant, say from which frequency on: {key}")
        return "".join(f"; {one}" for one in words)

    def check(self, plants: PlantSet, controller: StateSpace | System) -> CheckResult:
        """Close `controller` around the plants and judge, peaks as norms: ``assert requirement.check(...).passed``.

        Parameters
        ----------
        plants
            The plants.
        controller
            u = K y with the set's sample period. A `control.StateSpace` is joined by its signals' names.

        Returns
        -------
        CheckResult
            Of the worst plant.

        Raises
        ------
        ArgumentError
            The controller does not fit the plants, or the set has no plant of the groups.
        """
        K = plants.joined(controller)
        if self.metric.of != "controller" and not plants.of(self.over).any():
            raise ArgumentError(
                f"{self.name} is about {', '.join(self.over)}; the set of plants must have such ones, here "
                f"{', '.join(dict.fromkeys(plants.groups))}"
            )
        return self.result(plants, measure(plants, K, [self]))


# Names of gains of a loop whose sensors measure rates, by those for angles.
_OF_RATES = {
    "angle from Omega": "rate from Omega",
    "angle from torque": "rate from torque",
    "rad/(rad/s)": "(rad/s)/(rad/s)",
    "rad/(N m)": "(rad/s)/(N m)",
    "N m/rad": "N m/(rad/s)",
}
# A tracking loop sets commands of rates instead of torques.
_OF_COMMANDS = {
    "angle from torque": "angle from commanded rate",
    "torque noise": "noise of the commanded rate",
    "rad/(N m)": "rad/(rad/s)",
    "N m/rad": "(rad/s)/rad",
    "N m": "rad/s",
}


def of_readings(words: str, kind: str) -> str:
    """Return name or unit of a metric for a loop of this kind: rate loops read rates, tracking loops command them."""
    for usual, own in {"rate": _OF_RATES, "tracking": _OF_COMMANDS}.get(kind, {}).items():
        if words.startswith(usual):
            return words.replace(usual, own, 1)
    return words


def requirement(
    kind: str,
    limit: float,
    *,
    over: tuple[Group, ...] = NOMINAL,
    hard: bool = True,
    frequency: float | None = None,
    lowest: float = 0.0,
    name: str | None = None,
) -> LoopRequirement:
    """Return a limit on a metric of a loop; the table of metrics has its name, unit and sense.

    Parameters
    ----------
    kind
        A key of `platform_ctrl.analysis.metrics.METRICS`, such as ``"disk margin"``; docs/reference/job-file.md lists
        them with units, senses and meanings.
    limit
        Above 0, in the unit of the metric.
    over
        Groups of plants that it is about: `NOMINAL`, `WORST_CASE` (with Omega), `FAULTS`, or any choice of groups.
    hard
        False for a goal.
    frequency
        rad/s, see `LoopRequirement`; required for "tracking" and "attenuation".
    lowest
        rad/s, at least 0 and below `frequency`: where the band of these two begins.
    name
        Instead of the metric's own.

    Returns
    -------
    LoopRequirement
        The same object for tuning, checking and reporting.

    Raises
    ------
    ArgumentError
        An unknown kind or group, a limit that is not > 0, or a frequency that is missing or means nothing.

    Examples
    --------
    >>> from platform_ctrl.job import requirements
    >>> margin = requirements.requirement("disk margin", 0.5)
    >>> round(margin.ratio(0.75), 4)  # at most 1: met
    0.6667
    """
    one_of("requirement: kind", kind, tuple(METRICS))
    metric = METRICS[kind]
    over = tuple(over)
    for group in over or ("none",):
        one_of("requirement: over", group, get_args(Group))
    if metric.needs_frequency and frequency is None:
        raise ArgumentError(f"requirement: {kind} needs a frequency: {metric.band} which one, rad/s")
    if frequency is not None:
        one_of("requirement: kind with a frequency", kind, [key for key, one in METRICS.items() if one.band])
        frequency = positive("requirement: frequency", frequency)
    if lowest and not (metric.band == "up to" and frequency is not None and 0.0 <= lowest < frequency):
        raise ArgumentError(
            f"requirement: lowest must be from 0 to below frequency, got {lowest!r}, and only a band that ends at a "
            "frequency has one"
        )
    return LoopRequirement(
        name=metric.name if name is None else name,
        limit=positive("requirement: limit", limit),
        unit=metric.unit,
        sense=metric.sense,
        hard=hard,
        kind=kind,
        over=over,
        frequency=frequency,
        lowest=float(lowest),
    )


def limit_keys() -> dict[str, tuple[str, str]]:
    """Return the keys of ``[loop.limits]``: of each the metric, and what it is.

    ``""``, ``"worst_case"`` and ``"faults"`` are limits and the plants that they are about; ``"from_hz"`` and ``"hz"``
    the edges of the metric's band.
    """
    out = {}
    for scope in SCOPES:
        for kind, metric in METRICS.items():
            if metric.key and scope in metric.scopes:
                out[f"{metric.key}_{scope}" if scope else metric.key] = kind, scope
    for kind, metric in METRICS.items():
        if metric.frequency_key:
            out |= {metric.frequency_key: (kind, "hz"), metric.lowest_key: (kind, "from_hz")}
    return out


def limit_misfits(limits: Mapping[str, float]) -> Iterator[Misfit]:
    """Yield what is wrong with the limits or the goals of a loop: keys, and edges of bands without their metric."""
    known = limit_keys()
    yield from out_of_reach(limits)
    # A key that is mistyped is not missing as well.
    meant = {key if key in known else nearest(key, known) for key in limits}
    for key in sorted(limits):
        if key not in known:
            yield key, unknown_key((key,), limits[key], list(known)).words
    for metric in METRICS.values():
        edge, lowest = metric.frequency_key, metric.lowest_key
        of = [key for key, (name, scope) in known.items() if METRICS[name] is metric and scope in SCOPES]
        given = [key for key in of if key in limits]
        if edge in limits and not meant.intersection(of):
            yield missing(metric.key, f"{edge} has no effect without it")
        elif given and metric.needs_frequency and edge not in meant:
            yield missing(edge, f"{given[0]} has no effect without it")
        if lowest not in limits:
            continue
        if edge not in meant:
            words = f"{lowest} has no effect without {edge}, where the band ends; add it, or leave this out"
            yield lowest, words
        elif edge in limits and limits[edge] <= limits[lowest]:
            yield wrong(limits, lowest, f"below {edge} = {limits[edge]:g}", "; the band begins there")


def out_of_reach(limits: Mapping[str, float]) -> Iterator[Misfit]:
    """Yield the limits or goals of a loop, or of all loops together, that no loop can meet."""
    for key, (name, scope) in limit_keys().items():
        best = METRICS[name].best
        if key in limits and scope in SCOPES and best is not None and limits[key] > best:
            yield wrong(limits, key, f"at most {best:g}", "; no loop has more")


def loop_requirements(limits: Mapping[str, float], kind: str = "caging") -> tuple[LoopRequirement, ...]:
    """Return the requirements of a loop of a kind; every plant that a limit is about has to be stable."""
    stable = METRICS["stability"].name
    always = [
        requirement("stability", STABLE.limit, over=SCOPES[scope], name=stable + SCOPE_WORDS[scope])
        for scope in SCOPES
        if scope != "faults" or any(key.endswith("_faults") for key in limits)
    ]
    return (*always, *_required(limits, kind, hard=True))


def loop_goals(soft: Mapping[str, float], kind: str = "caging") -> tuple[LoopRequirement, ...]:
    """Return the goals of a loop of a kind, which no verdict rests on."""
    return _required(soft, kind, hard=False)


def _required(limits: Mapping[str, float], kind: str, hard: bool) -> tuple[LoopRequirement, ...]:
    known = limit_keys()
    for key in limits:
        known_name("limits", key, tuple(known))
    out = []
    for key, (name, scope) in known.items():
        if key in limits and scope in SCOPES:
            metric = METRICS[name]
            edge = limits.get(metric.frequency_key)
            one = requirement(
                name,
                limits[key],
                over=SCOPES[scope],
                hard=hard,
                frequency=None if edge is None else 2.0 * np.pi * edge,
                lowest=2.0 * np.pi * limits.get(metric.lowest_key, 0.0),
            )
            words = f"{'' if hard else GOAL}{of_readings(metric.name, kind)}{SCOPE_WORDS[scope]}"
            out.append(replaced(one, {"name": words, "unit": of_readings(one.unit, kind)}))
    return tuple(out)
