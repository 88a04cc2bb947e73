"""Quadratic costs and noise intensities: judged, and their Riccati equation solved in scaled units.

State feedback and Kalman filter are one problem and its dual; what is said here of weights and inputs holds for
intensities and measurements too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, state_scaling
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.arguments import real_array
from platform_ctrl.design.riccati import continuous_solution, discrete_solution, relative_residual
from platform_ctrl.errors import ArgumentError, IllPosedError, NotCertifiedError, UnscalableError
from platform_ctrl.frozen import FloatArray

if TYPE_CHECKING:
    from control import StateSpace

# Largest relative residual of a Riccati equation (scaled).
RESIDUAL = 1e-6
# A weight may be negative by this share of its largest eigenvalue: rounding.
SEMIDEFINITE = 1e-10


class Weights(NamedTuple):
    """[first, cross; cross', second], positive semidefinite with a positive definite second."""

    first: FloatArray
    second: FloatArray
    cross: FloatArray


def judged_weights(
    where: str,
    names: str,
    given: tuple[ArrayLike | None, ...],
    n: int,
    m: int,
    labels: list[str],
    system: StateSpace,
) -> Weights:
    """Judge weights or intensities.

    Parameters
    ----------
    where, names
        Who asks, and what the three matrices are called there, separated by commas.
    given
        Weights (n, n) of the states, (m, m) of the inputs, and (n, m) between them, None for 0.
    n, m, labels
        Numbers of states and inputs, and the inputs' names.
    system
        Attached to errors.

    Raises
    ------
    ArgumentError
        A plant without states or such signals; wrong shapes, not finite, not symmetric.
    IllPosedError
        The second is not positive definite, or the whole not positive semidefinite.
    """
    first, second, between = names.split(", ")
    if not (n and m):
        raise ArgumentError(
            f"{where}: {second} and {first} would be ({m}, {m}) and ({n}, {n}); expected a plant with states and at "
            f"least one signal that {second} weights"
        )
    Q = real_array(f"{where}: {first}", given[0], (n, n))
    R = real_array(f"{where}: {second}", given[1], (m, m))
    N = real_array(f"{where}: {between}", given[2], (n, m), 0.0)
    for name, matrix in ((first, Q), (second, R)):
        if not np.allclose(matrix, matrix.T, rtol=1e-8, atol=1e-12 * float(np.abs(matrix).max(initial=0.0))):
            raise ArgumentError(f"{where}: {name} is not symmetric; expected a symmetric matrix")
    Q, R = 0.5 * (Q + Q.T), 0.5 * (R + R.T)
    # In units of their own: a weight of 1e-12 beside one of 1 is small, not zero.
    if not np.all(np.diag(R) > 0.0):
        k = int(np.argmin(np.diag(R)))
        raise IllPosedError(
            f"{where}: {second} is {R[k, k]:.4g} for {labels[k]}; expected a positive definite {second}: every one "
            'counts; give a small positive number, or design.h2 with method="lmi"',
            system,
        )
    unit = np.sqrt(np.diag(R))
    values, vectors = np.linalg.eigh(R / unit / unit[:, None])
    if values[0] <= SEMIDEFINITE * values[-1]:
        k = int(np.argmax(np.abs(vectors[:, 0])))
        raise IllPosedError(
            f"{where}: {second} is not positive definite, for {labels[k]} among others; expected a positive definite "
            f"{second}; give larger numbers on its diagonal",
            system,
        )
    rest = Q - N @ np.linalg.solve(R, N.T)
    size = np.sqrt(np.maximum(np.diag(Q), 0.0))
    size[size == 0.0] = 1.0
    if n and np.linalg.eigvalsh(rest / size / size[:, None])[0] < -SEMIDEFINITE * n:
        raise IllPosedError(
            f"{where}: [{first}, {between}; {between}', {second}] is not positive semidefinite; expected one: the cost "
            "has no least value otherwise",
            system,
        )
    return Weights(Q, R, N)


def solved(
    A: FloatArray, B: FloatArray, weights: Weights, dt: float, where: str, system: StateSpace
) -> tuple[FloatArray, FloatArray, ComplexArray, float]:
    """X, the gain F of u = F x, the poles of A + B F and the relative residual of the equation, solved in scaled units.

    Raises
    ------
    IllPosedError
        The weights do not see a mode on the stability boundary; the message names it.
    UnscalableError
        There is no stabilising solution in floating point.
    NotCertifiedError
        The loop is not stable, or the equation is not solved.
    """
    Q, R, N = weights
    unit = 1.0 / np.sqrt(np.diag(R))
    root_of_Q = square_root(Q).T
    found = None
    # What balances A alone comes second: it suits a loop that is hardly faster than the plant.
    for s, cost in (_units(A, B * unit, root_of_Q), _units_of_plant(A, B * unit, root_of_Q)):
        As, Bs = A * s / s[:, None], B * unit / s[:, None]
        Qs, Rs, Ns = Q * s * s[:, None], R * unit * unit[:, None], N * unit * s[:, None]
        root = np.sqrt(cost)
        # The unit of time in which A is near one.
        rate = 1.0 if dt else max(float(np.linalg.norm(As, 2)), np.finfo(float).tiny)
        equation = (As / rate, Bs * root / rate, Qs / cost, Rs, Ns / root)
        try:
            found = discrete_solution(*equation) if dt else continuous_solution(*equation)
        except np.linalg.LinAlgError:
            found = None
        if found is not None and relative_residual(*equation, found[0], discrete=dt > 0) <= RESIDUAL:
            break
    if found is None:
        _name_blind_mode(equation, rate, dt, where, system)
        raise UnscalableError(
            f"{where}: the Riccati equation has no stabilising solution in scaled units; expected weights and modes "
            "with less spread; try larger weights on the slow states",
            system,
        )
    X, F = found[0], found[1]
    residual = relative_residual(*equation, X, discrete=dt > 0)
    F = F * (unit[:, None] * root) / s
    poles = np.asarray(np.linalg.eigvals(A + B @ F), dtype=np.complex128)
    if not spectral_abscissa(continuous_poles(poles, dt)) < 0.0 or not residual <= RESIDUAL:
        raise NotCertifiedError(
            f"{where}: the loop is not stable, or its Riccati equation holds to {residual:.2g} alone; expected a "
            f"stable loop and {RESIDUAL:g}; try weights with less spread",
            system,
        )
    return X * (cost / rate) / s / s[:, None], F, poles, residual


def _units(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, float]:
    """Units s of the states, and of the cost in which B and the root C of their weights are equally large."""
    s, cost = np.ones(len(A)), 1.0
    for _ in range(3):
        s = s * state_scaling(A * s / s[:, None], B * np.sqrt(cost) / s[:, None], C * s / np.sqrt(cost))
        into, seen = float(np.linalg.norm(B / s[:, None])), float(np.linalg.norm(C * s))
        if not (into and seen):
            break
        cost = float(2.0 ** np.round(np.log2(seen / into)))
    return s, cost


def _units_of_plant(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, float]:
    """Units of the states that balance [A B; C 0], and of the cost in which the weight of the states is near one."""
    s = state_scaling(A, B, C if len(C) else np.zeros((1, len(A))))
    return s, max(float(np.linalg.norm(C * s, 2)) ** 2, np.finfo(float).tiny) if len(C) else 1.0


def _name_blind_mode(equation: tuple[FloatArray, ...], rate: float, dt: float, where: str, system: StateSpace) -> None:
    """Raise an IllPosedError where the weights do not see a mode on the stability boundary."""
    A, B, Q, R, N = equation
    closed = A - B @ np.linalg.solve(R, N.T)
    seen = Q - N @ np.linalg.solve(R, N.T)
    for pole in np.linalg.eigvals(closed):
        distance = abs(abs(pole) - 1.0) if dt else abs(pole.real)
        shifted = np.vstack([closed - pole * np.eye(len(A)), seen])
        if distance < 1e-9 and np.linalg.svd(shifted, compute_uv=False)[-1] < 1e-9:
            at = f"z = {pole:.6g}" if dt else f"{pole * rate:.4g} rad/s"
            raise IllPosedError(
                f"{where}: the weights (or noise intensities) do not reach the mode at {at} on the stability boundary; "
                "expected one on every such mode; add a small weight (or noise) on its states",
                system,
            )


def square_root(Q: FloatArray) -> FloatArray:
    """Return a square root G, Q = G G', of a positive semidefinite matrix; zero columns left out."""
    size = np.sqrt(np.maximum(np.diag(Q), 0.0))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(Q / size / size[:, None])
    keep = values > 1e-14 * max(float(values[-1]), 0.0)
    return np.asarray(size[:, None] * vectors[:, keep] * np.sqrt(values[keep]))
