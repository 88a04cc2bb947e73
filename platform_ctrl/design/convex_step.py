"""One step of the convex-concave procedure: limits of responses, restricted to what is linear in the gains of a PID.

    u = K y,    K = Kp + Ki / s + Kd s / (filter_time s + 1)

sampled by Tustin's rule, s = (2/T) (z − 1)/(z + 1); responses are taken at z = exp(jωT), exactly. A limit is the
largest gain of a closed-loop response, at every frequency. With Z = I − P K (at the angles) or I − K P (at the
torques), S = Z⁻¹ and T = I − S,

    sensitivity peak                   ‖S‖ ≤ m                 c = 0
    complementary sensitivity peak     ‖S − I‖ ≤ m             c = 1
    disk margin                        ‖S − I/2‖ ≤ m = 1/α     c = 1/2

have one form: ‖S − c I‖ ≤ m exactly if the least singular value of Z + a I is at least r, with a = c/(m² − c²) and
r = m/(m² − c²): Z has to stay out of a ball. The other two compare Z with something known or linear in K:

    torque per noise       ‖K S‖ ≤ m               Z* Z ≥ K* K / m²
    resonance damping ζ    ‖P S‖ ≤ m               Z* Z ≥ P* P / m²

the last one near a pole jν with residue R that the data do not resolve, m = ‖R‖/(ζ ν).

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

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.sampling import from_w_plane
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.sections import PID
from platform_ctrl.errors import TimeLimitError, UnscalableError

# A, b and the cones, Clarabel's names with their sizes, in which b − A x has to be.
Cones = tuple[FloatArray, FloatArray, list[tuple[str, int]]]
CENTRES = {"sensitivity_peak": 0.0, "complementary_sensitivity_peak": 1.0, "disk_margin": 0.5}
# The limit of P S.
OF_ANGLE = "resonance_damping"

# Limits are tightened by this share, so that they hold after the solver's rounding.
_RESERVE = 5e-4
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


def actions(s: ComplexArray, filter_time: float, period: float) -> ComplexArray:
    """Return the responses of the three actions at points s, complex (N, 3)."""
    # Half the sample rate itself is infinity in Tustin's plane: kept a little below.
    half = 0.5 * s * period
    near = half.real + 1j * np.minimum(half.imag, 0.5 * np.pi * (1.0 - 1e-9))
    p = np.asarray(2.0 / period * np.tanh(near), dtype=np.complex128)
    return np.stack([np.ones_like(p), 1.0 / p, p / (filter_time * p + 1.0)], axis=-1)


def controller_response(gains: FloatArray, of_actions: ComplexArray) -> ComplexArray:
    """Return K, complex (N, n, n), from `gains` (3, n, n) and the responses of the actions (N, 3)."""
    return np.asarray(np.einsum("kb,bij->kij", of_actions, gains), dtype=np.complex128)


def realisation(gains: FloatArray, filter_time: float, period: float) -> System:
    """Return the controller's state-space arrays: an integrator and a filter for each pick-off."""
    n = gains.shape[-1]
    # The gains and the bandwidth of each pick-off's filter, as `PID` orders its parameters.
    parameters = np.append(gains, np.full(n, 1.0 / filter_time))
    return from_w_plane(PID(filter_order=1, filtered="derivative").block(parameters, n, n), period)


@value
class Sample:
    """A plant at some frequencies: response (N, n, n), actions (N, 3), and limits (N,), infinite where none applies."""

    P: ComplexArray
    actions: ComplexArray
    limits: dict[str, FloatArray]

    def only(self, index: NDArray[Any]) -> Sample:
        """Return the sample at some of its frequencies."""
        limits = {name: bound[index] for name, bound in self.limits.items()}
        return Sample(P=self.P[index], actions=self.actions[index], limits=limits)

    def ratios(self, gains: FloatArray) -> dict[str, FloatArray]:
        """Return the ratios of values and limits, (N,): at most 1 where a limit is met."""
        K = controller_response(gains, self.actions)
        return {name: _ratios(name, bound, self.P, K) for name, bound in self.limits.items()}

    def worst(self, gains: FloatArray) -> FloatArray:
        """Return the largest of these ratios, (N,)."""
        return np.asarray(np.max(list(self.ratios(gains).values()), axis=0), dtype=np.float64)


def _ratios(name: str, bound: FloatArray, P: ComplexArray, K: ComplexArray) -> FloatArray:
    eye = np.eye(P.shape[-1])
    S_output, S_input = sensitivities_of_plants(P, K)
    if name in CENTRES:
        c = CENTRES[name]
        reached = np.maximum(largest_singular_values(S_output - c * eye), largest_singular_values(S_input - c * eye))
    else:
        reached = largest_singular_values(P @ S_input if name == OF_ANGLE else K @ S_output)
    return np.asarray(reached / bound)


def convex_step(
    samples: Sequence[Sample], gains: FloatArray, *, miss: float, time_limit: float, problem: object
) -> tuple[FloatArray, float]:
    """Return the best gains in the restriction about `gains`, and how far a limit is missed, as a share of it.

    The unknowns are the gains, the least integral gain t, and how far limits are missed, the sensitivity by itself.
    With `miss` 0 the integral gain is maximised; otherwise the violation is minimised, to at most `miss`. `problem` is
    attached to errors.
    """
    n = gains.shape[-1]
    scale = np.linalg.norm(gains, axis=(1, 2))
    unit = np.repeat(np.where(scale > 0.0, scale, scale.max()), n * n)
    v = len(unit)
    directions = (unit[:, None] * np.eye(v)).reshape(v, *gains.shape)
    # The least singular value of Ki is that of Uᵀ Ki, at least its symmetric part's eigenvalue.
    turned = _polar(gains[1]).T @ directions[:, 1] / float(np.linalg.norm(gains[1], 2))
    integral = _positive(_hermitian(turned)[None], np.zeros((1, n, n), dtype=np.complex128), -np.eye(n), v)
    limits, distance = _restricted(samples, gains, directions)
    # While the violation is minimised the integral action may become weaker, but not vanish.
    least = 0.5 / float(np.linalg.cond(gains[1])) if miss else 0.0
    nearest = 1.0 - _LEAST_DISTANCE * min(1.0, distance)
    # The violation of the sensitivity, which keeps the loop stable, has a limit of its own. Negative violations
    # are a reserve, without which the problem would have no interior.
    t, missed, near = np.eye(v + 3)[v:]
    rows = np.array([t, -t, missed, near - missed, near, -near])
    blocks = [integral, *limits]
    A = np.concatenate([rows, *(A for A, _, _ in blocks)])
    cones = [("NonnegativeConeT", len(rows)), *(cone for _, _, own in blocks for cone in own)]
    reward, price = (_GAIN_WEIGHT, 1.0) if miss else (1.0, 0.0)
    for growth, tolerance in _TRIALS:
        b = np.concatenate([[growth, -least, miss, 0.0, nearest, _LARGEST_RESERVE], *(b for _, b, _ in blocks)])
        try:
            x = _minimised(price * missed - reward * t, A, b, cones, tolerance, time_limit, problem)
            break
        except UnscalableError:
            if (growth, tolerance) == _TRIALS[-1]:
                raise
    return np.einsum("v,vbij->bij", x[:v], directions), float(x[v + 1])


def _restricted(samples: Sequence[Sample], gains: FloatArray, directions: FloatArray) -> tuple[list[Cones], float]:
    """Return the restricted limits, and the distance of the sensitivity over its limit."""
    out, distance, n, v = [], np.inf, gains.shape[-1], len(directions)
    for sample in samples:
        K = controller_response(gains, sample.actions)
        dK = np.einsum("kb,vbij->kvij", sample.actions, directions)
        for name, bound in sample.limits.items():
            at = np.isfinite(bound)
            of = v + (2 if name == "sensitivity_peak" else 1)
            for side in ("output", "input") if name in CENTRES and n > 1 else ("",):
                slopes, offsets, weight, least = _linearised(name, bound[at], side, sample.P[at], K[at], dK[at])
                distance, slack = min(distance, least), np.eye(n)
                if name == "torque_per_noise":
                    # [[R, K*], [K, I]] ≥ 0 in other units of the first rows and columns.
                    size = np.linalg.norm(K[at], 2, axis=(-2, -1)) / np.sqrt(weight)
                    noise, none = dK[at] / size[:, None, None, None], np.zeros((n, n))
                    slopes = _blocks(slopes, _star(noise), noise, np.zeros_like(noise))
                    slack = _blocks(none, none, none, slack)
                    offsets = _blocks(offsets, none, none, np.eye(n))
                out.append(_positive(slopes, offsets, slack, of))
    return out, distance


def _minimised(
    q: FloatArray,
    A: FloatArray,
    b: FloatArray,
    cones: list[tuple[str, int]],
    tolerance: float,
    time_limit: float,
    problem: object,
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
        words = f"measured_pid: a convex step ended with {status!r}"
        raise UnscalableError(f"{words}; give another start or pattern, or looser limits", problem)
    return x


def _positive(slopes: ComplexArray, offsets: ComplexArray, slack: FloatArray, of: int) -> Cones:
    """Return A (r, v + 3), b (r,) and the cones of b − A x for Hermitian matrices that are to be positive semidefinite.

    They are linear in the gains, with `slopes` (N, v, h, h) and `offsets` (N, h, h), and in the unknown of number `of`,
    with `slack` (h, h).
    """
    rows, v, h = _triangle(slopes), slopes.shape[1], len(slack)
    A = np.zeros((len(rows), rows.shape[-1], v + 3))
    A[:, :, :v] = -rows.swapaxes(-1, -2)
    A[:, :, of] = -_triangle(slack)
    cone = ("NonnegativeConeT", 1) if h == 1 else ("PSDTriangleConeT", 2 * h)
    return A.reshape(-1, v + 3), _triangle(offsets).ravel(), [cone] * len(rows)


def _linearised(
    name: str, bound: FloatArray, side: str, P: ComplexArray, K: ComplexArray, dK: ComplexArray
) -> tuple[ComplexArray, ComplexArray, FloatArray, float]:
    """Slopes (N, v, n, n) and offsets (N, n, n) of what is ≥ 0, their weights (N,); distance of S over its limit."""
    eye = np.eye(P.shape[-1])
    at_input = name == OF_ANGLE or side == "input"
    Z = eye - (K @ P if at_input else P @ K)
    dZ = -(dK @ P[:, None] if at_input else P[:, None] @ dK)
    least = np.inf
    if name in CENTRES:
        c, m = CENTRES[name], bound * (1.0 - _RESERVE)
        a, r = c / (m**2 - c**2), m / (m**2 - c**2)
        Y = Z + a[:, None, None] * eye
        # In units of r.
        U = _polar(Y) / r[:, None, None]
        slope, offset = _hermitian(_star(U)[:, None] @ dZ), _hermitian(_star(U) @ Y) - eye
        # The offset holds the present controller's part, which the unknowns bring again.
        offset = offset - _hermitian(_star(U) @ (Z - eye))
        # Far from the limit the inequality is weighted less: large numbers would hide the others.
        weight = np.minimum(1.0, _FAR_FROM_LIMIT * r / np.linalg.norm(Y, 2, axis=(-2, -1)))
        if name == "sensitivity_peak":
            least = float((np.linalg.svd(Z, compute_uv=False)[:, -1] / r).min())
    else:
        V = np.minimum(_ratios(name, bound, P, K), 1.0)[:, None, None] * Z
        m = bound * (1.0 - _RESERVE)
        # In units of the other side.
        unit = (m / np.linalg.norm(P if name == OF_ANGLE else K, 2, axis=(-2, -1)))[:, None, None] ** 2
        slope, offset = (
            2.0 * unit[:, None] * _hermitian(_star(V)[:, None] @ dZ),
            unit * (2.0 * _hermitian(_star(V)) - _star(V) @ V),
        )
        if name == OF_ANGLE:
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
