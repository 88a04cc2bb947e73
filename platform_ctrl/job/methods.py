"""The design methods that a job may name: one `DesignMethod` each.

The job reader, `design.loops`, the app and the tables of the documentation take from here what they need to know of a
method: another one is a function of a `design.loop.LoopProblem` and an entry registered with `register_method`.
"""

from __future__ import annotations

import math
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import Any, Literal

from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError

Structure = Literal["cross-axis", "pid", "state-space"]
LoopKind = Literal["caging", "rate", "pointing", "tracking", "stabilisation"]

OptionGroup = Literal["gains", "lead", "notch", "lag", "design"]
Family = Literal["speed", "robustness"]
# A function, or where it is: "module:name" is imported on first use, so that reading a job needs no design.
Reference = str | Callable[..., Any]


@value
class Option:
    """A number that a method takes, all > 0, and how the app's slider shows it.

    Attributes
    ----------
    label, unit, group, tip
        What the slider is called and says; `group` is the heading that it stands under.
    low, high
        Ends of the slider; for frequencies `high` is a share of the sample rate.
    logarithmic, whole
        Whether the slider is logarithmic, and whether the number counts something.
    part
        The optional part of the controller that it belongs to, or an empty text.
    below_nyquist
        Whether the method refuses it from half the sample rate on.
    """

    label: str
    unit: str = ""
    group: OptionGroup
    tip: str
    low: float = 0.0
    high: float = math.inf
    logarithmic: bool = True
    whole: bool = False
    part: str = ""
    below_nyquist: bool = False


@value
class DesignMethod:
    """A way to design a loop of a job.

    Attributes
    ----------
    key
        What ``method`` is in the job file.
    kinds
        Which loops it designs.
    design
        `design.loop.LoopProblem` -> `design.loop.Designed`, or where that function is, as ``"module:name"``.
    options
        The numbers that it takes, by their keys in the job file.
    sections
        (`design.loop.LoopProblem`, options) -> the controller of these options as `design.sections.Section`, in their
        order, or where that function is. None: it is matrices alone.
    defaults
        (`DesignSpec`, `design.partition.Channels`, nutation frequency in rad/s, sample period in s) -> all options,
        those that are not given by rules of thumb. None for methods of stabilisation loops.
    advice
        What to try where its loop is not stable.
    structures
        What ``structure`` may be; none: the key is refused.
    tunable
        Options that the app and, with ``tune = true``, the method itself may move.
    tunes
        Whether ``tune = true`` is accepted.
    goals
        Whether it works on the loop's goals: then its claims are the largest ratios of limits and goals.
    instant
        Whether the app builds it while a slider moves; others are designed in the background.
    responses
        Where it works on measured responses, which the key ``responses`` names: (`Job`, `LoopSpec`, `DesignSpec`, the
        file's text, its name in messages) -> None, an `InputError` where these are none of the loop. None: the key is
        refused.
    on_responses
        (`design.loop.LoopProblem`, `design.loop.LoopDesign`) -> the design, judged on its measured responses too.
    parts
        Optional parts of the controller that the app switches on and off: label and tip by name.
    families
        Options that the app moves together for speed and for robustness: by how many per cent each for one per cent.
        The first of a loop's options in ``"speed"`` is shown as its speed.
    """

    key: str
    kinds: tuple[LoopKind, ...] = ("caging", "rate", "pointing")
    design: Reference
    options: Mapping[str, Option]
    sections: Reference | None = None
    defaults: Reference | None = None
    advice: str
    structures: tuple[Structure, ...] = ()
    tunable: tuple[str, ...] = ()
    tunes: bool = False
    goals: bool = False
    instant: bool = False
    responses: Reference | None = None
    on_responses: Reference | None = None
    parts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    families: Mapping[Family, Mapping[str, float]] = field(default_factory=dict)


def resolved(function: Reference) -> Callable[..., Any]:
    """Return a function that a `DesignMethod` refers to."""
    return pkgutil.resolve_name(function) if isinstance(function, str) else function


def _hz(
    label: str, group: OptionGroup, tip: str, high: float = math.inf, part: str = "", below_nyquist: bool = False
) -> Option:
    return Option(label=label, unit="Hz", group=group, tip=tip, high=high, part=part, below_nyquist=below_nyquist)


def _number(label: str, tip: str, low: float, high: float, group: OptionGroup = "design", **more: Any) -> Option:
    """Return an option that is no frequency, with the ends of its slider."""
    return Option(label=label, tip=tip, low=low, high=high, group=group, **more)


# Highest frequencies are shares of the sample rate.
_CLASSICAL: dict[str, Option] = {
    "crossover_hz": _hz(
        "crossover ωc", "gains", "cross-axis gain of the gyroscopic pairs: where the loop crosses over, about"
    ),
    "integral_hz": _hz("integral", "gains", "below this frequency the integral acts: trades ramp error for margin"),
    "damping_hz": _hz("damping 1", "gains", "direct-axis gain on the first axis of a pair: damps nutation"),
    "damping2_hz": _hz("damping 2", "gains", "direct-axis gain on the second axis of a pair: damps nutation"),
    "inertial_crossover_hz": _hz("inertial crossover", "gains", "crossover where no gyro stiffens the gimbals"),
    "lead_hz": _hz("lead zero", "lead", "zero of the direct-axis lead"),
    "rolloff_hz": _hz("lead roll-off", "lead", "pole of the direct-axis lead", high=0.45),
    "inertial_lead_hz": _hz("inertial lead zero", "lead", "zero of the lead where no gyro acts"),
    "inertial_rolloff_hz": _hz("inertial roll-off", "lead", "pole of that lead", high=0.45),
    "notch_hz": _hz(
        "notch", "notch", "centre of the notch in the cross-axis path", high=0.4, part="notch", below_nyquist=True
    ),
    "notch_depth": _number("notch depth", "gain at its centre", 0.01, 0.999, group="notch", part="notch"),
    "notch_width": _number("notch width", "its damping ratio", 0.01, 1.0, group="notch", part="notch"),
    "spin_notch_hz": _hz(
        "spin notch",
        "notch",
        "centre of the notch in front of everything: the rotors' spin",
        high=0.4,
        part="spin_notch",
        below_nyquist=True,
    ),
    "spin_notch_depth": _number(
        "spin notch depth", "gain at its centre", 0.01, 0.999, group="notch", part="spin_notch"
    ),
    "spin_notch_width": _number("spin notch width", "its damping ratio", 0.01, 1.0, group="notch", part="spin_notch"),
    "lag_hz": _hz("lag", "lag", "below this frequency the lag raises the gain", part="lag"),
    "lag_ratio": _number("lag ratio", "by how much it raises it", 1.01, 100.0, group="lag", part="lag"),
}
_RATE: dict[str, Option] = {
    "crossover_hz": _hz("crossover ωc", "gains", "gain over inertia: where each channel crosses over", high=0.2),
    "integral_hz": _hz("integral", "gains", "below this frequency the integral acts"),
    "double_integral_hz": _hz(
        "second integral", "gains", "below this frequency a second integral acts, against friction", part="second"
    ),
    "rolloff_hz": _hz("roll-off", "lead", "pole of the low-pass behind", high=0.45),
    **{name: option for name, option in _CLASSICAL.items() if name.startswith(("notch_", "lag_"))},
}
# Rules of thumb keep these frequencies in proportion. More lead and less integral action at one crossover: margin.
_CLASSICAL_FAMILIES: dict[Family, dict[str, float]] = {
    "speed": dict.fromkeys(
        (
            *("crossover_hz", "inertial_crossover_hz", "integral_hz", "damping_hz", "damping2_hz"),
            *("lead_hz", "inertial_lead_hz", "lag_hz"),
        ),
        1.0,
    ),
    "robustness": dict.fromkeys(("integral_hz", "lead_hz", "lag_hz", "inertial_lead_hz"), -1.0),
}
_RATE_FAMILIES: dict[Family, dict[str, float]] = {
    "speed": dict.fromkeys(("crossover_hz", "integral_hz", "double_integral_hz", "lag_hz"), 1.0),
    "robustness": dict.fromkeys(("integral_hz", "double_integral_hz", "lag_hz"), -1.0),
}
_SERVO: dict[str, Option] = {
    "crossover_hz": _hz(
        "crossover ωc", "gains", "gain over inertia: where the rate loop of the platform crosses over", high=0.1
    ),
    "position_hz": _hz("position", "gains", "angle over rate feedback: below this frequency the angle is held"),
    "filter_hz": _hz("rate filter", "lead", "low-pass on the rates that the gyros show", high=0.45, below_nyquist=True),
    "filter_damping": _number("filter damping", "its damping ratio", 0.1, 2.0, group="lead"),
}
_WEIGHTS: dict[str, Option] = {
    "bandwidth_hz": _hz("bandwidth", "design", "where the bound on S rises"),
    "sensitivity_peak": _number("sensitivity peak", "height to which the bound on S rises", 1.05, 20),
    "complementary": _number("weight on T", "bounds T", 0.01, 10.0),
    "disturbance": _number("disturbance", "torque disturbance: damps nutation", 1e-3, 10.0),
    "torque": _number("weight on torque", "larger: less torque", 1e-3, 10.0),
    "inertial_bandwidth_hz": _hz("inertial bandwidth", "design", "the same where no gyro acts"),
    "inertial_disturbance": _number("inertial disturbance", "the same where no gyro acts", 1e-3, 10.0),
    "inertial_torque": _number("inertial weight on torque", "the same where no gyro acts", 1e-3, 10.0),
}
_HINF = _WEIGHTS | {"backoff": _number("backoff", "relative distance from the least norm", 1e-3, 1.0)}
_LMI = _HINF | {
    "share": _number("share", "part of a limit that its inequality must prove", 0.1, 1.0),
    "pole_decay": _number("pole decay", "decay rate that all poles must have", 1e-2, 1e4, unit="1/s"),
    "pole_damping": _number("pole damping", "damping ratio that all poles must have: four times the effort", 0.01, 0.7),
    "rejection_share": _number("rejection share", "the same for the rejection of Omega", 0.05, 1.0),
    "time_limit": _number("time limit", "longest time for one convex problem", 0.1, 600.0, unit="s"),
}


def _torque(label: str, tip: str) -> Option:
    return Option(label=label, unit="N m", group="design", tip=tip)


_LARGEST, _RECOVERY = (
    "amplitude that counts as much as the largest error",
    "torque noise of the estimator: larger, more margin",
)
_LQG: dict[str, Option] = {
    "largest_error": Option(
        label="largest error", unit="rad", group="design", tip="amplitude of what is measured; rate loops: rad/s"
    ),
    "largest_rate": Option(
        label="largest rate", unit="rad/s", group="design", tip="amplitude of its rate; rate loops: rad/s²"
    ),
    "largest_torque": _torque("largest torque", _LARGEST),
    "largest_torque2": _torque("largest torque 2", f"{_LARGEST}: second axis of a pair"),
    "inertial_largest_torque": _torque("inertial largest torque", f"{_LARGEST}: where no gyro acts"),
    "integral_hz": _hz("integral", "design", "below this frequency the integral acts", high=0.4, below_nyquist=True),
    "platform_rate": Option(
        label="platform rate", unit="rad/s", group="design", tip="white platform rate that the estimator expects"
    ),
    "recovery": _torque("recovery", _RECOVERY),
    "recovery2": _torque("recovery 2", f"{_RECOVERY}: second axis of a pair"),
    "inertial_recovery": _torque("inertial recovery", f"{_RECOVERY}: where no gyro acts"),
}
_STRUCTURED: dict[str, Option] = {
    "order": _number("order", "states beside the integrators", 1, 30, whole=True, logarithmic=False),
    "starts": _number("starts", "starting points of the search", 1, 8, whole=True, logarithmic=False),
    "integral_hz": _hz("integral", "design", "corner of the integral at the start", high=0.4, below_nyquist=True),
    "rolloff_hz": _hz("roll-off", "design", "where the filter starts", high=0.45, below_nyquist=True),
    "reserve": _number("reserve", "share by which limits are met", 1e-3, 0.5),
    "evaluations": _number("evaluations", "most evaluations of the search", 10, 5000, whole=True),
}
_MEASURED: dict[str, Option] = {
    "rolloff_hz": _hz("roll-off", "design", "where the rate action ends", high=0.45, below_nyquist=True),
    "sensitivity_peak": _number("sensitivity peak", "largest gain of S where no limit is lower", 1.05, 20),
    "resonance_damping": _number(
        "resonance damping", "damping ratio that unresolved resonances get at least", 1e-3, 0.7
    ),
    "steps": _number("steps", "most convex problems", 5, 200, whole=True),
}

# By key, in the order in which messages and the documentation name them.
METHODS: dict[str, DesignMethod] = {}


def register_method(method: DesignMethod) -> None:
    """Add a design method; its key must be new."""
    if method.key in METHODS:
        raise ArgumentError(f"register_method: there is a method {method.key!r} already; choose another key")
    METHODS[method.key] = method


def unregister_method(key: str) -> None:
    """Remove a design method that `register_method` added."""
    del METHODS[known_method(key).key]


def known_method(key: str) -> DesignMethod:
    """Return the method with this key; an `ArgumentError` names those that are there."""
    keys = tuple(METHODS)
    return METHODS[keys[known_name("method", key, keys)]]


register_method(
    DesignMethod(
        key="classical",
        kinds=("caging", "pointing"),
        design="platform_ctrl.design.classical.caging:classical_design",
        options=_CLASSICAL,
        sections="platform_ctrl.design.classical.caging:classical_sections",
        defaults="platform_ctrl.design.classical.caging:default_options",
        advice="a lower crossover_hz, or tune = true",
        # The integral action is the user's: it trades ramp error for margin.
        tunable=(
            "crossover_hz",
            "damping_hz",
            "damping2_hz",
            "lead_hz",
            "rolloff_hz",
            "inertial_crossover_hz",
            "inertial_lead_hz",
            "inertial_rolloff_hz",
            "notch_hz",
            "notch_depth",
            "notch_width",
        ),
        tunes=True,
        instant=True,
        parts={
            "lag": ("lag", "raises the gain at low frequencies"),
            "notch": ("notch", "takes gain out of the cross-axis path, at nutation as a rule"),
            "spin_notch": ("spin notch", "keeps what an unbalanced rotor shakes from the torquers"),
        },
        families=_CLASSICAL_FAMILIES,
    )
)
register_method(
    DesignMethod(
        key="pi",
        kinds=("rate", "tracking"),
        design="platform_ctrl.design.classical.rate:rate_design",
        options=_RATE,
        sections="platform_ctrl.design.classical.rate:rate_sections",
        defaults="platform_ctrl.design.classical.rate:rate_options",
        advice="a lower crossover_hz, or tune = true",
        tunable=("crossover_hz", "integral_hz", "double_integral_hz", "notch_hz", "notch_depth", "notch_width"),
        tunes=True,
        instant=True,
        parts={
            "second": ("second integral", "takes out what dry friction does at low frequencies"),
            "lag": ("lag", "raises the gain at low frequencies"),
            "notch": ("notch", "takes gain out at a resonance"),
        },
        families=_RATE_FAMILIES,
    )
)
register_method(
    DesignMethod(
        key="hinf",
        kinds=("caging", "rate", "pointing", "tracking"),
        design="platform_ctrl.design.riccati.weighted_loop:hinf_design",
        options=_HINF,
        defaults="platform_ctrl.design.riccati.weighted_loop:hinf_options",
        advice="a lower bandwidth_hz, or a larger backoff",
    )
)
register_method(
    DesignMethod(
        key="lqg",
        kinds=("caging", "rate", "pointing", "tracking"),
        design="platform_ctrl.design.lqg:lqg_design",
        options=_LQG,
        defaults="platform_ctrl.design.lqg:lqg_options",
        advice="a smaller largest_torque, a larger recovery, or tune = true",
        # The integral action is the user's; only ratios of the other amplitudes count.
        tunable=(
            "largest_torque",
            "largest_torque2",
            "inertial_largest_torque",
            "platform_rate",
            "recovery",
            "recovery2",
            "inertial_recovery",
        ),
        tunes=True,
    )
)
register_method(
    DesignMethod(
        key="lmi",
        kinds=("caging", "rate", "pointing", "tracking"),
        design="platform_ctrl.design.lmi.method:lmi_design",
        options=_LMI,
        defaults="platform_ctrl.design.lmi.method:lmi_options",
        advice="a lower bandwidth_hz, or a larger backoff",
        tunable=tuple(_WEIGHTS),
        tunes=True,
        families={"speed": {"bandwidth_hz": 1.0, "inertial_bandwidth_hz": 1.0}},
    )
)
register_method(
    DesignMethod(
        key="structured",
        kinds=("caging", "rate", "pointing", "tracking"),
        design="platform_ctrl.design.fixed_structure.caging:structured_design",
        options=_STRUCTURED,
        defaults="platform_ctrl.design.fixed_structure.caging:default_options",
        advice="weaker limits, or another structure",
        structures=("cross-axis", "pid", "state-space"),
        goals=True,
    )
)
register_method(
    DesignMethod(
        key="measured",
        kinds=("caging", "rate", "pointing", "tracking"),
        design="platform_ctrl.design.measured.of_job:measured_design",
        options=_MEASURED,
        defaults="platform_ctrl.design.measured.of_job:default_options",
        advice="a smaller sensitivity_peak, or responses of the plant as it is",
        responses="platform_ctrl.design.measured.of_job:expect_fitting",
        on_responses="platform_ctrl.design.measured.of_job:on_responses",
    )
)
register_method(
    DesignMethod(
        key="platform-servo",
        kinds=("stabilisation",),
        design="platform_ctrl.design.classical.stabilisation:platform_servo",
        sections="platform_ctrl.design.classical.stabilisation:servo_sections",
        options=_SERVO,
        advice="a lower crossover_hz",
        tunable=tuple(_SERVO),
        instant=True,
    )
)
