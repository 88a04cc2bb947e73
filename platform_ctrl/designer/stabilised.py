"""The picture of the loop on a free platform: all caging loops closed, the servo broken at one root torquer."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.feedback import closed_loop_arrays
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping, pole_arrays, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response_arrays
from platform_ctrl.analysis.sensitivity import sensitivities
from platform_ctrl.designer.curves import (
    channel_response,
    degrees,
    gain_locus,
    moved_by_gain,
)
from platform_ctrl.designer.free_loop import Sensitivity, StabilisedLoop, disk_margins, loop_grid, used_arrays
from platform_ctrl.designer.free_measures import Kept, requirements
from platform_ctrl.designer.free_responses import rate_step, turning
from platform_ctrl.designer.parts import (
    Band,
    Measured,
    Parts,
    channel_margins,
    frequency_parts,
)
from platform_ctrl.designer.pictures import Drawn, Locus, Margins, Overlay
from platform_ctrl.designer.values import Settings
from platform_ctrl.errors import DesignError
from platform_ctrl.frozen import FloatArray


def stabilised_parts(loop: StabilisedLoop, settings: Settings, kept: Kept) -> Parts:
    """Return what is drawn for the free platform, and what measures it.

    Raises
    ------
    DesignError
        No controller acts on the platform.
    """
    K, at, torquers = loop.joined(loop.shown)
    roots, name = _roots(loop, settings, torquers)
    channel = torquers.index(name)
    P = used_arrays(loop.shown.arrays, 0, at)
    z = pole_arrays(closed_loop_arrays(*P[:4], *K[:4])[0])
    s = continuous_poles(z, P.dt)
    stable = bool(spectral_abscissa(s) < 0.0)
    grid = np.union1d(loop_grid(P, s), loop.plants.frequency)
    sensitivity = Sensitivity(P, K)
    S = sensitivity.at(grid)
    response = channel_response(S, channel)
    banded = bool(settings.band and len(loop.plants.labels) > 1)
    poles = _set_poles(loop, K, at) if banded else s[None]
    channel_own = channel_margins(grid, response, stable)
    reference = max(channel_own.crossover or 1.0, 1.0)
    at_rest = settings.plant == loop.plants.labels[0] and not any(settings.Omega)
    inside = bool(np.all(spectral_abscissa(poles) < 0.0)) if banded else stable
    band, worst, worst_plant = _band(loop, K, at, channel) if banded else (None, math.inf, settings.plant)
    bode, nichols = frequency_parts(
        name, grid, response, math.pi / P.dt, settings.plant, band, loop.job.coupled.disk_margin
    )
    step, low_frequency = turning(loop, settings, K, at, grid, s, stable, banded)

    def measured() -> Measured:
        own = float(disk_margins(P, K, [channel])[0]) if stable else 0.0
        return Measured(
            margins=Margins(
                disk=own,
                worst_disk=min(own, worst) if inside else 0.0,
                worst_plant=worst_plant if worst < own else settings.plant,
                **channel_own._asdict(),
                bandwidth=_bandwidth(grid, S, [torquers.index(one) for one in roots]) if stable else 0.0,
                damping=float(minimum_damping(z[None], 0.1 * reference, P.dt)[0]),
            ),
            requirements=requirements(loop, kept, (s, grid, sensitivity, S) if at_rest else None),
        )

    drawn = Drawn(
        bode=bode,
        nichols=nichols,
        locus=_locus(loop, P, K, s, poles, reference),
        step=step,
        Omega_time=rate_step(loop, settings, K, at, s, stable, banded),
        Omega_frequency=low_frequency,
        bandwidth=None,
        stable=stable,
        all_stable=inside,
    )
    return drawn, measured


def stabilised_overlay(
    loop: StabilisedLoop, settings: Settings, method: str, frequency: FloatArray, kept: Kept | None = None
) -> Overlay:
    """Return what is drawn of another servo, over the picture with the bode diagram at `frequency`.

    Its limits are measured with `kept` alone.

    Raises
    ------
    DesignError
        No controller acts on the platform.
    """
    K, at, torquers = loop.joined(loop.shown)
    _, name = _roots(loop, settings, torquers)
    P = used_arrays(loop.shown.arrays, 0, at)
    s = continuous_poles(pole_arrays(closed_loop_arrays(*P[:4], *K[:4])[0]), P.dt)
    stable = bool(spectral_abscissa(s) < 0.0)
    response = channel_response(Sensitivity(P, K).at(frequency), torquers.index(name))
    step, over_frequency = turning(loop, settings, K, at, frequency, s, stable, False)
    return Overlay(
        design=settings.design,
        method=method,
        response=response,
        magnitude=np.abs(response),
        phase=degrees(response),
        poles=s,
        step=step,
        Omega_step=rate_step(loop, settings, K, at, s, stable, False),
        Omega_gain=over_frequency.gain,
        requirements=() if kept is None else requirements(loop, kept),
    )


def _roots(loop: StabilisedLoop, settings: Settings, torquers: tuple[str, ...]) -> tuple[list[str], str]:
    """Return the torquers on the platform that are set, and the one at which the loop is shown broken."""
    roots = [t.name for t in loop.job.platform.torquers if t.root_axis is not None and t.name in torquers]
    if not roots:
        raise DesignError(f"{loop.spec.name}: no controller sets a torque on the platform; expected a servo")
    return roots, settings.channel if settings.channel in roots else roots[0]


def _band(loop: StabilisedLoop, K: StateArrays, at: list[int], channel: int) -> tuple[Band, float, str]:
    """Return the loops of all plants broken at a channel, and the least of their margins there with its plant."""
    w = loop.plants.frequency
    S = sensitivities(-frequency_response_arrays(*K, w) @ loop.plants.response[..., : len(loop.plants.sensors), at])[0]
    peaks = np.abs(S[..., channel, channel] - 0.5).max(axis=-1)
    k = int(np.argmax(peaks))
    return Band(loop.plants.labels, w, channel_response(S, channel)), 1.0 / float(peaks[k]), loop.plants.labels[k]


def _set_poles(loop: StabilisedLoop, K: StateArrays, at: list[int]) -> ComplexArray:
    A, B, C, D, dt = loop.plants.arrays
    return continuous_poles(pole_arrays(closed_loop_arrays(A, B[..., at], C, D[..., at], *K[:4])[0]), dt)


def _locus(
    loop: StabilisedLoop, P: StateArrays, K: StateArrays, s: ComplexArray, poles: ComplexArray, crossover: float
) -> Locus:
    """The servo's gain varies on all root axes; the caging loops stay closed as they are."""
    roots = {t.name for t in loop.job.platform.torquers if t.root_axis is not None}
    names = loop.joined(loop.shown)[2]
    moving = np.array([name in roots for name in names])
    inner = StateArrays(K.A, K.B, np.where(moving[:, None], 0.0, K.C), np.where(moving[:, None], 0.0, K.D), K.dt)
    # Both halves read the same states of the controller: close the inner rows first, then the rest as feedback.
    A, B, _, _ = closed_loop_arrays(*P[:4], *inner[:4])
    m = P.B.shape[1]
    feedback = np.hstack([K.D @ P.C, K.C]) * moving[:, None]
    if P.D.any():
        gains, branches = gain_locus(P, K, points=32)
    else:
        closed = StateArrays(A, B[:, :m], feedback, np.zeros((m, m)), P.dt)
        static = StateArrays(np.zeros((0, 0)), np.zeros((0, m)), np.zeros((m, 0)), np.eye(m), P.dt)
        gains, branches = gain_locus(closed, static, points=32)
    finite = np.isfinite(s)
    size = np.where(finite, np.abs(s), np.inf)
    nyquist = math.pi / P.dt
    reach = min(8.0 * crossover, nyquist)
    others = poles.ravel()
    return Locus(
        gains=gains,
        branches=branches,
        present=s,
        draggable=np.asarray(
            finite & (s.imag > 1e-6 * size) & (size < 0.9 * nyquist) & moved_by_gain(gains, branches, s)
        ),
        others=others[np.isfinite(others) & (np.abs(others) < 4.0 * reach)],
        reach=reach,
        damping=None,
    )


def _bandwidth(grid: FloatArray, S: ComplexArray, rows: list[int]) -> float:
    """Lowest frequency at which the largest singular value of S on the root axes reaches 1/sqrt(2), rad/s."""
    sizes = np.linalg.norm(S[:, rows][:, :, rows], 2, axis=(-2, -1))
    above = np.flatnonzero(sizes >= math.sqrt(0.5))
    return float(grid[above[0]]) if above.size else float(grid[-1])
