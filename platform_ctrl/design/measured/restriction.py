"""One step of the convex-concave procedure: the limits, restricted to inequalities that are linear in the gains.

The least singular value of Y = Z + a I is at least r if Re(U* Y) ≥ r I for some unitary U; the polar factor of the
present Y is exact there. So each limit becomes a convex set within what the limit allows, which contains the present
controller if that keeps the limit. Between two controllers in the same restriction Z is nowhere singular: the loop
stays stable at the measured frequencies (Boyd, Hast and Åström, Int. J. Robust Nonlinear Control 26, 2016, with Z
itself in place of U).

Limits of the form Z* Z ≥ N* N become Z* V + V* Z − V* V ≥ N* N, true for any V; here V = ρ Z at the present controller,
ρ ≤ 1 its ratio to the limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.conic import Solver, cp
from platform_ctrl.design.measured.pid import CENTRES, OF_ANGLE, Limit, controller_response, ratios
from platform_ctrl.errors import UnscalableError

# Limits are tightened by this share, so that they hold after the solver's rounding.
RESERVE = 5e-4
# A step may bring Z at most this near to singular, as a share of its present distance over that of the limit.
_LEAST_DISTANCE = 0.3
# Largest growth of the integral gain in a step, and the solver's tolerance, tried in turn: a step need not be optimal,
# and its result is evaluated again.
_TRIALS = ((20.0, 1e-5), (20.0, 1e-3), (4.0, 1e-5), (4.0, 1e-3), (1.5, 1e-5), (1.5, 1e-3))
# Largest reserve that a step may leave to the limits, as a share of them.
_LARGEST_RESERVE = 0.05
# An inequality is weighted less beyond so many times its limit.
_FAR_FROM_LIMIT = 4.0
# Weight of the integral gain, in units of the present one, while the violation is minimised.
_GAIN_WEIGHT = 1e-3


@value
class Sample:
    """A plant at the frequencies of a problem: response (N, n, n), actions (N, 3), limits."""

    P: ComplexArray
    actions: ComplexArray
    limits: tuple[Limit, ...]

    def only(self, index: NDArray[np.intp]) -> Sample:
        """Return the sample at some of its frequencies (indices)."""
        limits = tuple(Limit(name=limit.name, bound=limit.bound[index]) for limit in self.limits)
        return Sample(P=self.P[index], actions=self.actions[index], limits=limits)


@value
class Step:
    """The result of a step: gains (3, n, n), and the largest violation of a restricted limit as a share of it."""

    gains: FloatArray
    miss: float


class Restriction:
    """The convex problem, made once and solved again about each controller.

    `free` says which gains are unknowns, (3, n, n) of zeros and ones; `problem` is attached to errors.
    """

    def __init__(self, samples: Sequence[Sample], free: FloatArray, problem: object) -> None:
        self.samples, self.problem, self.n = samples, problem, free.shape[-1]
        self.entries, self.shape = np.argwhere(free > 0.0), free.shape
        v, d = len(self.entries), self.n**2
        self.x, self.t = cp.Variable(v), cp.Variable()
        # Violations, that of the sensitivity, which keeps the loop stable, apart. Negative values are a reserve,
        # without which the problem would have no interior.
        self.miss, self.near = cp.Variable(), cp.Variable()
        self.most, self.nearest = cp.Parameter(nonneg=True), cp.Parameter(nonneg=True)
        self.reward, self.price, self.least, self.growth = (cp.Parameter(nonneg=True) for _ in range(4))
        every = [limit for sample in samples for limit in sample.limits]
        rows = d * sum(len(_sides(limit, self.n)) * int(_required(limit).sum()) for limit in every)
        noise_rows = 2 * d * sum(int(_required(limit).sum()) for limit in every if limit.name == "torque_per_noise")
        self.slopes, self.offsets = cp.Parameter((rows, v)), cp.Parameter(rows)
        self.noise_slopes = cp.Parameter((noise_rows, v)) if noise_rows else None
        self.integral = cp.Parameter((d, v))
        constraints = [
            self.near <= self.nearest,
            self.near <= self.miss,
            self.miss <= self.most,
            self.near >= -_LARGEST_RESERVE,
            self.t >= self.least,
            self.t <= self.growth,
            _square(self.integral @ self.x, self.n) - self.t * np.eye(self.n) >> 0,
            *self._limits(every),
        ]
        self.convex = cp.Problem(cp.Maximize(self.reward * self.t - self.price * self.miss), constraints)

    def step(self, gains: FloatArray, *, miss: float, time_limit: float) -> Step:
        """Return the best controller in the restriction about `gains`.

        With `miss` 0 the integral gain is maximised; otherwise the violation is minimised, to at most `miss`.
        """
        scale = np.linalg.norm(gains, axis=(1, 2))
        unit = np.where(scale > 0.0, scale, scale.max())[self.entries[:, 0]]
        directions = np.zeros((len(unit), *self.shape))
        directions[np.arange(len(unit)), *self.entries.T] = unit
        slopes, offsets, noise_slopes = [], [], []
        distance = np.inf
        for sample in self.samples:
            K = controller_response(gains, sample.actions)
            dK = np.einsum("kb,vbij->kvij", sample.actions, directions)
            for limit in sample.limits:
                at = _required(limit)
                part = Limit(name=limit.name, bound=limit.bound[at])
                for side in _sides(limit, self.n):
                    slope, offset, weight, least = _linearised(part, side, sample.P[at], K[at], dK[at])
                    slopes.append(slope.reshape(-1, len(unit)))
                    offsets.append(offset.ravel())
                    distance = min(distance, least)
                if limit.name == "torque_per_noise":
                    # [[R, K*], [K, I]] ≥ 0 in other units of the first rows and columns.
                    size = np.linalg.norm(K[at], 2, axis=(-2, -1)) / np.sqrt(weight)
                    noise = dK[at] / size[:, None, None, None]
                    flat = noise.reshape(*noise.shape[:2], -1)
                    parts = np.concatenate([flat.real, flat.imag], axis=-1)
                    noise_slopes.append(np.moveaxis(parts, 1, -1).reshape(-1, len(unit)))
        self.slopes.value, self.offsets.value = np.concatenate(slopes), np.concatenate(offsets)
        if self.noise_slopes is not None:
            self.noise_slopes.value = np.concatenate(noise_slopes)
        # The least singular value of Ki is that of Uᵀ Ki, at least its symmetric part's eigenvalue.
        turned = _polar(gains[1]).T @ directions[:, 1]
        symmetric = 0.5 * (turned + turned.swapaxes(-1, -2))
        self.integral.value = symmetric.reshape(len(symmetric), -1).T / float(np.linalg.norm(gains[1], 2))
        self.most.value, self.nearest.value = miss, 1.0 - _LEAST_DISTANCE * min(1.0, distance)
        self.reward.value, self.price.value = (_GAIN_WEIGHT, 1.0) if miss else (1.0, 0.0)
        # While the violation is minimised the integral action may become weaker, but not vanish.
        self.least.value = 0.5 / float(np.linalg.cond(gains[1])) if miss else 0.0
        cure = "give another start or pattern, or looser limits"
        solver = Solver(where="measured_pid", cure=cure, time_limit=time_limit, P=self.problem)
        for growth, tolerance in _TRIALS:
            self.growth.value = growth
            try:
                solver.solve(self.convex, (self.x,), "a convex step", tolerance, decompose=False)
                break
            except UnscalableError:
                if (growth, tolerance) == _TRIALS[-1]:
                    raise
        return Step(gains=np.einsum("v,vbij->bij", self.x.value, directions), miss=float(self.miss.value))

    def _limits(self, every: list[Limit]) -> list[Any]:
        """The inequalities, from the independent real parts of all matrices."""
        n, d = self.n, self.n**2
        eye, embedding, noise_embedding = np.eye(2 * n), _embedding(n), _noise_embedding(n)
        hermitian = self.slopes @ self.x + self.offsets
        noise: Any = None if self.noise_slopes is None else self.noise_slopes @ self.x
        out = []
        row = noise_row = 0
        for limit in every:
            slack = self.near if limit.name == "sensitivity_peak" else self.miss
            for _ in range(len(_sides(limit, n)) * int(_required(limit).sum())):
                matrix = _square(embedding @ hermitian[row : row + d], 2 * n)
                row += d
                if limit.name == "torque_per_noise":
                    K = _square(noise_embedding @ noise[noise_row : noise_row + 2 * d], 2 * n)
                    noise_row += 2 * d
                    out.append(cp.bmat([[matrix, K.T], [K, (1.0 + slack) * eye]]) >> 0)
                else:
                    out.append(matrix + slack * eye >> 0)
        return out


def _sides(limit: Limit, n: int) -> tuple[str, ...]:
    if limit.name in CENTRES and n > 1:
        return ("output", "input")
    return ("input",) if limit.name in OF_ANGLE else ("output",)


def _required(limit: Limit) -> NDArray[np.bool_]:
    return np.isfinite(limit.bound)


def _linearised(
    limit: Limit, side: str, P: ComplexArray, K: ComplexArray, dK: ComplexArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Slopes (N, n², v) and offsets (N, n²) of what has to be ≥ 0, their weights (N,); distance of S over its limit."""
    eye = np.eye(P.shape[-1])
    Z = eye - (P @ K if side == "output" else K @ P)
    dZ = -(P[:, None] @ dK if side == "output" else dK @ P[:, None])
    least = np.inf
    if limit.name in CENTRES:
        c, m = CENTRES[limit.name], limit.bound * (1.0 - RESERVE)
        a, r = c / (m**2 - c**2), m / (m**2 - c**2)
        Y = Z + a[:, None, None] * eye
        # In units of r.
        U = _polar(Y) / r[:, None, None]
        slope, offset = _hermitian(_star(U)[:, None] @ dZ), _hermitian(_star(U) @ Y) - eye
        # The offset holds the present controller's part, which the unknowns bring again.
        offset = offset - _hermitian(_star(U) @ (Z - eye))
        # Far from the limit the inequality is weighted less: large numbers would hide the others.
        weight = np.minimum(1.0, _FAR_FROM_LIMIT * r / np.linalg.norm(Y, 2, axis=(-2, -1)))
        if limit.name == "sensitivity_peak":
            least = float((np.linalg.svd(Z, compute_uv=False)[:, -1] / r).min())
    else:
        V = np.minimum(ratios(limit, P, K), 1.0)[:, None, None] * Z
        m = limit.bound * (1.0 - RESERVE)
        # In units of the other side.
        unit = (m / np.linalg.norm(P if limit.name in OF_ANGLE else K, 2, axis=(-2, -1)))[:, None, None] ** 2
        slope, offset = (
            2.0 * unit[:, None] * _hermitian(_star(V)[:, None] @ dZ),
            unit * (2.0 * _hermitian(_star(V)) - _star(V) @ V),
        )
        if limit.name in OF_ANGLE:
            offset = offset - _star(P) @ P / np.linalg.norm(P, 2, axis=(-2, -1))[:, None, None] ** 2
        present = unit * (2.0 * _hermitian(_star(V) @ Z) - _star(V) @ V)
        weight = np.minimum(1.0, _FAR_FROM_LIMIT / np.linalg.norm(present, 2, axis=(-2, -1)))
    slopes, offsets = np.moveaxis(_parts(slope), 1, -1), _parts(offset)
    return slopes * weight[:, None, None], offsets * weight[:, None], weight, least


def _star(matrices: ComplexArray) -> ComplexArray:
    return np.conj(matrices.swapaxes(-1, -2))


def _hermitian(matrices: ComplexArray) -> ComplexArray:
    return np.asarray(0.5 * (matrices + _star(matrices)), dtype=np.complex128)


def _polar(matrices: Any) -> Any:
    """Unitary factor of the polar decomposition."""
    left, _, right = np.linalg.svd(matrices)
    return left @ right


def _parts(hermitian: ComplexArray) -> FloatArray:
    """The n² independent real numbers of Hermitian matrices (..., n, n): diagonal, then real and imaginary above it."""
    i, j = np.triu_indices(hermitian.shape[-1], 1)
    above = hermitian[..., i, j]
    diagonal = np.diagonal(hermitian, axis1=-2, axis2=-1).real
    return np.concatenate([diagonal, above.real, above.imag], axis=-1)


def _embedding(n: int) -> FloatArray:
    """From the parts of a Hermitian matrix to the real symmetric one of twice the size, ((2n)², n²)."""
    i, j = np.triu_indices(n, 1)
    out = []
    entries = [(k, k, 0.5) for k in range(n)] + [(int(row), int(column), 1.0) for row, column in zip(i, j, strict=True)]
    for row, column, unit in entries:
        one = np.zeros((n, n), dtype=np.complex128)
        one[row, column] = unit
        out.append(_real(one + _star(one)))
    for row, column, _ in entries[n:]:
        one = np.zeros((n, n), dtype=np.complex128)
        one[row, column] = 1j
        out.append(_real(one + _star(one)))
    return np.array([matrix.ravel() for matrix in out]).T


def _noise_embedding(n: int) -> FloatArray:
    """From real and imaginary parts of a matrix, row by row, to the real one of twice the size, ((2n)², 2 n²)."""
    units = [factor * np.eye(1, n * n, k).reshape(n, n) for factor in (1.0, 1j) for k in range(n * n)]
    return np.array([_real(unit).ravel(order="F") for unit in units]).T


def _real(matrices: Any) -> FloatArray:
    """Complex matrices as real ones of twice the size."""
    return np.block([[matrices.real, -matrices.imag], [matrices.imag, matrices.real]])


def _square(vector: Any, size: int) -> Any:
    return cp.reshape(vector, (size, size), order="F")
