"""Margins: how far gain and phase of all channels at once, or of one at a time, may move.

Every channel's loop gain is multiplied by (1 + delta (1 - skew) alpha/2) / (1 - delta (1 + skew) alpha/2) with any
complex |delta| < 1, one for each channel. The loop stays stable for alpha < 1 / max mu(S + (skew - 1)/2 I), mu for
diagonal perturbations; skew = 0 gives (S - T)/2 (Seiler, Packard and Gahinet, IEEE Control Systems 40(5), 2020).

Gain and phase margins are of one channel broken at the plant's input, all others closed. With S_i, the entry (i, i) of
the sensitivity at the input, the loop transfer of channel i is L_i = 1/S_i − 1. On the unit circle L(1/z) is the
conjugate of L(z), so that L is real where L(z) − L(1/z) has a zero and |L| = 1 where L(z) L(1/z) − 1 has one:
generalised eigenvalues. Next to narrow resonances and to z = 1 rounding moves these; L changes its sign between points
beside them, where it is followed to the crossing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.feedback import At, closed_loop_with_sensitivity, loop_of_sensitivity
from platform_ctrl.analysis.mu import SLACK, MuPeak
from platform_ctrl.analysis.norms import hinf_norm, peak_gain
from platform_ctrl.analysis.poles import continuous_poles, poles, resonances, search_grid, spectral_abscissa
from platform_ctrl.analysis.response import NamedSystem, StateSystem, frequency_response, linear_arrays
from platform_ctrl.analysis.singular_values import boundary_poles, largest_singular_values, pencil_crossings
from platform_ctrl.analysis.system import ComplexArray, System, block
from platform_ctrl.common.arguments import number, positive, real_numbers
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError


@value
class DiskMargin:
    """Margin of a loop against perturbations in all of its channels at once; ``float(margin)`` is `alpha`.

    Attributes
    ----------
    lower, upper
        Dimensionless. No perturbation smaller than `lower` makes the loop unstable; one of size `upper`,
        `perturbation`, does. They agree up to three channels; 0 if the closed loop is not stable.
    unstructured
        1/‖S + (skew - 1)/2 I‖, dimensionless: the margin against perturbations that couple the channels; not above
        `lower`.
    frequency
        Where the margin is reached, rad/s.
    proved
        Whether `lower` holds between all frequencies, to 0.01 %: constant scalings cover the whole axis.
    skew
        Of the disk, dimensionless. 0: gain may rise and fall alike; > 0: mostly rise; < 0: mostly fall.
    reason
        Why the margin is 0 although the loop has a response; else empty.
    perturbation : complex (m,)
        Factors of the channels' loop gains, of disk size `upper`, that put a closed-loop pole at `frequency` on the
        stability boundary. A complex factor is gain |f| and phase arg f at that frequency. Infinite where only an
        infinite gain does, or nothing.
    frequencies : (N,)
        Where the responses below are given, rad/s: a grid that follows the closed loop's poles.
    lower_response, upper_response : (N,)
        The bounds frequency by frequency, dimensionless.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """

    lower: float
    upper: float
    unstructured: float
    frequency: float
    proved: bool
    skew: float = 0.0
    reason: str = ""
    perturbation: ComplexArray
    frequencies: FloatArray
    lower_response: FloatArray
    upper_response: FloatArray

    @property
    def alpha(self) -> float:
        """The margin: `lower`, dimensionless."""
        return self.lower

    def __float__(self) -> float:
        return self.alpha

    @property
    def guaranteed(self) -> float:
        """Margin that holds between all frequencies, dimensionless.

        `lower`, or without a proof `unstructured`; less the 0.01 % that the proof leaves open.
        """
        return (self.lower if self.proved else self.unstructured) / (1.0 + SLACK)

    @property
    def gain_phase(self) -> tuple[float, float, float]:
        """Lowest and highest gain factor and the phase, rad, that `alpha` allows in every channel."""
        return disk_to_gain_phase(self.alpha, self.skew)


@value
class LoopMargins:
    """Disk margins of one channel at a time, all others closed.

    Attributes
    ----------
    channels
        Names of the m torques or pick-offs.
    alpha : (m,)
        Disk margin of each channel, dimensionless; 0 if the closed loop is not stable.
    frequency : (m,)
        Where it is reached, rad/s.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """

    channels: tuple[str, ...]
    alpha: FloatArray
    frequency: FloatArray


def disk_margin(loop_transfer: StateSystem, skew: float = 0.0) -> DiskMargin:
    """Return the disk margin of a loop in all channels simultaneously.

    The peak is searched over all frequencies, not only those of a grid, and a check with constant scalings between the
    crossings of Hamiltonian eigenvalues shows that none was missed.

    Parameters
    ----------
    loop_transfer
        L with negative feedback, square, continuous or discrete: S = (I + L)^-1 (see `loop_transfer`), as
        `control.StateSpace` or `TransferFunction`.
    skew
        Skew of the disk, dimensionless: 0 for gain that rises and falls alike.

    Returns
    -------
    DiskMargin
        The margin with its bounds, the worst frequency and the perturbation that is as small.

    Raises
    ------
    ArgumentError
        If the loop transfer is not square, I + D is singular, or `skew` is not finite.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.

    A. Packard, J. C. Doyle, Automatica 29, 1993.

    Examples
    --------
    >>> import control
    >>> from platform_ctrl import analysis
    >>> margin = analysis.disk_margin(control.ss([[0, 1], [0, -1]], [[0], [1]], [[1, 0]], 0))
    >>> round(margin.alpha, 4), round(margin.frequency, 3)
    (0.8944, 1.0)
    >>> [round(bound, 3) for bound in margin.gain_phase]  # two gain factors, and a phase in rad
    [0.382, 2.618, 0.841]
    """
    if not isinstance(skew, Real) or not math.isfinite(skew):
        raise ArgumentError(f"disk_margin: skew must be a finite number, got {skew!r}")
    L = linear_arrays(loop_transfer, "disk_margin")
    m = L.D.shape[0]
    if L.D.shape != (m, m) or m == 0:
        raise ArgumentError(f"disk_margin: the loop transfer must be square, got {m} outputs and {L.D.shape[1]} inputs")
    eye = np.eye(m)
    if np.linalg.svd(eye + L.D, compute_uv=False).min() < 1e-12 * max(1.0, float(np.abs(L.D).max())):
        words = "the loop is not well posed because I + D of its transfer is singular; add a lag"
        raise ArgumentError(f"disk_margin: {words}")
    # S + (skew − 1)/2 I
    E = np.linalg.inv(eye + L.D)
    disk = System(L.A - L.B @ E @ L.C, L.B @ E, -E @ L.C, E + 0.5 * (skew - 1.0) * eye, L.dt)
    peak = MuPeak(disk)
    axis = peak.axis
    s, on_boundary = boundary_poles(axis.system.A, disk.dt, axis.poles())
    if len(s) and (spectral_abscissa(s) >= 0.0 or on_boundary.any()):
        return no_margin(skew, np.zeros(0), s, disk)
    grid = search_grid(disk, s)
    response = axis.response(grid)
    if not np.all(np.isfinite(response)):  # a pole that is stable by rounding alone
        return no_margin(skew, grid, s, disk)
    gains, proved = largest_singular_values(response), True
    norm, at = peak_gain(axis, s, 1e-9) if len(s) else (float(gains.max()), 0.0)
    if m == 1:
        peak.mu, peak.frequency, peak.M = norm, at, axis.response(np.array([at]))[0]
        mu = gains, gains
    else:
        more = np.unique([at, axis.edge])
        peak.search(more, axis.response(more), between=False)
        mu = peak.search(grid, response)
        proved = peak.prove()
    if not np.all(np.isfinite(peak.M)):
        return no_margin(skew, grid, s, disk)
    delta, lower = peak.reached(), _inverse(peak.mu)
    with np.errstate(divide="ignore"):
        lower_response, upper_response = 1.0 / mu[0], 1.0 / mu[1]
    return DiskMargin(
        lower=lower,
        upper=max(lower, float(np.abs(delta).max())),
        unstructured=min(_inverse(norm), lower),
        frequency=peak.frequency,
        proved=proved,
        skew=float(skew),
        perturbation=disk_factors(delta, skew),
        frequencies=grid,
        lower_response=lower_response,
        upper_response=np.maximum(lower_response, upper_response),
    )


def loop_margins(plant: NamedSystem, controller: NamedSystem, at: At = "input") -> LoopMargins:
    """Return the disk margin of each channel, broken one at a time with all others closed.

    Parameters
    ----------
    plant, controller
        Joined as u = K y (see `loop_transfer`).
    at
        Break the torques (``"input"``) or the pick-offs (``"output"``).

    Returns
    -------
    LoopMargins
        One margin for each channel.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    S = closed_loop_with_sensitivity(plant, controller, at)
    names = tuple(controller.output_labels if at == "input" else controller.input_labels)
    if spectral_abscissa(continuous_poles(poles(S.A), S.dt)) >= 0.0:
        return LoopMargins(channels=names, alpha=np.zeros(len(names)), frequency=np.zeros(len(names)))
    # With the others closed, channel i's own sensitivity is the i-th diagonal entry of S.
    peaks = [hinf_norm(S.part([i], [i], -0.5), allow_unstable=True) for i in range(len(names))]
    return LoopMargins(
        channels=names,
        alpha=np.array([_inverse(norm) for norm, _ in peaks]),
        frequency=np.array([frequency for _, frequency in peaks]),
    )


def _inverse(mu: float) -> float:
    return 1.0 / mu if mu > 0.0 else math.inf


def no_margin(skew: float, shown: FloatArray, s: ComplexArray, disk: System) -> DiskMargin:
    """Return the margin of a loop that is not stable; `s` are its poles, `disk` the system whose gain counts."""
    nothing = np.zeros(shown.shape)
    worst = s[np.argmax(s.real)]
    rounded = "" if worst.real >= 0.0 else " but for rounding"
    return DiskMargin(
        lower=0.0,
        upper=0.0,
        unstructured=0.0,
        frequency=float(abs(worst.imag)),
        proved=True,
        skew=float(skew),
        reason=f"the closed loop is not stable{rounded}: pole at s = {worst:.6g}",
        perturbation=np.ones(len(disk.D), dtype=np.complex128),
        frequencies=shown,
        lower_response=nothing,
        upper_response=nothing,
    )


def disk_to_gain_phase(alpha: float, skew: float = 0.0) -> tuple[float, float, float]:
    """Return the lowest and highest gain factor and the phase in rad that a disk of size `alpha` contains.

    The highest factor is infinite and the phase pi where the disk does not bound them (Seiler, Packard and Gahinet
    2020).
    """
    alpha = positive("disk_to_gain_phase: alpha", alpha, zero=True)
    skew = number("disk_to_gain_phase: skew", skew)
    low = (2.0 - alpha * (1.0 - skew)) / (2.0 + alpha * (1.0 + skew))
    denominator = 2.0 - alpha * (1.0 + skew)
    if denominator == 0.0:
        return low, math.inf, math.acos(min(1.0, max(-1.0, low)))
    high = (2.0 + alpha * (1.0 - skew)) / denominator
    cosine = (1.0 + low * high) / (low + high) if low + high != 0.0 else math.inf
    phase = math.acos(cosine) if abs(cosine) <= 1.0 else math.pi
    return low, high if high > 0.0 else math.inf, phase


def disk_phase(gain: ArrayLike, alpha: float) -> FloatArray:
    """Return the phase, rad, up to which a loop may turn while its gain changes by a factor, both inside one disk.

    Factors f = gain exp(±j phase) with |f - 1| < alpha/2 |1 + f|, skew 0, make up the disk. Its edge is at
    cos phase = (gain + 1/gain)/2 (4 - alpha²)/(4 + alpha²): the highest and lowest gain leave no phase, and the largest
    phase of all is that at gain 1. NaN where the gain alone leaves the disk.
    """
    gain, a = real_numbers("disk_phase: gain", gain), 0.5 * min(alpha, 1e9)
    need, weight = (gain**2 + 1.0) * (1.0 - a**2), 2.0 * gain * (1.0 + a**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.where(weight != 0.0, need / weight, np.where(need < 0.0, -1.0, 2.0))
    # The ends themselves, but for rounding, are on the edge.
    return np.where(cosine > 1.0 + 1e-12, math.nan, np.arccos(np.clip(cosine, -1.0, 1.0)))[()]


def disk_factors(delta: ComplexArray, skew: float) -> ComplexArray:
    """Return the factors f of perturbations delta; infinite where the disk reaches an infinite gain or delta is."""
    out = np.full(delta.shape, complex(math.inf, 0.0))
    below = 1.0 - 0.5 * (1.0 + skew) * np.where(np.isfinite(delta), delta, 0.0)
    finite = np.isfinite(delta) & (np.abs(below) > 1e-12)
    out[finite] = (1.0 + 0.5 * (1.0 - skew) * delta[finite]) / below[finite]
    return out


# Of gain and phase margins: share of the slowest pole from which on L is followed, of Nyquist's below which a pole is
# one at 0; a gain like that of an integrator at 0.
_FIRST, _ZERO, _BEYOND = 1e-2, 1e-10, 1e8
# How far |L| may be from 1, and its angle from ±180°, at such a frequency, relative.
_AT = 1e-3
# Points of a grid beside the eigenvalues; parts into which an interval with a crossing is cut, and how often.
_GRID, _PARTS, _CUTS = 200, 16, 10


def margins_of_channel(sensitivity: System) -> tuple[float, float]:
    """Return the gain margin, a factor > 1, and the phase margin, rad, of a stable sampled loop, from its S_i.

    The gain margin is the least factor by which the gain may be raised or lowered, infinite where none ends stability.
    """
    loop = loop_of_sensitivity(sensitivity)

    def L(w: FloatArray) -> ComplexArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1.0 / frequency_response(sensitivity, w)[0, 0] - 1.0)

    own = np.concatenate([poles(sensitivity.A), poles(loop.A)])
    near = resonances(continuous_poles(own, loop.dt))
    real = _crossings(L, lambda x: x.imag, _real_frequencies(loop), near, np.pi / loop.dt)
    # L is real at zero frequency and at Nyquist's, too.
    real = np.concatenate([real, L(np.array([0.0, np.pi / loop.dt]))])
    real = real[(real.real < 0.0) & (np.abs(real) < _BEYOND) & (np.abs(real.imag) < _AT * np.abs(real.real))]
    unit = _crossings(L, lambda x: np.abs(x) - 1.0, pencil_crossings(*loop), near, np.pi / loop.dt)
    unit = unit[np.abs(np.abs(unit) - 1.0) < _AT]
    gain = float(np.exp(np.abs(np.log(-real.real)).min(initial=np.inf)))
    return gain, float((np.pi - np.abs(np.angle(unit))).min(initial=np.inf))


def _crossings(
    L: Callable[[FloatArray], ComplexArray],
    of: Callable[[ComplexArray], FloatArray],
    known: FloatArray,
    near: FloatArray,
    nyquist: float,
) -> ComplexArray:
    """Return L where a function of it changes its sign, and at `known` frequencies, rad/s.

    The function is followed between `near` and the midpoints of known frequencies: each interval has one crossing.
    """
    low = _FIRST * near[near > _ZERO * nyquist].min(initial=nyquist)
    w = np.unique(np.concatenate([known, near, np.geomspace(low, nyquist, _GRID)]))
    w = w[(w >= low) & (w < nyquist)]
    w = np.unique(np.concatenate([0.5 * (w[1:] + w[:-1]), w]))
    signs = np.sign(of(L(w)))
    at = np.flatnonzero(signs[1:] * signs[:-1] < 0.0)
    low_ends, high_ends = w[at], w[at + 1]
    every = np.arange(len(at))
    for _ in range(_CUTS if len(at) else 0):
        points = low_ends[:, None] + (high_ends - low_ends)[:, None] * np.linspace(0.0, 1.0, _PARTS + 1)
        same = np.sign(of(L(points.ravel()))).reshape(points.shape) == signs[at, None]
        last = np.clip(_PARTS - np.argmax(same[:, ::-1], axis=1), 0, _PARTS - 1)
        low_ends, high_ends = points[every, last], points[every, last + 1]
    return L(np.concatenate([known, low_ends]))


def _real_frequencies(L: System) -> FloatArray:
    """Return frequencies, rad/s, that contain all where L(z) = L(1/z): z E v = F v with v = [x, adjoint, u]."""
    from scipy.linalg import eigvals

    A, B, C, _, dt = L
    n, one = len(A), np.eye(len(A))
    E = block([[one, 0, np.zeros((n, 1))], [0, A.T, C.T], [np.zeros((1, n)), 0, 0]])
    F = block([[A, 0, B], [0, one, 0], [C, -B.T, np.zeros((1, 1))]])
    with np.errstate(all="ignore"):
        z: ComplexArray = np.asarray(eigvals(F, E), dtype=np.complex128)
    angles = np.angle(z[np.isfinite(z)])
    return np.asarray(angles[angles > 0.0] / dt)
