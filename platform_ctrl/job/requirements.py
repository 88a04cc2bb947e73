"""What a loop must do: one object that tunes, verifies, tests and reports.

A requirement turns a measured value into a ratio that is at most 1 when it is met, whatever its sense. It is held
against a plant set and a controller (`LoopRequirement.check`), against a closed loop with named signals
(`LoopRequirement.check_closed_loop`), or against figures that were measured already (`LoopRequirement.ratios`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.loop_figures import BANDED, GRIDDED, OF_CONTROLLER, fastest
from platform_ctrl.analysis.loop_measures import LoopMeasures, exact_figures
from platform_ctrl.analysis.norms import h2_norm
from platform_ctrl.analysis.peaks import peak
from platform_ctrl.analysis.plant_set import Group, PlantSet
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping, poles, spectral_abscissa
from platform_ctrl.common.arguments import one_of, positive
from platform_ctrl.common.signatures import check_arguments, check_kinds
from platform_ctrl.common.values import FloatArray, input_value, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import LoopLimits

if TYPE_CHECKING:
    import control

Sense = Literal["at least", "at most"]
Stage = Literal["decoupled", "coupled", "simulated"]
# How a value is found: "exact", of the plants that are judged, to rounding or to 1e-9 from the worse side; "bound", one
# that is guaranteed not to be better than the true value; "proved", in interval arithmetic; "sampled", the worst at the
# frequencies of a grid; "simulated", the worst at the samples of one run.
Method = Literal["exact", "bound", "proved", "sampled", "simulated"]
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

# What each kind is called where it is judged, its unit, its sense.
_WORDS: dict[Kind, tuple[str, str, Sense]] = {
    "stability": ("slowest decay", "1/s", "at least"),
    "damping": ("damping", "", "at least"),
    "fastest pole": ("fastest pole", "rad/s", "at most"),
    "bandwidth": ("bandwidth", "Hz", "at least"),
    "disk margin": ("disk margin", "", "at least"),
    "sensitivity peak": ("sensitivity peak", "", "at most"),
    "complementary peak": ("complementary peak", "", "at most"),
    "tracking": ("tracking error", "", "at most"),
    "Omega rejection": ("angle from Omega", "rad s/rad", "at most"),
    "torque rejection": ("angle from torque", "rad/(N m)", "at most"),
    "torque noise": ("torque noise, rms", "N m", "at most"),
    "torque limit": ("torque at full Omega over its limit", "", "at most"),
    "H-infinity norm": ("H-infinity norm", "", "at most"),
    "H2 norm": ("H2 norm", "", "at most"),
    "controller poles": ("fastest pole of the controller", "rad/s", "at most"),
    "controller gain": ("gain of the controller", "N m/rad", "at most"),
}
# Kinds that a closed loop answers by itself, without knowing which of its signals are torques and angles.
_OF_CLOSED_LOOP = ("stability", "damping", "fastest pole", "H-infinity norm", "H2 norm")


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
        As measured and as asked, both in `unit`.
    ratio
        Dimensionless; at most 1 when met.
    passed
        Whether it is.
    stage
        Where in the chain it was measured.
    evidence
        What recomputes the value.
    hard
        Whether the verdict rests on it; a goal that is missed is no failure.
    method
        How the value is found: ``"exact"``, ``"bound"``, ``"proved"``, ``"sampled"`` or ``"simulated"``.
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

    @property
    def margin(self) -> float:
        """Distance to the limit, relative to the limit, positive when met; infinite where that is no number."""
        distance = self.value - self.limit if self.sense == "at least" else self.limit - self.value
        if distance == 0.0:
            return 0.0
        if not np.isfinite(self.value) or not np.isfinite(self.limit) or self.limit == 0.0:
            return float("inf") if self.passed else float("-inf")
        return distance / abs(self.limit)


@input_value
class Requirement:
    """A bound on one figure.

    Attributes
    ----------
    name
        The figure, in the field's words.
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

    @check_kinds
    def ratio(self, measured: float) -> float:
        """Return a number that is at most 1 when the bound is met.

        Parameters
        ----------
        measured
            The figure, in the requirement's unit.

        Returns
        -------
        float
            Dimensionless; infinite when `measured` is no number.

        Raises
        ------
        ArgumentError
            An argument of another kind than annotated.
        """
        measured = float(measured)
        if not np.isfinite(measured):
            return float("inf")
        if self.limit == 0.0:
            return 1.0 if (measured <= 0.0 if self.sense == "at most" else measured >= 0.0) else float("inf")
        if self.sense == "at most":
            return measured / self.limit
        return self.limit / measured if measured > 0.0 else float("inf")

    @check_kinds
    def judge(
        self,
        measured: float,
        *,
        subject: str,
        stage: Stage,
        evidence: str,
        design: str = "",
        method: Method = "sampled",
    ) -> CheckResult:
        """Hold a measured figure against the bound: met where the ratio is at most 1.

        Parameters
        ----------
        measured
            The figure, in the requirement's unit.
        subject
            Loop or manoeuvre.
        stage
            Where in the chain it was measured.
        evidence
            What recomputes it.
        design
            Name of the design.
        method
            How it is found, see `CheckResult`; the least that can be said of a figure by default.

        Returns
        -------
        CheckResult
            With ratio and verdict.

        Raises
        ------
        ArgumentError
            An argument of another kind than annotated.
        """
        ratio = self.ratio(measured)
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
        )


# Stable, and by more than rounding: every disturbance of the loop has died away in a minute or two.
STABLE = Requirement(name="slowest decay", limit=0.05, unit="1/s", sense="at least")


@input_value
class LoopRequirement(Requirement):
    """A bound on a figure of one loop, of the nominal plant or of several plants of a set; see `requirement`.

    Attributes
    ----------
    kind
        Which figure, as in `requirement`.
    over
        Of which groups of plants it is asked.
    frequency
        "tracking", "torque limit": up to which frequency, rad/s; None: all. "controller gain": from which frequency on;
        None: from a tenth of the nutation frequency.
    channel
        "H-infinity norm" and "H2 norm": between which signals, with which weights; None: all signals.
    name
        The figure, in the field's words.
    limit, unit, sense
        The bound, > 0, in `unit`, and whether it is one from above or below.
    hard
        Whether it has to be met; a soft one is a goal.
    """

    kind: Kind
    over: tuple[Group, ...] = NOMINAL
    frequency: float | None = None
    channel: Channel | None = None

    @property
    def over_spread(self) -> bool:
        """Whether it is asked of more than the nominal plant."""
        return any(group != "nominal" for group in self.over)

    @check_arguments
    def figures(self, measures: LoopMeasures) -> FloatArray:
        """Return the figures that this bound is held against, one or several.

        Parameters
        ----------
        measures
            Taken with this requirement among what was asked.

        Returns
        -------
        (k,)
            In the requirement's unit.

        Raises
        ------
        ArgumentError
            `measures` were taken without this requirement.
        """
        return measures.figures(self)

    @check_arguments
    def ratios(self, measures: LoopMeasures) -> FloatArray:
        """Return a ratio for every figure.

        Parameters
        ----------
        measures
            Taken with this requirement among what was asked.

        Returns
        -------
        (k,)
            Dimensionless; at most 1 where the bound is met.

        Raises
        ------
        ArgumentError
            `measures` were taken without this requirement.
        """
        return np.array([self.ratio(float(figure)) for figure in self.figures(measures)])

    @check_arguments
    def result(self, plants: PlantSet, measures: LoopMeasures, *, subject: str = "", design: str = "") -> CheckResult:
        """Hold the worst figure against the bound; the evidence names the plant, or the torquer, that it is from.

        Parameters
        ----------
        plants
            The plants that were measured.
        measures
            Taken with this requirement among what was asked.
        subject, design
            Names for the result.

        Returns
        -------
        CheckResult
            Of the worst figure.

        Raises
        ------
        ArgumentError
            `measures` were taken without this requirement.
        """
        return self._worst(plants, self.figures(measures), subject, design, measures.exact)

    def _worst(self, plants: PlantSet, figures: FloatArray, subject: str, design: str, exact: bool) -> CheckResult:
        worst = int(figures.argmax() if self.sense == "at most" else figures.argmin())
        if self.kind in OF_CONTROLLER:
            where = "controller"
        elif self.kind == "torque noise" and not self.over_spread:
            where = f"torquer {plants.torques[worst]}"
        elif self.over_spread:
            where = plants.labels[np.flatnonzero(plants.of(self.over))[worst]]
        else:
            where = "nominal plant"
        # Of the nominal plant and of the controller there is one.
        number = len(figures) if self.over_spread else 1
        return self.judge(
            float(figures[worst]),
            subject=subject,
            design=design,
            stage="decoupled",
            evidence=f"{where}; {number} plant{'' if number == 1 else 's'}, sampled with delay and torquer lag",
            method="exact" if exact or self.kind not in GRIDDED else "sampled",
        )

    @check_arguments
    def check(
        self, plants: PlantSet, controller: control.StateSpace | StateArrays, *, subject: str = "", design: str = ""
    ) -> CheckResult:
        """Close `controller` around the plants and judge, peaks as norms: ``assert requirement.check(...).passed``.

        Parameters
        ----------
        plants
            The plants.
        controller
            u = K y with the set's sample period. A `control.StateSpace` is joined by its signals' names.
        subject, design
            Names for the result.

        Returns
        -------
        CheckResult
            Of the worst plant.

        Raises
        ------
        ArgumentError
            The controller does not fit the plants, the set has no plant of the groups, or a channel names a signal
            that the closed loops do not have.
        """
        K = plants.joined(controller)
        if self.kind not in OF_CONTROLLER and not plants.of(self.over).any():
            raise ArgumentError(
                f"{self.name}: asked over {', '.join(self.over)}; expected a set with such plants, here "
                f"{', '.join(dict.fromkeys(plants.groups))}"
            )
        return self._worst(plants, exact_figures(plants, K, self), subject, design, True)

    @check_arguments
    def check_closed_loop(
        self, closed_loop: control.StateSpace, *, subject: str = "", design: str = "", above: float = 0.0
    ) -> CheckResult:
        """Judge a loop that is closed already, as a synthesis or `analysis.closed_loop` returns it.

        Parameters
        ----------
        closed_loop
            Continuous or sampled; a channel finds its signals by name.
        subject, design
            Names for the result.
        above
            "damping": poles slower than this, rad/s, do not count.

        Returns
        -------
        CheckResult
            Of this one loop.

        Raises
        ------
        ArgumentError
            A kind that needs to know which signals are torques and angles, or a channel that does not fit.
        """
        one_of("check_closed_loop: kind", self.kind, _OF_CLOSED_LOOP)
        arrays = state_arrays(closed_loop, "check_closed_loop")
        z = poles(arrays.A)
        decay = float(-spectral_abscissa(continuous_poles(z, arrays.dt)))
        if self.kind == "stability":
            found = decay
        elif self.kind == "damping":
            found = float(minimum_damping(z, above, arrays.dt))
        elif self.kind == "fastest pole":
            found = float(fastest(z, arrays.dt))
        else:
            channel = self.channel or Channel()
            part = channel.of(arrays, closed_loop.input_labels, closed_loop.output_labels)
            found = _norm(self.kind, part) if decay > 0.0 else float("inf")
        evidence = f"closed loop with {arrays.A.shape[0]} states"
        return self.judge(found, subject=subject, design=design, stage="decoupled", evidence=evidence, method="exact")

    @check_arguments
    def check_controller(self, controller: control.StateSpace, *, subject: str = "", design: str = "") -> CheckResult:
        """Judge a controller by itself: kinds "controller poles" and "controller gain" (from `frequency` on).

        Parameters
        ----------
        controller
            Continuous or sampled.
        subject, design
            Names for the result.

        Returns
        -------
        CheckResult
            Of the controller alone.

        Raises
        ------
        ArgumentError
            Another kind.
        """
        one_of("check_controller: kind", self.kind, sorted(OF_CONTROLLER))
        K = state_arrays(controller, "check_controller")
        if self.kind == "controller poles":
            found = float(fastest(poles(K.A), K.dt))
        else:
            found = peak(K, (self.frequency or 0.0, np.inf))[0]
        evidence = f"controller with {K.A.shape[0]} states"
        return self.judge(found, subject=subject, design=design, stage="decoupled", evidence=evidence, method="exact")


@check_arguments
def requirement(
    kind: Kind,
    limit: float,
    *,
    over: tuple[Group, ...] = NOMINAL,
    hard: bool = True,
    frequency: float | None = None,
    channel: Channel | None = None,
    name: str | None = None,
) -> LoopRequirement:
    """Return a bound on a figure of a loop; the kind brings name, unit and sense.

    Parameters
    ----------
    kind
        At least: ``"stability"`` (decay of the slowest pole, 1/s), ``"damping"``, ``"bandwidth"`` (Hz), ``"disk
        margin"``. At most: ``"fastest pole"`` (rad/s, in the w-plane of a sampled loop; with stability and damping a
        pole region), ``"sensitivity peak"``, ``"complementary peak"`` (‖S‖, ‖T‖, the larger of plant input and
        output), ``"tracking"`` (σ(S) at the plant's output up to `frequency`), ``"Omega rejection"``, ``"torque
        rejection"`` (peak gain from the platform's rate and from disturbing torques to the angles), ``"torque noise"``
        (rms from pick-off noise, N m, worst torquer), ``"torque limit"`` (torque amplitude over the torquer's limit,
        for any sinusoidal platform rate, up to `frequency`, in the ellipsoid with half-axes Omega), ``"H-infinity
        norm"``, ``"H2 norm"`` (of `channel`), ``"controller poles"`` (rad/s), ``"controller gain"`` (N m/rad).
    limit
        Above 0, in the unit of the kind.
    over
        Of which groups of plants: `NOMINAL`, `SPREAD` (with Omega), `FAULTS`, or any choice of groups.
    hard
        False for a goal.
    frequency
        rad/s, see `LoopRequirement`; required for "tracking".
    channel
        See `LoopRequirement`.
    name
        Instead of the kind's own.

    Returns
    -------
    LoopRequirement
        The same object for tuning, checking and reporting.

    Raises
    ------
    ArgumentError
        An unknown kind or group, a limit that is not > 0, or a frequency or channel that is missing or means nothing.

    Examples
    --------
    >>> from platform_ctrl.job import requirements
    >>> margin = requirements.requirement("disk margin", 0.5)
    >>> round(margin.ratio(0.75), 4)  # at most 1: met
    0.6667
    """
    one_of("requirement: kind", kind, get_args(Kind))
    over = tuple(over)
    for group in over or ("none",):
        one_of("requirement: over", group, get_args(Group))
    if kind == "tracking" and frequency is None:
        raise ArgumentError("requirement: tracking without frequency; expected up to which frequency in rad/s")
    if frequency is not None:
        one_of("requirement: kind with a frequency", kind, (*sorted(BANDED), "controller gain"))
        frequency = positive("requirement: frequency", frequency)
    if channel is not None:
        one_of("requirement: kind with a channel", kind, ("H-infinity norm", "H2 norm"))
    words, unit, sense = _WORDS[kind]
    return LoopRequirement(
        name=words if name is None else name,
        limit=positive("requirement: limit", limit),
        unit=unit,
        sense=sense,
        hard=hard,
        kind=kind,
        over=over,
        frequency=frequency,
        channel=channel,
    )


@check_arguments
def loop_requirements(limits: LoopLimits) -> tuple[LoopRequirement, ...]:
    """Return what `limits` ask of a loop; stability of every plant that something is asked of is always asked.

    Parameters
    ----------
    limits
        As a job file has them.

    Returns
    -------
    tuple of LoopRequirement
        One for each number given, and stability.

    Raises
    ------
    ArgumentError
        A limit that is not > 0, or a frequency that is missing.
    """
    always = [
        requirement("stability", STABLE.limit),
        requirement("stability", STABLE.limit, over=SPREAD, name="slowest decay over the spread"),
    ]
    if any(limit is not None for limit in (limits.disk_margin_faults, limits.damping_faults)):
        always.append(requirement("stability", STABLE.limit, over=FAULTS, name="slowest decay with a fault"))
    return (*always, *_asked(limits, hard=True))


@check_arguments
def hard_and_soft(
    limits: LoopLimits, soft: LoopLimits
) -> tuple[tuple[LoopRequirement, ...], tuple[LoopRequirement, ...]]:
    """Return the limits of a loop, stability among them, and its goals, which no verdict rests on.

    Parameters
    ----------
    limits, soft
        What has to be met, and the goals.

    Returns
    -------
    hard, soft
        Requirements of either kind.

    Raises
    ------
    ArgumentError
        A limit that is not > 0, or a frequency that is missing.
    """
    return loop_requirements(limits), _asked(soft, hard=False)


def _asked(limits: LoopLimits, hard: bool) -> tuple[LoopRequirement, ...]:
    asked: list[LoopRequirement] = []

    def ask(kind: Kind, limit: float | None, over: tuple[Group, ...] = NOMINAL, edge_hz: float | None = None) -> None:
        if limit is None:
            return
        frequency = None if edge_hz is None else 2.0 * np.pi * edge_hz
        name = _WORDS[kind][0] + {NOMINAL: "", SPREAD: " over the spread", FAULTS: " with a fault"}[over]
        name = name if hard else f"goal: {name}"
        asked.append(requirement(kind, limit, over=over, hard=hard, frequency=frequency, name=name))

    ask("bandwidth", limits.bandwidth_hz)
    ask("disk margin", limits.disk_margin)
    ask("sensitivity peak", limits.sensitivity_peak)
    ask("complementary peak", limits.complementary_peak)
    ask("damping", limits.damping)
    ask("fastest pole", limits.fastest_pole)
    ask("tracking", limits.tracking, edge_hz=limits.tracking_hz)
    ask("Omega rejection", limits.Omega_rejection)
    ask("torque rejection", limits.torque_rejection)
    ask("torque noise", limits.torque_noise)
    ask("torque limit", limits.torque_limit, edge_hz=limits.torque_limit_hz)
    ask("controller poles", limits.controller_poles)
    ask("controller gain", limits.controller_gain)
    ask("disk margin", limits.disk_margin_spread, SPREAD)
    ask("sensitivity peak", limits.sensitivity_peak_spread, SPREAD)
    ask("complementary peak", limits.complementary_peak_spread, SPREAD)
    ask("damping", limits.damping_spread, SPREAD)
    ask("disk margin", limits.disk_margin_faults, FAULTS)
    ask("damping", limits.damping_faults, FAULTS)
    return tuple(asked)


def _norm(kind: Kind, part: StateArrays) -> float:
    if kind == "H-infinity norm":
        return peak(part)[0]
    if part.dt == 0.0 and np.any(part.D):
        return float("inf")
    import control

    return h2_norm(control.StateSpace(*part[:4], part.dt, remove_useless_states=False))
