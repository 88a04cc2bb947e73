"""Disk margins: how far gain and phase of all channels at once, or of one at a time, may move.

Every channel's loop gain is multiplied by (1 + delta (1 - skew) alpha/2) / (1 - delta (1 + skew) alpha/2) with any
complex |delta| < 1, one for each channel. The loop stays stable for alpha < 1 / max mu(S + (skew - 1)/2 I), mu for
diagonal perturbations; skew = 0 gives (S - T)/2 (Seiler, Packard and Gahinet, IEEE Control Systems 40(5), 2020).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, frequencies, state_arrays
from platform_ctrl.analysis.diagonal_mu import mu_lower_bound, mu_upper_bound
from platform_ctrl.analysis.feedback import At, closed_loop_with_sensitivity
from platform_ctrl.analysis.norms import crossing_frequencies, gains, hinf_norm_arrays, resonances
from platform_ctrl.analysis.poles import continuous_poles, pole_arrays, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response_arrays
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, value

if TYPE_CHECKING:
    import control


@value
class DiskMargin:
    """Margin of a loop against perturbations in all of its channels at once; ``float(margin)`` is `alpha`.

    Attributes
    ----------
    alpha
        The guaranteed margin: `lower`. 0 if the closed loop is not stable.
    lower, upper
        No perturbation smaller than `lower` makes the loop unstable; one of size `upper` does.
        They agree up to three channels.
    unstructured
        1/‖S + (skew - 1)/2 I‖: the margin against perturbations that couple the channels; not above `lower`.
    frequency
        Where the margin is reached, rad/s.
    proved
        Whether `lower` holds between all frequencies, to 0.01 %: constant scalings cover the whole axis.
    skew
        0: gain may rise and fall alike; > 0: mostly rise; < 0: mostly fall.
    frequencies : (N,)
        rad/s.
    lower_response, upper_response, unstructured_response : (N,)
        The bounds frequency by frequency.
    """

    alpha: float
    lower: float
    upper: float
    unstructured: float
    frequency: float
    proved: bool
    skew: float
    frequencies: FloatArray
    lower_response: FloatArray
    upper_response: FloatArray
    unstructured_response: FloatArray

    def __float__(self) -> float:
        return self.alpha

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
        Signal names.
    alpha : (m,)
        Disk margin of each channel; 0 if the closed loop is not stable.
    frequency : (m,)
        Where it is reached, rad/s.
    """

    channels: tuple[str, ...]
    alpha: FloatArray
    frequency: FloatArray


def disk_margin(loop_transfer: control.StateSpace, skew: float = 0.0, frequency: ArrayLike | None = None) -> DiskMargin:
    """Return the disk margin of a loop in all channels simultaneously.

    The peak is searched over all frequencies, not only those of a grid, and a check with constant scalings between the
    crossings of Hamiltonian eigenvalues shows that none was missed.

    Parameters
    ----------
    loop_transfer
        L with negative feedback, square, continuous or discrete: S = (I + L)^-1 (see `loop_transfer`).
    skew
        Skew of the disk.
    frequency : (N,), optional
        Frequencies of the result's arrays, rad/s; default a grid that follows the closed loop's poles. The margin
        does not depend on it.

    Raises
    ------
    ArgumentError
        If the loop transfer is not square, I + D is singular, or `skew` or `frequency` is not finite.
    """
    L = state_arrays(loop_transfer, "disk_margin")
    m = L.D.shape[0]
    if L.D.shape != (m, m) or m == 0:
        raise ArgumentError(
            f"disk_margin: the loop transfer has {m} outputs and {L.D.shape[1]} inputs, expected a square one"
        )
    if not math.isfinite(skew):
        raise ArgumentError(f"disk_margin: skew = {skew!r}, expected a finite number")
    disk = _disk_arrays(L, skew)
    s = continuous_poles(pole_arrays(disk.A), disk.dt)
    given = None if frequency is None else frequencies(frequency, "disk_margin")
    if spectral_abscissa(s) >= 0.0:
        return _unstable(skew, np.zeros(0) if given is None else given, s)
    norm, at = hinf_norm_arrays(*disk)
    grid = _grid(disk, s, at)
    if m == 1:
        lower = upper = _inverse(norm)
        proved = True
    else:
        peak = _Peak(disk)
        # The grid only has to tell the hills apart: the peak itself is computed to seven digits.
        peak.climb(grid, mu_upper_bound(peak.response(grid), 1e-3)[0])
        proved = peak.prove()
        at, lower = peak.frequency, _inverse(peak.mu)
        upper = _inverse(float(mu_lower_bound(peak.response(np.array([at])), peak.D[None])[0]))
    shown = grid if given is None else given
    response = frequency_response_arrays(*disk, shown)
    mu, D = mu_upper_bound(response, 1e-4)
    with np.errstate(divide="ignore"):
        lower_response = 1.0 / mu
        upper_response = 1.0 / np.minimum(mu_lower_bound(response, D, iterations=15), mu)
        unstructured_response = 1.0 / np.linalg.norm(response, 2, axis=(-2, -1))
    return DiskMargin(
        alpha=lower,
        lower=lower,
        upper=max(lower, upper),
        unstructured=min(_inverse(norm), lower),
        frequency=at,
        proved=proved,
        skew=float(skew),
        frequencies=shown,
        lower_response=lower_response,
        upper_response=upper_response,
        unstructured_response=unstructured_response,
    )


def loop_margins(
    plant: control.StateSpace, controller: control.StateSpace, at: At = "input", skew: float = 0.0
) -> LoopMargins:
    """Return the disk margin of each channel, broken one at a time with all others closed.

    Parameters
    ----------
    plant, controller
        Joined as u = K y (see `loop_transfer`).
    at
        Break the torques (``"input"``) or the pick-offs (``"output"``).
    skew
        Skew of the disk.

    Raises
    ------
    ArgumentError
        If plant and controller do not fit together.
    """
    S = closed_loop_with_sensitivity(plant, controller, at)
    names = tuple(controller.output_labels if at == "input" else controller.input_labels)
    if spectral_abscissa(continuous_poles(pole_arrays(S.A), S.dt)) >= 0.0:
        return LoopMargins(channels=names, alpha=np.zeros(len(names)), frequency=np.zeros(len(names)))
    # With the others closed, channel i's own sensitivity is the i-th diagonal entry of S.
    peaks = [
        hinf_norm_arrays(S.A, S.B[:, [i]], S.C[[i]], S.D[[i]][:, [i]] + 0.5 * (skew - 1.0), S.dt)
        for i in range(len(names))
    ]
    return LoopMargins(
        channels=names,
        alpha=np.array([_inverse(norm) for norm, _ in peaks]),
        frequency=np.array([frequency for _, frequency in peaks]),
    )


def disk_to_gain_phase(alpha: float, skew: float = 0.0) -> tuple[float, float, float]:
    """Return the lowest and highest gain factor and the phase in rad that a disk of size `alpha` contains.

    The highest factor is infinite and the phase pi where the disk does not bound them.
    """
    low = (2.0 - alpha * (1.0 - skew)) / (2.0 + alpha * (1.0 + skew))
    denominator = 2.0 - alpha * (1.0 + skew)
    if denominator == 0.0:
        return low, math.inf, math.acos(min(1.0, max(-1.0, low)))
    high = (2.0 + alpha * (1.0 - skew)) / denominator
    cosine = (1.0 + low * high) / (low + high) if low + high != 0.0 else math.inf
    phase = math.acos(cosine) if abs(cosine) <= 1.0 else math.pi
    return low, high if high > 0.0 else math.inf, phase


def _inverse(mu: float) -> float:
    return 1.0 / mu if mu > 0.0 else math.inf


def _disk_arrays(L: StateArrays, skew: float) -> StateArrays:
    """Return the arrays of S + (skew - 1)/2 I for S = (I + L)^-1."""
    eye = np.eye(L.D.shape[0])
    if np.linalg.svd(eye + L.D, compute_uv=False).min() < 1e-12 * max(1.0, float(np.abs(L.D).max())):
        raise ArgumentError(
            "disk_margin: I + D of the loop transfer is singular, expected a well-posed loop; add a lag"
        )
    E = np.linalg.inv(eye + L.D)
    return StateArrays(L.A - L.B @ E @ L.C, L.B @ E, -E @ L.C, E + 0.5 * (skew - 1.0) * eye, L.dt)


def _unstable(skew: float, shown: FloatArray, s: ComplexArray) -> DiskMargin:
    nothing = np.zeros(shown.shape)
    return DiskMargin(
        alpha=0.0,
        lower=0.0,
        upper=0.0,
        unstructured=0.0,
        frequency=float(abs(s[np.argmax(s.real)].imag)),
        proved=True,
        skew=float(skew),
        frequencies=shown,
        lower_response=nothing,
        upper_response=nothing,
        unstructured_response=nothing,
    )


def _grid(disk: StateArrays, s: ComplexArray, peak: float) -> FloatArray:
    """Return frequencies that follow the closed loop's poles, and about 15 a decade between and beyond them."""
    own = resonances(s)
    own = own[own > 0.0]
    if own.size == 0:
        own = np.ones(1)
    low, high = 0.1 * float(own.min()), 10.0 * float(own.max())
    if disk.dt > 0.0:
        high = math.pi / disk.dt
        low = min(low, 1e-3 * high)
    low = max(low, 1e-9 * high)
    fill = np.geomspace(low, high, 2 + int(15 * math.log10(high / low)))
    own = np.append(own, peak) if 0.0 < peak < math.inf else own
    return np.unique(np.concatenate([[0.0], own[(own >= low) & (own <= high)], fill]))


class _Peak:
    """The largest mu over frequency: climbed, then proved."""

    def __init__(self, disk: StateArrays) -> None:
        self.disk = disk
        self.edge = math.inf if disk.dt == 0.0 else math.pi / disk.dt
        self.mu = self.frequency = 0.0
        self.D = np.ones(disk.D.shape[0])

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Return S + (skew - 1)/2 I, (N, m, m); at infinite frequency its direct term."""
        infinite = np.isinf(frequency)
        out = np.array(frequency_response_arrays(*self.disk, np.where(infinite, 0.0, frequency)))
        out[infinite] = self.disk.D
        return out

    def exact(self, frequency: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mu's upper bound and D at each frequency, and keep the largest."""
        mu, D = mu_upper_bound(self.response(frequency), 1e-7)
        i = int(np.argmax(mu))
        if mu[i] > self.mu:
            self.mu, self.frequency, self.D = float(mu[i]), float(frequency[i]), D[i]
        return mu, D

    def climb(self, grid: FloatArray, mu: FloatArray, hills: int = 2) -> None:
        """Refine the highest local maxima of `mu` on `grid` side by side."""
        padded = np.concatenate([[-np.inf], mu, [-np.inf]])
        tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
        tops = tops[mu[tops] >= 0.7 * mu.max()]
        tops = tops[np.argsort(-mu[tops])][:hills]
        left, right = grid[np.maximum(tops - 1, 0)], grid[np.minimum(tops + 1, len(grid) - 1)]
        row = np.arange(len(tops))
        self.exact(grid[tops])
        for _ in range(6):
            fan = np.linspace(left, right, 11, axis=1)
            at = self.exact(fan.ravel())[0].reshape(fan.shape).argmax(axis=1)
            left, right = fan[row, np.maximum(at - 1, 0)], fan[row, np.minimum(at + 1, 10)]

    def prove(self, slack: float = 1e-4, most: int = 80) -> bool:
        """Show that mu exceeds its peak nowhere by more than `slack`; climb where it does.

        With D fixed, the Hamiltonian of D (S + ...) D^-1 shows where its gain exceeds the peak; another D is needed
        only there (Ferreres, Magni and Biannic, Int. J. Robust Nonlinear Control 13, 2003).
        """
        self.exact(np.array([self.edge]))
        doubtful = [(0.0, self.edge)]
        D = self.D
        for _ in range(most):
            doubtful = self._exceeding(doubtful, D, self.mu * (1.0 + slack))
            if not doubtful:
                return True
            low, high = max(doubtful, key=lambda part: math.inf if part[0] == 0.0 else part[1] / part[0])
            middle = _middle(low, high)
            before = self.mu
            mu, scalings = self.exact(np.array([middle]))
            D = scalings[0]
            if mu[0] > before:
                grid = np.array([max(low, 0.5 * middle), middle, min(high, 2.0 * middle)])
                self.climb(grid, self.exact(grid)[0])
        return False

    def _exceeding(
        self, intervals: list[tuple[float, float]], D: FloatArray, level: float
    ) -> list[tuple[float, float]]:
        """Return the parts of `intervals` where the gain of D (S + ...) D^-1 exceeds `level`."""
        disk = self.disk
        scaled = StateArrays(disk.A, disk.B / D, D[:, None] * disk.C, D[:, None] * disk.D / D, disk.dt)
        crossings = crossing_frequencies(scaled, level)
        parts: list[tuple[float, float]] = []
        for low, high in intervals:
            inner = crossings[(crossings > low) & (crossings < high)]
            edges = [low, *inner.tolist(), high]
            parts += list(pairwise(edges))
        exceeds = gains(scaled, np.array([_middle(*part) for part in parts])) > level
        kept: list[tuple[float, float]] = []
        for part, bad in zip(parts, exceeds, strict=True):
            if not bad:
                continue
            if kept and kept[-1][1] == part[0]:
                kept[-1] = (kept[-1][0], part[1])
            else:
                kept.append(part)
        return kept


def _middle(low: float, high: float) -> float:
    if math.isinf(high):
        return 3.0 * low if low > 0.0 else 1.0
    return math.sqrt(low * high) if low > 0.0 else 0.3 * high
