"""Single curves over frequency: channels of a loop with the others closed, entries of a plant, phases, margins."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system
from platform_ctrl.analysis.margins import DiskMargin, disk_margin
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.plots.systems import DrawnSystem, features, gaps, sorted_data

# A step of the phase beyond which a pole or zero without damping is taken for its cause, degrees.
_JUMP = 135.0
_BISECTIONS = 50
# An entry that is smaller than this share of the largest one at every frequency is rounding.
_ROUNDING = 1e-11


@value
class Curve:
    """One response over frequency."""

    label: str  # For the legend
    system: DrawnSystem  # With one input and one output
    frequency: FloatArray  # (N,), rad/s
    response: ComplexArray  # (N,), NaN where nothing is drawn
    phase: FloatArray  # (N,), Degrees, without jumps


@value
class Margins:
    """Classical margins of one loop at all of its crossovers, sorted by frequency."""

    gain_crossovers: FloatArray  # (k,), Where the gain is 1, rad/s
    phase_margins: FloatArray  # (k,), Phase above −180° there, in (−180, 180], degrees
    phase_crossovers: FloatArray  # (j,), Where the phase is −180° or an odd multiple of it, rad/s
    gain_margins: FloatArray  # (j,), Factor on the gain that makes it 1 there
    stable: bool | None  # Whether the closed loop is; None: data cannot tell
    disk: DiskMargin | None  # Disk margin of this channel alone; None where there is none


def channels(name: str, loop: DrawnSystem) -> tuple[DrawnSystem, ...]:
    """Return the loop transfer of every channel with all others closed, 1/S_ii − 1, each as a system of its own."""
    if loop.shape == (1, 1):
        return (loop,)
    return tuple(_channel(name, loop, k) for k in range(len(loop.inputs)))


def _channel(plot: str, loop: DrawnSystem, k: int) -> DrawnSystem:
    import control

    where, name = f"{plot}: {loop.label}" if loop.label else plot, loop.inputs[k]
    others = [i for i in range(len(loop.inputs)) if i != k]
    if loop.is_data:
        w, L = sorted_data(loop.source)
        S = _sensitivity(np.moveaxis(L, -1, 0), where)
        with np.errstate(all="ignore"):
            own = 1.0 / S[:, k, k] - 1.0
        return _part(loop, k, k, None, control.frd(own.reshape(1, 1, -1), w, dt=loop.source.dt))
    if loop.arrays is None:
        raise ArgumentError(f"{where}: an improper loop transfer cannot be closed; add poles")
    A, B, C, D, dt = loop.arrays
    M = np.eye(len(others)) + D[np.ix_(others, others)]
    if np.linalg.svd(M, compute_uv=False).min(initial=1.0) < 1e-12 * max(1.0, float(np.abs(D).max(initial=0.0))):
        raise ArgumentError(
            f"{where}: I + D of the channels beside {name} is singular, so that they cannot be closed; add a lag"
        )
    # e_o = -v_o for the others.
    F = np.linalg.inv(M)
    seen, direct = F @ C[others], F @ D[np.ix_(others, [k])]
    arrays = StateArrays(
        A - B[:, others] @ seen,
        B[:, [k]] - B[:, others] @ direct,
        C[[k]] - D[np.ix_([k], others)] @ seen,
        D[np.ix_([k], [k])] - D[np.ix_([k], others)] @ direct,
        dt,
    )
    return _part(loop, k, k, arrays, named_system(arrays, [name], [loop.outputs[k]]))


def _sensitivity(L: ComplexArray, where: str) -> ComplexArray:
    out = np.full(L.shape, complex(math.nan, math.nan))
    fine = np.all(np.isfinite(L), axis=(-2, -1))
    try:
        out[fine] = np.linalg.inv(np.eye(L.shape[-1]) + L[fine])
    except np.linalg.LinAlgError:
        raise ArgumentError(f"{where}: I + L is singular at a frequency of the data") from None
    return out


def _entry(system: DrawnSystem, i: int, j: int) -> DrawnSystem:
    if system.shape == (1, 1):
        return system
    arrays = system.arrays
    if arrays is not None:
        arrays = arrays.part([i], [j])
    return _part(system, i, j, arrays, system.source[i, j] if arrays is None else None, own_features=False)


def _part(
    whole: DrawnSystem, i: int, j: int, arrays: StateArrays | None, source: object, own_features: bool = True
) -> DrawnSystem:
    poles, zeros, undamped = whole.poles, whole.zeros, whole.undamped
    if arrays is not None and own_features:
        poles, zeros, undamped = features(arrays)
    return DrawnSystem(
        label=whole.label,
        inputs=(whole.inputs[j],),
        outputs=(whole.outputs[i],),
        dt=whole.dt,
        poles=poles,
        zeros=zeros,
        undamped=undamped,
        arrays=arrays,
        source=source,
    )


def curve(system: DrawnSystem, grid: FloatArray, label: str) -> Curve:
    """Return the response of a system with one input and one output along `grid`, with its phase."""
    frequency, response = system.along(grid)
    return _curve(system, frequency, response[0, 0], label)


def _curve(system: DrawnSystem, frequency: FloatArray, response: ComplexArray, label: str) -> Curve:
    return Curve(
        label=label,
        system=system,
        frequency=frequency,
        response=response,
        phase=phase_in_degrees(frequency, response, begun=not system.is_data),
    )


def loop_phase(frequency: FloatArray, loop: ComplexArray) -> FloatArray:
    """Return the phase of a loop transfer as below, in the turn in which it comes closest to the critical point."""
    phase = phase_in_degrees(frequency, loop)
    with np.errstate(all="ignore"):
        distance = np.where(np.isfinite(phase), np.abs(1.0 + loop), np.inf)
    closest = phase[np.argmin(distance)]
    return phase - 360.0 * np.round((closest + 180.0) / 360.0) if np.isfinite(closest) else phase


def phase_in_degrees(frequency: FloatArray, response: ComplexArray, *, begun: bool = True) -> FloatArray:
    """Return the phase without jumps, degrees; NaN where the response is 0 or NaN.

    Across a pole on the stability boundary the phase falls by 180°, across a zero there it rises, as with the least
    damping. It begins where the slope of the gain puts it, −90° for each integrator (`begun`), or within half a turn.
    """
    known = np.flatnonzero(np.isfinite(response) & (response != 0.0))
    out = np.full(len(response), math.nan)
    if not known.size:
        return out
    h = response[known]
    log_gain = np.log(np.abs(h))
    angle = np.degrees(np.angle(h))
    step = (np.diff(angle) + 180.0) % 360.0 - 180.0
    for k in np.flatnonzero(np.abs(step) > _JUMP).tolist():
        # The gain distinguishes pole and zero: it has a peak, or a dip, between the two points.
        before = log_gain[k] - log_gain[max(k - 1, 0)]
        after = log_gain[min(k + 2, len(h) - 1)] - log_gain[k + 1]
        bend = after - before
        if bend < 0.0 < step[k]:
            step[k] -= 360.0
        elif bend > 0.0 > step[k]:
            step[k] += 360.0
    slope = 0.0
    if begun and len(h) > 1:
        w = frequency[known[:2]]
        slope = min(max(round(float((log_gain[1] - log_gain[0]) / np.log(w[1] / w[0]))), -6), 6)
    first = _begin(float(angle[0]), 90.0 * slope)
    out[known] = first + np.concatenate([[0.0], np.cumsum(step)])
    return out


def _begin(angle: float, target: float) -> float:
    """Return `angle` plus whole turns: close to `target`; of a negative gain the one closer to 0, −180° before 180°."""
    nearest = target + (angle - target + 180.0) % 360.0 - 180.0
    other = nearest + math.copysign(360.0, target - nearest)
    if abs(nearest - target) < 120.0:
        return nearest
    return min(nearest, other, key=lambda phase: abs(phase) + (60.0 if phase > 0.0 else 0.0))


def margins(one: Curve, *, skew: float = 0.0) -> Margins:
    """Return the margins of a loop at the crossovers that are drawn; between points of the grid they are sought."""
    gain = np.abs(one.response)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_gain = np.log(gain)
        # Odd multiples of 180 degrees are multiples of 360 here.
        turned = (one.phase + 180.0) / 360.0
        crossing = np.diff(np.sign(log_gain)) != 0.0
    crossing &= np.isfinite(log_gain[1:]) & np.isfinite(log_gain[:-1])
    w_gain, h_gain = _roots(one, np.flatnonzero(crossing), lambda h: np.log(np.abs(h)), of_gain=True)
    whole = np.floor(turned)
    with np.errstate(invalid="ignore"):
        passing = np.diff(whole) != 0.0
    passing &= np.isfinite(turned[1:]) & np.isfinite(turned[:-1])
    # Not where the phase jumps at an undamped pole or zero: there is no crossing at a finite gain.
    passing &= np.abs(np.diff(turned)) < _JUMP / 360.0
    w_phase, h_phase = _roots(one, np.flatnonzero(passing), lambda h: np.angle(-h), of_gain=False)
    stable, own = _disk(one.system, skew)
    phases = np.degrees(np.angle(-h_gain))
    with np.errstate(divide="ignore"):
        factors = 1.0 / np.abs(h_phase)
    return Margins(
        gain_crossovers=w_gain,
        phase_margins=np.where(phases <= -180.0, 180.0, phases),
        phase_crossovers=w_phase,
        gain_margins=factors,
        stable=stable,
        disk=own,
    )


def _roots(
    one: Curve, at: NDArray[np.intp], measure: Callable[[ComplexArray], FloatArray], *, of_gain: bool
) -> tuple[FloatArray, ComplexArray]:
    """Return where `measure` of the response is 0 between the points `at` and those behind, and the response there."""
    if not at.size:
        return np.zeros(0), np.zeros(0, dtype=np.complex128)
    low, high = one.frequency[at].copy(), one.frequency[at + 1].copy()
    if one.system.is_data:
        # Between two data the logarithm of the response is straight.
        start = np.log(one.response[at])
        turn = np.diff(np.radians(one.phase))[at]
        way = np.log(np.abs(one.response[at + 1] / one.response[at])) + 1j * turn
        target = start.real if of_gain else np.angle(-one.response[at])
        rate = way.real if of_gain else way.imag
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.clip(np.where(rate != 0.0, -target / rate, 0.0), 0.0, 1.0)
        return low * (high / low) ** share, np.exp(start + share * way)
    below = np.sign(measure(one.response[at]))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        same = np.sign(measure(one.system.response(middle)[0, 0])) == below
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    found = 0.5 * (low + high)
    return found, one.system.response(found)[0, 0]


def _disk(system: DrawnSystem, skew: float) -> tuple[bool | None, DiskMargin | None]:
    """Return whether the closed loop is stable (None: not known), and its disk margin where there is one."""
    if system.arrays is not None:
        E = 1.0 + system.arrays.D[0, 0]
        if abs(E) < 1e-12 * max(1.0, abs(system.arrays.D[0, 0])):
            return None, None
        A, B, C, _, dt = system.arrays
        s = continuous_poles(poles(A - B @ C / E), dt)
        stable = bool(spectral_abscissa(s) < 0.0)
        own = disk_margin(named_system(system.arrays, ["e"], ["v"]), skew=skew)
        return stable, own
    if not system.is_data:
        return None, None
    import control

    w, h = sorted_data(system.source)
    h = gaps(h)
    fine = np.isfinite(h[0, 0]) & (h[0, 0] != -1.0)
    if not fine.any():
        return None, None
    return None, disk_margin(control.frd(h[..., fine], w[fine]), skew=skew)
