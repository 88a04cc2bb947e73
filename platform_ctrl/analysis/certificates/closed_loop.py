"""The closed loop that a certificate speaks of: formed from plant and controller in balls, not in rounded numbers."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeGuard

import flint
import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays, state_scaling
from platform_ctrl.analysis.certificates.intervals import Balls, Enclosure, balls, blocks, identity
from platform_ctrl.analysis.feedback import performance_loop
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError


class BallSystem(NamedTuple):
    """A, B, C, D as matrices of balls."""

    A: Balls
    B: Balls
    C: Balls
    D: Balls


@value
class ClosedLoop:
    """A system, or a plant with the controller that closes it: what a certificate makes its claim about.

    Attributes
    ----------
    A, B, C, D
        The system in its units; with a controller the plant with inputs [w, u] and outputs [z, y]. Shapes (n, n),
        (n, m), (p, n), (p, m).
    dt
        Sample period, s; 0: continuous.
    A_K, B_K, C_K, D_K
        The controller u = K y of the last inputs and outputs, in its units, or None. Shapes (k, k), (k, y), (u, k),
        (u, y).
    label
        What it is, for example the corner of a plant set.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    dt: float = 0.0
    A_K: FloatArray | None = None
    B_K: FloatArray | None = None
    C_K: FloatArray | None = None
    D_K: FloatArray | None = None
    label: str = ""

    @property
    def controller(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
        """A, B, C, D (k, k), (k, y), (u, k), (u, y) of the controller in its units, or None."""
        if self.A_K is None or self.B_K is None or self.C_K is None or self.D_K is None:
            return None
        return self.A_K, self.B_K, self.C_K, self.D_K

    @property
    def order(self) -> int:
        """States of plant and controller together."""
        return len(self.A) + (0 if self.A_K is None else len(self.A_K))

    @property
    def finite(self) -> bool:
        """Whether every entry is a finite number."""
        parts = [self.A, self.B, self.C, self.D, *(self.controller or ())]
        return all(bool(np.all(np.isfinite(part))) for part in parts) and bool(np.isfinite(self.dt) and self.dt >= 0)

    @property
    def mistake(self) -> str:
        """What makes it no closed loop, in words; empty where it is one."""
        given = (self.A_K, self.B_K, self.C_K, self.D_K)
        if any(part is None for part in given) and any(part is not None for part in given):
            return "a controller must have all of A_K, B_K, C_K and D_K, or none of them"
        K = self.controller or ()
        if not all(is_matrix(part) for part in (self.A, self.B, self.C, self.D, *K)):
            return "a closed loop holds what is no matrix of doubles"
        if not isinstance(self.dt, float | int) or isinstance(self.dt, bool):
            return f"dt must be a sample period in s, or 0 for a continuous system, got {self.dt!r}"
        n, (r, m) = len(self.A), self.D.shape
        fits = self.A.shape == (n, n) and self.B.shape == (n, m) and self.C.shape == (r, n)
        if K:
            k, (q, p) = len(K[0]), K[3].shape
            fits = fits and K[0].shape == (k, k) and K[1].shape == (k, p) and K[2].shape == (q, k) and q <= m and p <= r
        if not fits:
            return "the matrices of a closed loop have sizes that do not fit together"
        return "" if self.finite else "a matrix is not finite"

    def rounded(self) -> StateArrays:
        """Return the closed loop in floating point: what a certificate is searched with.

        Returns
        -------
        StateArrays
            From w to z; a loop that is not well posed is an `ArgumentError`.
        """
        if self.controller is None:
            return StateArrays(self.A, self.B, self.C, self.D, self.dt)
        plant = StateArrays(self.A, self.B, self.C, self.D, self.dt)
        return performance_loop(plant, StateArrays(*self.controller, self.dt))

    def enclosed(self) -> BallSystem:
        """Return balls that contain the exact closed loop, at the present working precision.

        Returns
        -------
        BallSystem
            From w to z; a loop that is not well posed, or that the precision cannot tell from one, is a
            `ZeroDivisionError`.
        """
        return enclosed_by(balls, self)


def enclosed_by(enclosure: Enclosure, loop: ClosedLoop) -> BallSystem:
    """Return what contains the exact closed loop: `balls`, or `rounded` for double precision."""
    if loop.controller is None:
        return BallSystem(*(enclosure(part) for part in (loop.A, loop.B, loop.C, loop.D)))
    A_K, B_K, C_K, D_K = loop.controller
    q, p = D_K.shape
    m, r = loop.B.shape[1] - q, loop.C.shape[0] - p
    A, K, DK = enclosure(loop.A), enclosure(A_K), enclosure(D_K)
    B1, B2, C1, C2 = (enclosure(x) for x in (loop.B[:, :m], loop.B[:, m:], loop.C[:r], loop.C[r:]))
    D11, D12 = enclosure(loop.D[:r, :m]), enclosure(loop.D[:r, m:])
    D21, D22 = enclosure(loop.D[r:, :m]), enclosure(loop.D[r:, m:])
    Fx, Fk, Fw = DK * C2, enclosure(C_K), DK * D21
    if np.any(loop.D[r:, m:]) and np.any(D_K):
        E = (enclosure(np.eye(q)) - DK * D22).inv()
        Fx, Fk, Fw = E * Fx, E * Fk, E * Fw
    BK = enclosure(B_K)
    return BallSystem(
        blocks([[A + B2 * Fx, B2 * Fk], [BK * (C2 + D22 * Fx), K + BK * D22 * Fk]]),
        blocks([[B1 + B2 * Fw], [BK * (D21 + D22 * Fw)]]),
        blocks([[C1 + D12 * Fx, D12 * Fk]]),
        D11 + D12 * Fw,
    )


def is_matrix(item: object) -> TypeGuard[FloatArray]:
    """Return whether `item` is a matrix of doubles, whose exact values balls can hold."""
    return isinstance(item, np.ndarray) and item.dtype == np.float64 and item.ndim == 2


def matrices_of(
    A: ArrayLike, B: ArrayLike | None, C: ArrayLike | None, D: ArrayLike | None, dt: float, where: str
) -> StateArrays:
    """Return the matrices of a system as float64, missing ones empty."""
    try:
        state = np.atleast_2d(np.asarray(A, dtype=np.float64))
        n = len(state) if state.size else 0
        state = state if state.size else np.zeros((0, 0))
        inputs = np.zeros((n, 0)) if B is None else np.asarray(B, dtype=np.float64)
        outputs = np.zeros((0, n)) if C is None else np.asarray(C, dtype=np.float64)
        shape = (outputs.shape[0], inputs.shape[1])
        direct = np.zeros(shape) if D is None else np.asarray(D, dtype=np.float64)
        period = float(dt)
    except (TypeError, ValueError, IndexError):
        raise ArgumentError(f"{where}: A, B, C, D, dt are no matrices of real numbers and a sample period") from None
    if state.shape != (n, n) or inputs.shape[0] != n or outputs.shape[1:] != (n,) or direct.shape != shape:
        raise ArgumentError(
            f"{where}: A, B, C and D must be (n, n), (n, m), (p, n) and (p, m), "
            f"got {state.shape}, {inputs.shape}, {outputs.shape} and {direct.shape}"
        )
    return StateArrays(state, inputs, outputs, direct, period)


@check_arguments
def static_gain(gain: FloatArray, dt: float) -> StateArrays:
    """Return u = gain y (u, y) as a controller without states."""
    if gain.ndim != 2:
        raise ArgumentError(f"static_gain: gain must be a matrix, got shape {gain.shape}")
    q, p = gain.shape
    return StateArrays(np.zeros((0, 0)), np.zeros((0, p)), np.zeros((q, 0)), gain, dt)


@check_arguments
def closed(
    system: StateArrays, controller: StateArrays | None = None, label: str = "", where: str = "certificate"
) -> ClosedLoop:
    """Return the loop of a plant and u = K y as a certificate speaks of it; without a controller the system.

    With a controller the plant has inputs [w, u] and outputs [z, y]. Nothing is rounded.
    """
    A, B, C, D, dt = matrices_of(*system[:4], system.dt, where)
    if controller is None:
        return ClosedLoop(A=A, B=B, C=C, D=D, dt=dt, label=label)
    A_K, B_K, C_K, D_K, dt_K = matrices_of(*controller[:4], controller.dt, f"{where} (controller)")
    if D_K.shape[0] > B.shape[1] or D_K.shape[1] > C.shape[0]:
        raise ArgumentError(
            f"{where}: the controller has {D_K.shape[1]} inputs and {D_K.shape[0]} outputs, the plant only "
            f"{C.shape[0]} outputs and {B.shape[1]} inputs; give the plant with inputs [w, u] and outputs [z, y]"
        )
    if dt_K != dt and len(A_K):
        raise ArgumentError(
            f"{where}: plant and controller must have the same sample period, got {dt:g} s and {dt_K:g} s"
        )
    return ClosedLoop(A=A, B=B, C=C, D=D, dt=dt, A_K=A_K, B_K=B_K, C_K=C_K, D_K=D_K, label=label)


_BITS = 320
_STEPS = 150


def real_modes(A: FloatArray) -> FloatArray:
    """Return T such that T A T^-1 has real poles a on its diagonal and blocks [[a, b], [-b, a]] for a ± jb."""
    values, vectors = np.linalg.eig(A)
    columns = [vectors[:, k].real if values[k].imag <= 0 else vectors[:, k].imag for k in range(len(values))]
    return np.asarray(np.linalg.inv(np.array(columns).reshape(len(A), len(A)).T), dtype=np.float64)


def modes(system: StateArrays) -> FloatArray:
    """Return T such that T A T^-1 is nearly diagonal but for 2 x 2 blocks, inputs and outputs of like size."""
    T = real_modes(system.A)
    back = np.linalg.inv(T)
    s = state_scaling(T @ system.A @ back, T @ system.B, system.C @ back)
    return np.asarray(T / s[:, None], dtype=np.float64)


def stabilising(
    loop: ClosedLoop, T: FloatArray, weight: float | None, gamma: float = np.inf, decay: float = 0.0
) -> FloatArray | None:
    """Return X in the coordinates T x of the stabilising solution, or None.

    `weight` is the multiple of the identity, in these coordinates, that is added to C'C. None: no C, and instead of the
    identity the rates of the coordinates, |diag A|, so that X is about the identity for modes. `gamma` is the norm for
    which the Riccati equation is solved; infinite: B does not matter (Lyapunov's equation). `decay`, 1/s, is the rate
    by which the solutions are slowed down first.
    """
    with flint.ctx.workprec(_BITS):
        try:
            system = _flattened(_moved(loop.enclosed(), T), loop.dt, decay)
            n = len(T)
            if weight is None:
                rates = [[abs(system.A[i, i]) if i == j else 0 for j in range(n)] for i in range(n)]
                X = _riccati(system._replace(C=flint.arb_mat(0, n)), flint.arb_mat(rates), gamma)
            else:
                X = _riccati(system, flint.arb(weight) * identity(n), gamma)
        except ZeroDivisionError:
            return None
        if X is None:
            return None
        out = np.array([[float(x) for x in row] for row in X.tolist()]).reshape(len(T), len(T))
    return 0.5 * (out + out.T) if np.all(np.isfinite(out)) else None


def _moved(system: BallSystem, T: FloatArray) -> BallSystem:
    to = balls(T)
    back = to.inv().mid()
    return BallSystem((to * system.A * back).mid(), (to * system.B).mid(), (system.C * back).mid(), system.D.mid())


def _flattened(system: BallSystem, dt: float, decay: float) -> BallSystem:
    """Slow down, and carry a sampled system to the w-plane, which keeps X."""
    A, B, C, D = system
    eye, rate = identity(A.nrows()), flint.arb(decay)
    if dt == 0:
        return BallSystem((A + rate * eye).mid(), B, C, D)
    A = ((rate * flint.arb(dt)).exp() * A).mid()
    inverse = (A + eye).inv().mid()
    root = flint.arb(2).sqrt().mid()
    return BallSystem(
        (inverse * (A - eye)).mid(),
        (root * (inverse * B)).mid(),
        (root * (C * inverse)).mid(),
        (D - C * inverse * B).mid(),
    )


def _riccati(system: BallSystem, weight: Balls, gamma: float) -> Balls | None:
    """F'X + XF + XGX + Q = 0 of the bounded-real inequality for [z, weight^1/2 x]."""
    A, B, C, D = system
    n, m = A.nrows(), D.ncols()
    F, Q, G = A, weight + (C.transpose() * C if C.nrows() else flint.arb_mat(n, n)), flint.arb_mat(n, n)
    if np.isfinite(gamma) and m:
        level = flint.arb(gamma)
        inverse = (level * level * identity(m) - D.transpose() * D).inv().mid()
        cross = (inverse * D.transpose() * C).mid()
        F = A + B * cross
        G = B * inverse * B.transpose()
        Q = Q + C.transpose() * D * cross
    S = _sign(blocks([[F, G], [-1 * Q, -1 * F.transpose()]]).mid())
    if S is None:
        return None
    rows, eye = S.tolist(), identity(n)
    S11, S12, S21, S22 = (flint.arb_mat([row[j : j + n] for row in rows[i : i + n]]) for i in (0, n) for j in (0, n))
    # S [I; X] = -[I; X]: twice as many equations as unknowns, consistent.
    left = blocks([[S12], [S22 + eye]]).mid()
    right = blocks([[-1 * (S11 + eye)], [-1 * S21]]).mid()
    return ((left.transpose() * left).mid().inv().mid() * (left.transpose() * right).mid()).mid()


def _sign(Z: Balls) -> Balls | None:
    """Return the sign of a matrix without eigenvalues on the imaginary axis, or None where none is reached."""
    half = flint.arb(0.5)
    for _ in range(_STEPS):
        inverse = Z.inv().mid()
        size, other = _size(Z), _size(inverse)
        c = (other / size).sqrt().mid() if abs(other / size - 1) > 1e-2 else flint.arb(1)
        new = (half * (c * Z + (1 / c).mid() * inverse)).mid()
        change = _size(new - Z)
        Z = new
        if change < flint.arb(2) ** (-_BITS // 3) * size:
            return Z
    return None


def _size(Z: Balls) -> Any:
    return sum((abs(x) ** 2 for x in Z.entries()), flint.arb(0)).sqrt().mid()
