"""The picture of a caging loop: Omega is prescribed, one torquer is shown broken while all others stay closed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import get_args

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.bandwidth import bandwidth_of_response
from platform_ctrl.analysis.feedback import sensitivity_functions
from platform_ctrl.analysis.frequency_grids import following_grid
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure, measured
from platform_ctrl.analysis.loop_set import LoopSet
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.analysis.plant_set import Group, PlantSet
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping
from platform_ctrl.analysis.resolvent import ON_A_GRID
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.app.curves import (
    EDGE,
    GRID_POINTS,
    POINTS,
    Band,
    ChannelMargins,
    Measured,
    Parts,
    channel_margins,
    channel_response,
    degrees,
    frequency_parts,
    gain_locus,
    held_responses,
    locus,
    round_up,
    sample_times,
    settling,
    step_size,
    time_response,
)
from platform_ctrl.app.pictures import Drawn, FrequencyGain, Locus, Margins, Overlay, TimeResponse
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import judged, requirements_of
from platform_ctrl.job.job import Job, LoopSpec, Manoeuvre, manoeuvre_scenario
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.scenario import HalfCosine

# Groups that a band shows: a part that fails is another story.
_BAND = ("nominal", "uncertainty", "Omega")
# States of a closed loop up to which norms are worked out while a slider moves.
_QUICK = 32


@value
class CagedLoop:
    """A caging loop with its plants and a controller.

    Attributes
    ----------
    job
        With the settings' spins, sampling and range of Omega.
    spec, design
        Which loop and design.
    plants, shown
        The whole set, and the plant that is shown alone.
    controller
        u = K y.
    """

    job: Job
    spec: LoopSpec
    design: str
    plants: PlantSet
    shown: PlantSet
    controller: StateArrays


# Measures of a loop that may be known already; else they are taken.
KeptMeasures = Callable[[Callable[[], LoopMetrics]], LoopMetrics]


def loop_measures(loop: CagedLoop, whole: LoopSet | None = None) -> LoopMetrics:
    """Return the measures that the page shows of a loop: peaks are norms unless it has too many states for that."""
    asked = requirements_of(loop.spec)
    if _exact(loop):
        return measure(loop.plants, loop.controller, asked, loops=whole)
    return measure(loop.plants, loop.controller, asked, exact=False)


def _exact(loop: CagedLoop) -> bool:
    return int(loop.plants.A.shape[-1]) + len(loop.controller.A) <= _QUICK


def caged_parts(loop: CagedLoop, settings: Settings, kept: KeptMeasures) -> Parts:
    """Return what is drawn for a caging loop, and what measures it."""
    spec, plants, K = loop.spec, loop.plants, loop.controller
    channel = plants.torques.index(settings.channel) if settings.channel in plants.torques else 0
    shown = LoopSet(loop.shown, K)
    exact = _exact(loop)
    whole = LoopSet(plants, K)
    inside = np.flatnonzero(plants.of(_BAND))
    banded = bool(settings.band and len(plants.labels) > 1)
    every = (whole if len(inside) == len(plants.labels) else whole.only(inside.tolist())) if banded else None
    s = continuous_poles(shown.poles[0], plants.period)
    grid = _grid(loop.shown, s)
    response = shown_channel(loop.shown, K, grid, channel)
    stable = bool(shown.decay[0] > 0.0)
    band = None
    if every is not None:
        band = Band(every.plants.labels, every.plants.frequency, channel_response(every.S_input, channel))
    bode, nichols = frequency_parts(
        plants.torques[channel],
        grid,
        response,
        math.pi / plants.period,
        settings.plant,
        band,
        spec.limits.get("disk_margin"),
    )
    margins = channel_margins(grid, response, stable)
    asked = requirements_of(spec)

    def measured() -> Measured:
        measures = kept(lambda: loop_measures(loop, whole))
        requirements, goals = judged(spec, loop.design, plants, measures)
        return Measured(
            margins=_margins(loop, measures, shown, margins, _disk(loop, measures, shown, exact), exact),
            requirements=requirements,
            goals=goals,
            notes=()
            if exact
            else (
                "peaks are the highest at some frequencies: the loop is too large for exact ones while a slider moves",
            ),
        )

    drawn = Drawn(
        bode=bode,
        nichols=nichols,
        locus=_locus(loop, s, every, exact),
        step=_step(loop, shown, every, channel, s, stable),
        Omega_time=_manoeuvre(loop, shown, every, settings.axis),
        Omega_frequency=_Omega_gain(loop, shown, every, grid, settings.axis),
        bandwidth=next((one.limit for one in asked if one.hard and one.kind == "bandwidth"), None),
        stable=stable,
        all_stable=bool(np.all(whole.decay[inside] > 0.0)),
    )
    return drawn, measured


def caged_overlay(
    loop: CagedLoop, settings: Settings, method: str, frequency: FloatArray, measured: bool = False
) -> Overlay:
    """Return what is drawn of another design of the loop, over the picture with the bode diagram at `frequency`.

    Its limits are empty unless they are to be `measured`.
    """
    channel = loop.plants.torques.index(settings.channel) if settings.channel in loop.plants.torques else 0
    shown = LoopSet(loop.shown, loop.controller)
    response = shown_channel(loop.shown, loop.controller, frequency, channel)
    s = continuous_poles(shown.poles[0], loop.shown.period)
    results: tuple[CheckResult, ...] = ()
    if measured:
        results = judged(loop.spec, loop.design, loop.plants, loop_measures(loop))[0]
    return Overlay(
        design=loop.design,
        method=method,
        response=response,
        magnitude=np.abs(response),
        phase=degrees(response),
        poles=s,
        step=_step(loop, shown, None, channel, s, bool(shown.decay[0] > 0.0)),
        Omega_step=_manoeuvre(loop, shown, None, settings.axis),
        Omega_gain=_Omega_gain(loop, shown, None, frequency, settings.axis).gain,
        requirements=results,
    )


def _grid(plant: PlantSet, s: ComplexArray) -> FloatArray:
    nyquist = math.pi / plant.period
    own = continuous_poles(np.linalg.eigvals(plant.A[0]), plant.period)
    low = max(min(2e-3 * plant.nutation, 0.05 * nyquist), 1e-4 * nyquist)
    # What the loop does slowest is in the diagram.
    low = max(min(low, 0.2 * float(np.abs(s[np.isfinite(s)]).min(initial=np.inf))), 1e-5 * nyquist)
    grid = following_grid(np.concatenate([s, own]), low, EDGE * nyquist, GRID_POINTS)
    # The band's own frequencies among them: its phases are those of this curve and a difference.
    return np.union1d(grid, plant.frequency)


def shown_channel(plant: PlantSet, K: StateArrays, grid: FloatArray, channel: int) -> ComplexArray:
    """Return the loop of the first plant broken at one channel, at the frequencies of `grid`, complex (F,)."""
    P = frequency_response(
        StateArrays(plant.A[0], plant.B[0], plant.C[0], plant.D[0], plant.period), grid, -3, ON_A_GRID
    )
    return channel_response(sensitivity_functions(-frequency_response(K, grid, -3) @ P)[0], channel)


def _locus(loop: CagedLoop, s: ComplexArray, every: LoopSet | None, exact: bool) -> Locus:
    plants = loop.shown
    P = StateArrays(plants.A[0], plants.B[0], plants.C[0], plants.D[0], plants.period)
    branches = gain_locus(P, loop.controller, points=110 if exact else 40)
    nyquist = math.pi / plants.period
    size = np.where(np.isfinite(s), np.abs(s), np.inf)
    # Oscillations, and what is about as fast as nutation: faster poles would squeeze everything else together.
    oscillating = size[(s.imag > 1e-6 * size) & (size < 0.7 * nyquist)]
    reach = min(1.25 * max(oscillating.max(initial=0.0), 1.5 * min(plants.nutation, 0.3 * nyquist)), nyquist)
    others = np.zeros(0, dtype=np.complex128) if every is None else continuous_poles(every.poles, plants.period).ravel()
    return locus(branches, s, others, reach, nyquist, loop.spec.limits.get("damping"))


def _step(
    loop: CagedLoop, shown: LoopSet, every: LoopSet | None, channel: int, s: ComplexArray, stable: bool
) -> TimeResponse:
    plants = loop.plants
    size = step_size(float(plants.torque_limit[channel]))
    duration = settling(s, shown.plants.nutation, plants.period, stable)
    t, sampled_every = sample_times(duration, plants.period, POINTS)
    u = np.full(sampled_every * (len(t) - 1) + 1, size)
    m = shown.m

    def responses(loops: LoopSet) -> FloatArray:
        A, B, C, D, _ = loops.own_arrays
        return held_responses(A, B[..., channel : channel + 1], C, D[..., channel : channel + 1], u, sampled_every)

    order = [*range(m, m + shown.p), *range(m)]
    return time_response(
        loop.job.platform,
        f"{1e3 * size:g} mN m step at {plants.torques[channel]}",
        t,
        (*plants.angles, *plants.torques),
        ("rad",) * shown.p + ("N m",) * m,
        (responses(shown)[0][order], None if every is None else responses(every)[:, order]),
        np.ones(len(t)),
    )


def _manoeuvre(loop: CagedLoop, shown: LoopSet, every: LoopSet | None, axis: int) -> TimeResponse:
    plants = loop.plants
    title, duration, limit, rate = caged_rate(loop.job, axis, plants.nutation)
    t, sampled_every = sample_times(duration, plants.period, POINTS)
    u = rate(np.arange(sampled_every * (len(t) - 1) + 1, dtype=np.float64) * plants.period)
    m, p = shown.m, shown.p
    largest = np.abs(u).max()

    def responses(loops: LoopSet) -> FloatArray:
        A, B, C, D, _ = loops.arrays
        column = slice(m + axis - 1, m + axis)
        rows = slice(0, m + p)
        return held_responses(A, B[..., column], C[..., rows, :], D[..., rows, column], u, sampled_every)

    order = [*range(m, m + p), *range(m)]
    return time_response(
        loop.job.platform,
        title,
        t,
        (*plants.angles, *plants.torques),
        ("rad",) * p + ("N m",) * m,
        (responses(shown)[0][order], None if every is None else responses(every)[:, order]),
        u[::sampled_every] / (largest if largest > 0.0 else 1.0),
        limit,
    )


def caged_rate(
    job: Job, axis: int, nutation: float
) -> tuple[str, float, float | None, Callable[[FloatArray], FloatArray]]:
    """Return title, duration, allowed angle and the rate over time of the job's caged manoeuvre about `axis`."""
    found = next((one for one in job.manoeuvres if one.mode == "caged" and one.axis == axis and _turns(one)), None)
    if found is None:
        rate = float(job.Omega[axis - 1]) or 1.0
        rise = round_up(40.0 / nutation)
        profile = HalfCosine(axis=axis, rate=rate, rise=rise, hold=2.0 * rise)
        return f"{rate:g} rad/s about axis {axis}", 5.0 * rise, None, lambda t: half_cosine(profile, t)
    scenario = manoeuvre_scenario(job, found)

    def given(t: FloatArray) -> FloatArray:
        out = np.zeros(len(t))
        if scenario.profile is not None:
            out += half_cosine(scenario.profile, t)
        if scenario.Omega_table is not None:
            out += scenario.Omega_table.at(t)[:, axis - 1]
        return out

    return found.name, found.duration, found.limits.get("angle"), given


def _turns(manoeuvre: Manoeuvre) -> bool:
    table = manoeuvre.Omega_table
    return bool(manoeuvre.rate) or (table is not None and bool(np.any(table.values[:, manoeuvre.axis - 1])))


def half_cosine(profile: HalfCosine, t: FloatArray) -> FloatArray:
    """Return the rate of a profile at times t (N,), rad/s."""
    end = 2.0 * profile.rise + profile.hold
    inside = np.minimum(np.minimum(t, end - t), profile.rise)
    share = np.clip(inside, 0.0, None) / profile.rise if profile.rise > 0.0 else (inside >= 0.0).astype(np.float64)
    return np.asarray(profile.rate * 0.5 * (1.0 - np.cos(np.pi * share)))


def _Omega_gain(loop: CagedLoop, shown: LoopSet, every: LoopSet | None, grid: FloatArray, axis: int) -> FrequencyGain:
    m, p = shown.m, shown.p
    A, B, C, D, dt = shown.arrays
    column, rows = slice(m + axis - 1, m + axis), slice(m, m + p)
    own = frequency_response(
        StateArrays(A[0], B[0][:, column], C[0][rows], D[0][rows, column], dt), grid, -3, ON_A_GRID
    )
    none = np.zeros(0)
    w, low, high = none, none, none
    if every is not None:
        w = every.plants.frequency
        responses = every.S_output @ every.plants.Omega_response[..., axis - 1 : axis]
        gains = np.linalg.norm(responses[..., 0], axis=-1)
        low, high = gains.min(axis=0), gains.max(axis=0)
    return FrequencyGain(
        title=f"rate Omega{axis} → angles",
        unit="rad/(rad/s)",
        frequency=grid,
        gain=np.asarray(np.linalg.norm(own[..., 0], axis=-1)),
        band_frequency=w,
        low=low,
        high=high,
        limit=loop.spec.limits.get("Omega_rejection"),
    )


def _disk(loop: CagedLoop, measures: LoopMetrics, shown: LoopSet, exact: bool) -> float:
    """Return the disk margin of the plant shown."""
    if all(np.array_equal(getattr(loop.shown, of)[0], getattr(loop.plants, of)[0]) for of in ("A", "B", "C", "D")):
        # The nominal plant's is measured in any case.
        return float(measures.disk_margin[0])
    return float(measured(shown, DISK, exact=exact)[0])


def _margins(
    loop: CagedLoop, measures: LoopMetrics, shown: LoopSet, channel: ChannelMargins, disk: float, exact: bool
) -> Margins:
    plants = loop.plants
    inside = np.flatnonzero(plants.of(_BAND))
    worst = int(inside[np.argmin(measures.disk_margin[inside])])
    stable = bool(shown.decay[0] > 0.0)
    found = min(
        bandwidth_of_response(shown.plants.frequency, S[0]) if stable else 0.0 for S in (shown.S_output, shown.S_input)
    )
    return Margins(
        disk=disk,
        worst_disk=float(measures.disk_margin[worst]),
        worst_plant=plants.labels[worst],
        worst_sampled=not exact,
        **channel._asdict(),
        bandwidth=float(found),
        damping=float(minimum_damping(shown.poles, shown.plants.nutation / 10.0, plants.period)[0]),
    )


DISK = MetricRequest(kind="disk margin", over=get_args(Group))
