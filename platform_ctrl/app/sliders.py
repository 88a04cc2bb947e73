"""Which numbers of the settings a slider moves, from where to where, and how each is called."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from platform_ctrl.app.settings import Group, Settings, Slider
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.methods import METHODS

# A slider goes this factor to both sides of where it started.
_REACH = 20.0
# Typed numbers may lie beyond the slider, but not beyond these: options, sample rate, spins and rates in their units.
_OPTION, _RATE, _SPIN, _OMEGA = (1e-9, 1e7), (1e-2, 1e7), 1e6, 1e4
_LONGEST_DELAY = 100.0


def option_sliders(
    method: str,
    options: Mapping[str, float],
    start: Mapping[str, float],
    rate_hz: float,
    fixed: frozenset[str],
) -> list[Slider]:
    """Return a slider for each of the `options` of a method; `start` is what sliders reach to both sides of."""
    out = []
    offered = METHODS[method]
    for name, kind in offered.options.items():
        if name not in options:
            continue
        middle = start.get(name, options[name])
        high = min(_REACH * middle, kind.high * rate_hz) if kind.unit == "Hz" else kind.high
        low = middle / _REACH if kind.unit == "Hz" else kind.low
        out.append(
            Slider(
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
                tunable=name in offered.tunable,
                background=not offered.instant,
            )
        )
    return out


def lowest_rate(method: str, options: Mapping[str, float]) -> float:
    """Return the sample rate, Hz, from which on a method's `options` stand within their sliders; 0 without such."""
    kinds = METHODS[method].options
    return max(
        (x / kinds[name].high for name, x in options.items() if name in kinds and kinds[name].below_nyquist),
        default=0.0,
    )


def plant_sliders(
    settings: Settings, start: Settings, Omega: tuple[float, float, float], slowest: float = 0.0
) -> list[Slider]:
    """Return the sliders of sampling, rotors and platform rate.

    `Omega` is the job's largest rate, `slowest` the sample rate below which a loop cannot be built, Hz.
    """
    fixed = settings.fixed
    rate, period = start.rate_hz, 1.0 / start.rate_hz

    def slider(name: str, label: str, unit: str, group: Group, low: float, high: float, at: float, tip: str) -> Slider:
        return Slider(
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
        slider("rate_hz", "sample rate", "Hz", "sampling", slow, fast, settings.rate_hz, "of all loops"),
        slider("delay", "delay", "s", "sampling", 0.0, longest, settings.delay, "from sample to torque"),
    ]
    for name, spin in settings.spins.items():
        first = start.spins[name]
        low, high = (min(0.0, 1.6 * first), max(0.0, 1.6 * first)) if first else (-1e3, 1e3)
        tip = "speed against its carrier"
        out.append(slider(f"spin {name}", f"rotor {name}", "rad/s", "rotors", low, high, spin, tip))
    for k, rate_now in enumerate(settings.Omega):
        most = 2.0 * Omega[k] if Omega[k] > 0.0 else 1.0
        tip = "platform rate at which the plants are shown"
        out.append(slider(f"Omega{k + 1}", f"Omega {k + 1}", "rad/s", "Omega", -most, most, rate_now, tip))
    return out


def moved(settings: Settings, sliders: Mapping[str, Slider], name: str, number: float) -> Settings:
    """Return the settings with a slider at `number`."""
    known_name("slider", name, tuple(sliders))
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
    if name.startswith("spin ") and sliders[name].group == "rotors":
        _expect(name, at, -_SPIN, _SPIN)
        return dataclasses.replace(settings, spins={**settings.spins, name.removeprefix("spin "): at})
    if sliders[name].group == "Omega":
        _expect(name, at, -_OMEGA, _OMEGA)
        rates = list(settings.Omega)
        rates[int(name[-1]) - 1] = at
        return settings.but(Omega=tuple(rates))
    _expect(name, at, *_OPTION)
    whole = any(method.options[name].whole for method in METHODS.values() if name in method.options)
    return with_options(settings, {name: float(round(at)) if whole else at})


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
