"""State feedback, estimators and output feedback by quadratic cost: LQR, the Kalman filter, LQG.

    cost      ∫ x' Q1 x + 2 x' Q12 u + u' Q2 u dt      (sampled plants: the sum over the samples)
    noise     x' = A x + B u + v1,  y = C x + D u + v2,  v1 and v2 white with intensities R1, R2 and R12 between them
              (sampled plants: x[k + 1] in place of x', covariances in place of intensities)

State feedback is u = −state_gain x, as in python-control; the controller of `lqg` is u = K y (positive feedback).
Solved in scaled units; each result is checked by the residual of its Riccati equation and the closed-loop poles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, state_arrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.closed_loop import static_gain
from platform_ctrl.analysis.certificates.makers import stability_certificate
from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lower_bounds import h2_lower_bound
from platform_ctrl.design.partition import Partition, partition, split, whole, with_direct_path
from platform_ctrl.design.riccati.equations import well_conditioned
from platform_ctrl.design.riccati.h2 import on_estimate
from platform_ctrl.design.riccati.quadratic_cost import Weights, checked_weights, solved, square_root
from platform_ctrl.design.scaling import require_stabilisable
from platform_ctrl.design.synthesis import Synthesis, certify
from platform_ctrl.errors import ArgumentError, DesignError, NotCertifiedError

if TYPE_CHECKING:
    from control import StateSpace

# The recomputed cost of LQG may exceed the claimed one by this share of its root.
TOLERANCE = 1e-5


@value
class StateFeedback:
    """A state feedback of least quadratic cost.

    Attributes
    ----------
    system
        The plant as given.
    state_gain : (m, n + p)
        K of u = −K [x, xi], as `control.lqr`, in the plant's units; xi (p,) are the integrals (sampled: sums) of y,
        where these are requested.
    X : (n + p, n + p)
        Of all inputs that bring the state x to rest, the least cost is x' X x, in units of the cost.
    poles : complex (n + p,)
        Of the closed loop: rad/s, or in z (dimensionless).
    integrals
        Number p of integrals.
    residual
        Relative residual of the Riccati equation, in scaled units.
    """

    system: StateSpace
    state_gain: FloatArray
    X: FloatArray
    poles: ComplexArray
    integrals: int
    residual: float

    @property
    def certificate(self) -> Certificate:
        """Proof that plant and integrals are stable with this gain, made at each use; or a `NotCertifiedError`."""
        arrays = state_arrays(self.system, "lqr")
        A, B = _integrated(arrays, self.integrals)
        gain = static_gain(-self.state_gain, arrays.dt)
        return stability_certificate(A, arrays.dt, B=B, C=np.eye(len(A)), controller=gain, label="state feedback")


@value
class Estimator:
    """A Kalman filter, x̂' = A x̂ + B u + observer_gain (y − C x̂ − D u); sampled: x̂[k + 1], the predictor.

    Attributes
    ----------
    system
        The plant as given.
    observer_gain : (n, p)
        Of the innovation, in units of the states per y (continuous: over s).
    Y : (n, n)
        Covariance of x − x̂ in the steady state, in units of the states; sampled: before y[k] is used.
    poles : complex (n,)
        Of the estimation error: rad/s, or in z (dimensionless).
    present_gain : (n, p)
        Sampled plants, in units of the states per y: x̂[k] + present_gain (y[k] − C x̂[k] − D u[k]) is the estimate
        that uses y[k]. Empty for others.
    residual
        Relative residual of the Riccati equation, in scaled units.
    """

    system: StateSpace
    observer_gain: FloatArray
    Y: FloatArray
    poles: ComplexArray
    present_gain: FloatArray
    residual: float

    @property
    def certificate(self) -> Certificate:
        """Proof that the estimation error decays, made at each use; a `NotCertifiedError` where none is found."""
        A, _, C, _, dt = state_arrays(self.system, "lqe")
        gain = static_gain(-self.observer_gain, dt)
        return stability_certificate(A, dt, B=np.eye(len(A)), C=C, controller=gain, label="estimation error")


@value
class LqgDesign:
    """LQG output feedback with its parts and the evidence.

    Attributes
    ----------
    controller
        u = K y (positive feedback), from the plant's outputs to its inputs, integrators included.
    feedback, estimator
        The two parts.
    synthesis
        The same loop as an H2 problem: its plant has the outputs y and, where integrals are requested, their integrals
        as measurements, and `synthesis.gamma`² is the cost, recomputed from the closed loop.
    """

    controller: StateSpace
    feedback: StateFeedback
    estimator: Estimator
    synthesis: Synthesis

    @property
    def poles(self) -> ComplexArray:
        """Poles (n,) of plant and controller: rad/s, or in z (dimensionless)."""
        return self.synthesis.poles

    @property
    def cost(self) -> float:
        """The rate (sampled: mean per sample) of the cost in the steady state, in units of Q1 and Q2; recomputed."""
        return self.synthesis.gamma**2

    @property
    def certificate(self) -> Certificate:
        """Proof of stability and of the root of the cost, of `synthesis`."""
        return self.synthesis.certificate


def lqr(
    system: StateSpace, Q1: ArrayLike, Q2: ArrayLike, Q12: ArrayLike | None = None, integral: ArrayLike | None = None
) -> StateFeedback:
    """State feedback u = −state_gain x of least quadratic cost, with the sign of `control.lqr`.

    Parameters
    ----------
    system
        Continuous or sampled plant.
    Q1, Q2
        Weights of the states and of the inputs, in units that make x' Q1 x and u' Q2 u alike. Shapes (n, n), (m, m). Q1
        may be indefinite, and Q2 of sampled plants singular, as long as there is a stabilising solution.
    Q12 : (n, m), optional
        Weight between them, in the same units; default 0.
    integral : (p, p), optional
        Weight of the integrals of y (sampled: of their sums), in the same units; None for no integral action.

    Returns
    -------
    StateFeedback
        Gain, cost matrix and poles.

    Raises
    ------
    ArgumentError
        The arguments do not make sense.
    IllPosedError
        Q2 of a continuous plant is not positive definite; the Riccati equation has no stabilising solution (for
        semidefinite weights: the cost does not see a mode on the stability boundary, which the message names); or the
        cost of a sampled plant has no least value, Q2 + B'XB not being positive definite.
    NotStabilisableError
        No input moves a mode that is not stable.
    UnscalableError, NotCertifiedError
        The Riccati equation was not solved, or the loop is not stable.

    References
    ----------
    A. J. Laub, IEEE Trans. Automatic Control 24, 1979.

    D. L. Kleinman, IEEE Trans. Automatic Control 13, 1968.

    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, 1996, ch. 13.

    Examples
    --------
    >>> import control, numpy as np
    >>> from platform_ctrl import design
    >>> double_integrator = control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0)
    >>> design.lqr(double_integrator, np.eye(2), [[1]]).state_gain.round(4)  # u = -state_gain x
    array([[1.    , 1.7321]])
    """
    arrays = state_arrays(system, "lqr")
    weights = checked_weights("lqr", "Q1, Q2, Q12", (Q1, Q2, Q12), system.input_labels, system, semidefinite=False)
    return _feedback(system, arrays, weights, integral, "lqr")


def lqe(system: StateSpace, R1: ArrayLike, R2: ArrayLike, R12: ArrayLike | None = None) -> Estimator:
    """Kalman filter in the steady state.

    Parameters
    ----------
    system
        Continuous or sampled plant.
    R1, R2
        Intensities (sampled: covariances) of v1 and v2, in units of the states and of y. Noise that enters at G has R1
        = G R G'. Shapes (n, n), (p, p).
    R12 : (n, p), optional
        Intensity between them, in the same units; default 0.

    Returns
    -------
    Estimator
        Gain, covariance and poles.

    Raises
    ------
    ArgumentError, IllPosedError, NotStabilisableError, UnscalableError, NotCertifiedError
        As `lqr`, for noise and measurements in place of weights and inputs; and where [R1, R12; R12', R2] is not
        positive semidefinite, or R2 not positive definite.

    References
    ----------
    A. J. Laub, IEEE Trans. Automatic Control 24, 1979.

    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, 1996, ch. 13.
    """
    arrays = state_arrays(system, "lqe")
    noise = checked_weights("lqe", "R1, R2, R12", (R1, R2, R12), system.output_labels, system)
    return _estimator(system, arrays, noise, "lqe")


@check_arguments
def lqg(  # noqa: PLR0913 - options by keyword
    system: StateSpace,
    Q1: ArrayLike,
    Q2: ArrayLike,
    R1: ArrayLike,
    R2: ArrayLike,
    *,
    Q12: ArrayLike | None = None,
    R12: ArrayLike | None = None,
    integral: ArrayLike | None = None,
    direct: bool = True,
) -> LqgDesign:
    """LQG output feedback: the state feedback of least cost on the Kalman filter's estimate.

    Parameters
    ----------
    system
        Continuous or sampled plant.
    Q1, Q2, R1, R2, Q12, R12
        As in `lqr` and `lqe`.
    integral : (p, p), optional
        Weight of the integrals of y (sampled: of their sums), as in `lqr`. The controller integrates what it measures,
        so it knows them exactly; it is still the optimum.
    direct
        Sampled plants: whether u[k] may use y[k].

    Returns
    -------
    LqgDesign
        The controller, and both halves of it.

    Raises
    ------
    ArgumentError, IllPosedError, NotStabilisableError, UnscalableError, NotCertifiedError
        As `lqr` and `lqe`; IllPosedError also where [Q1, Q12; Q12', Q2] is not positive semidefinite or Q2 not positive
        definite, since the cost is a norm squared; NotCertifiedError also where the closed loop does not have the cost
        that was promised.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, 1996, ch. 14.

    See docs/full-order.md.
    """
    arrays = state_arrays(system, "lqg")
    weights = checked_weights("lqg", "Q1, Q2, Q12", (Q1, Q2, Q12), system.input_labels, system)
    noise = checked_weights("lqg", "R1, R2, R12", (R1, R2, R12), system.output_labels, system)
    feedback = _feedback(system, arrays, weights, integral, "lqg")
    estimator = _estimator(system, arrays, noise, "lqg")
    plant = _cost_plant(arrays, weights, noise, integral)
    try:
        K, least = _joined(plant, arrays, feedback, estimator, weights, direct and arrays.dt > 0.0)
    except np.linalg.LinAlgError:
        raise NotCertifiedError("lqg: I + D_K D is singular; try direct=False", system) from None
    measured = [*system.output_labels, *(f"integral of {name}" for name in system.output_labels[: feedback.integrals])]
    P = named_system(
        whole(plant),
        [*(f"noise {k + 1}" for k in range(plant.B1.shape[1])), *system.input_labels],
        [*(f"cost {k + 1}" for k in range(len(plant.C1))), *measured],
    )
    parts = partition(P, len(measured), system.ninputs, sampled=True)
    synthesis = certify(
        P, parts, K,
        gamma_optimal=h2_lower_bound(parts, direct), least=least, backoff=0.0,
        method="lqg", norm="h2", tolerance=TOLERANCE,
        residual={
            "relative residual of the Riccati equation of X": feedback.residual,
            "relative residual of the Riccati equation of Y": estimator.residual,
        },
    )  # fmt: skip
    return LqgDesign(
        controller=_with_integrators(K, len(arrays.C), feedback.integrals, system),
        feedback=feedback, estimator=estimator, synthesis=synthesis,
    )  # fmt: skip


def _with_integrals(
    arrays: StateArrays, weights: Weights, integral: ArrayLike | None, where: str
) -> tuple[FloatArray, FloatArray, Weights, int]:
    """Return A, B and weights with the integrals of y as further states, and their number."""
    if integral is None:
        return arrays.A, arrays.B, weights, 0
    (n, m), p = arrays.B.shape, len(arrays.C)
    extra = real_array(f"{where}: integral", integral, (p, p))
    if np.linalg.eigvalsh(0.5 * (extra + extra.T)).min(initial=0.0) < 0.0 or not np.allclose(extra, extra.T):
        raise ArgumentError(f"{where}: integral must be a positive semidefinite weight of the integrals of y")
    A, B = _integrated(arrays, p)
    Q = np.block([[weights.first, np.zeros((n, p))], [np.zeros((p, n)), extra]])
    return A, B, Weights(Q, weights.second, np.vstack([weights.cross, np.zeros((p, m))])), p


def _integrated(arrays: StateArrays, integrals: int) -> tuple[FloatArray, FloatArray]:
    """Return A and B with the integrals (sampled: sums) of y as further states, if there are any."""
    A, B, C, D, dt = arrays
    if integrals == 0:
        return A, B
    n, p = len(A), integrals
    keep = np.eye(p) if dt else np.zeros((p, p))
    return np.block([[A, np.zeros((n, p))], [C, keep]]), np.vstack([B, D])


def _feedback(
    system: StateSpace, arrays: StateArrays, weights: Weights, integral: ArrayLike | None, where: str
) -> StateFeedback:
    A, B, weights, p = _with_integrals(arrays, weights, integral, where)
    X, K, poles, residual = _solution(A, B, np.eye(len(A)), weights, where, system)
    return StateFeedback(system=system, state_gain=K, X=X, poles=poles, integrals=p, residual=residual)


def _estimator(system: StateSpace, arrays: StateArrays, noise: Weights, where: str) -> Estimator:
    A, _, C, _, dt = arrays
    Y, Lt, poles, residual = _solution(A, np.eye(len(A)), C, noise, where, system, dual=True)
    present = np.zeros((len(Y), 0))
    if dt:
        present = np.asarray(np.linalg.solve(noise.second + C @ Y @ C.T, C @ Y).T)
    return Estimator(system=system, observer_gain=Lt.T, Y=Y, poles=poles, present_gain=present, residual=residual)


def _solution(
    A: FloatArray, B: FloatArray, C: FloatArray, weights: Weights, where: str, system: StateSpace, dual: bool = False
) -> tuple[FloatArray, FloatArray, ComplexArray, float]:
    """Return what `solved` does for A, B or the dual A', C'; a mode out of reach is named before any other error."""
    n, dt = len(A), float(system.dt or 0.0)

    def require() -> None:
        B_all, C_all = np.hstack([np.eye(n), B]), np.vstack([np.eye(n), C])
        whole = StateArrays(A, B_all, C_all, np.zeros((len(C_all), B_all.shape[1])), dt)
        require_stabilisable(split(whole, n, n), system, where)

    left, right = (A.T, C.T) if dual else (A, B)
    try:
        found = solved(left, right, weights, dt, where, system)
    except DesignError:
        require()
        raise
    if not well_conditioned(left - right @ found[1], found[0], dt > 0):
        require()
    return found


def _cost_plant(arrays: StateArrays, weights: Weights, noise: Weights, integral: ArrayLike | None) -> Partition:
    """Return the H2 problem: w = roots of the noise, z = roots of the cost, measurements [y, its integrals]."""
    n, m = arrays.B.shape
    A, B, weights, p = _with_integrals(arrays, weights, integral, "lqg")
    V = square_root(np.block([[noise.first, noise.cross], [noise.cross.T, noise.second]]))
    Z = square_root(np.block([[weights.first, weights.cross], [weights.cross.T, weights.second]])).T
    V2 = V[n:]
    return Partition(
        A=A, B1=V[: n + p], B2=B, C1=Z[:, : n + p],
        C2=np.block([[arrays.C, np.zeros((len(V2), p))], [np.zeros((p, n)), np.eye(p)]]),
        D11=np.zeros((len(Z), V.shape[1])), D12=Z[:, n + p :], D21=np.vstack([V2, np.zeros((p, V.shape[1]))]),
        D22=np.vstack([arrays.D, np.zeros((p, m))]), dt=arrays.dt,
    )  # fmt: skip


def _joined(
    plant: Partition, arrays: StateArrays, feedback: StateFeedback, estimator: Estimator, weights: Weights, direct: bool
) -> tuple[StateArrays, float]:
    """Return the controller from [y, its integrals] to u, states the estimate, and the root of the least cost."""
    n = len(arrays.A)
    X, F, Y, L = feedback.X, -feedback.state_gain, estimator.Y, estimator.observer_gain
    Fx, Fi = F[:, :n], F[:, n:]
    W = weights.second + (plant.B2.T @ X @ plant.B2 if arrays.dt else 0.0)
    cost = float(np.trace(plant.B1.T @ X @ plant.B1) + np.trace(W @ Fx @ Y @ Fx.T))
    V2 = plant.D21[: len(arrays.C)]
    present: FloatArray = np.zeros((len(F), len(V2)))
    if direct:
        # The estimate from y[k] of the present state, and of the noise that drives the next one.
        S = V2 @ V2.T + arrays.C @ Y @ arrays.C.T
        ahead = -np.linalg.solve(W, plant.B2.T @ X @ plant.B1 @ V2.T)
        present = np.asarray(np.linalg.solve(S, (Fx @ Y @ arrays.C.T + ahead).T).T)
        cost -= float(np.trace(W @ present @ S @ present.T))
    K = on_estimate(arrays.A, arrays.B, arrays.C, Fx, L, present)
    K = K._replace(B=np.hstack([K.B, arrays.B @ Fi]), D=np.hstack([present, Fi]))
    return with_direct_path(K, plant.D22), float(np.sqrt(max(cost, 0.0)))


def _with_integrators(K: StateArrays, ny: int, integrals: int, system: StateSpace) -> StateSpace:
    """Return the controller from y alone, with states [x̂, xi]."""
    n, p = len(K.A), integrals
    dt = float(system.dt or 0.0)
    keep = np.eye(p) if dt else np.zeros((p, p))
    A = np.block([[K.A, K.B[:, ny:]], [np.zeros((p, n)), keep]])
    B, C = np.vstack([K.B[:, :ny], np.eye(ny)[:p]]), np.hstack([K.C, K.D[:, ny:]])
    states = [f"estimate_{name}" for name in system.state_labels]
    states += [f"integral_{name}" for name in system.output_labels[:p]]
    return named_system(StateArrays(A, B, C, K.D[:, :ny], dt), system.output_labels, system.input_labels, states)
