"""Inputs of a loop over time, by a job's manoeuvres or as a step, and its response sample by sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.job import Job
from platform_ctrl.job.manoeuvre import Manoeuvre
from platform_ctrl.job.scenario import HalfCosine, Scenario, Sine
from platform_ctrl.simulation.scenarios import commanded_readings, courses_of

# Points that a period of the fastest sine needs to be drawn.
_PER_PERIOD = 16


# Points of a response over time.
POINTS = 240
# Values beyond this are of a loop that diverges: no page has to draw them.
_FARTHEST = 1e12


def first_axis(job: Job) -> int:
    """Return the axis about which the job's first caged manoeuvre turns the base; without one that of most Omega."""
    turned = (axis for one in job.manoeuvres if one.mode == "caged" for axis in (1, 2, 3) if _turns(one, axis))
    return next(turned, 1 + int(np.argmax(job.Omega)))


def caged_excitation(
    job: Job, axis: int, readings: Sequence[str], nutation: float, period: float
) -> tuple[SampledInput, tuple[str, ...], FloatArray]:
    """Return the job's caged manoeuvre that turns the base about `axis`, else one that commands the `readings` alone.

    The rate of the base, rad/s, with the largest angle that is allowed; the readings that are commanded, and what they
    are held at at all samples, (N, readings). Random vibration is left out: the budget has it. Without a manoeuvre the
    base turns at the job's largest rate.
    """
    caged = [one for one in job.manoeuvres if one.mode == "caged"]
    found = next((one for one in caged if _turns(one, axis)), None) or next(
        (one for one in caged if _commands(one, readings) and not any(_turns(one, k) for k in (1, 2, 3))), None
    )
    if found is None:
        rate = float(job.Omega[axis - 1]) or 1.0
        rise = round_up(40.0 / nutation)
        profile = HalfCosine(axis=axis, rate=rate, rise=rise, hold=2.0 * rise)
        title = f"{rate:g} rad/s about axis {axis}"
        turn = drive(title, 5.0 * rise, period, lambda t: _half_cosine(profile, t))
        return turn, (), np.zeros((len(turn.u), 0))
    scenario = job.scenario(found)
    fastest = max((one.frequency_hz for one in _sines(found, axis)), default=0.0)
    longest = POINTS / (_PER_PERIOD * fastest) if fastest else math.inf
    title = found.name if found.duration <= longest else f"{found.name}, the first {longest:.3g} s"
    duration, limit = min(found.duration, longest), found.limits.get("angle")
    turn = drive(title, duration, period, lambda t: _rate(scenario, axis, t), limit)
    commanded = _commands(found, readings)
    times = np.arange(len(turn.u), dtype=np.float64) * period
    names = commanded_readings(scenario)
    return turn, commanded, courses_of(scenario, times)[:, 1, [names.index(name) for name in commanded]]


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


def _half_cosine(profile: HalfCosine, t: FloatArray) -> FloatArray:
    end = 2.0 * profile.rise + profile.hold
    inside = np.minimum(np.minimum(t, end - t), profile.rise)
    share = np.clip(inside, 0.0, None) / profile.rise if profile.rise > 0.0 else (inside >= 0.0).astype(np.float64)
    return np.asarray(profile.rate * 0.5 * (1.0 - np.cos(np.pi * share)))


def round_up(x: float) -> float:
    """Return the next of 1, 2, 5, 10, ... times a power of ten, so that axes do not move with every slider."""
    decade = 10.0 ** math.floor(math.log10(x))
    return float(next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= x * (1.0 - 1e-9)))


class SampledInput(NamedTuple):
    """An input over time: at all samples, and the times `t` (T,), s, of every `every`-th one, which are drawn."""

    title: str
    t: FloatArray
    u: FloatArray
    every: int
    limit: float | None


def drive(
    title: str, duration: float, period: float, rate: Callable[[FloatArray], FloatArray], limit: float | None = None
) -> SampledInput:
    """Return an input over about `duration`, s, by its value at the times of the samples (N,)."""
    every = max(1, math.ceil(duration / period / POINTS))
    count = max(2, math.ceil(duration / period / every - 1e-9) + 1)
    t = np.asarray(np.arange(count) * (every * period), dtype=np.float64)
    u = rate(np.arange(every * (count - 1) + 1, dtype=np.float64) * period)
    return SampledInput(title=title, t=t, u=u, every=every, limit=limit)


def sampled_responses(systems: System, inputs: FloatArray, every: int) -> FloatArray:
    """Return the outputs (..., p, T) of sampled systems at rest at every `every`-th sample.

    `inputs` (m, every * (T - 1) + 1) have all samples. Exact: a power of A carries the state over whole intervals,
    within which the inputs count one by one.
    """
    A, B, C, D, _ = systems
    m, count = len(inputs), (inputs.shape[1] - 1) // every + 1
    with np.errstate(all="ignore"):
        # [A^(every-1) B, ..., A B, B]
        driven, power = B, A
        while driven.shape[-1] < every * m:
            driven = np.concatenate([power @ driven, driven], axis=-1)
            power = power @ power
        driven = driven[..., -every * m :]
        # Change of the state by the inputs of each interval, (..., T - 1, n), and then the state after it.
        x = inputs[:, :-1].T.reshape(count - 1, every * m) @ driven.swapaxes(-1, -2)
        step = np.linalg.matrix_power(A, every).swapaxes(-1, -2)
        for k in range(1, count - 1):
            x[..., k, :] += (x[..., k - 1 : k, :] @ step)[..., 0, :]
        y = D @ inputs[:, ::every]
        y[..., 1:] += C @ x.swapaxes(-1, -2)
    return np.asarray(
        np.clip(np.nan_to_num(y, nan=_FARTHEST, posinf=_FARTHEST, neginf=-_FARTHEST), -_FARTHEST, _FARTHEST)
    )


def step_size(limit: float) -> float:
    """Return the torque step that is shown, N m: about a tenth of what the torquer can do, 1 mN m without a limit."""
    return round_up(0.05 * limit) if math.isfinite(limit) else 1e-3


def settling(s: ComplexArray, nutation: float, period: float, stable: bool) -> float:
    """Return the duration of a step response, s: 1, 2 or 5 times a power of ten."""
    shortest = max(40.0 * period, 2.0 * math.pi / nutation)
    if not stable:
        return round_up(10.0 * shortest)
    decay = -s.real[np.isfinite(s)]
    slowest = float(decay.min(initial=math.inf))
    return round_up(float(np.clip(5.0 / slowest if slowest > 0.0 else math.inf, shortest, 400.0 * shortest)))
