"""How the matrix of a certificate is found: in floating point, without an LMI solver; the proof is made afterwards.

Every matrix is looked for in doubles, in balanced states (powers of two, exact). Where that does not prove the claim,
it is looked for with hundreds of bits and rounded in the coordinates of the modes (`precise`).
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import ParamSpec

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays, state_scaling
from platform_ctrl.analysis.certificates.certificate import Certificate, Claim
from platform_ctrl.analysis.certificates.closed_loop import ClosedLoop, closed, matrices_of, modes, stabilising
from platform_ctrl.analysis.norms import gains, hinf_norm, resonances, stationary_covariance
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError, NotCertifiedError, PlatformCtrlError

# Shares of the true decay rate that are claimed, and how far above the true norm: the first that can be proved.
_SHARES = (0.99, 0.9, 0.5, 0.1)
_ABOVE = (9e-7, 1e-5, 1e-4, 1e-3, 1e-2)

# Below this a norm cannot be distinguished from zero.
_NOTHING = 1e-100

# From a balanced system, in doubles; and from the closed loop, its rounded form and coordinates, with many bits.
Finder = Callable[[StateArrays], FloatArray]
PreciseFinder = Callable[[ClosedLoop, StateArrays, FloatArray], FloatArray | None]


Given = ParamSpec("Given")


def found_in_doubles(make: Callable[Given, Certificate]) -> Callable[Given, Certificate]:
    """Suppress floating-point warnings: what is found is proved or refused afterwards."""

    @functools.wraps(make)
    def made(*args: Given.args, **options: Given.kwargs) -> Certificate:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                return make(*args, **options)
            except PlatformCtrlError:
                raise
            except (ValueError, ArithmeticError, np.linalg.LinAlgError):
                raise NotCertifiedError(
                    f"{make.__name__}: the matrices hold numbers too large, or too far apart, for floating point; "
                    "no proof was found; try other units",
                    args,
                ) from None

    return made


@check_arguments
@found_in_doubles
def stability_certificate(
    A: ArrayLike,
    dt: float = 0.0,
    *,
    B: ArrayLike | None = None,
    C: ArrayLike | None = None,
    D: ArrayLike | None = None,
    controller: StateArrays | None = None,
    label: str = "",
) -> Certificate:
    """Return a proved certificate that a system, or a plant closed by a controller, is stable.

    x' = A x, or x(k+1) = A x(k) with a sample period dt > 0, s. With a controller u = K y the matrices are those of the
    plant from u to y. The decay that is claimed is 99 % of that of the slowest pole, or less where that cannot be
    proved. Raises `ArgumentError` where matrices do not fit together, `NotCertifiedError` where no proof was found. See
    docs/certificates.md; Boyd, El Ghaoui, Feron, Balakrishnan, Linear Matrix Inequalities in System and Control Theory,
    1994.
    """
    where = "stability_certificate"
    loop, system, decay = _stable_loop(matrices_of(A, B, C, D, dt, where), controller, label, where)
    claimed = [share * decay for share in _SHARES] + [0.0] if np.isfinite(decay) else [0.0]
    made = _first_proved("stability", claimed, loop, system, _lyapunov)
    if made is not None:
        return made
    raise NotCertifiedError(
        f"{where}: no proof that the closed loop{_of(label)} is stable (its slowest pole decays at {decay:.6g} 1/s); "
        "try other units of the states",
        loop,
    )


@check_arguments
@found_in_doubles
def norm_certificate(  # noqa: PLR0913 - the matrices of a loop and the claim
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    dt: float = 0.0,
    gamma: float | None = None,
    *,
    controller: StateArrays | None = None,
    norm: float | None = None,
    label: str = "",
) -> Certificate:
    """Return a proved certificate that a system is stable and its H-infinity norm below `gamma`.

    With a controller the matrices are those of the plant from [w, u] to [z, y]. `gamma`, in units of z per w, is by
    default the `norm` (where it is known already it is not computed again) and as little above it as can be proved.
    Otherwise as `stability_certificate`.
    """
    where = "norm_certificate"
    loop, system, _ = _stable_loop(matrices_of(A, B, C, D, dt, where), controller, label, where)
    norm = _hinf(*system) if norm is None else float(norm)
    return _norm_proved("norm", norm, gamma, loop, system, _bounded_real)


@check_arguments
@found_in_doubles
def h2_certificate(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike | None = None,
    dt: float = 0.0,
    *,
    controller: StateArrays | None = None,
    label: str = "",
) -> Certificate:
    """Return a proved certificate that a system is stable, with a bound as little above its H2 norm as can be proved.

    D is zero if the system is continuous; the unit is then that of z per w times s^-1/2. Otherwise as
    `norm_certificate`.
    """
    where = "h2_certificate"
    loop, system, _ = _stable_loop(matrices_of(A, B, C, D, dt, where), controller, label, where)
    if dt == 0 and np.any(system.D):
        raise NotCertifiedError(
            f"{where}: the H2 norm of a continuous system with D ≠ 0 is infinite; remove the direct term", loop
        )
    s = state_scaling(*system[:3])
    balanced = _in_coordinates(system, np.diag(1.0 / s), np.diag(s))
    X = _gramian(balanced.A, balanced.C.T @ balanced.C, dt)
    norm = float(np.sqrt(max(np.trace(balanced.B.T @ X @ balanced.B) + np.sum(system.D**2), 0.0)))
    return _norm_proved("h2", norm, None, loop, system, _observability)


def _hinf(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> float:
    # The norm of what transfers nothing is looked for among numbers so small that their inverses overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        return hinf_norm(StateArrays(A, B, C, D, dt), allow_unstable=True)[0]


def _just_above(norm: float) -> list[float]:
    """Return the bounds to try where none is required."""
    return [norm * (1.0 + above) for above in _ABOVE] if norm > _NOTHING else [2.0 * _NOTHING]


def _of(label: str) -> str:
    return f" ({label})" if label else ""


def _rounded(loop: ClosedLoop, where: str) -> StateArrays:
    if not loop.finite:
        raise ArgumentError(f"{where}: the matrices must be finite and dt at least zero")
    try:
        return loop.rounded()
    except ArgumentError:
        raise NotCertifiedError(
            f"{where}: the loop is not well posed because I − D_K D22 is singular; try another controller", loop
        ) from None


def _stable_loop(
    plant: StateArrays, controller: StateArrays | None, label: str, where: str
) -> tuple[ClosedLoop, StateArrays, float]:
    """Return the closed loop, its matrices rounded, and the decay rate of its slowest pole, 1/s."""
    loop = closed(plant, controller, label, where)
    system = _rounded(loop, where)
    growth = float(spectral_abscissa(continuous_poles(poles(system.A), system.dt))) if len(system.A) else -np.inf
    if not growth < 0.0:
        raise NotCertifiedError(
            f"{where}: the slowest pole{_of(label)} grows at {growth:.3g} 1/s, so the closed loop is not stable; "
            "try another controller",
            loop,
        )
    return loop, system, -growth


def _norm_proved(
    claim: Claim,
    norm: float,
    required: float | None,
    loop: ClosedLoop,
    system: StateArrays,
    finders: Callable[[float, float], tuple[Finder, PreciseFinder]],
) -> Certificate:
    """Return the certificate that a norm lies below the required bound, or as little above `norm` as can be proved."""
    bounds = [float(required)] if required is not None else _just_above(norm)
    above = [one for one in bounds if one > norm]
    made = _first_proved(claim, above, loop, system, lambda one: finders(one, norm))
    if made is not None:
        return made
    raise NotCertifiedError(
        f"{claim}_certificate: no proof that the norm{_of(loop.label)} is below {bounds[0]:.9g} "
        f"(it is about {norm:.9g}); try a larger {'gamma' if claim == 'norm' else 'bound'}",
        loop,
    )


def _first_proved(
    claim: Claim,
    bounds: Sequence[float],
    loop: ClosedLoop,
    system: StateArrays,
    finders: Callable[[float], tuple[Finder, PreciseFinder]],
) -> Certificate | None:
    """Return the certificate of the first bound that is proved, None if none is."""
    for bound in bounds:
        for certificate in _attempts(claim, bound, loop, system, *finders(bound)):
            if certificate.verify().proved:
                return certificate
    return None


def _attempts(
    claim: Claim, bound: float, loop: ClosedLoop, system: StateArrays, finder: Finder, precise: PreciseFinder
) -> Iterator[Certificate]:
    """Yield candidates: in balanced states by floating point, then in the coordinates of the modes by many bits."""
    s = state_scaling(*system[:3])
    first = _tried(finder, _in_coordinates(system, np.diag(1.0 / s), np.diag(s)))
    if first is not None:
        X = first / s / s[:, None]
        if np.all(np.isfinite(X)):
            yield Certificate(claim=claim, bound=bound, loops=(loop,), X=X)
    if len(s) == 0:
        return
    try:
        T = modes(system)
        moved = _in_coordinates(system, T, np.asarray(np.linalg.inv(T), dtype=np.float64))
    except np.linalg.LinAlgError:
        return
    found = precise(loop, moved, T) if np.all(np.isfinite(T)) else None
    if found is not None:
        yield Certificate(claim=claim, bound=bound, loops=(loop,), X=found, coordinates=T)


def _in_coordinates(system: StateArrays, T: FloatArray, inverse: FloatArray) -> StateArrays:
    return StateArrays(T @ system.A @ inverse, T @ system.B, system.C @ inverse, system.D, system.dt)


def _tried(finder: Finder, system: StateArrays) -> FloatArray | None:
    with np.errstate(all="ignore"):
        try:
            X = finder(system)
        except (np.linalg.LinAlgError, ValueError):
            return None
        X = 0.5 * (X + X.T)
    return X if np.all(np.isfinite(X)) else None


def _gramian(A: FloatArray, Q: FloatArray, dt: float) -> FloatArray:
    """X = A'XA + Q, or A'X + XA + Q = 0."""
    if len(A) == 0:
        return np.zeros((0, 0))
    if dt > 0:
        values, vectors = np.linalg.eigh(Q)
        return stationary_covariance(A.T, vectors * np.sqrt(np.maximum(values, 0.0)))
    from scipy.linalg import solve_continuous_lyapunov

    return np.asarray(solve_continuous_lyapunov(A.T, -Q), dtype=np.float64)


def _lyapunov(decay: float) -> tuple[Finder, PreciseFinder]:
    def find(system: StateArrays) -> FloatArray:
        A, eye = system.A, np.eye(len(system.A))
        moved = A * np.exp(decay * system.dt) if system.dt > 0 else A + decay * eye
        return _gramian(moved, eye, system.dt)

    return find, lambda loop, moved, T: stabilising(loop, T, None, decay=decay)


def _slack(system: StateArrays, size: float) -> float:
    """Return e such that e times the norm from w to the states, added to z, changes the norm by about `size`."""
    n = len(system.A)
    states = StateArrays(system.A, system.B, np.eye(n), np.zeros((n, system.B.shape[1])), system.dt)
    s = continuous_poles(poles(system.A), system.dt)
    w = np.append(resonances(s), 0.0)
    # Near the resonances is near enough: the peak between them is not much higher.
    found = gains(states, w[w <= np.pi / system.dt] if system.dt > 0 else w)
    reach = float(found[np.isfinite(found)].max(initial=0.0))
    return size / reach if reach > _NOTHING else 1.0


def _bounded_real(bound: float, norm: float) -> tuple[Finder, PreciseFinder]:
    """X of the stabilising solution for [z, e x], e so small that the norm stays below the bound.

    Then the inequality for z alone holds with e²I to spare.
    """
    # ‖[z, ex]‖² <= norm² + e² reach²: a third of what is between norm² and bound².
    between = max(bound**2 - norm**2, 0.0)
    spare, level = np.sqrt(between / 3.0), np.sqrt(norm**2 + 2.0 / 3.0 * between)

    def find(system: StateArrays) -> FloatArray:
        from scipy.linalg import solve_continuous_are, solve_discrete_are

        A, B, C, D, dt = system
        n, m = len(A), B.shape[1]
        if n == 0:
            return np.zeros((0, 0))
        e = _slack(system, spare)
        if not np.any(B):
            return _gramian(A, np.asarray(C.T @ C + e * e * np.eye(n), dtype=np.float64), dt)
        # In units of the level: Q, R, S of order one.
        Q = (C.T @ C + e * e * np.eye(n)) / level**2
        R = D.T @ D / level**2 - np.eye(m)
        S = C.T @ D / level**2
        solve = solve_discrete_are if dt > 0 else solve_continuous_are
        return np.asarray(solve(A, B, Q, R, s=S) * level**2, dtype=np.float64)

    return find, lambda loop, moved, T: stabilising(loop, T, _slack(moved, spare) ** 2, gamma=level)


def _observability(bound: float, norm: float) -> tuple[Finder, PreciseFinder]:
    def weight(system: StateArrays, spare: FloatArray) -> float:
        size = float(np.trace(system.B.T @ spare @ system.B))
        return 0.5 * (bound**2 - norm**2) / size if size > 0 else 1.0

    def find(system: StateArrays) -> FloatArray:
        spare = _gramian(system.A, np.eye(len(system.A)), system.dt)
        X = _gramian(system.A, system.C.T @ system.C, system.dt) + weight(system, spare) * spare
        return np.asarray(X, dtype=np.float64)

    def precise(loop: ClosedLoop, moved: StateArrays, T: FloatArray) -> FloatArray | None:
        spare = _tried(lambda system: _gramian(system.A, np.eye(len(system.A)), system.dt), moved)
        return None if spare is None else stabilising(loop, T, weight(moved, spare))

    return find, precise
