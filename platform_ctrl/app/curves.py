"""Curves of closed loops worked out fast for a whole set of plants: phases, crossovers, time responses, root loci."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.plant_set import BoolArray
from platform_ctrl.analysis.pole_branches import pole_branches
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.common.values import FloatArray

# Values beyond this are of a loop that diverges: no page has to draw them.
_FARTHEST = 1e12


def channel_response(S: ComplexArray, channel: int) -> ComplexArray:
    """Return the loop broken at one channel, all others closed, 1/S_ii - 1, complex (..., F) of S (..., F, m, m)."""
    with np.errstate(all="ignore"):
        out = 1.0 / S[..., channel, channel] - 1.0
    return np.asarray(np.where(np.isfinite(out), out, 0.0), dtype=np.complex128)


def degrees(response: ComplexArray) -> FloatArray:
    """Return the unwrapped phase (F,), degrees, shifted by whole turns: from -360 to 0 where the gain is nearest 1."""
    phase = np.degrees(np.unwrap(np.angle(response)))
    middle = phase[int(np.argmin(np.abs(np.log(np.maximum(np.abs(response), 1e-300)))))]
    return np.asarray(phase - 360.0 * np.ceil(middle / 360.0))


def degrees_beside(responses: ComplexArray, leading: ComplexArray, phase: FloatArray) -> FloatArray:
    """Return the phases (N, F) of responses like `leading` (F,), whose unwrapped `phase` is given, on its sheet.

    What is unwrapped is the difference, which turns slowly where a grid is too coarse for the phase itself.
    """
    with np.errstate(all="ignore"):
        ratio = responses * np.conj(leading)
    return np.asarray(phase + np.degrees(np.unwrap(np.angle(ratio), axis=-1)))


def gain_crossings(frequency: FloatArray, response: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return where the gain passes 1, rad/s, and the phase there above -180, degrees, from -180 to 180."""
    with np.errstate(divide="ignore"):
        size = np.log(np.maximum(np.abs(response), 1e-300))
    at = np.flatnonzero((size[:-1] > 0.0) != (size[1:] > 0.0))
    share = size[at] / (size[at] - size[at + 1])
    w = np.exp((1.0 - share) * np.log(frequency[at]) + share * np.log(frequency[at + 1]))
    turn = np.angle(response[at + 1] / response[at])
    phase = np.degrees(np.angle(-response[at]) + share * turn)
    return w, np.asarray((phase + 180.0) % 360.0 - 180.0)


def gain_range(response: ComplexArray) -> tuple[float, float]:
    """Return the factors nearest to 1, below and above, that bring the response (F,) to -1: 0 and inf without any."""
    imaginary, real = response.imag, response.real
    at = np.flatnonzero((imaginary[:-1] > 0.0) != (imaginary[1:] > 0.0))
    with np.errstate(all="ignore"):
        share = imaginary[at] / (imaginary[at] - imaginary[at + 1])
        crossing = (1.0 - share) * real[at] + share * real[at + 1]
    # At both ends of the grid, next to 0 and to Nyquist's, the response is as good as real.
    ends = [real[k] for k in (0, -1) if abs(imaginary[k]) < 1e-2 * abs(real[k])]
    crossing = np.append(crossing, ends)
    factors = -1.0 / crossing[np.isfinite(crossing) & (crossing < 0.0)]
    return (
        float(factors[factors <= 1.0].max(initial=0.0)),
        float(factors[factors > 1.0].min(initial=np.inf)),
    )


def round_up(x: float) -> float:
    """Return the next of 1, 2, 5, 10, ... times a power of ten: axes stand still while a slider moves."""
    decade = 10.0 ** math.floor(math.log10(x))
    return float(next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= x * (1.0 - 1e-9)))


def sample_times(duration: float, period: float, points: int) -> tuple[FloatArray, int]:
    """Return about `points` times of samples over `duration`, s, and how many periods lie between them."""
    every = max(1, math.ceil(duration / period / points))
    count = max(2, math.ceil(duration / period / every - 1e-9) + 1)
    return np.asarray(np.arange(count) * (every * period), dtype=np.float64), every


def held_responses(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, inputs: FloatArray, every: int
) -> FloatArray:
    """Return the outputs (..., p, T) of sampled systems at rest for one input, at every `every`-th sample.

    Parameters
    ----------
    A, B, C, D
        Stacks (..., n, n), (..., n, 1), (..., p, n), (..., p, 1).
    inputs : (every * (T - 1) + 1,)
        At all samples.
    every
        Samples between those that are returned.

    Notes
    -----
    Exact: a power of A carries the state over whole intervals, within which the inputs count one by one.
    """
    from platform_ctrl.app.recurrence import recur  # loads numba: the page is to be there before

    count = (len(inputs) - 1) // every + 1
    with np.errstate(all="ignore"):
        # [A^(every-1) B, ..., A B, B]
        driven, power = B, A
        while driven.shape[-1] < every:
            driven = np.concatenate([power @ driven, driven], axis=-1)
            power = power @ power
        driven = driven[..., -every:]
        # What comes to the state over each interval, (..., T - 1, n), and then the state after it.
        x = inputs[:-1].reshape(count - 1, every) @ driven.swapaxes(-1, -2)
        step = np.linalg.matrix_power(A, every).swapaxes(-1, -2)
        n = A.shape[-1]
        recur(np.ascontiguousarray(step).reshape(-1, n, n), x.reshape(-1, count - 1, n))
        y = D * inputs[::every]
        y[..., 1:] += C @ x.swapaxes(-1, -2)
    return np.asarray(
        np.clip(np.nan_to_num(y, nan=_FARTHEST, posinf=_FARTHEST, neginf=-_FARTHEST), -_FARTHEST, _FARTHEST)
    )


def gain_locus(
    plant: StateArrays, controller: StateArrays, points: int, highest: float = 2.5
) -> tuple[FloatArray, ComplexArray]:
    """Return factors on all of a controller from 0 to `highest`, 1 among them, and the closed-loop poles (G, n) in s.

    Columns are continuous branches; s = ln(z)/T.
    """
    A, B, C, D, period = plant

    def poles(factors: FloatArray) -> ComplexArray:
        f = factors[:, None, None]
        closed = closed_loop(
            StateArrays(A, B, C, D, period),
            StateArrays(controller.A, controller.B, f * controller.C, f * controller.D, period),
        ).A
        return np.asarray(np.linalg.eigvals(closed), dtype=np.complex128)

    # From 0 on poles move as the root of the factor: closer steps there.
    half = points // 2
    gains = np.concatenate([np.linspace(0.0, 1.0, half + 1) ** 1.5, np.linspace(1.0, highest, half)[1:]])
    return gains, continuous_poles(pole_branches(poles(gains)), period)


def moved_by_gain(gains: FloatArray, branches: ComplexArray, present: ComplexArray) -> BoolArray:
    """Return which of the present poles (n,) the gain moves: by a hundredth of themselves or more, if it is doubled."""
    at = int(np.argmin(np.abs(gains - 1.0)))
    low, high = max(at - 1, 0), min(at + 1, len(gains) - 1)
    with np.errstate(all="ignore"):
        speed = np.abs(branches[high] - branches[low]) / (gains[high] - gains[low])
        nearest = np.nanargmin(
            np.where(np.isfinite(branches[at]), np.abs(present[:, None] - branches[at]), np.inf), axis=1
        )
        return np.asarray(speed[nearest] > 0.01 * np.abs(present))


def arrays_of(stack: StateArrays, k: int) -> StateArrays:
    """Return one system of a stack."""
    return StateArrays(stack.A[k], stack.B[k], stack.C[k], stack.D[k], stack.dt)
