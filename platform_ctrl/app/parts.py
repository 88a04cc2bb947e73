"""What pictures of both modes are made of: one loop over frequency with its band, one response over time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.app.curves import degrees, degrees_beside, gain_crossings, gain_range, round_up
from platform_ctrl.app.pictures import Bode, Drawn, Locus, Margins, Nichols, TimeResponse
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.quantities import signal_series

# Points of a response over time.
POINTS = 240
# What is sampled is looked at up to this share of Nyquist's frequency: at its edge sensitivities say nothing.
EDGE = 0.999
# Frequencies of a curve besides those at its resonances.
GRID_POINTS = 160


@value
class Measured:
    """What is measured; see `Picture`."""

    margins: Margins
    requirements: tuple[CheckResult, ...]
    goals: tuple[CheckResult, ...] = ()
    notes: tuple[str, ...] = ()


# What is drawn, and what measures the same loop when it is called.
Parts = tuple[Drawn, Callable[[], Measured]]


class Band(NamedTuple):
    """The loops of a set: labels of the N plants, frequencies (B,), rad/s, and responses, complex (N, B)."""

    labels: tuple[str, ...]
    frequency: FloatArray
    responses: ComplexArray


def frequency_parts(
    channel: str,
    grid: FloatArray,
    response: ComplexArray,
    nyquist: float,
    shown: str,
    band: Band | None,
    disk_margin: float | None,
) -> tuple[Bode, Nichols]:
    """Return both diagrams of the loop broken at `channel`; the frequencies of a band are some of `grid`."""
    magnitude, phase = np.abs(response), degrees(response)
    none = np.zeros(0)
    w, low, high, phase_low, phase_high = none, none, none, none, none
    labels: tuple[str, ...] = (shown,)
    phases, sizes, where = phase[None], magnitude[None], grid
    if band is not None:
        labels, w, where = band.labels, band.frequency, band.frequency
        at = np.searchsorted(grid, w)
        sizes, phases = np.abs(band.responses), degrees_beside(band.responses, response[at], phase[at])
        low, high = around(sizes, magnitude[at])
        phase_low, phase_high = around(phases, phase[at])
        first = [k for k, label in enumerate(labels) if label == shown][:1]
        order = [*first, *(k for k in range(len(labels)) if k not in first)]
        labels, sizes, phases = tuple(labels[k] for k in order), sizes[order], phases[order]
    bode = Bode(
        channel=channel,
        frequency=grid,
        response=response,
        magnitude=magnitude,
        phase=phase,
        band_frequency=w,
        magnitude_low=low,
        magnitude_high=high,
        phase_low=phase_low,
        phase_high=phase_high,
        crossovers=gain_crossings(grid, response)[0],
        nyquist=nyquist,
    )
    return bode, Nichols(labels=labels, phase=phases, magnitude=sizes, frequency=where, disk_margin=disk_margin)


def around(every: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest over the first axis of `every`, of the same shape as `own`, which counts too."""
    return np.minimum(every.min(axis=0), own), np.maximum(every.max(axis=0), own)


def time_response(
    platform: Platform,
    title: str,
    t: FloatArray,
    signals: tuple[str, ...],
    units: tuple[str, ...],
    responses: tuple[FloatArray, FloatArray | None],
    drive: FloatArray,
    limit: float | None = None,
) -> TimeResponse:
    """Return signals over time; `responses` are those of the plant shown (k, T) and of the set (N, k, T), or None."""
    own, every = responses
    none = np.zeros((len(own), 0))
    low, high = (none, none) if every is None else around(every, own)
    colour = signal_series(platform)
    return TimeResponse(
        title=title,
        t=t,
        signals=signals,
        series=tuple(colour[name] for name in signals),
        units=units,
        values=own,
        low=low,
        high=high,
        drive=drive,
        limit=limit,
    )


def locus(
    gain_branches: tuple[FloatArray, ComplexArray],
    present: ComplexArray,
    others: ComplexArray,
    reach: float,
    nyquist: float,
    damping: float | None,
) -> Locus:
    """Return the root locus with the poles of other plants that a view of size `reach` may show."""
    gains, branches = gain_branches
    size = np.where(np.isfinite(present), np.abs(present), np.inf)
    return Locus(
        gains=gains,
        branches=branches,
        present=present,
        draggable=np.asarray((present.imag > 1e-6 * size) & (size < 0.9 * nyquist)),
        others=others[np.isfinite(others) & (np.abs(others) < 4.0 * reach)],
        reach=reach,
        damping=damping,
    )


class ChannelMargins(NamedTuple):
    """Margins of one channel; see `Margins`."""

    gain_up: float
    gain_down: float
    phase: float
    delay: float
    crossover: float | None


def channel_margins(grid: FloatArray, response: ComplexArray, stable: bool) -> ChannelMargins:
    """Return the margins of a channel by its loop transfer on a grid."""
    w, above = gain_crossings(grid, response)
    down, up = gain_range(response) if stable else (math.nan, math.nan)
    # Phase that may be lost: how far above -180 degrees, taken upwards from there.
    lead = np.radians(above % 360.0)
    return ChannelMargins(
        gain_up=up,
        gain_down=down,
        phase=float(np.abs(above).min(initial=math.inf)) if stable else math.nan,
        delay=float((lead / w).min(initial=math.inf)) if stable else math.nan,
        crossover=float(w[-1]) if len(w) else None,
    )


def step_size(limit: float) -> float:
    """Return the torque step that is shown, N m: about a tenth of what the torquer can do, 1 mN m without a limit."""
    if not math.isfinite(limit):
        return 1e-3
    return round_up(0.05 * limit)


def settling(s: ComplexArray, nutation: float, period: float, stable: bool) -> float:
    """Return how long a step response is worth seeing, s: 1, 2 or 5 times a power of ten."""
    shortest = max(40.0 * period, 2.0 * math.pi / nutation)
    if not stable:
        return round_up(10.0 * shortest)
    decay = -s.real[np.isfinite(s)]
    slowest = float(decay.min(initial=math.inf))
    return round_up(float(np.clip(5.0 / slowest if slowest > 0.0 else math.inf, shortest, 400.0 * shortest)))
