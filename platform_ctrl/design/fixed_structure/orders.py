"""Stabilising controllers of a given order, where searches from other starts found none.

Free matrices [A_K, B_K; C_K, D_K] have as many coordinates that change nothing as A_K has entries, and the rightmost
poles of a loop have kinks where descents come to rest. With A_K in companion form, which all but special controllers
have in some states, there are far fewer coordinates, and descents get further. What a lower order reaches is a start
too: with a state more that nothing reads, or behind a fast low-pass where there is to be no direct term.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.norm import augmented
from platform_ctrl.design.fixed_structure.parametrised import Parametrised
from platform_ctrl.design.fixed_structure.quasi_newton import Stopped, descended
from platform_ctrl.design.fixed_structure.run import Limits
from platform_ctrl.design.fixed_structure.structures import StateSpaceOrder, Units
from platform_ctrl.design.partition import Partition

# Random starts of one order, and most iterations of the descent from each.
_STARTS, _ITERATIONS = 32, 600
# Share of what is left of the evaluations that they may use.
_RANDOM = 0.75
# Poles of random starts in units of the rate, and decades by which they all are faster; decades of the gains.
_POLES, _FASTER, _GAINS = (0.3, 3.0), (-0.3, 0.7), (-1.0, 1.0)
# Corners of a low-pass that stands behind a controller of lower order, and poles of a state that nothing reads, in
# units of the rate.
# How much more decay than requested ends a descent, relative: the search that follows begins inside.
_AHEAD = 1e-3
_CORNERS, _UNREAD = (1e3, 3e2, 1e2, 3e1, 1e1), (1.0, 10.0)


@value
class Reached:
    """A controller M = [A_K, B_K; C_K, D_K], and the largest real part of the loops' poles."""

    M: FloatArray
    abscissa: float


class Orders:
    """Controllers of every order for one set of plants.

    Parameters
    ----------
    plants
        Continuous, or in the w-plane.
    decay
        That every pole is to keep, rad/s.
    units
        Of gains and rates.
    rng
        Of the random starts.
    limits
        Of all orders together; where they end the search, the nearest so far is the answer.

    Attributes
    ----------
    spent
        Evaluations of the loops' poles.
    """

    def __init__(
        self, plants: Sequence[Partition], decay: float, units: Units, rng: np.random.Generator, limits: Limits
    ) -> None:
        self.plants, self.decay, self.units, self.rng, self.limits = plants, decay, units, rng, limits
        self.spent = 0
        self.ncon, self.nmeas = units.gain.shape
        self._known: dict[tuple[int, bool], Reached] = {}

    def best(self, order: int, strictly_proper: bool) -> Reached:
        """Return the controller with the most decay that was found, the first that has enough."""
        key = order, strictly_proper
        if key not in self._known:
            self._known[key] = self._found(order, strictly_proper)
        return self._known[key]

    def _found(self, order: int, strictly_proper: bool) -> Reached:
        free = StateSpaceOrder(states=order, strictly_proper=strictly_proper)
        zero = np.zeros((order + self.ncon, order + self.nmeas))
        zero[:order, :order] = -self.units.rate * np.eye(order)
        best = self._descended(free, zero, 0)
        # Lower orders are to have their turn.
        enough = self.spent + int(_RANDOM * (self.limits.evaluations - self.spent))
        for _ in range(_STARTS):
            if self._ended(best):
                return best
            if self.spent >= enough:
                break
            best = self._better(best, self._descended(self._companion(order, strictly_proper), None, _ITERATIONS))
        # Once more with all entries.
        best = self._better(best, self._descended(free, best.M, _ITERATIONS))
        if strictly_proper and order > self.ncon and not self._ended(best):
            lower = self.best(order - self.ncon, False)
            behind = [low_passed(lower.M, order - self.ncon, c * self.units.rate, self.ncon) for c in _CORNERS]
            first = min((self._descended(free, M, 0) for M in behind), key=lambda one: one.abscissa)
            best = self._better(best, self._descended(free, first.M, _ITERATIONS))
        if order > 1 and not self._ended(best):
            lower = self.best(order - 1, strictly_proper)
            for speed in _UNREAD:
                inputs = np.asarray(self.rng.standard_normal(self.nmeas) * self.units.rate)
                M = with_state(lower.M, order - 1, speed * self.units.rate, inputs)
                best = self._better(best, self._descended(free, M, _ITERATIONS))
        return best

    def _ended(self, best: Reached) -> bool:
        """Whether there is enough decay, or no more work is allowed."""
        return best.abscissa < -self.decay or self._over()

    def _over(self) -> bool:
        return self.spent >= self.limits.evaluations or time.monotonic() > self.limits.deadline

    @staticmethod
    def _better(one: Reached, other: Reached) -> Reached:
        return min(one, other, key=lambda r: r.abscissa)

    def _companion(self, order: int, strictly_proper: bool) -> StateSpaceOrder:
        """Return the order with A_K in companion form, at random starting values."""
        rate, gain = self.units.rate, float(np.exp(np.mean(np.log(self.units.gain))))
        poles = -self.rng.uniform(*_POLES, order) * 10.0 ** self.rng.uniform(*_FASTER)
        size = 10.0 ** self.rng.uniform(*_GAINS)
        start = {f"a1{j + 1}": -rate * c for j, c in enumerate(np.poly(poles)[1:])}
        fixed = {f"a{i + 1}{j + 1}": rate if i == j + 1 else 0.0 for i in range(1, order) for j in range(order)}
        for i in range(order):
            for j in range(self.nmeas):
                if self.nmeas == 1:
                    fixed[f"b{i + 1}1"] = rate if i == 0 else 0.0
                else:
                    start[f"b{i + 1}{j + 1}"] = rate * float(self.rng.standard_normal())
        for i in range(self.ncon):
            for j in range(order):
                start[f"c{i + 1}{j + 1}"] = size * gain * float(self.rng.standard_normal())
            for j in range(0 if strictly_proper else self.nmeas):
                start[f"d{i + 1}{j + 1}"] = size * gain * float(self.rng.standard_normal())
        return StateSpaceOrder(states=order, strictly_proper=strictly_proper, start=start, fixed=fixed)

    def _descended(self, structure: StateSpaceOrder, M: FloatArray | None, iterations: int) -> Reached:
        whole = Parametrised(structure, self.nmeas, self.ncon, self.units)
        poles = _Poles([augmented(plant, structure.states) for plant in self.plants], whole)
        x = whole.start if M is None else whole.nearest(M)

        def requested(y: FloatArray, _: float) -> tuple[float, FloatArray]:
            if self._over():
                raise Stopped
            self.spent += 1
            return poles.rightmost(y)

        if iterations:
            low, high = np.full(x.size, -np.inf), np.full(x.size, np.inf)
            enough = -self.decay * (1.0 + _AHEAD)
            x = descended(requested, x, low, high, target=enough, iterations=iterations, progress=0.0).x
        return Reached(M=poles.matrix(x), abscissa=poles.rightmost(x)[0])


class _Poles:
    """The rightmost poles of several loops as a function of numbers in which M is affine."""

    def __init__(self, plants: Sequence[Partition], whole: Parametrised) -> None:
        zero = np.zeros(len(whole.start))
        self.base, self.slope = whole.matrix(zero), whole.jacobian(zero)
        self.A, self.B, self.C, self.D = (
            np.array([getattr(plant, name) for plant in plants]) for name in ("A", "B2", "C2", "D22")
        )
        self.direct = bool(np.any(self.D))

    def matrix(self, x: FloatArray) -> FloatArray:
        """Return M."""
        return np.asarray(self.base + self.slope @ x)

    def rightmost(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return the largest real part of all poles and its gradient."""
        refused = np.inf, np.zeros(len(x))
        M = self.matrix(x)
        if not np.all(np.isfinite(M)):
            return refused
        try:
            gain = np.linalg.inv(np.eye(len(M)) - M @ self.D) @ M if self.direct else M
            loops = self.A + self.B @ gain @ self.C
            real = np.linalg.eigvals(loops).real.max(axis=1)
            k = int(np.argmax(real))
            poles, vectors = np.linalg.eig(loops[k])
            i = int(np.argmax(poles.real))
            left = np.linalg.inv(vectors)[i]
        except np.linalg.LinAlgError:
            return refused
        a, b = left @ self.B[k], self.C[k] @ vectors[:, i]
        if self.direct:
            # d(gain) = (I − M D22)⁻¹ dM (I + D22 gain).
            a = a @ np.linalg.inv(np.eye(len(M)) - M @ self.D[k])
            b = b + self.D[k] @ (gain[k] @ b)
        return float(real[k]), np.einsum("ij,ijx->x", np.real(np.outer(a, b)), self.slope)


def with_state(M: FloatArray, order: int, pole: float, inputs: FloatArray) -> FloatArray:
    """Return a controller with one more state of the rate −`pole`, which measurements drive and nothing reads."""
    out = np.insert(np.insert(M, order, 0.0, axis=0), order, 0.0, axis=1)
    out[order, order], out[order, order + 1 :] = -pole, inputs
    return np.asarray(out)


def low_passed(M: FloatArray, order: int, corner: float, ncon: int) -> FloatArray:
    """Return a controller whose every control passes corner/(s + corner): without direct term."""
    A, B, C, D = M[:order, :order], M[:order, order:], M[order:, :order], M[order:, order:]
    one, ny = np.eye(ncon), B.shape[1]
    return np.block(
        [
            [A, np.zeros((order, ncon)), B],
            [corner * C, -corner * one, corner * D],
            [np.zeros((ncon, order)), one, np.zeros((ncon, ny))],
        ]
    )
