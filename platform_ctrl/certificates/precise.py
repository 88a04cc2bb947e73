"""The matrix of a certificate where floating point cannot find it: a Riccati equation solved with hundreds of bits.

Loops with poles a billion apart, as controllers near the least gamma have them, leave a Riccati solver in doubles
without a digit for the slow ones. Here the stabilising solution is read off the sign of the Hamiltonian matrix
(Roberts, Int. J. Control 32, 1980), by Newton's iteration with norm scaling (Byers, Linear Algebra Appl. 85, 1987),
on the midpoints of balls. Then it is rounded to doubles in coordinates in which it is nearly diagonal: the modes.
Nothing here has to be rigorous: what is found is proved afterwards.
"""

from __future__ import annotations

from typing import Any

import flint
import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_scaling
from platform_ctrl.certificates.balls import Balls, balls, blocks, identity
from platform_ctrl.certificates.closed_loop import BallSystem, ClosedLoop
from platform_ctrl.frozen import FloatArray

_BITS = 320
_STEPS = 150


def real_modes(A: FloatArray) -> FloatArray:
    """Return T such that T A T^-1 has real poles a on its diagonal and blocks [[a, b], [-b, a]] for a ± jb.

    Raises
    ------
    numpy.linalg.LinAlgError
        A has no eigenvectors that span the states, to the digits of doubles.
    """
    values, vectors = np.linalg.eig(A)
    columns = [vectors[:, k].real if values[k].imag <= 0 else vectors[:, k].imag for k in range(len(values))]
    return np.asarray(np.linalg.inv(np.array(columns).reshape(len(A), len(A)).T), dtype=np.float64)


def modes(system: StateArrays) -> FloatArray:
    """Return T such that T A T^-1 is nearly diagonal but for 2 x 2 blocks, inputs and outputs of like size.

    Raises
    ------
    numpy.linalg.LinAlgError
        A has no eigenvectors that span the states, to the digits of doubles.
    """
    T = real_modes(system.A)
    back = np.linalg.inv(T)
    s = state_scaling(T @ system.A @ back, T @ system.B, system.C @ back)
    return np.asarray(T / s[:, None], dtype=np.float64)


def stabilising(
    loop: ClosedLoop, T: FloatArray, weight: float | None, gamma: float = np.inf, decay: float = 0.0
) -> FloatArray | None:
    """Return X in the coordinates T x of the stabilising solution, or None.

    Parameters
    ----------
    loop, T
        The closed loop and the coordinates.
    weight
        Multiple of the identity, in these coordinates, that is added to C'C. None: no C, and in place of the identity
        the rates of the coordinates, |diag A|, so that X is about the identity for modes.
    gamma
        Norm for which the Riccati equation is solved; infinite: then B does not matter (Lyapunov's equation).
    decay
        Rate, 1/s, by which the solutions are slowed down first.
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
