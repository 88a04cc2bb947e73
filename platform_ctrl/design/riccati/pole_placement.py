"""Pole placement by state feedback, in coordinates in which the units of the states do not matter.

The method is python-control's `place` (Tits and Yang, IEEE Trans. Automatic Control 41, 1996): of all gains that
place the poles, one whose closed loop has well-conditioned eigenvectors. What is well conditioned depends on the
units of the states: angles in rad and momenta in N m s differ by orders of magnitude. Here the states are those that
a unit input moves by one within the time of the wanted poles: their Gramian is the identity. The poles reached are
computed from A − B K itself.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, state_arrays, state_scaling
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.closed_loop import static_gain
from platform_ctrl.analysis.certificates.makers import stability_certificate
from platform_ctrl.common.arguments import known_names
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, NotCertifiedError, NotStabilisableError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import control

# Least singular value of [A − λ, B] in balanced units, over its largest, at which a mode can be moved.
_LEAST_CONTROLLABILITY = 1e-10
# Rate, over that of the fastest wanted pole (discrete: over the sample rate), at which the past is forgotten.
_FORGETTING_RATE = 0.5
# Largest relative distance of a pole from where it was to be.
_LARGEST_POLE_ERROR = 1e-6


@value
class PolePlacement:
    """State feedback u = −K x.

    Attributes
    ----------
    system
        The plant as given.
    inputs
        Names of the inputs that the feedback uses, in the order of the gain's rows.
    state_gain : (m, n)
        K, with the sign of `control.place`, in units of the inputs per state.
    poles : complex (n,)
        Eigenvalues of A − B K, in the order in which they were requested: rad/s, or in z (dimensionless).
    error
        Relative: largest distance of a pole from where it was to be, over its size (at least that of a tenth of
        the largest).
    condition
        Condition number of the closed loop's eigenvectors in those coordinates, dimensionless: how much a small change
        moves the poles.
    """

    system: control.StateSpace
    inputs: tuple[str, ...]
    state_gain: FloatArray
    poles: ComplexArray
    error: float
    condition: float

    @property
    def certificate(self) -> Certificate:
        """Proof that A − B K is stable, made at each use; a `NotCertifiedError` where none is found."""
        A, B, _, _, dt = state_arrays(self.system, "pole_placement")
        names = list(self.system.input_labels)
        columns, gain = [names.index(name) for name in self.inputs], static_gain(-self.state_gain, dt)
        return stability_certificate(A, dt, B=B[:, columns], C=np.eye(len(A)), controller=gain, label="state feedback")


@check_arguments
def pole_placement(system: control.StateSpace, poles: ArrayLike, inputs: Sequence[str] | None = None) -> PolePlacement:
    """Return the state feedback u = −K x that gives A − B K the wanted poles.

    Parameters
    ----------
    system
        Continuous or discrete, n states.
    poles : complex (n,)
        In s, rad/s, or in z; complex ones in conjugate pairs, none more often than there are inputs.
    inputs
        Names of the inputs that the feedback uses; default all. The platform rates are inputs of `state_space` too.

    Returns
    -------
    PolePlacement
        The gain, and the poles that it reaches.

    Raises
    ------
    ArgumentError
        The poles make no sense, or an input does not exist.
    NotStabilisableError
        No input moves a mode.
    NotCertifiedError
        The poles were not reached.

    References
    ----------
    A. L. Tits, Y. Yang, IEEE Trans. Automatic Control 41, 1996.

    See docs/classical.md.

    Examples
    --------
    >>> import control, numpy as np
    >>> from platform_ctrl import design
    >>> double_integrator = control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0)
    >>> design.pole_placement(double_integrator, [-1, -2]).state_gain.round(6)  # u = -state_gain x
    array([[2., 3.]])
    """
    arrays = state_arrays(system, "pole_placement")
    chosen = list(system.input_labels) if inputs is None else list(inputs)
    known_names("inputs", chosen, list(system.input_labels))
    A, B = arrays.A, arrays.B[:, [list(system.input_labels).index(name) for name in chosen]]
    wanted = _checked(poles, len(A))
    scale = state_scaling(A, B, arrays.C)
    A_s, B_s = A * scale / scale[:, None], B / scale[:, None]
    _require_movable(A_s, B_s, system)
    _require_rank(wanted, int(np.linalg.matrix_rank(B_s)))
    # Time in units of the wanted poles.
    unit = (float(np.abs(wanted).max()) or 1.0) if arrays.dt == 0.0 else 1.0
    root = _gramian_root(A_s / unit, B_s / unit, arrays.dt, system)
    A_n, B_n = (np.asarray(np.linalg.solve(root, item), dtype=np.float64) for item in (A_s @ root, B_s))
    K_n = _placed(A_n / unit, B_n / unit, wanted / unit, system)
    K = np.linalg.solve(root.T, K_n.T).T / scale
    reached, error = _matched(np.linalg.eigvals(A_n - B_n @ K_n).astype(np.complex128), wanted)
    if not error <= _LARGEST_POLE_ERROR:
        k = int(np.abs(reached - wanted).argmax())
        raise NotCertifiedError(
            f"pole_placement: the pole requested at {wanted[k]:.5g} is at {reached[k]:.5g}, off by more than "
            f"{_LARGEST_POLE_ERROR:g} of its size; choose poles that differ more from one another, or are "
            "nearer to the plant's",
            system,
        )
    vectors = np.linalg.eig(A_n - B_n @ K_n)[1]
    condition = float(np.linalg.cond(vectors))
    return PolePlacement(
        system=system, inputs=tuple(chosen), state_gain=K, poles=reached, error=error, condition=condition
    )


def _gramian_root(A: FloatArray, B: FloatArray, dt: float, system: control.StateSpace) -> FloatArray:
    """Return the Cholesky factor of the plant's Gramian, after a shift (or a factor) that makes it decay."""
    from scipy.linalg import cholesky, solve_continuous_lyapunov, solve_discrete_lyapunov

    s = np.linalg.eigvals(A)
    if dt == 0.0:
        shift = max(0.0, float(s.real.max())) + _FORGETTING_RATE
        gramian = solve_continuous_lyapunov(A - shift * np.eye(len(A)), -B @ B.T)
    else:
        decaying = A / (max(1.0, float(np.abs(s).max())) * np.exp(_FORGETTING_RATE))
        gramian = solve_discrete_lyapunov(decaying, B @ B.T)
    try:
        return np.asarray(cholesky(0.5 * (gramian + gramian.T), lower=True), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise NotStabilisableError(
            "pole_placement: the inputs hardly move some combination of the states; give more inputs",
            system,
        ) from None


def _checked(poles: ArrayLike, n: int) -> ComplexArray:
    try:
        wanted = np.asarray(poles, dtype=np.complex128)
    except (TypeError, ValueError):
        raise ArgumentError(f"poles: must be {n} numbers, got {short(poles)}") from None
    if wanted.shape != (n,) or not np.all(np.isfinite(wanted)):
        raise ArgumentError(f"poles: must be {n} finite numbers, one for each state, got {short(poles)}")
    rounding = 1e-9 * np.abs(wanted).max(initial=1.0)
    for pole in wanted:
        mirrored = np.sum(np.abs(wanted - np.conj(pole)) <= rounding) == np.sum(np.abs(wanted - pole) <= rounding)
        if not mirrored:
            raise ArgumentError(f"poles: complex poles must be conjugate pairs, got {pole:.5g} without its conjugate")
    return wanted


def _require_movable(A: FloatArray, B: FloatArray, system: control.StateSpace) -> None:
    size = float(np.linalg.norm(A)) or 1.0
    for mode in np.linalg.eigvals(A):
        pencil = np.hstack([A - mode * np.eye(len(A)), B * size / max(float(np.linalg.norm(B)), 1e-300)])
        if np.linalg.svd(pencil, compute_uv=False)[-1] < _LEAST_CONTROLLABILITY * size:
            raise NotStabilisableError(
                f"pole_placement: no input moves the mode at {mode:.5g}; give more inputs",
                system,
            )


def _require_rank(wanted: ComplexArray, rank: int) -> None:
    for pole in wanted:
        count = int(np.sum(np.abs(wanted - pole) <= 1e-9 * max(abs(pole), 1e-300)))
        if count > rank:
            raise ArgumentError(
                f"poles: a pole may occur at most {rank} times, the rank of B, got {pole:.5g} {count} times; "
                "move them apart a little"
            )


def _placed(A: FloatArray, B: FloatArray, wanted: ComplexArray, system: control.StateSpace) -> FloatArray:
    import control

    with warnings.catch_warnings():
        # Its "convergence not reached" is about the condition, not about the poles, which are checked afterwards.
        warnings.simplefilter("ignore")
        try:
            return _corrected(A, B, np.asarray(control.place(A, B, wanted), dtype=np.float64), wanted)
        except (ValueError, np.linalg.LinAlgError, ArithmeticError) as error:
            line = " ".join(str(error).split())
            raise NotCertifiedError(f"pole_placement: no gain was found: {line}; try other poles", system) from None


def _corrected(A: FloatArray, B: FloatArray, K: FloatArray, wanted: ComplexArray) -> FloatArray:
    """Return K after one Newton step: `place` is coarse for poles much slower than the fastest."""
    s, X = np.linalg.eig(A - B @ K)
    target = _matched(wanted, s)[0]
    inverse = np.linalg.pinv(X)
    moved = inverse @ B  # row i times a column of gains moves pole i
    gains = moved.conj() * ((s - target) / np.maximum((np.abs(moved) ** 2).sum(axis=1), 1e-300))[:, None]
    better = np.asarray(K + (gains.T @ inverse).real)
    if not np.all(np.isfinite(better)):
        return K

    def error(gain: FloatArray) -> float:
        reached = _matched(np.linalg.eigvals(A - B @ gain).astype(np.complex128), wanted)[0]
        return float((np.abs(reached - wanted) / np.maximum(np.abs(wanted), 1e-9)).max())

    return min(K, better, key=error)


def _matched(found: ComplexArray, wanted: ComplexArray) -> tuple[ComplexArray, float]:
    """Return poles in the order of those wanted, and the largest relative distance."""
    from scipy.optimize import linear_sum_assignment

    distance = np.abs(found[None, :] - wanted[:, None])
    order = linear_sum_assignment(distance)[1]
    size = np.maximum(np.abs(wanted), 0.1 * np.abs(wanted).max())
    reached = np.asarray(found[order], dtype=np.complex128)
    return reached, float((np.abs(reached - wanted) / size).max())
