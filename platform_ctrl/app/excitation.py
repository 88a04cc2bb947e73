"""What the Disturbance plot shows of a job: the rate of the base about an axis and commands of a loop over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from platform_ctrl.app.curves import POINTS, round_up
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.job import Job, Manoeuvre, manoeuvre_scenario
from platform_ctrl.job.scenario import HalfCosine, Scenario, Sine
from platform_ctrl.simulation.scenarios import commanded_readings, courses_of

# Points that a period of the fastest sine needs to be drawn.
_PER_PERIOD = 16


@value
class Excitation:
    """The rate of the base about one axis, and commands of what a loop reads.

    `rate` returns rad/s, `commands` what the `readings` are held at, (N, readings), at times (N,), s. `limit` is the
    largest angle that is allowed, rad, or None.
    """

    title: str
    duration: float
    rate: Callable[[FloatArray], FloatArray]
    limit: float | None = None
    readings: tuple[str, ...] = ()
    commands: Callable[[FloatArray], FloatArray] = lambda t: np.zeros((len(t), 0))


def first_axis(job: Job) -> int:
    """Return the axis about which the job's first caged manoeuvre turns the base; without one that of most Omega."""
    turned = (axis for one in job.manoeuvres if one.mode == "caged" for axis in (1, 2, 3) if _turns(one, axis))
    return next(turned, 1 + int(np.argmax(job.Omega)))


def caged_excitation(job: Job, axis: int, readings: Sequence[str], nutation: float) -> Excitation:
    """Return the job's caged manoeuvre that turns the base about `axis`, else one that commands the `readings` alone.

    Random vibration is left out: the budget has it. Without a manoeuvre the base turns at the job's largest rate.
    """
    caged = [one for one in job.manoeuvres if one.mode == "caged"]
    found = next((one for one in caged if _turns(one, axis)), None) or next(
        (one for one in caged if _commands(one, readings) and not any(_turns(one, k) for k in (1, 2, 3))), None
    )
    if found is None:
        rate = float(job.Omega[axis - 1]) or 1.0
        rise = round_up(40.0 / nutation)
        profile = HalfCosine(axis=axis, rate=rate, rise=rise, hold=2.0 * rise)
        return Excitation(
            title=f"{rate:g} rad/s about axis {axis}", duration=5.0 * rise, rate=lambda t: _half_cosine(profile, t)
        )
    scenario = manoeuvre_scenario(job, found)
    fastest = max((one.frequency_hz for one in _sines(found, axis)), default=0.0)
    longest = POINTS / (_PER_PERIOD * fastest) if fastest else math.inf
    commanded = _commands(found, readings)
    return Excitation(
        title=found.name if found.duration <= longest else f"{found.name}, the first {longest:.3g} s",
        duration=min(found.duration, longest),
        rate=lambda t: _rate(scenario, axis, t),
        limit=found.limits.get("angle"),
        readings=commanded,
        commands=lambda t: _commanded(scenario, commanded, t),
    )


def _turns(manoeuvre: Manoeuvre, axis: int) -> bool:
    table = manoeuvre.Omega_table
    return bool(
        (manoeuvre.rate and manoeuvre.axis == axis)
        or (table is not None and np.any(table.values[:, axis - 1]))
        or _sines(manoeuvre, axis)
    )


def _sines(manoeuvre: Manoeuvre, axis: int) -> list[Sine]:
    return [one for one in manoeuvre.sines if one.kind == "rate" and one.axis == axis]


def _commands(manoeuvre: Manoeuvre, readings: Sequence[str]) -> tuple[str, ...]:
    commanded = {one.reading for one in manoeuvre.commands}
    return tuple(name for name in readings if name in commanded)


def _rate(scenario: Scenario, axis: int, t: FloatArray) -> FloatArray:
    out = np.zeros(len(t))
    if scenario.profile is not None and scenario.profile.axis == axis:
        out += _half_cosine(scenario.profile, t)
    if scenario.Omega_table is not None:
        out += scenario.Omega_table.at(t)[:, axis - 1]
    for one in scenario.sines:
        if one.kind == "rate" and one.axis == axis:
            out += one.amplitude * np.sin(2.0 * math.pi * one.frequency_hz * t + one.phase)
    return out


def _commanded(scenario: Scenario, readings: Sequence[str], t: FloatArray) -> FloatArray:
    names = commanded_readings(scenario)
    return courses_of(scenario, t)[:, 1, [names.index(name) for name in readings]]


def _half_cosine(profile: HalfCosine, t: FloatArray) -> FloatArray:
    end = 2.0 * profile.rise + profile.hold
    inside = np.minimum(np.minimum(t, end - t), profile.rise)
    share = np.clip(inside, 0.0, None) / profile.rise if profile.rise > 0.0 else (inside >= 0.0).astype(np.float64)
    return np.asarray(profile.rate * 0.5 * (1.0 - np.cos(np.pi * share)))
