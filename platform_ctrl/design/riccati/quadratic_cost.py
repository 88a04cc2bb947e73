"""Quadratic costs and noise intensities: checks, and their Riccati equation solved in scaled units.

State feedback and Kalman filter are one problem and its dual: weights and inputs below are also intensities and
measurements.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, state_scaling
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.riccati.equations import Equation, relative_error, relative_residual, riccati_solution
from platform_ctrl.errors import ArgumentError, IllPosedError, NotCertifiedError, UnscalableError

if TYPE_CHECKING:
    from control import StateSpace

# Largest relative residual of a Riccati equation (scaled).
RESIDUAL = 1e-6
# Or largest relative error of its solution, where control is so cheap that poles are more than ten decades apart and no
# solution in doubles has such a residual.
ERROR = 1e-5
# A noise intensity may be negative by this share of its largest eigenvalue: rounding.
SEMIDEFINITE = 1e-10
# A weight of the inputs whose least eigenvalue, of a unit diagonal, is below this is singular: rounding.
SINGULAR = 1e-15
# Largest weight: the product of two must not overflow.
_LARGEST = 1e150


class Weights(NamedTuple):
    """[first, cross; cross', second]."""

    first: FloatArray
    second: FloatArray
    cross: FloatArray


def checked_weights(
    where: str,
    names: str,
    given: tuple[ArrayLike | None, ...],
    labels: list[str],
    system: StateSpace,
    *,
    semidefinite: bool = True,
) -> Weights:
    """Return weights (n, n) of the states, (m, m) of the inputs `labels` and (n, m) between them, None for 0.

    With `semidefinite` they have to be positive semidefinite together, and the second positive definite, as intensities
    and norms squared are. Otherwise the second has to be so for continuous systems only, and the equation decides.
    """
    first, second, between = names.split(", ")
    n, m = system.nstates, len(labels)
    if not (n and m):
        raise ArgumentError(
            f"{where}: the plant must have states and at least one signal for {second}, got {n} states and {m} signals"
        )
    Q = real_array(f"{where}: {first}", given[0], (n, n))
    R = real_array(f"{where}: {second}", given[1], (m, m))
    N = real_array(f"{where}: {between}", given[2], (n, m), 0.0)
    for name, matrix in ((first, Q), (second, R), (between, N)):
        if np.any(np.abs(matrix) > _LARGEST):
            raise ArgumentError(f"{where}: {name} must not exceed {_LARGEST:g}; choose other units")
    for name, matrix in ((first, Q), (second, R)):
        if not np.allclose(matrix, matrix.T, rtol=1e-8, atol=1e-12 * float(np.abs(matrix).max(initial=0.0))):
            raise ArgumentError(f"{where}: {name} must be symmetric")
    Q, R = 0.5 * (Q + Q.T), 0.5 * (R + R.T)
    if semidefinite or not system.dt:
        _require_definite(f"{where}: {second}", R, labels, bool(system.dt), system)
    if semidefinite:
        whole = np.block([[Q, N], [N.T, R]])
        size = np.sqrt(np.maximum(np.diag(whole), 0.0))
        size[size == 0.0] = 1.0
        if np.linalg.eigvalsh(whole / size / size[:, None])[0] < -SEMIDEFINITE * (n + m):
            raise IllPosedError(
                f"{where}: [{first}, {between}; {between}', {second}] must be positive semidefinite: "
                + ("intensities of noise are never negative" if first == "R1" else "the cost of LQG is a norm squared"),
                system,
            )
    return Weights(Q, R, N)


def _require_definite(name: str, R: FloatArray, labels: list[str], sampled: bool, system: StateSpace) -> None:
    """Raise an IllPosedError that names an input without a weight."""
    # With a unit diagonal: a weight of 1e-12 beside one of 1 is small, not zero.
    reason = "" if sampled else ", otherwise the best input has impulses"
    if not np.all(np.diag(R) > 0.0):
        k = int(np.argmin(np.diag(R)))
        raise IllPosedError(
            f"{name} must be positive definite{reason}, but is {R[k, k]:.4g} for {labels[k]}; give a small "
            'positive number, or use design.h2 with method="lmi"',
            system,
        )
    unit = np.sqrt(np.diag(R))
    values, vectors = np.linalg.eigh(R / unit / unit[:, None])
    if values[0] <= SINGULAR * len(R) * values[-1]:
        k = int(np.argmax(np.abs(vectors[:, 0])))
        raise IllPosedError(
            f"{name} must be positive definite{reason}, but is singular for {labels[k]} among others; "
            "give larger numbers on its diagonal",
            system,
        )


def solved(
    A: FloatArray, B: FloatArray, weights: Weights, dt: float, where: str, system: StateSpace
) -> tuple[FloatArray, FloatArray, ComplexArray, float]:
    """Solve in scaled units: X, the gain K of u = −K x, the poles of A − B K and the equation's relative residual."""
    tried = list(_solutions(A, B, weights, dt))
    found = next((one for one in tried if one.X is not None and one.accurate), None)
    if found is None:
        _refuse(tried, dt, where, system)
    assert found is not None
    assert found.X is not None
    poles = np.asarray(np.linalg.eigvals(A + B @ found.F), dtype=np.complex128)
    if not spectral_abscissa(continuous_poles(poles, dt)) < 0.0:
        raise NotCertifiedError(
            f"{where}: the loop is not stable in floating point; try weights with less spread",
            system,
        )
    size = np.sqrt(np.abs(np.diag(found.W)))
    size[size == 0.0] = 1.0
    if dt and np.linalg.eigvalsh(found.W / size / size[:, None])[0] <= -SEMIDEFINITE:
        raise IllPosedError(
            f"{where}: the cost has no least value, since R + B'XB is not positive definite; give the inputs larger "
            "weights",
            system,
        )
    return found.X, -found.F, poles, found.residual


class _Solution(NamedTuple):
    """The result with one choice of units: X is None where there is no solution, or none was found."""

    equation: Equation
    rate: float
    exists: bool
    X: FloatArray | None = None
    F: FloatArray = np.zeros((0, 0))
    W: FloatArray = np.zeros((0, 0))
    residual: float = np.inf
    accurate: bool = False


def _solutions(A: FloatArray, B: FloatArray, weights: Weights, dt: float) -> Iterator[_Solution]:
    """Solve the equation in one choice of units after the other, up to the first that will do."""
    Q, R, N = weights
    # Powers of two are exact to undo: what is solved is the equation as given.
    unit = _power_of_two(1.0 / np.sqrt(np.where(np.diag(R) > 0.0, np.diag(R), 1.0)))
    for s, root in _all_units(A, B * unit, square_root(Q).T):
        As, Bs = A * s / s[:, None], B * unit / s[:, None]
        Qs, Rs, Ns = Q * s * s[:, None], R * unit * unit[:, None], N * unit * s[:, None]
        # The unit of time in which A and B are at most near one; without any the equation is not finite either.
        finite = bool(np.all(np.isfinite(As)))
        size = float(np.linalg.norm(As, 2) + np.linalg.norm(Bs) * root) if finite else 1.0
        rate = 1.0 if dt or not size else float(_power_of_two(size))
        equation = Equation(As / rate, Bs * (root / rate), Qs / root**2, Rs, Ns / root, discrete=dt > 0)
        if not _is_finite(equation):
            yield _Solution(equation, rate, exists=True)
            continue
        try:
            found = riccati_solution(equation)
        except np.linalg.LinAlgError:
            yield _Solution(equation, rate, exists=True)
            continue
        if found is None:
            yield _Solution(equation, rate, exists=False)
            continue
        X, F, W = found
        residual = relative_residual(equation, X)
        accurate = residual <= RESIDUAL or relative_error(equation, X) <= ERROR
        X, F = X * (root**2 / rate) / s / s[:, None], F * (unit[:, None] * root) / s
        yield _Solution(equation, rate, True, X, F, W, residual, accurate)
        if accurate:
            return


def _refuse(tried: list[_Solution], dt: float, where: str, system: StateSpace) -> None:
    """Raise the error that says why there is no solution."""
    if inaccurate := [one.residual for one in tried if one.X is not None]:
        raise NotCertifiedError(
            f"{where}: the Riccati equation has a relative residual of {min(inaccurate):.2g}, more than {RESIDUAL:g}; "
            "try weights with less spread",
            system,
        )
    _name_blind_mode(tried[0].equation, tried[0].rate, dt, where, system)
    if any(one.exists for one in tried):
        raise UnscalableError(
            f"{where}: no stabilising solution of the Riccati equation was found in floating point: weights or modes "
            "have too much spread; try other units, or larger weights on the slow states",
            system,
        )
    raise IllPosedError(
        f"{where}: the Riccati equation has no stabilising solution: its {'symplectic' if dt else 'Hamiltonian'} "
        f"pencil has eigenvalues on the {'unit circle' if dt else 'imaginary axis'}, or too near to it for floating "
        "point; try weights (or intensities) that are positive definite, or less negative",
        system,
    )


def _power_of_two(number: ArrayLike) -> FloatArray:
    return np.asarray(np.exp2(np.round(np.log2(number))))


def _all_units(A: FloatArray, B: FloatArray, C: FloatArray) -> Iterator[tuple[FloatArray, float]]:
    """Yield units of the states, and of the root of the cost."""
    yield _units(A, B, C)
    s, root = _units_of_plant(A, B, C)
    yield s, root
    # In which B is as large as A: for costs of the states far below the cost of stabilising them.
    fast, into = float(np.linalg.norm(A * s / s[:, None])), float(np.linalg.norm(B / s[:, None]))
    if fast and into:
        yield s, float(_power_of_two(fast / into))


def _units(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, float]:
    """Return units s of the states, and of the root of the cost, in which B and the root C of the weights are alike."""
    s, root = np.ones(len(A)), 1.0
    for _ in range(3):
        s = s * state_scaling(A * s / s[:, None], B * root / s[:, None], C * s / root)
        into, seen = float(np.linalg.norm(B / s[:, None])), float(np.linalg.norm(C * s))
        if not (into and seen):
            break
        root = float(_power_of_two(np.sqrt(seen / into)))
    return s, root


def _units_of_plant(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, float]:
    """Return units of the states that balance [A B; C 0], and of the cost in which their weight is near one."""
    s = state_scaling(A, B, C if len(C) else np.zeros((1, len(A))))
    return s, float(_power_of_two(max(float(np.linalg.norm(C * s, 2)), np.finfo(float).tiny))) if len(C) else 1.0


def _is_finite(equation: Equation) -> bool:
    """Return whether all numbers are finite in the units of an equation: LAPACK prints lines about others."""
    return all(np.all(np.isfinite(M)) for M in (equation.A, equation.B, equation.Q, equation.R, equation.N))


def _name_blind_mode(equation: Equation, rate: float, dt: float, where: str, system: StateSpace) -> None:
    """Raise an IllPosedError where the weights do not see a mode on the stability boundary."""
    A, B, Q, R, N, _ = equation
    if not _is_finite(equation):
        return
    across = np.linalg.lstsq(R, N.T)[0]
    closed, seen = A - B @ across, Q - N @ across
    size = 1.0 if dt else float(np.linalg.norm(closed, 2)) or 1.0
    weight = seen / (float(np.linalg.norm(seen, 2)) or 1.0)
    for pole in np.linalg.eigvals(closed):
        distance = abs(abs(pole) - 1.0) if dt else abs(pole.real) / size
        shifted = np.vstack([(closed - pole * np.eye(len(A))) / size, weight])
        if distance < 1e-9 and np.linalg.svd(shifted, compute_uv=False)[-1] < 1e-9:
            at = f"z = {pole:.6g}" if dt else f"{pole * rate:.4g} rad/s"
            raise IllPosedError(
                f"{where}: the weights (or noise intensities) do not reach the mode at {at} on the stability boundary; "
                "add a small weight (or noise) on its states",
                system,
            )


def square_root(Q: FloatArray) -> FloatArray:
    """Return a root G, Q = G G', of a semidefinite matrix, without zero columns; of |Q| if it is indefinite."""
    size = np.sqrt(np.abs(np.diag(Q)))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(Q / size / size[:, None])
    values = np.abs(values)
    keep = values > 1e-14 * float(values.max(initial=0.0))
    return np.asarray(size[:, None] * vectors[:, keep] * np.sqrt(values[keep]))
