"""The table of metrics: what can be measured of a loop, and so be required of it; one entry each.

Everything that deals with requirements reads `METRICS`: the reader of job files, measuring and judging, the tuners, the
report, the app and the tables of the documentation. See docs/reference/architecture.md, "A requirement".
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis import measuring, transfers
from platform_ctrl.analysis.poles import fastest_pole, minimum_damping, poles
from platform_ctrl.analysis.time_responses import overshoot, ramp_error, settling_time, steady_error
from platform_ctrl.common.values import FloatArray, value

Sense = Literal["at least", "at most"]
# Beyond this ratio, 400 dB, what is left is rounding.
_NOTHING_LEFT = 1e20


@value
class Quantity:
    """A quantity that can be measured, and so be required."""

    name: str  # in verdicts, tables and plots
    key: str = ""  # of its limit in a job file; empty: from Python alone
    unit: str = ""  # of limits and verdicts
    sense: Sense = "at most"  # smaller is better; ``"at least"``: larger is better
    meaning: str  # one sentence for the documentation

    @property
    def worst(self) -> float:
        """The value where there is none to be had: infinite; where larger is better 0, in dB minus infinity."""
        return np.inf if self.sense == "at most" else -np.inf if self.unit == "dB" else 0.0


@value
class Metric(Quantity):
    """A metric of a loop; its limit is in ``[loop.limits]``, with the edges of its band as ``_from_hz`` and ``_hz``."""

    scale: float = 1.0  # the unit in SI units
    decibels: bool = False  # whether the unit is dB: of a ratio of amplitudes
    measure: measuring.Measure  # how it is measured
    # which limits a job file may set: ``""``: of the nominal plant; ``"worst_case"`` and ``"faults"``: with the key's
    # ending ``_worst_case`` or ``_faults``
    scopes: tuple[str, ...] = ("",)
    best: float | None = None  # the best value that any loop can have, in `unit`
    # what has to be known: ``"plants"`` and the controller, or the ``"controller"`` alone
    of: Literal["plants", "controller"] = "plants"
    needs_frequency: bool = False  # whether the frequency must be given
    # Whether it is also one of each torquer in the coupled system: a stabilisation loop may have a limit.
    of_torquers: bool = False

    def in_SI(self, number: float) -> float:
        """Return a number in the metric's unit in SI units."""
        return float(10.0 ** (number / 20.0)) if self.decibels else number * self.scale

    def in_unit(self, values: FloatArray | float) -> FloatArray:
        """Return values in SI units in the metric's unit."""
        if not self.decibels:
            return np.asarray(values) / self.scale
        with np.errstate(divide="ignore"):
            return np.asarray(20.0 * np.log10(np.minimum(values, _NOTHING_LEFT)))

    @property
    def band(self) -> str:
        """Whether it is taken ``"up to"`` or ``"from"`` a frequency; empty: it has none."""
        if isinstance(self.measure, measuring.ControllerGain):
            return "from"
        return "up to" if isinstance(self.measure, measuring.Peak) and self.measure.banded else ""

    @property
    def disturbed_by(self) -> set[str]:
        """The continuous disturbances whose effect it is, between samples too: ``"Omega"``, ``"torque"`` or none."""
        parts = self.measure.transfers if isinstance(self.measure, measuring.Peak) else ()
        return {one.source for one in parts if one.source == "Omega" or (one.source, one.target) == ("torque", "angle")}

    @property
    def of_sight(self) -> bool:
        """Whether it is about the budget of the line of sight."""
        return isinstance(self.measure, measuring.Sight)

    @property
    def searched(self) -> bool:
        """Whether a grid of frequencies may miss the worst: a verdict then takes exact values."""
        return not isinstance(self.measure, measuring.Direct)

    @property
    def frequency_key(self) -> str:
        """Key of the band's edge in a job file, Hz; empty where there is none."""
        return f"{self.key.removesuffix('_db')}_hz" if self.key and self.band == "up to" else ""

    @property
    def lowest_key(self) -> str:
        """Key of the frequency at which that band begins, Hz; empty where there is no band."""
        return f"{self.frequency_key.removesuffix('_hz')}_from_hz" if self.frequency_key else ""


METRICS: dict[str, Metric] = {
    "stability": Metric(
        name="minimum decay rate",
        unit="1/s",
        sense="at least",
        meaning="decay rate of the slowest pole",
        measure=measuring.Direct(function=lambda loops: loops.decay),
    ),
    "bandwidth": Metric(
        name="bandwidth",
        key="bandwidth_hz",
        unit="Hz",
        scale=2.0 * np.pi,
        sense="at least",
        meaning="lowest frequency at which the largest singular value of S, at plant input or output, reaches 1/√2",
        measure=measuring.Bandwidth(),
    ),
    "disk margin": Metric(
        name="disk margin",
        key="disk_margin",
        sense="at least",
        meaning="1/‖(S − T)/2‖∞, the smaller of input and output. Unstructured: all channels at once, "
        "cross-talk included",
        measure=measuring.Peak(transfers=transfers.OF_HALF, reciprocal=True),
        scopes=("", "worst_case", "faults"),
        best=2.0,
    ),
    "gain margin": Metric(
        name="gain margin",
        key="gain_margin_db",
        unit="dB",
        decibels=True,
        sense="at least",
        meaning="least change of the gain of one torquer, up or down, that ends stability, all others closed",
        measure=measuring.Direct(function=measuring.of_margins(0)),
        scopes=("", "worst_case"),
    ),
    "phase margin": Metric(
        name="phase margin",
        key="phase_margin_deg",
        unit="°",
        scale=np.pi / 180.0,
        sense="at least",
        meaning="least lag of one torquer that ends stability where its loop's gain is 1, all others closed",
        measure=measuring.Direct(function=measuring.of_margins(1)),
        scopes=("", "worst_case"),
        best=180.0,
    ),
    "sensitivity peak": Metric(
        name="sensitivity peak",
        key="sensitivity_peak",
        meaning="‖S‖∞, the larger of input and output",
        measure=measuring.Peak(transfers=transfers.OF_S),
        scopes=("", "worst_case"),
    ),
    "complementary sensitivity peak": Metric(
        name="complementary sensitivity peak",
        key="complementary_sensitivity_peak",
        meaning="‖T‖∞, the larger of input and output",
        measure=measuring.Peak(transfers=transfers.OF_T),
        scopes=("", "worst_case"),
    ),
    "damping": Metric(
        name="damping",
        key="damping",
        sense="at least",
        meaning="smallest damping ratio of the closed-loop poles (poles in z taken to s by ln z / T)",
        measure=measuring.Direct(function=lambda loops: minimum_damping(loops.poles, loops.period)),
        scopes=("", "worst_case", "faults"),
        best=1.0,
    ),
    "fastest pole": Metric(
        name="fastest pole",
        key="fastest_pole",
        unit="rad/s",
        meaning="magnitude of the closed-loop poles in the w-plane, (2/T) (z − 1)/(z + 1). A delay counts as 2/T; a "
        "pole that rings at the Nyquist frequency counts as infinitely fast. With stability and damping this is a pole "
        "region",
        measure=measuring.Direct(function=lambda loops: fastest_pole(loops.poles, loops.period)),
    ),
    "tracking": Metric(
        name="tracking error",
        key="tracking",
        meaning="the largest singular value of S at the plant's output up to this frequency; of a design with "
        "`command` of the transfer from commands to their errors",
        measure=measuring.Peak(transfers=(transfers.FOLLOWING,), banded=True),
        needs_frequency=True,
    ),
    "overshoot": Metric(
        name="overshoot",
        key="overshoot",
        meaning="of what is measured, over a step of its reference, u = K (y − reference), relative; worst channel",
        measure=measuring.Direct(function=measuring.of_steps(overshoot)),
        scopes=("", "worst_case"),
    ),
    "settling time": Metric(
        name="settling time",
        key="settling_time",
        unit="s",
        meaning="until what is measured stays within 2 % of a step of its reference; worst channel",
        measure=measuring.Direct(function=measuring.of_steps(settling_time)),
        scopes=("", "worst_case"),
    ),
    "steady-state error": Metric(
        name="steady-state error",
        key="steady_error",
        meaning="share of a step of the reference that remains as error; worst channel",
        measure=measuring.Direct(function=measuring.of_following(steady_error)),
        scopes=("", "worst_case"),
    ),
    "ramp error": Metric(
        name="ramp error",
        key="ramp_error",
        unit="s",
        meaning="error behind a ramp of the reference over the slope of the ramp; worst channel",
        measure=measuring.Direct(function=measuring.of_following(ramp_error)),
        scopes=("", "worst_case"),
    ),
    "Omega rejection": Metric(
        name="angle from Omega",
        key="Omega_rejection",
        unit="rad/(rad/s)",
        meaning="peak gain from the platform's rate to the angles",
        measure=measuring.Peak(transfers=(transfers.ANGLE_PER_OMEGA,)),
    ),
    "attenuation": Metric(
        name="attenuation of base motion",
        key="attenuation_db",
        unit="dB",
        decibels=True,
        sense="at least",
        meaning="the platform's rate over the rate of the line of sight that it causes, in the worst direction, up to "
        "this frequency; of the axes across the line of sight that the loop's torquers move",
        measure=measuring.Peak(transfers=(transfers.SIGHT_PER_OMEGA,), banded=True, reciprocal=True),
        scopes=("", "worst_case"),
        needs_frequency=True,
    ),
    "torque rejection": Metric(
        name="angle from torque",
        key="torque_rejection",
        unit="rad/(N m)",
        meaning="peak gain from torques that add to the torquers' to the angles",
        measure=measuring.Peak(transfers=(transfers.ANGLE_PER_TORQUE,)),
    ),
    "torque noise": Metric(
        name="torque noise, rms",
        key="torque_noise",
        unit="N m",
        meaning="rms of the torque command from the noise of all pick-offs, in the worst torquer",
        measure=measuring.Direct(function=lambda loops: measuring.torque_noise(loops).max(axis=-1, initial=0.0)),
        of_torquers=True,
    ),
    "torque limit": Metric(
        name="torque at full Omega over its limit",
        key="torque_limit",
        meaning="commanded torque over the torquer's limit (1: just at it), worst torquer, for sinusoidal platform "
        "rates in the ellipsoid with half-axes `Omega`, up to this frequency or of any frequency. Torquers without "
        "a limit do not count",
        measure=measuring.Peak(transfers=(transfers.TORQUE_SHARE,), banded=True),
    ),
    "fastest controller pole": Metric(
        name="fastest pole of the controller",
        key="fastest_controller_pole",
        unit="rad/s",
        meaning="magnitude of the controller's poles in the w-plane",
        measure=measuring.Direct(function=lambda loops: fastest_pole(poles(loops.controller.A), loops.period)[None]),
        of="controller",
    ),
    "controller gain": Metric(
        name="gain of the controller",
        key="controller_gain",
        unit="N m/rad",
        meaning="largest singular value of the controller from a tenth of nutation on",
        measure=measuring.ControllerGain(),
        of="controller",
    ),
}

# Of all loops closed together; the limits are in ``[coupled]``.
COUPLED_METRICS: dict[str, Quantity] = {
    "simultaneous disk margin": Quantity(
        name="simultaneous disk margin",
        key="disk_margin",
        sense="at least",
        meaning="disk margin of all torquer channels at once, each with its own perturbation",
    ),
    "coupling cost": Quantity(
        name="disk margin lost by coupling",
        key="coupling_cost",
        meaning="largest relative loss of a loop-by-loop disk margin against the decoupled design",
    ),
    "limit cycle": Quantity(
        name="limit cycle from play", key="limit_cycle", unit="rad", meaning="amplitude of a gimbal by drives with play"
    ),
}

# Of the line of sight; the limits are in ``[budget.limits]`` and, of one source, in ``[[budget.source]]``.
BUDGET_METRICS: dict[str, Quantity] = {
    key: Quantity(name=name, key=key, unit="rad", meaning=meaning)
    for key, name, meaning in (
        (
            "jitter",
            "line-of-sight jitter",
            "rms of both axes across the line of sight together, in the band of the budget",
        ),
        (
            "jitter_per_axis",
            "line-of-sight jitter of one axis",
            "the larger rms of the two axes across the line of sight, in the band of the budget",
        ),
        (
            "windowed_jitter",
            "line-of-sight jitter within an exposure",
            "rms about the mean of an exposure, both axes together, at the exposure where it is largest",
        ),
        (
            "smear",
            "line-of-sight smear within an exposure",
            "rms of the extent of the line that fits an exposure best, from end to end, both axes together",
        ),
        ("limit", "line-of-sight rms", "rms of both axes across the line of sight from one source alone"),
    )
}
BUDGET_METRICS["contrast"] = Quantity(
    name="contrast of the image",
    key="contrast",
    sense="at least",
    meaning="modulation transfer function of the motion within an exposure, at the exposure, axis and spatial "
    "frequency where it is least",
)

METRICS |= {
    one.name: Metric(**dataclasses.asdict(one), measure=measuring.Sight(key=key, worst=one.worst))
    for key, one in BUDGET_METRICS.items()
    if key != "limit"
}


@value
class RunMetric(Quantity):
    """A metric of a simulated run; the limits are in ``[manoeuvre.limits]``."""

    always: bool = False  # whether it is shown also where no manoeuvre limits it
    sight: bool = False  # whether the plant needs a line of sight
    commanded: bool = False  # whether the run needs a command in its unit
    stops: bool = False  # whether the plant needs a gimbal with stops


RUN_METRICS: dict[str, RunMetric] = {
    one.key: one
    for one in (
        RunMetric(
            name="largest gimbal angle",
            key="angle",
            unit="rad",
            meaning="largest magnitude of a gimbal's angle",
            always=True,
        ),
        RunMetric(
            name="largest angle between stops",
            key="angle_between_stops",
            unit="rad",
            meaning="largest magnitude of the angle of a gimbal with stops; others, as wheels, do not count",
            stops=True,
        ),
        RunMetric(
            name="largest platform angle",
            key="attitude",
            unit="rad",
            meaning="largest component of the platform's rotation vector",
            always=True,
        ),
        RunMetric(
            name="largest torque over its limit",
            key="torque_share",
            meaning="largest commanded torque over its torquer's limit, a motor's over what its supply leaves",
            always=True,
        ),
        RunMetric(
            name="largest gimbal rate", key="gimbal_rate", unit="rad/s", meaning="largest magnitude of a gimbal's rate"
        ),
        RunMetric(
            name="largest error behind a commanded angle",
            key="angle_following_error",
            unit="rad",
            meaning="largest magnitude of an angle that is read, without the sensor's bias, scale error and faults, "
            "less its command after `settle`",
            commanded=True,
        ),
        RunMetric(
            name="largest error behind a commanded rate",
            key="rate_following_error",
            unit="rad/s",
            meaning="largest magnitude of a rate that is read, without the sensor's bias, scale error and faults, "
            "less its command after `settle`",
            commanded=True,
        ),
        RunMetric(
            name="line-of-sight angle, rms",
            key="los_angle_rms",
            unit="rad",
            meaning="rms of `los_angle1` or `los_angle2` after `settle`, the larger: about zero, but about the mean in "
            "a run with commands",
            sight=True,
        ),
        RunMetric(
            name="line-of-sight rate, rms",
            key="los_rate_rms",
            unit="rad/s",
            meaning="rms of `los_rate1` or `los_rate2` after `settle`, the larger: about zero, but about the mean in a "
            "run with commands",
            sight=True,
        ),
        RunMetric(
            name="attenuation of base motion, simulated",
            key="attenuation_db",
            unit="dB",
            sense="at least",
            meaning="rms of the platform rate over the larger of `los_rate1` and `los_rate2`, about means, dB, caged",
            sight=True,
        ),
    )
}


def run_metrics(limits: Iterable[Mapping[str, float]]) -> tuple[str, ...]:
    """Return the keys of the metrics that are shown of runs with these limits, in the order of the table."""
    limited = {key for one in limits for key in one}
    return tuple(key for key, metric in RUN_METRICS.items() if metric.always or key in limited)


def over_limit(values: ArrayLike, limits: ArrayLike, sense: Sense) -> FloatArray:
    """Return values relative to their limits: at most 1 where a limit is met, infinite where a value is no number."""
    x, bound = np.broadcast_arrays(np.asarray(values, np.float64), np.asarray(limits, np.float64))
    met, (upper, lower) = (x <= bound, (x, bound)) if sense == "at most" else (x >= bound, (bound, x))
    with np.errstate(over="ignore"):
        ratio = np.divide(upper, lower, out=np.full(x.shape, np.inf), where=lower > 0.0)
    ratio = np.where(bound == 0.0, np.where(met, 1.0, np.inf), ratio)
    return np.where(np.isfinite(x), ratio, np.inf)


def attenuation_db(base: FloatArray, sight: FloatArray) -> FloatArray:
    """Return the rms of base rates (..., 3) over the larger of two of the line of sight (..., 2), dB; 0 at rest."""
    moved = np.sqrt(np.sum(base * base, axis=-1))
    left = np.maximum(sight.max(axis=-1), moved / _NOTHING_LEFT)
    return np.asarray(20.0 * np.log10(np.divide(moved, left, out=np.ones_like(moved), where=moved > 0.0)))
