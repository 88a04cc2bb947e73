"""The PID controllers u = K y with one gain matrix for each action, and the limits of their closed loops.

    K = Kp + Ki / s + Kd s / (filter_time s + 1)

Sampled by Tustin's rule, s = (2/T) (z − 1)/(z + 1); responses are taken at z = exp(jωT), exactly. All channels of one
pick-off share their integrator and their filter.

A limit is the largest gain of a closed-loop response, at every frequency.
With Z = I − P K (at the angles) or I − K P (at the torques), S = Z⁻¹ and T = I − S,

    sensitivity peak       ‖S‖ ≤ m                 c = 0
    complementary sensitivity peak     ‖S − I‖ ≤ m             c = 1
    disk margin            ‖S − I/2‖ ≤ m = 1/α     c = 1/2

have one form: ‖S − c I‖ ≤ m exactly if the least singular value of Z + a I is at least r, with a = c/(m² − c²) and
r = m/(m² − c²): Z has to stay out of a ball. The other two compare Z with something known or linear in K:

    torque per noise       ‖K S‖ ≤ m               Z* Z ≥ K* K / m²
    resonance damping ζ    ‖P S‖ ≤ m               Z* Z ≥ P* P / m²

the last one near a pole jν with residue R that the data do not resolve, m = ‖R‖/(ζ ν).

One step of the convex-concave procedure: the limits, restricted to inequalities that are linear in the gains.

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
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.sampling import from_w_plane
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.sections import PID
from platform_ctrl.design.measured.responses import Contour
from platform_ctrl.errors import ArgumentError, TimeLimitError, UnscalableError

Pattern = Literal["full", "diagonal", "cross-axis"]
CENTRES = {"sensitivity_peak": 0.0, "complementary_sensitivity_peak": 1.0, "disk_margin": 0.5}
# The limit of P S.
OF_ANGLE = "resonance_damping"


def basis(s: ComplexArray, filter_time: float, period: float) -> ComplexArray:
    """Return the responses of the three actions at points s, complex (N, 3)."""
    # Half the sample rate itself is infinity in Tustin's plane: kept a little below.
    half = 0.5 * s * period
    near = half.real + 1j * np.minimum(half.imag, 0.5 * np.pi * (1.0 - 1e-9))
    p = np.asarray(2.0 / period * np.tanh(near), dtype=np.complex128)
    return np.stack([np.ones_like(p), 1.0 / p, p / (filter_time * p + 1.0)], axis=-1)


def controller_response(gains: FloatArray, actions: ComplexArray) -> ComplexArray:
    """Return K, complex (N, n, n), from `gains` (3, n, n) and the responses of the actions (N, 3)."""
    return np.asarray(np.einsum("kb,bij->kij", actions, gains), dtype=np.complex128)


def realisation(gains: FloatArray, filter_time: float, period: float) -> System:
    """Return the controller's state-space arrays: two states for each pick-off."""
    n = gains.shape[-1]
    # The gains and the bandwidth of each pick-off's filter, as `PID` orders its parameters.
    parameters = np.append(gains, np.full(n, 1.0 / filter_time))
    return from_w_plane(PID(filter_order=1, filtered="derivative").block(parameters, n, n), period)


def masks(pattern: Pattern, n: int) -> FloatArray:
    """Return which gains are free, (3, n, n) of zeros and ones.

    ``"cross-axis"`` is that of a caged gyro: integral action across, rate action along, proportional action in both.
    """
    one_of("measured_pid: pattern", pattern, ("full", "diagonal", "cross-axis"))
    if pattern == "cross-axis" and n != 2:
        raise ArgumentError(f"measured_pid: pattern 'cross-axis' needs two angles, got {n}")
    eye, full = np.eye(n), np.ones((n, n))
    if pattern == "cross-axis":
        return np.array([full, full - eye, eye])
    return np.array([full if pattern == "full" else eye] * 3)


@value
class Limit:
    """One limit over the frequencies of one plant: m, (N,); 1/margin of disks; infinite where none applies."""

    name: str
    bound: FloatArray


def limits_along(path: Contour, requested: dict[str, float]) -> tuple[Limit, ...]:
    """Return the limits that are requested, along the contour of a plant."""
    out = []
    for name, m in requested.items():
        bound = np.full(len(path.s), 1.0 / m if name == "disk_margin" else m)
        if name == OF_ANGLE:
            bound = np.where(path.residue > 0.0, path.residue / (m * path.frequency), np.inf)
        if np.isfinite(bound).any():
            out.append(Limit(name=name, bound=bound))
    return tuple(out)


def ratios(limit: Limit, P: ComplexArray, K: ComplexArray) -> FloatArray:
    """Return what is reached over the limit, (N,): at most 1 where it is kept."""
    eye = np.eye(P.shape[-1])
    S_output, S_input = sensitivities_of_plants(P, K)
    if limit.name in CENTRES:
        c = CENTRES[limit.name]
        reached = np.maximum(largest_singular_values(S_output - c * eye), largest_singular_values(S_input - c * eye))
    else:
        reached = largest_singular_values(P @ S_input if limit.name == OF_ANGLE else K @ S_output)
    return np.asarray(reached / limit.bound)


Cones = list[tuple[str, int]]

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
class ConvexStep:
    """The result of a step: gains (3, n, n), and the largest violation of a restricted limit as a share of it."""

    gains: FloatArray
    miss: float


class Restriction:
    """The convex problem about a controller, in the gains, the least integral gain t, and how far limits are missed.

    `free` says which gains are unknowns, (3, n, n) of zeros and ones; `problem` is attached to errors.
    """

    def __init__(self, samples: Sequence[Sample], free: FloatArray, problem: object) -> None:
        self.samples, self.problem, self.n = samples, problem, free.shape[-1]
        self.entries, self.shape = np.argwhere(free > 0.0), free.shape

    def step(self, gains: FloatArray, *, miss: float, time_limit: float) -> ConvexStep:
        """Return the best controller in the restriction about `gains`.

        With `miss` 0 the integral gain is maximised; otherwise the violation is minimised, to at most `miss`.
        """
        scale = np.linalg.norm(gains, axis=(1, 2))
        unit = np.where(scale > 0.0, scale, scale.max())[self.entries[:, 0]]
        v = len(unit)
        directions = np.zeros((v, *self.shape))
        directions[np.arange(v), *self.entries.T] = unit
        # The least singular value of Ki is that of Uᵀ Ki, at least its symmetric part's eigenvalue.
        turned = _polar(gains[1]).T @ directions[:, 1] / float(np.linalg.norm(gains[1], 2))
        integral = _Inequalities(
            slopes=_hermitian(turned)[None],
            offsets=np.zeros((1, self.n, self.n), dtype=np.complex128),
            slack=-np.eye(self.n),
            of=v,
        )
        limits, distance = self._limits(gains, directions)
        # While the violation is minimised the integral action may become weaker, but not vanish.
        least = 0.5 / float(np.linalg.cond(gains[1])) if miss else 0.0
        nearest = 1.0 - _LEAST_DISTANCE * min(1.0, distance)
        # The violation of the sensitivity, which keeps the loop stable, has a limit of its own. Negative violations
        # are a reserve, without which the problem would have no interior.
        t, missed, near = np.eye(v + 3)[v:]
        rows = np.array([t, -t, missed, near - missed, near, -near])
        blocks = [integral.cones(v), *(one.cones(v) for one in limits)]
        A = np.concatenate([rows, *(A for A, _, _ in blocks)])
        cones = [("NonnegativeConeT", len(rows)), *(cone for _, _, own in blocks for cone in own)]
        reward, price = (_GAIN_WEIGHT, 1.0) if miss else (1.0, 0.0)
        for growth, tolerance in _TRIALS:
            b = np.concatenate([[growth, -least, miss, 0.0, nearest, _LARGEST_RESERVE], *(b for _, b, _ in blocks)])
            try:
                x = _minimised(price * missed - reward * t, A, b, cones, tolerance, time_limit, self.problem)
                break
            except UnscalableError:
                if (growth, tolerance) == _TRIALS[-1]:
                    raise
        return ConvexStep(gains=np.einsum("v,vbij->bij", x[:v], directions), miss=float(x[v + 1]))

    def _limits(self, gains: FloatArray, directions: FloatArray) -> tuple[list[_Inequalities], float]:
        """Return the restricted limits, and the distance of the sensitivity over its limit."""
        out, distance, n, v = [], np.inf, self.n, len(directions)
        for sample in self.samples:
            K = controller_response(gains, sample.actions)
            dK = np.einsum("kb,vbij->kvij", sample.actions, directions)
            for limit in sample.limits:
                at = _required(limit)
                part = Limit(name=limit.name, bound=limit.bound[at])
                of = v + (2 if limit.name == "sensitivity_peak" else 1)
                for side in _sides(limit, n):
                    slopes, offsets, weight, least = _linearised(part, side, sample.P[at], K[at], dK[at])
                    distance, slack = min(distance, least), np.eye(n)
                    if limit.name == "torque_per_noise":
                        # [[R, K*], [K, I]] ≥ 0 in other units of the first rows and columns.
                        size = np.linalg.norm(K[at], 2, axis=(-2, -1)) / np.sqrt(weight)
                        noise, none = dK[at] / size[:, None, None, None], np.zeros((n, n))
                        slopes = _blocks(slopes, _star(noise), noise, np.zeros_like(noise))
                        slack = _blocks(none, none, none, slack)
                        offsets = _blocks(offsets, none, none, np.eye(n))
                    out.append(_Inequalities(slopes=slopes, offsets=offsets, slack=slack, of=of))
        return out, distance


def _minimised(
    q: FloatArray, A: FloatArray, b: FloatArray, cones: Cones, tolerance: float, time_limit: float, problem: object
) -> FloatArray:
    """Return the x that minimises q'x with b − A x in the product of `cones`, Clarabel's names with their sizes."""
    import clarabel
    from scipy.sparse import csc_matrix

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.chordal_decomposition_enable, settings.time_limit = False, False, time_limit
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    none, size = csc_matrix((len(q), len(q))), [getattr(clarabel, kind)(size) for kind, size in cones]
    found = clarabel.DefaultSolver(none, q, csc_matrix(A), b, size, settings).solve()
    x, status = np.array(found.x), str(found.status)
    if status == "MaxTime":
        raise TimeLimitError(f"measured_pid: no convex step in {time_limit:.3g} s; give a larger time_limit", problem)
    if status not in ("Solved", "AlmostSolved") or not np.all(np.isfinite(x)):
        raise UnscalableError(
            f"measured_pid: a convex step ended with {status!r}; give another start or pattern, or looser limits",
            problem,
        )
    return x


@value
class _Inequalities:
    """Hermitian matrices that are linear in the gains and have to be positive semidefinite.

    `slopes` (N, v, h, h) and `offsets` (N, h, h), and `slack` (h, h) times the unknown of number `of`.
    """

    slopes: ComplexArray
    offsets: ComplexArray
    slack: FloatArray
    of: int

    def cones(self, v: int) -> tuple[FloatArray, FloatArray, Cones]:
        """Return A (r, v + 3), b (r,) and the cones of b − A x."""
        rows = _triangle(self.slopes)
        A = np.zeros((len(rows), rows.shape[-1], v + 3))
        A[:, :, :v] = -rows.swapaxes(-1, -2)
        A[:, :, self.of] = -_triangle(self.slack)
        h = len(self.slack)
        cone = ("NonnegativeConeT", 1) if h == 1 else ("PSDTriangleConeT", 2 * h)
        return A.reshape(-1, v + 3), _triangle(self.offsets).ravel(), [cone] * len(rows)


def _sides(limit: Limit, n: int) -> tuple[str, ...]:
    if limit.name in CENTRES and n > 1:
        return ("output", "input")
    return ("input",) if limit.name == OF_ANGLE else ("output",)


def _required(limit: Limit) -> NDArray[np.bool_]:
    return np.isfinite(limit.bound)


def _linearised(
    limit: Limit, side: str, P: ComplexArray, K: ComplexArray, dK: ComplexArray
) -> tuple[ComplexArray, ComplexArray, FloatArray, float]:
    """Slopes (N, v, n, n) and offsets (N, n, n) of what is ≥ 0, their weights (N,); distance of S over its limit."""
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
        unit = (m / np.linalg.norm(P if limit.name == OF_ANGLE else K, 2, axis=(-2, -1)))[:, None, None] ** 2
        slope, offset = (
            2.0 * unit[:, None] * _hermitian(_star(V)[:, None] @ dZ),
            unit * (2.0 * _hermitian(_star(V)) - _star(V) @ V),
        )
        if limit.name == OF_ANGLE:
            offset = offset - _star(P) @ P / np.linalg.norm(P, 2, axis=(-2, -1))[:, None, None] ** 2
        present = unit * (2.0 * _hermitian(_star(V) @ Z) - _star(V) @ V)
        weight = np.minimum(1.0, _FAR_FROM_LIMIT / np.linalg.norm(present, 2, axis=(-2, -1)))
    return slope * weight[:, None, None, None], offset * weight[:, None, None], weight, least


def _star(matrices: ComplexArray) -> ComplexArray:
    return np.conj(matrices.swapaxes(-1, -2))


def _hermitian(matrices: ComplexArray) -> ComplexArray:
    return np.asarray(0.5 * (matrices + _star(matrices)), dtype=np.complex128)


def _polar(matrices: Any) -> Any:
    """Unitary factor of the polar decomposition."""
    left, _, right = np.linalg.svd(matrices)
    return left @ right


def _blocks(*parts: Any) -> Any:
    """Return the matrices [[a, b], [c, d]] of four stacks of matrices (..., n, n)."""
    a, b, c, d = np.broadcast_arrays(*parts)
    return np.concatenate([np.concatenate([a, b], axis=-1), np.concatenate([c, d], axis=-1)], axis=-2)


def _triangle(hermitian: Any) -> FloatArray:
    """Return Hermitian matrices (..., h, h) as real ones of twice the size, the upper triangle by columns."""
    H = np.asarray(hermitian, dtype=np.complex128)
    if H.shape[-1] == 1:
        return H[..., 0].real
    real = _blocks(H.real, -H.imag, H.imag, H.real)
    j, i = np.tril_indices(real.shape[-1])
    return np.asarray(real[..., i, j] * np.where(i == j, 1.0, np.sqrt(2.0)), dtype=np.float64)
