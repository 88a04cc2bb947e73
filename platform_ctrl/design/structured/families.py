"""Families of sampled controllers: parameters x → M = [[A_K, B_K], [C_K, D_K]] and its derivatives.

* `Named`: whatever builds a controller from positive numbers with names, in their logarithms;
* `Pid`: K = F(s) (K_P + K_I/s + K_D s) with full matrices and a second-order low-pass F for every channel;
* `StateSpace`: all entries of a controller of fixed order, behind a PI in every channel, so that integral action stays.

Units make a change of one in any parameter a large one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.feedback import series
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.partition import Channels, between, first_order, side_by_side
from platform_ctrl.design.structured.starts import balanced_truncation

# Relative step of the differences that stand for a builder's own derivative; the builder is smooth and cheap.
_STEP = 1e-5
# Least damping of the PID's filter: with less it gains phase by a resonance, which would lift the gain at frequencies
# where gimbals and mountings bend.
_FILTER_DAMPING = 0.4
# Poles this near to z = 1 are integrators.
_INTEGRATOR = 1e-5


class Family(Protocol):
    """A parametrised controller.

    Attributes
    ----------
    start, lower, upper : (d,)
        Starting values and bounds of the parameters.
    """

    start: FloatArray
    lower: FloatArray
    upper: FloatArray

    def block(self, x: FloatArray) -> StateArrays:
        """Return the controller."""

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx, (d, n_K + m, n_K + p)."""


class Named:
    """A controller built from named positive numbers.

    Parameters
    ----------
    build
        Numbers → controller.
    values
        All numbers.
    movable
        Names of those that a search may change.
    largest
        Upper bounds of some.
    """

    def __init__(
        self,
        build: Callable[[dict[str, float]], StateArrays],
        values: dict[str, float],
        movable: Sequence[str],
        largest: dict[str, float],
    ) -> None:
        self._build, self._values = build, values
        self.names = [name for name in movable if name in values]
        self.upper = np.log(np.array([largest.get(name, np.inf) for name in self.names]))
        self.lower = np.full(len(self.names), -np.inf)
        self.start = np.minimum(np.log(np.array([values[name] for name in self.names])), self.upper)

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return all numbers."""
        return self._values | {name: float(v) for name, v in zip(self.names, np.exp(x), strict=True)}

    def block(self, x: FloatArray) -> StateArrays:
        """Return the controller."""
        return self._build(self.values(x))

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx by central differences."""
        return differences(self.block, x)


class Pid:
    """A matrix PID with a second-order low-pass in every channel, in the channels of the gyros.

    Parameters
    ----------
    like
        Controller whose response the start resembles, between a tenth of the nutation and a fifth of the sample rate.
    channel, period, nutation
        Directions; s; rad/s.
    integral, rolloff
        rad/s: of the PI of `like`, and the start of the filter.
    """

    def __init__(
        self, like: StateArrays, channel: Channels, period: float, nutation: float, integral: float, rolloff: float
    ) -> None:
        self._period, self._basis = period, channel.basis
        self._n = len(channel.basis)
        K_P, K_I, K_D = self._fitted(like, nutation, rolloff)
        self._unit = float(np.abs(K_P).max() + nutation * np.abs(K_D).max()) or 1.0
        gains = [K_P, K_I / integral, K_D * nutation]
        self._nutation, self._integral = nutation, integral
        self.start = np.concatenate(
            [np.array(gains).ravel() / self._unit, np.full(self._n, np.log(rolloff)), np.full(self._n, np.log(0.8))]
        )
        self.upper = np.full(len(self.start), np.inf)
        # Beyond 1/π of the sample rate Tustin's poles turn negative, and ring.
        self.upper[3 * self._n**2 : 3 * self._n**2 + self._n] = np.log(0.9 * np.pi / period)
        self.upper[3 * self._n**2 + self._n :] = np.log(2.0)
        self.lower = np.full(len(self.start), -np.inf)
        self.lower[3 * self._n**2 + self._n :] = np.log(_FILTER_DAMPING)
        self.start = np.minimum(self.start, self.upper)

    def block(self, x: FloatArray) -> StateArrays:
        """Return the controller."""
        n = self._n
        K_P, K_I, K_D = x[: 3 * n * n].reshape(3, n, n) * self._unit
        A, B, angle, rate = self._filters(x)
        # The filtered angle and rate of every channel, and the integral of the angle, by Tustin's rule.
        integral = self._integrated(angle)
        basis = self._basis
        shown = K_P @ angle + K_I @ integral + K_D @ rate
        into = np.vstack([B, self._period * angle[:, 3 * n :]])
        whole = np.block([[A, np.zeros((2 * n, n))], [self._period * angle[:, : 2 * n], np.eye(n)]])
        along = StateArrays(whole, into, shown[:, : 3 * n], shown[:, 3 * n :], self._period)
        return between(basis, along, basis.T)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx: what the gains read, and central differences for the filters."""
        n = self._n
        _, _, angle, rate = self._filters(x)
        read = np.array([angle, self._integrated(angle), rate]) * self._unit
        read[:, :, 3 * n :] = read[:, :, 3 * n :] @ self._basis
        out = np.zeros((len(x), 4 * n, 4 * n))
        # Gain k, row i, column j: M changes by row i of the basis times what gain k reads of channel j.
        gains = np.einsum("ia,kjb->kijab", self._basis, read)
        out[: 3 * n * n, 3 * n :] = gains.reshape(3 * n * n, n, 4 * n)
        out[3 * n * n :] = differences(self.block, x, range(3 * n * n, len(x)))
        return out

    def _filters(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A, B of the filters, and the filtered angle and rate of every channel from [filters, integrals, y]."""
        n = self._n
        w, z = np.exp(x[3 * n * n : 3 * n * n + n]), np.exp(x[3 * n * n + n :])
        A, B, C, D, _ = side_by_side(*(_low_pass(w[k], z[k], self._period) for k in range(n)))
        none = np.zeros((n, n))
        angle, rate = (np.hstack([C[k::2], none, D[k::2]]) for k in (0, 1))
        return A, B, angle, rate / self._nutation

    def _integrated(self, angle: FloatArray) -> FloatArray:
        """Return the integral of the filtered angle, in units of 1/integral."""
        out = 0.5 * self._period * angle
        out[:, 2 * self._n : 3 * self._n] += np.eye(self._n)
        return self._integral * out

    def _fitted(self, like: StateArrays, nutation: float, rolloff: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        w = np.geomspace(0.1 * nutation, min(4.0 * nutation, 0.4 * np.pi / self._period), 40)
        target = self._basis @ frequency_response(like, w, -3) @ self._basis.T
        s = 2.0 / self._period * 1j * np.tan(0.5 * w * self._period)
        F = rolloff**2 / (s**2 + 1.6 * rolloff * s + rolloff**2)
        terms = np.array([F, F / s, F * s]).T
        weight = 1.0 / np.linalg.norm(target, axis=(1, 2))
        left, right = terms * weight[:, None], target.reshape(len(w), -1) * weight[:, None]
        found = np.linalg.lstsq(np.vstack([left.real, left.imag]), np.vstack([right.real, right.imag]), rcond=None)[0]
        K_P, K_I, K_D = found.reshape(3, self._n, self._n)
        return K_P, K_I, K_D


class StateSpace:
    """A controller of fixed order behind a PI in every channel: every entry of its matrices is a parameter.

    Parameters
    ----------
    inner
        What stands behind the PI, in the channels of the gyros (see `without_integrators`).
    channel, period, nutation
        Directions; s; rad/s, the unit of rates.
    integral
        rad/s: PI = 1 + integral/s, by Tustin's rule.
    """

    def __init__(self, inner: StateArrays, channel: Channels, period: float, nutation: float, integral: float) -> None:
        A, B, C, D, self._period = inner
        self._n, self._size = len(A), len(D)
        self._basis, self._gain, self._slow = channel.basis, 1.0 + 0.5 * integral * period, integral * period
        # Rates in units of the nutation, torques in units of the direct term, states between the two.
        rate = nutation * period
        unit = float(np.abs(D).max()) or float(np.linalg.norm(C) * np.linalg.norm(B)) or 1.0
        turn = np.sqrt(np.linalg.norm(C) / np.linalg.norm(B) / unit) if self._n else 1.0
        root = np.sqrt(rate)
        self._units = np.block(
            [
                [np.full(A.shape, rate), np.full(B.shape, root / turn)],
                [np.full(C.shape, unit * root * turn), np.full(D.shape, unit)],
            ]
        )
        self._origin = np.zeros(self._units.shape)
        self._origin[: self._n, : self._n] = np.eye(self._n)
        self.start = ((np.block([[A, B], [C, D]]) - self._origin) / self._units).ravel()
        self.lower, self.upper = np.full(len(self.start), -np.inf), np.full(len(self.start), np.inf)
        # M is linear in the inner matrices.
        units = self._units.ravel()
        each = np.zeros((len(units), *self._units.shape))
        each.reshape(len(units), -1)[np.arange(len(units)), np.arange(len(units))] = units
        self._derivative = self._placed(each)

    def _placed(self, inner: FloatArray) -> FloatArray:
        """Return what the inner matrices (..., n + m, n + m) contribute to M: states [PI, inner]."""
        n, k = self._n, self._size
        out = np.zeros((*inner.shape[:-2], k + n + k, k + n + k))
        A, B = inner[..., :n, :n], inner[..., :n, n:]
        C, D = self._basis.T @ inner[..., n:, :n], self._basis.T @ inner[..., n:, n:]
        out[..., k : k + n, :k], out[..., k : k + n, k : k + n] = B * self._slow, A
        out[..., k : k + n, k + n :] = self._gain * B @ self._basis
        out[..., k + n :, :k], out[..., k + n :, k : k + n] = D * self._slow, C
        out[..., k + n :, k + n :] = self._gain * D @ self._basis
        return out

    def block(self, x: FloatArray) -> StateArrays:
        """Return the controller."""
        k = self._size
        M = self._placed(self._origin + x.reshape(self._units.shape) * self._units)
        M[:k, :k] += np.eye(k)
        M[:k, k + self._n :] += self._basis
        n = k + self._n
        return StateArrays(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:], self._period)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx."""
        return self._derivative


def differences(
    build: Callable[[FloatArray], StateArrays], x: FloatArray, which: Sequence[int] | None = None
) -> FloatArray:
    """Return dM/dx of a builder by central differences, for all parameters or those in `which`."""
    out = []
    for k in range(len(x)) if which is None else which:
        step = np.zeros(len(x))
        step[k] = _STEP
        (A, B, C, D, _), (a, b, c, d, _) = build(x + step), build(x - step)
        out.append(np.block([[A - a, B - b], [C - c, D - d]]) / (2.0 * _STEP))
    return np.array(out)


def _low_pass(frequency: float, damping: float, period: float) -> StateArrays:
    """Return y → [F y, s F y], F = f²/(s² + 2 damping f s + f²), by Tustin's rule."""
    A = np.array([[0.0, 1.0], [-(frequency**2), -2.0 * damping * frequency]])
    B = np.array([[0.0], [frequency**2]])
    half, eye = 0.5 * period, np.eye(2)
    inverse = np.asarray(np.linalg.inv(eye - half * A), dtype=np.float64)
    into: FloatArray = inverse @ B
    return StateArrays(inverse @ (eye + half * A), period * into, inverse, half * into, period)


def without_integrators(
    controller: StateArrays, channel: Channels, integral: float, period: float
) -> StateArrays | None:
    """Return a controller without its PI, 1 + integral/s, in the channels of the gyros; None if unstable then."""
    from scipy.linalg import schur, solve_sylvester

    basis = channel.basis
    undone = side_by_side(*[first_order(1.0, 0.0, 1.0, integral, period)] * len(basis))
    A, B, C, D, _ = series(undone, between(basis.T, controller, basis))
    triangle, vectors, kept = schur(A, sort=lambda re, im=0.0: bool(abs(complex(re, im) - 1.0) > _INTEGRATOR))
    left, right = triangle[:kept, :kept], triangle[kept:, kept:]
    if kept and np.abs(np.linalg.eigvals(left)).max() >= 1.0:
        return None
    # The integrators are no longer excited: what remains is split from them.
    X = solve_sylvester(left, -right, -triangle[:kept, kept:]) if kept < len(A) else np.zeros((kept, 0))
    B, C = vectors.T @ B, C @ vectors
    return StateArrays(left, B[:kept] - X @ B[kept:], C[:, :kept], D, period)


def of_order(system: StateArrays, order: int, rate: float) -> StateArrays:
    """Return a stable system with `order` states: balanced truncation, or with faint modes of its own added.

    Parameters
    ----------
    system
        Stable, sampled.
    order
        Number of states.
    rate
        Nutation frequency times period: added modes lie there, well damped.
    """
    less = balanced_truncation(system, order)
    A, B, C, D, period = less
    missing = order - len(A)
    if missing <= 0:
        return less
    size = len(D)
    own = np.zeros((missing, missing))
    for k in range(0, missing, 2):
        pair = slice(k, min(k + 2, missing))
        turn = np.array([[-0.7, 1.0], [-1.0, -0.7]]) * (1.0 + 0.15 * k)
        own[pair, pair] = np.eye(2)[: missing - k, : missing - k] + rate * turn[: missing - k, : missing - k]
    # Every mode sees and drives another mixture of channels, faintly.
    phase = np.pi * np.outer(np.arange(missing) + 0.5, np.arange(size) + 0.5) / max(missing, size)
    unit = float(np.abs(D).max()) or 1.0
    turn_size = float(np.sqrt(np.linalg.norm(C) / np.linalg.norm(B) / unit)) if len(A) else 1.0
    into, out = np.sqrt(rate) / turn_size * 0.3 * np.cos(phase), unit * np.sqrt(rate) * turn_size * 0.02 * np.sin(phase)
    first = len(A)
    whole = np.zeros((order, order))
    whole[:first, :first], whole[first:, first:] = A, own
    return StateArrays(whole, np.vstack([B, into]), np.hstack([C, out.T]), D, period)
