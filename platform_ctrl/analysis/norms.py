"""Norms of systems: H-infinity with its frequency, H2, the rms that sampled white noise causes, and the bandwidth.

The H-infinity norm follows Bruinsma and Steinbuch (Systems & Control Letters 14, 1990) and Boyd and Balakrishnan (ibid.
15, 1990): the eigenvalues of a Hamiltonian matrix show where the largest singular value crosses a level. These only
propose frequencies; what decides is the response evaluated there. So a widely spread system, whose Hamiltonian
eigenvalues are inexact, cannot make the result wrong by a wrong test of "on the axis".

The bandwidth is the lowest frequency at which the largest singular value of S reaches 1/sqrt(2).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np

from platform_ctrl.analysis import poles as pole
from platform_ctrl.analysis.feedback import At, closed_loop_with_sensitivity
from platform_ctrl.analysis.response import StateSystem, frequency_response, linear_arrays
from platform_ctrl.analysis.singular_values import FrequencyAxis, boundary_poles, largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, StateSpace, System, scaled
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

# Relative error of a peak: what is returned is the upper end.
PEAK_TOLERANCE = 5e-10

# Searches for a higher peak; two or three are usual.
_SEARCHES = 60

Band = tuple[float, float]
WHOLE: Band = (0.0, np.inf)


def hinf_norm(system: StateSystem, allow_unstable: bool = False) -> tuple[float, float]:
    """Return the H-infinity norm of `system` and the frequency where it is reached.

    Parameters
    ----------
    system
        Continuous or discrete, stable: `control.StateSpace`, `TransferFunction` or `System` of one system. Data
        are refused: the largest gain among their frequencies is not the norm.
    allow_unstable
        Take unstable systems too and return the L-infinity norm, the peak along the frequency axis.

    Returns
    -------
    norm, frequency
        Largest singular value, to 1e-9, in the units of the outputs per unit of the inputs, and its frequency in rad/s;
        ``inf`` as the frequency of a continuous system whose norm is that of D, ``inf`` as the norm of a system with a
        pole on the stability boundary.

    Raises
    ------
    ArgumentError
        If the system is unstable and `allow_unstable` is not set, improper, data, or a stack of several.

    References
    ----------
    N. A. Bruinsma, M. Steinbuch, Systems & Control Letters 14, 1990.

    S. Boyd, V. Balakrishnan, Systems & Control Letters 15, 1990.

    Examples
    --------
    >>> import control
    >>> from platform_ctrl import analysis
    >>> oscillator = control.ss([[0, 1], [-1, -0.2]], [[0], [1]], [[1, 0]], 0)
    >>> norm, frequency = analysis.hinf_norm(oscillator)
    >>> round(norm, 4), round(frequency, 4)
    (5.0252, 0.9899)
    """
    return _norm(FrequencyAxis(linear_arrays(system, "hinf_norm")), 1e-9, allow_unstable)


def _norm(axis: FrequencyAxis, tolerance: float, allow_unstable: bool) -> tuple[float, float]:
    A, B, C, D, dt = axis.system
    if B.shape[1] == 0 or len(C) == 0:
        return 0.0, 0.0
    if len(A) == 0:
        return float(np.linalg.norm(D, 2)), 0.0
    s, on_boundary = boundary_poles(A, dt, axis.poles())
    unstable = (s.real > 0.0) & ~on_boundary
    if not allow_unstable and np.any(unstable):
        worst = s[np.argmax(np.where(unstable, s.real, -math.inf))]
        raise ArgumentError(
            f"hinf_norm: the system must be stable, it has a pole at s = {worst:.6g}; "
            "allow_unstable=True gives the L-infinity norm"
        )
    if np.any(on_boundary):
        return math.inf, float(np.abs(s[on_boundary].imag).min())
    return peak_gain(axis, s, tolerance)


def peak_gain(axis: FrequencyAxis, s: ComplexArray, tolerance: float, band: Band = WHOLE) -> tuple[float, float]:
    """Return the largest gain in a band of a system with poles `s`, none on the boundary there, and its frequency.

    The gain at resonances is climbed from the highest; then the eigenvalues of a Hamiltonian matrix show where it
    exceeds the best one (Bruinsma and Steinbuch).
    """
    top = min(band[1], axis.edge)
    if not band[0] <= top:
        return 0.0, 0.0

    def points(own: FloatArray) -> FloatArray:
        return np.concatenate([[band[0], top], own[(own > band[0]) & (own < top)]])

    best, frequency = axis.largest(points(pole.resonances(s)))
    for _ in range(_SEARCHES):
        best, frequency = _climbed(axis, s, best, frequency, 0.05 * tolerance, band)
        if not 0.0 < best < math.inf:
            break
        crossings = level_frequencies(axis, best * (1.0 + tolerance))
        if not crossings.any():
            break
        found, at = axis.largest(points(crossings))
        if found <= best * (1.0 + tolerance):
            break
        best, frequency = found, at
    return best, frequency


# Where a climb looks around the best frequency, in widths: at first, and around where the top should be.
_FAN, _AROUND = np.linspace(-1.0, 1.0, 15), np.array([-1.0, -0.2, 0.0, 0.2, 1.0])
# How much closer it looks where a parabola says where the top is.
_CLOSER = 0.05


def _climbed(
    axis: FrequencyAxis, s: ComplexArray, best: float, frequency: float, slack: float, band: Band
) -> tuple[float, float]:
    """Return the local maximum near `frequency`: fans of frequencies that contract around the best.

    Where states spread widely, crossings are too inexact for the last digits of a narrow peak.
    """
    if not (math.isfinite(frequency) and math.isfinite(best)) or frequency == 0.0:
        return best, frequency
    # The peak cannot be much narrower than the distance to the nearest pole.
    width = float(np.abs(s[np.isfinite(s)] - 1j * frequency).min(initial=frequency))
    centre, offsets = frequency, _FAN
    for _ in range(12):
        fan = np.abs(centre + width * offsets)
        fan = fan[(fan >= band[0]) & (fan <= min(band[1], axis.edge))]
        if not fan.size:
            break
        sizes = axis.gains(fan)
        i = int(np.argmax(sizes))
        if sizes[i] > best:
            best, frequency = float(sizes[i]), float(fan[i])
        # The top lies between the neighbours of the highest: it cannot rise much above where these are as high.
        three = sizes[max(i - 1, 0) : i + 2]
        if best - float(three.min()) <= slack * best or width < 1e-15 * frequency:
            break
        step = _to_top(fan[i - 1 : i + 2], three) if len(three) == 3 and sizes[i] >= best * (1.0 - slack) else None
        if step is None:
            centre, width = frequency, 0.5 * width
        elif step[1] <= slack:
            return best, float(fan[i] + step[0])
        else:
            centre, width, offsets = fan[i] + step[0], _CLOSER * width, _AROUND
    return best, frequency


def _to_top(w: FloatArray, gains: FloatArray) -> tuple[float, float] | None:
    """Return how far the top of the parabola through 1/gain² is from the middle of three, and how much it rises there.

    Next to a single pole it is the gain itself. None where the parabola has no top.
    """
    below, _, above = (w - w[1]).tolist()
    if not (gains.min() > 0.0 and below < 0.0 < above):
        return None
    left, _, right = ((gains[1] / gains) ** 2 - 1.0).tolist()
    bend = (right / above - left / below) / (above - below)
    slope = left / below - bend * below
    if not (bend > 0.0 and slope * slope < 4.0 * bend):
        return None
    return -0.5 * slope / bend, 1.0 / math.sqrt(1.0 - 0.25 * slope * slope / bend) - 1.0


def level_frequencies(axis: FrequencyAxis, level: float) -> FloatArray:
    """Return frequencies among which, if the gain exceeds `level` anywhere, one lies where it does.

    Crossings, and frequencies between them, below and above.
    """
    w = axis.crossings(level)
    if w.size == 0:
        return w
    return np.concatenate([w, np.sqrt(w[1:] * w[:-1]), 0.5 * (w[1:] + w[:-1]), [0.5 * w[0], 2.0 * w[-1]]])


def gains(system: System, frequency: FloatArray) -> FloatArray:
    """Return the largest singular value at each frequency, (N,); inf where the response is not finite."""
    return largest_singular_values(frequency_response(system, frequency, -3))


def h2_norm(system: StateSystem) -> float:
    """Return the H2 norm: the rms sum of the outputs when white noise of unit density (or variance) drives it.

    Parameters
    ----------
    system
        Continuous or discrete, stable: `control.StateSpace` or `TransferFunction`.

    Returns
    -------
    float
        In the units of the outputs per unit of the inputs (times s^-1/2 for a continuous system).

    Raises
    ------
    ArgumentError
        If the system is not stable, or is continuous and has a direct term.
    """
    A, B, C, D, dt = linear_arrays(system, "h2_norm")
    if dt == 0.0 and np.any(D):
        raise ArgumentError("h2_norm: D of a continuous system must be zero, otherwise the norm is infinite")
    A, B, C = scaled(A, B, C)
    s = pole.continuous_poles(pole.poles(A), dt)
    if pole.spectral_abscissa(s) >= 0.0:
        raise ArgumentError(f"h2_norm: the system must be stable, it has a pole at s = {s[np.argmax(s.real)]:.6g}")
    close = ArgumentError(
        f"h2_norm: a pole at s = {s[np.argmax(s.real)]:.6g} is stable by no more than rounding; "
        "poles must be farther from the imaginary axis"
    )
    if dt > 0.0:
        X = stationary_covariance(A, B)
        if not np.isfinite(X).all():
            raise close
    else:
        from scipy.linalg import solve_continuous_lyapunov

        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            try:
                X = np.asarray(solve_continuous_lyapunov(A, -B @ B.T), dtype=np.float64)
            except (RuntimeWarning, np.linalg.LinAlgError):
                raise close from None
    return math.sqrt(max(0.0, float(np.trace(C @ X @ C.T) + np.sum(D * D))))


def noise_rms(system: System, rms: FloatArray) -> FloatArray:
    """Return the rms (..., p) of every output of sampled systems (..., n, n) from independent white samples.

    `rms` (m,) or a number is the standard deviation of the samples at each input, in its unit. Infinite where a system
    is not stable.
    """
    A, B, C = scaled(system.A, system.B, system.C)
    X = stationary_covariance(A, B * rms)
    with np.errstate(invalid="ignore", over="ignore"):
        variance = np.einsum("...ij,...jk,...ik->...i", C, X, C) + np.sum((system.D * rms) ** 2, axis=-1)
    return np.where(np.isfinite(variance), np.sqrt(np.maximum(variance, 0.0)), np.inf)


# Time after which the noise of a loop that drifts counts, s: a random walk has no rms.
_DRIFT_TIME = 3600.0


def drifting_rms(system: System, rms: FloatArray) -> FloatArray:
    """Return the rms (p,) of the outputs of one system with poles z = 1 after an hour, from white samples.

    The part along the equilibria is a random walk, whose variance grows with time; the rest is stationary. Infinite
    where the system is unstable otherwise.
    """
    A, B, C, D, dt = system
    P = pole.onto_equilibria(system)
    if P is None:
        return np.full(len(C), np.inf)
    walk = np.linalg.norm((C @ P @ B) * rms, axis=1)
    rest = noise_rms(System(A - P, B - P @ B, C, D, dt), rms)
    return np.asarray(np.hypot(rest, math.sqrt(_DRIFT_TIME / dt) * walk))


def stationary_covariance(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return X = A X A' + B B' for stacks (..., n, n), (..., n, m); inf where A is not stable.

    By doubling (Smith): sums of positive terms only, so small variances keep their digits beside large ones.
    """
    X = B @ np.swapaxes(B, -1, -2)
    batch = np.broadcast_shapes(A.shape[:-2], X.shape[:-2])
    X = np.array(np.broadcast_to(X, (*batch, *X.shape[-2:])))
    if A.shape[-1] == 0:
        return X
    stable = np.less(np.broadcast_to(np.abs(pole.poles(A)).max(axis=-1, initial=0.0), batch), 1.0, dtype=np.bool_)
    X[~stable] = np.inf
    power = np.array(np.broadcast_to(A, (*batch, *A.shape[-2:])))[stable]
    inside = X[stable]
    with np.errstate(over="ignore", invalid="ignore"):  # where only rounding has a pole inside the unit circle
        for _ in range(64):
            more = power @ inside @ np.swapaxes(power, -1, -2)
            inside = inside + more
            if not np.any(
                np.abs(more).max(axis=(-2, -1), initial=0.0) > 1e-17 * np.abs(inside).max(axis=(-2, -1), initial=0.0)
            ):
                break
            power = power @ power
    X[stable] = np.where(np.isfinite(inside).all(axis=(-2, -1), keepdims=True), inside, np.inf)
    return X


def peak(system: System | FrequencyAxis, band: Band = WHOLE) -> tuple[float, float]:
    """Return an upper bound of the largest singular value over `band`, within 5e-10, and the peak's frequency, rad/s.

    Stable where the band is the whole axis; poles may lie anywhere outside of the band.
    """
    axis = FrequencyAxis(system) if isinstance(system, System) else system
    if band == WHOLE:
        norm, frequency = _norm(axis, PEAK_TOLERANCE, True)
    else:
        norm, frequency = peak_gain(axis, pole.continuous_poles(axis.poles(), axis.system.dt), PEAK_TOLERANCE, band)
    return norm * (1.0 + PEAK_TOLERANCE), frequency


def exceeds(axis: FrequencyAxis, level: float, band: Band = WHOLE) -> bool:
    """Return whether the largest singular value is above `level` anywhere in `band`, which has no poles, or may be."""
    s = pole.continuous_poles(axis.poles(), axis.system.dt)
    crossings = level_frequencies(axis, level)
    if not crossings.size and level > 0.0 and axis.system.A.size:
        # The Hamiltonian leaves floating point: nothing is shown.
        return True
    # The poles' own frequencies too: next to a narrow peak a crossing is as inexact as the pole.
    own = np.concatenate([np.abs(s.imag[np.isfinite(s)]), crossings])
    low, top = band[0], min(band[1], axis.edge)
    own = np.concatenate([[low, top], own[(own > low) & (own < top)]])
    return low <= top and axis.largest(own)[0] > level


# Times that a grid is refined, around how many tops at once, and until neighbours are as high but for this share.
_REFINEMENTS, _TOPS, _ALIKE = 20, 40, 1e-3


def refined_peak(gain: Callable[[FloatArray], FloatArray], w: FloatArray) -> tuple[float, float]:
    """Return the largest value of a function on rising frequencies (F,), rad/s, refined around its tops, and where.

    Tops that may be the highest are refined until their neighbours are as high but for 0.1 %. What is narrower than the
    grid is not seen: it has to contain the resonances.
    """
    y = gain(w)
    for _ in range(_REFINEMENTS):
        padded = np.pad(y, 1, constant_values=-np.inf)
        high = (y >= padded[:-2]) & (y >= padded[2:])
        beside = np.minimum(np.where(padded[:-2] < 0.0, y, padded[:-2]), np.where(padded[2:] < 0.0, y, padded[2:]))
        # Between points that differ much a top may be higher by about as much.
        tops = np.flatnonzero(high & (2.0 * y - beside >= y.max()) & (beside < (1.0 - _ALIKE) * y))
        if not tops.size:
            break
        # Of a gain that is the same everywhere rounding makes every other point a top.
        tops = tops[np.argsort(beside[tops] - 2.0 * y[tops])[:_TOPS]]
        ends = np.unique(np.concatenate([tops[tops > 0] - 1, tops[tops < len(w) - 1]]))
        shares = np.array([0.25, 0.5, 0.75])
        new = np.setdiff1d(w[ends, None] + (w[ends + 1] - w[ends])[:, None] * shares, w)
        if not new.size:
            break
        at = np.searchsorted(w, new)
        w, y = np.insert(w, at, new), np.insert(y, at, gain(new))
    k = int(np.argmax(y))
    return float(y[k]), float(w[k])


LEVEL = math.sqrt(0.5)
# Relative distance from the level up to which a gain is at it.
_ROUNDING = 1e-12
# Share of the highest frequency below which the response is rounding.
_ROUNDED = 1e-9


def bandwidth(plant: StateSpace, controller: StateSpace, at: At = "output") -> float:
    """Return the lowest frequency, rad/s, at which the largest singular value of S reaches 1/sqrt(2).

    Found among the crossings that the Hamiltonian of S shows, so that a narrow peak between grid points is not missed,
    and refined by root finding.

    Parameters
    ----------
    plant, controller
        Joined as u = K y (see `loop_transfer`).
    at
        Where S is taken: the plant's ``"input"`` or ``"output"``.

    Returns
    -------
    float
        rad/s. 0 if the closed loop is not stable or S is that large at the lowest frequencies already; the Nyquist
        frequency (infinity for a continuous loop) if S never gets there.

    References
    ----------
    S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2005, ch. 2.

    S. Boyd, V. Balakrishnan, Systems & Control Letters 15, 1990.
    """
    return bandwidth_of_sensitivity(FrequencyAxis(closed_loop_with_sensitivity(plant, controller, at)))


def bandwidth_of_sensitivity(axis: FrequencyAxis) -> float:
    """Return the bandwidth, as `bandwidth` does, of a loop with this sensitivity."""
    from scipy.optimize import brentq

    S = axis.system
    s = pole.continuous_poles(axis.poles(), S.dt)
    if S.A.shape[0] and pole.spectral_abscissa(s) >= 0.0:
        return 0.0
    # Crossings, and frequencies between them: so fine that the first is in the first interval whose ends differ.
    w = np.union1d(pole.search_grid(S, s), level_frequencies(axis, LEVEL))
    # An integrator in the loop makes S as small as the frequency; far below the fastest pole rounding rules.
    w = w[(w > _ROUNDED * w[np.isfinite(w)].max()) & (w <= axis.edge)]
    sizes = axis.gains(w)
    first = int(np.argmax(sizes >= LEVEL * (1.0 - _ROUNDING)))
    if sizes[first] < LEVEL * (1.0 - _ROUNDING):
        return axis.edge
    if first == 0:
        return 0.0
    if sizes[first] <= LEVEL * (1.0 + _ROUNDING):
        return float(w[first])
    return float(
        brentq(lambda x: axis.gains(np.array([x]))[0] - LEVEL, *w[first - 1 : first + 1], xtol=1e-300, rtol=1e-12)
    )


def bandwidth_of_response(frequency: FloatArray, S: ComplexArray) -> float:
    """Return the bandwidth, rad/s, from sensitivities (N, m, m) on a grid (N,), for a tuner: interpolated.

    The first frequency if S is that large there already, the last if it never gets there.
    """
    sizes = largest_singular_values(S) / LEVEL
    above = np.flatnonzero(sizes >= 1.0)
    if not above.size:
        return float(frequency[-1])
    ends = slice(max(above[0] - 1, 0), above[0] + 1)
    levels = np.log(np.maximum(sizes[ends], np.finfo(float).tiny))
    return float(np.exp(np.interp(0.0, levels, np.log(frequency[ends]))))
