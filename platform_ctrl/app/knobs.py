"""Which numbers of the settings a slider moves, from where to where, and how each is called."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from platform_ctrl.app.values import Group, Knob, Settings
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import value
from platform_ctrl.errors import ArgumentError

# A slider goes this factor to both sides of where it started.
_REACH = 20.0
# Typed numbers may lie beyond the slider, but not beyond these: options, sample rate, spins and rates in their units.
_OPTION, _RATE, _SPIN, _OMEGA = (1e-9, 1e7), (1e-2, 1e7), 1e6, 1e4
_LONGEST_DELAY = 100.0


@value
class OptionKind:
    """An option of a method as a knob: see `Knob`; one that is `refused` is so from half the sample rate on."""

    label: str
    unit: str
    group: Group
    tip: str
    low: float = 0.0
    high: float = math.inf
    logarithmic: bool = True
    part: str = ""
    refused: bool = False


def _hz(
    label: str, group: Group, tip: str, high: float = math.inf, part: str = "", refused: bool = False
) -> OptionKind:
    return OptionKind(label=label, unit="Hz", group=group, tip=tip, high=high, part=part, refused=refused)


# Highest frequencies are shares of the sample rate.
CLASSICAL: dict[str, OptionKind] = {
    "crossover_hz": _hz("crossover", "gains", "cross-axis gain of the gyroscopic pairs: where the loop crosses over"),
    "integral_hz": _hz("integral", "gains", "below this frequency the integral acts: trades ramp error for margin"),
    "damping_hz": _hz("damping 1", "gains", "direct-axis gain on the first axis of a pair: damps nutation"),
    "damping2_hz": _hz("damping 2", "gains", "direct-axis gain on the second axis of a pair: damps nutation"),
    "inertial_crossover_hz": _hz("inertial crossover", "gains", "crossover where no gyro stiffens the gimbals"),
    "lead_hz": _hz("lead zero", "lead", "zero of the direct-axis lead"),
    "rolloff_hz": _hz("lead roll-off", "lead", "pole of the direct-axis lead", high=0.45),
    "inertial_lead_hz": _hz("inertial lead zero", "lead", "zero of the lead where no gyro acts"),
    "inertial_rolloff_hz": _hz("inertial roll-off", "lead", "pole of that lead", high=0.45),
    "notch_hz": _hz(
        "notch", "notch", "centre of the notch in the cross-axis path", high=0.4, part="notch", refused=True
    ),
    "notch_depth": OptionKind(
        label="notch depth", unit="", group="notch", tip="gain at its centre", low=0.01, high=0.999, part="notch"
    ),
    "notch_width": OptionKind(
        label="notch width", unit="", group="notch", tip="its damping ratio", low=0.01, high=1.0, part="notch"
    ),
    "spin_notch_hz": _hz(
        "spin notch",
        "notch",
        "centre of the notch in front of everything: the rotors' spin",
        high=0.4,
        part="spin_notch",
        refused=True,
    ),
    "spin_notch_depth": OptionKind(
        label="spin notch depth",
        unit="",
        group="notch",
        tip="gain at its centre",
        low=0.01,
        high=0.999,
        part="spin_notch",
    ),
    "spin_notch_width": OptionKind(
        label="spin notch width",
        unit="",
        group="notch",
        tip="its damping ratio",
        low=0.01,
        high=1.0,
        part="spin_notch",
    ),
    "lag_hz": _hz("lag", "lag", "below this frequency the lag raises the gain", part="lag"),
    "lag_ratio": OptionKind(
        label="lag ratio", unit="", group="lag", tip="by how much it raises it", low=1.01, high=100.0, part="lag"
    ),
}
SERVO: dict[str, OptionKind] = {
    "crossover_hz": _hz("crossover", "gains", "where the rate loop of the platform crosses over", high=0.1),
    "position_hz": _hz("position", "gains", "angle over rate feedback: below this frequency the angle is held"),
    "filter_hz": _hz("rate filter", "lead", "low-pass on the rates that the gyros show", high=0.45, refused=True),
    "filter_damping": OptionKind(
        label="filter damping", unit="", group="lead", tip="its damping ratio", low=0.1, high=2.0
    ),
}
_WEIGHTS: dict[str, OptionKind] = {
    "bandwidth_hz": _hz("bandwidth", "design", "where the bound on S rises"),
    "sensitivity_peak": OptionKind(
        label="sensitivity peak", unit="", group="design", tip="height to which the bound on S rises", low=1.05, high=20
    ),
    "complementary": OptionKind(label="weight on T", unit="", group="design", tip="bounds T", low=0.01, high=10.0),
    "disturbance": OptionKind(
        label="disturbance", unit="", group="design", tip="torque disturbance: damps nutation", low=1e-3, high=10.0
    ),
    "torque": OptionKind(
        label="weight on torque", unit="", group="design", tip="larger: less torque", low=1e-3, high=10.0
    ),
    "inertial_bandwidth_hz": _hz("inertial bandwidth", "design", "the same where no gyro acts"),
    "inertial_disturbance": OptionKind(
        label="inertial disturbance", unit="", group="design", tip="the same where no gyro acts", low=1e-3, high=10.0
    ),
    "inertial_torque": OptionKind(
        label="inertial weight on torque",
        unit="",
        group="design",
        tip="the same where no gyro acts",
        low=1e-3,
        high=10.0,
    ),
}
_HINF = _WEIGHTS | {
    "backoff": OptionKind(
        label="backoff", unit="", group="design", tip="relative distance from the least norm", low=1e-3, high=1.0
    )
}
_STRUCTURED: dict[str, OptionKind] = {
    "order": OptionKind(
        label="order", unit="", group="design", tip="states beside the integrators", low=1, high=30, logarithmic=False
    ),
    "starts": OptionKind(
        label="starts", unit="", group="design", tip="starting points of the search", low=1, high=8, logarithmic=False
    ),
    "integral_hz": _hz("integral", "design", "corner of the integral at the start", high=0.4, refused=True),
    "rolloff_hz": _hz("roll-off", "design", "where the filter starts", high=0.45, refused=True),
    "reserve": OptionKind(
        label="reserve", unit="", group="design", tip="share by which limits are met", low=1e-3, high=0.5
    ),
    "evaluations": OptionKind(
        label="evaluations", unit="", group="design", tip="most evaluations of the search", low=10, high=5000
    ),
}
KINDS: dict[str, dict[str, OptionKind]] = {
    "classical": CLASSICAL,
    "platform-servo": SERVO,
    "hinf": _HINF,
    "lqg": _WEIGHTS,
    "structured": _STRUCTURED,
}
# Whole numbers.
COUNTS = frozenset({"order", "starts", "evaluations"})
PARTS: dict[str, tuple[str, str]] = {
    "lag": ("lag", "raises the gain at low frequencies"),
    "notch": ("notch", "takes gain out of the cross-axis path, at nutation as a rule"),
    "spin_notch": ("spin notch", "keeps what an unbalanced rotor shakes from the torquers"),
}


def option_knobs(
    method: str,
    options: Mapping[str, float],
    start: Mapping[str, float],
    rate_hz: float,
    fixed: frozenset[str],
    tunable: frozenset[str],
) -> list[Knob]:
    """Return a knob for each of the `options` of a method; `start` is what sliders reach to both sides of."""
    out = []
    for name, kind in KINDS[method].items():
        if name not in options:
            continue
        middle = start.get(name, options[name])
        high = min(_REACH * middle, kind.high * rate_hz) if kind.unit == "Hz" else kind.high
        low = middle / _REACH if kind.unit == "Hz" else kind.low
        out.append(
            Knob(
                name=name,
                label=kind.label,
                unit=kind.unit,
                group=kind.group,
                low=min(low, high, options[name]),
                high=max(high, options[name]),
                value=options[name],
                logarithmic=kind.logarithmic,
                tip=kind.tip,
                fixed=name in fixed,
                part=kind.part,
                tunable=name in tunable,
                background=method in ("hinf", "lqg", "structured"),
            )
        )
    return out


def lowest_rate(method: str, options: Mapping[str, float]) -> float:
    """Return the sample rate, Hz, from which on a method's `options` stand within their sliders; 0 without such."""
    kinds = KINDS[method]
    return max(
        (x / kinds[name].high for name, x in options.items() if name in kinds and kinds[name].refused), default=0.0
    )


def plant_knobs(
    settings: Settings, start: Settings, Omega: tuple[float, float, float], slowest: float = 0.0
) -> list[Knob]:
    """Return the knobs of sampling, rotors and platform rate.

    `Omega` is the job's largest rate, `slowest` the sample rate below which a loop cannot be built, Hz.
    """
    fixed = settings.fixed
    rate, period = start.rate_hz, 1.0 / start.rate_hz

    def knob(name: str, label: str, unit: str, group: Group, low: float, high: float, at: float, tip: str) -> Knob:
        return Knob(
            name=name,
            label=label,
            unit=unit,
            group=group,
            low=min(low, high, at),
            high=max(high, at),
            value=at,
            logarithmic=name == "rate_hz",
            tip=tip,
            fixed=name in fixed,
        )

    slow = max(rate / 5.0, slowest)
    fast = min(rate * 5.0, _LONGEST_DELAY / settings.delay if settings.delay > 0.0 else math.inf)
    longest = min(max(3.0 * start.delay, 2.0 * period), _LONGEST_DELAY / settings.rate_hz)
    out = [
        knob("rate_hz", "sample rate", "Hz", "sampling", slow, fast, settings.rate_hz, "of all loops"),
        knob("delay", "delay", "s", "sampling", 0.0, longest, settings.delay, "from sample to torque"),
    ]
    for name, spin in settings.spins.items():
        first = start.spins[name]
        low, high = (min(0.0, 1.6 * first), max(0.0, 1.6 * first)) if first else (-1e3, 1e3)
        tip = "speed against its carrier"
        out.append(knob(f"spin {name}", f"rotor {name}", "rad/s", "rotors", low, high, spin, tip))
    for k, rate_now in enumerate(settings.Omega):
        most = 2.0 * Omega[k] if Omega[k] > 0.0 else 1.0
        tip = "platform rate at which the plants are shown"
        out.append(knob(f"Omega{k + 1}", f"Omega {k + 1}", "rad/s", "Omega", -most, most, rate_now, tip))
    return out


def moved(settings: Settings, knobs: Mapping[str, Knob], name: str, number: float) -> Settings:
    """Return the settings with a knob at `number`."""
    known_name("knob", name, tuple(knobs))
    at = _number(name, number)
    if name == "rate_hz":
        _expect(name, at, *_RATE)
    if name in ("rate_hz", "delay"):
        new = settings.but(**{name: at})
        longest = _LONGEST_DELAY / new.rate_hz
        if not 0.0 <= new.delay <= longest * (1.0 + 1e-9):
            raise ArgumentError(
                f"{name}: given {short(number)}, so that the delay is {new.delay * new.rate_hz:.4g} periods; expected "
                f"0 to {_LONGEST_DELAY:g}"
            )
        return new
    if name.startswith("spin ") and knobs[name].group == "rotors":
        _expect(name, at, -_SPIN, _SPIN)
        return dataclasses.replace(settings, spins={**settings.spins, name.removeprefix("spin "): at})
    if knobs[name].group == "Omega":
        _expect(name, at, -_OMEGA, _OMEGA)
        rates = list(settings.Omega)
        rates[int(name[-1]) - 1] = at
        return settings.but(Omega=tuple(rates))
    _expect(name, at, *_OPTION)
    return with_options(settings, {name: float(round(at)) if name in COUNTS else at})


def with_options(settings: Settings, changes: Mapping[str, float]) -> Settings:
    """Return the settings with other options of the design that is worked on."""
    mine = {**settings.options[settings.loop][settings.design], **changes}
    designs = {**settings.options[settings.loop], settings.design: mine}
    return dataclasses.replace(settings, options={**settings.options, settings.loop: designs})


def _number(name: str, given: float) -> float:
    try:
        out = float(given)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(f"{name}: given {short(given)}; expected a number") from None
    if isinstance(given, bool) or not math.isfinite(out):
        raise ArgumentError(f"{name}: given {short(given)}; expected a finite number")
    return out


def _expect(name: str, at: float, low: float, high: float) -> None:
    if not low <= at <= high:
        raise ArgumentError(f"{name}: given {at:g}; expected a number from {low:g} to {high:g}")
