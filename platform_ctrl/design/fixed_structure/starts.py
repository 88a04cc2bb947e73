"""Where searches begin: the structure's own values, fits to the full-order controller, and a scatter.

Where those lead nowhere: stabilising controllers of a given order. Free matrices [A_K, B_K; C_K, D_K] have as many
coordinates that change nothing as A_K has entries, and the rightmost poles of a loop have kinks where descents come to
rest. With A_K in companion form, which all but special controllers have in some states, there are far fewer
coordinates, and descents get further. What a lower order reaches is a start too: with a state more that nothing reads,
or behind a fast low-pass where there is to be no direct term.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.norms import stationary_covariance
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.norm import ClosedLoop
from platform_ctrl.design.fixed_structure.parametrised import Parametrised
from platform_ctrl.design.fixed_structure.quasi_newton import Stopped, descended
from platform_ctrl.design.fixed_structure.run import Limits
from platform_ctrl.design.fixed_structure.structures import StateSpaceOrder, Units
from platform_ctrl.design.partition import Partition, augmented

# Hankel singular values below this share of the largest are negligible.
_NEGLIGIBLE = 1e-7


def balanced_truncation(system: StateArrays, order: int, negligible: float = _NEGLIGIBLE) -> StateArrays:
    """Return the balanced truncation of a stable system, by square roots (Tombs and Postlethwaite 1987).

    Fewer than `order` states are kept where Hankel singular values are below the share `negligible` of the largest.
    """
    A, B, C, D, dt = system
    if not len(A):
        return system
    reach, show = (_root(_gramian(a, b, dt > 0.0)) for a, b in ((A, B), (A.T, C.T)))
    U, s, V = np.linalg.svd(show.T @ reach)
    order = min(order, int(np.sum(s > negligible * s[0])))
    scale = 1.0 / np.sqrt(s[:order])
    right, left = reach @ V[:order].T * scale, (show @ U[:, :order] * scale).T
    first, into, out = (np.asarray(item, dtype=np.float64) for item in (left @ A @ right, left @ B, C @ right))
    return StateArrays(first, into, out, D, dt)


def _gramian(A: FloatArray, B: FloatArray, sampled: bool) -> FloatArray:
    """Return X = A X A' + B B', or A X + X A' + B B' = 0."""
    if sampled:
        return stationary_covariance(A, B)
    from scipy.linalg import solve_continuous_lyapunov

    return np.asarray(solve_continuous_lyapunov(A, -B @ B.T), dtype=np.float64)


def _root(gramian: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    out: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return out


# Frequencies of a fit, and how far beyond the poles they reach.
_POINTS, _BEYOND = 60, 10.0
# Decades over which the size of random starts is spread, either side of the units.
_DECADES = 1.5
# Hankel singular values below this share of the largest are rounding.
_ROUNDING = 1e-12
# Width of the scatter about a good start, in search coordinates.
_SCATTER = 0.7


def truncated(K: StateArrays, order: int) -> StateArrays | None:
    """Return the balanced truncation of a stable continuous controller to `order` states; None where there is none."""
    if order >= len(K.A):
        return K if order == len(K.A) else None
    if np.max(np.linalg.eigvals(K.A).real, initial=-np.inf) >= 0.0:
        return None
    try:
        less = balanced_truncation(K, order, _ROUNDING)
    except np.linalg.LinAlgError:
        return None
    return less if len(less.A) == order else None


class Fit:
    """Fits of a structure to a full-order controller, to first order in the closed loop.

    With L and R the loop around `full` from u to z and from w to y, T(K) ≈ T(full) + L (K − full) R: least squares of
    that difference over frequency.
    """

    def __init__(self, plant: Partition, full: StateArrays, structured: Parametrised) -> None:
        self.structured = structured
        order = len(full.A)
        loop = ClosedLoop(augmented(plant, order), np.block([[full.A, full.B], [full.C, full.D]]))
        speeds = np.abs(np.concatenate([loop.poles, np.linalg.eigvals(plant.A)]))
        speeds = speeds[speeds > 1e-6 * speeds.max()]
        self.frequency = np.geomspace(speeds.min() / _BEYOND, _BEYOND * np.median(speeds), _POINTS)
        seen = [loop.responses(float(w)) for w in self.frequency]
        self.left = np.array([L[:, order:] for _, L, _, _ in seen])
        self.right = np.array([R[order:] for _, _, R, _ in seen])
        self.wanted = frequency_response(StateArrays(full.A, full.B, full.C, full.D, 0.0), self.frequency, -3)
        self._order = structured.structure.order(structured.nmeas, structured.ncon)

    def difference(self, x: FloatArray) -> FloatArray:
        """Return real and imaginary parts of the closed loops' difference."""
        M, k = self.structured.matrix(x), self._order
        try:
            K = frequency_response(StateArrays(M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:], 0.0), self.frequency, -3)
            error = (self.left @ (K - self.wanted) @ self.right).ravel()
        except (np.linalg.LinAlgError, ArithmeticError):
            error = np.full(self.left.shape[0] * self.left.shape[1] * self.right.shape[2], np.inf, dtype=complex)
        out = np.concatenate([error.real, error.imag])
        return np.where(np.isfinite(out), out, 1e6)

    def gains(self, x: FloatArray) -> FloatArray:
        """Return x with the numbers that enter affinely fitted, the positive ones kept."""
        affine = ~self.structured.positive
        base = x.copy()
        base[affine] = 0.0
        at = self.difference(base)
        columns = []
        for k in np.flatnonzero(affine):
            one = base.copy()
            one[k] = 1.0
            columns.append(self.difference(one) - at)
        if not columns:
            return x
        out = base
        out[affine] = np.linalg.lstsq(np.array(columns).T, -at, rcond=1e-12)[0]
        return np.clip(out, self.structured.lower, self.structured.upper)

    def everything(self, start: FloatArray) -> FloatArray:
        """Return all numbers fitted, from `start` on."""
        from scipy.optimize import least_squares

        low, high = self.structured.lower, self.structured.upper
        room = 1e-9 * np.maximum(1.0, np.abs(start))
        found = least_squares(
            self.difference, np.clip(start, low + room, high - room), bounds=(low, high), x_scale="jac", max_nfev=60
        )
        return np.clip(np.asarray(found.x, dtype=np.float64), low, high)


def fits(
    plants: Sequence[Partition], known: Sequence[StateArrays], structured: Parametrised
) -> list[tuple[Fit, FloatArray]]:
    """Return a fit to each known full-order controller, and what it found; those that have none are left out."""
    out = []
    for plant, K in zip(plants, known, strict=True):
        try:
            fit = Fit(plant, K, structured)
            out.append((fit, fit.everything(fit.gains(structured.start))))
        except (np.linalg.LinAlgError, ValueError):
            continue
    return out


def scattered(count: int, size: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return points of random direction and of lengths spread over decades about one."""
    return [rng.standard_normal(size) * 10.0 ** rng.uniform(-_DECADES, _DECADES) for _ in range(count)]


def around(centre: FloatArray, fit: Fit | None, rng: np.random.Generator, structured: Parametrised) -> FloatArray:
    """Return a point about a centre: positive numbers scattered, the others fitted again or scattered too."""
    drawn = rng.standard_normal(centre.size)
    x = np.clip(centre + _SCATTER * drawn * structured.positive, structured.lower, structured.upper)
    if fit is not None and structured.positive.any():
        return fit.gains(x)
    width = _SCATTER * np.maximum(0.1, np.abs(centre))
    return np.clip(np.where(structured.positive, x, centre + width * drawn), structured.lower, structured.upper)


# Random starts of one order, and most iterations of the descent from each.
_STARTS, _ITERATIONS = 32, 600
# Share of what is left of the evaluations that they may use.
_RANDOM = 0.75
# Poles of random starts in units of the rate, and decades by which they all are faster; decades of the gains.
_POLES, _FASTER, _GAINS = (0.3, 3.0), (-0.3, 0.7), (-1.0, 1.0)
# How much more decay than requested ends a descent, relative: the search that follows begins inside.
_AHEAD = 1e-3
# Corners of a low-pass behind a controller of lower order, and poles of a state that nothing reads, times the rate.
_CORNERS, _UNREAD = (1e3, 3e2, 1e2, 3e1, 1e1), (1.0, 10.0)


@value
class Reached:
    """A controller M = [A_K, B_K; C_K, D_K], and the largest real part of the loops' poles."""

    M: FloatArray
    abscissa: float


class Orders:
    """Controllers of every order for one set of plants, continuous or in the w-plane.

    Every pole is to keep `decay`, rad/s. `units` are of gains and rates, `rng` draws the random starts; `limits` are of
    all orders together: where they end the search, the nearest so far is the answer. `spent` counts the evaluations of
    the loops' poles.
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
