"""Responses over frequency and time beside python-control, which uses slycot for the former where it is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from side_by_side import Comparison, DisagreementError, Section, close

from platform_ctrl import analysis
from platform_ctrl.common.values import FloatArray


class WithoutSlycot(control.StateSpace):  # type: ignore[misc]
    """A system that answers as where slycot is not installed."""

    def slycot_laub(self, x: Any) -> Any:
        """Fail as the import would."""
        raise ImportError("slycot")


def system(states: int, inputs: int, outputs: int, seed: int = 0, dt: float = 0.0) -> control.StateSpace:
    """Return a stable system with random modes, some of them lightly damped."""
    rng = np.random.default_rng(seed)
    A = np.zeros((states, states))
    for k in range(0, states - 1, 2):
        frequency, damping = 10.0 ** rng.uniform(-1.0, 3.0), 10.0 ** rng.uniform(-3.0, 0.0)
        A[k : k + 2, k : k + 2] = frequency * np.array([[0.0, 1.0], [-1.0, -2.0 * damping]])
    if states % 2:
        A[-1, -1] = -1.0
    T = np.linalg.qr(rng.normal(size=(states, states)))[0] @ np.diag(rng.uniform(0.5, 2.0, states))
    B, C = rng.normal(size=(states, inputs)), rng.normal(size=(outputs, states))
    out = control.ss(T @ A @ np.linalg.inv(T), B, C, np.zeros((outputs, inputs)))
    return analysis.sampled(out, dt) if dt else out


def _beside_control(one: control.StateSpace, z: NDArray[Any], w: FloatArray) -> dict[str, Callable[[], Any]]:
    plain: Any = WithoutSlycot(one.A, one.B, one.C, one.D, one.dt)
    with_slycot = importlib.util.find_spec("slycot") is not None
    theirs: dict[str, Callable[[], Any]] = {}
    if with_slycot:
        theirs["control, slycot"] = partial(one, z)
        theirs["frequency_response, slycot"] = lambda: control.frequency_response(one, w).complex
    theirs["control alone"] = partial(plain, z)
    return theirs


def frequency_response() -> Iterator[Comparison]:
    """Compare responses of one system on the imaginary axis and on the unit circle."""
    w = np.geomspace(1e-2, 1e4, 1000)
    for inputs, outputs in ((1, 1), (2, 2), (3, 3)):
        one = system(16, inputs, outputs)
        yield Comparison(
            name=f"16 states, {outputs} x {inputs}, 1,000 frequencies",
            ours=partial(analysis.frequency_response, one, w),
            theirs=_beside_control(one, 1j * w, w),
            target=40.0,
            clock="cpu",
            check=close(1e-9),
        )
    period = 1e-3
    one = system(16, 2, 2, dt=period)
    w = np.geomspace(1e-2, np.pi / period, 1000)
    yield Comparison(
        name="16 states, 2 x 2, sampled, 1,000 frequencies",
        ours=partial(analysis.frequency_response, one, w),
        theirs=_beside_control(one, np.exp(1j * w * period), w),
        target=40.0,
        clock="cpu",
        check=close(1e-9),
    )


def modal(
    states: int, inputs: int, outputs: int, rates: tuple[float, float], damping: float, residues: float = 0.0
) -> control.StateSpace:
    """Return lightly damped modes, two states each; rates in powers of ten, contributions by that power of the rate."""
    rng = np.random.default_rng(states)
    w = np.sort(10.0 ** rng.uniform(*rates, states // 2))
    A, B, C = np.zeros((states, states)), np.zeros((states, inputs)), np.zeros((outputs, states))
    k = np.arange(0, states, 2)
    A[k, k + 1], A[k + 1, k], A[k + 1, k + 1] = w, -w, -2.0 * damping * w
    B[1::2] = rng.normal(size=(states // 2, inputs)) * w[:, None] ** residues
    C[:, 1::2] = rng.normal(size=(outputs, states // 2)) * w**residues
    return control.ss(A, B, C, 0, remove_useless_states=False)


def lags_and_modes() -> control.StateSpace:
    """Return 1,000 lags and three modes (Penzl; Chahlaoui and Van Dooren, SLICOT working note 2002-2)."""
    A = np.diag(-np.concatenate([np.ones(6), np.arange(1.0, 1001.0)]))
    for k, w in enumerate((100.0, 200.0, 400.0)):
        A[2 * k, 2 * k + 1], A[2 * k + 1, 2 * k] = w, -w
    b = np.concatenate([np.full(6, 10.0), np.ones(1000)])[:, None]
    return control.ss(A, b, b.T, 0)


def masses(states: int) -> control.StateSpace:
    """Return a chain of masses between walls with proportional damping, from a force to a place."""
    k = states // 2
    K = k**2 * (2.0 * np.eye(k) - np.eye(k, k=1) - np.eye(k, k=-1))
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-K, -2e-5 * K - 1e-2 * np.eye(k)]])
    B, C = np.zeros((states, 1)), np.zeros((1, states))
    B[k + k // 3], C[0, k // 2] = k, 1.0
    return control.ss(A, B, C, 0, remove_useless_states=False)


def beam(states: int) -> control.StateSpace:
    """Return a cantilever of Euler-Bernoulli elements with consistent masses, from a force to the place of its end."""
    count, length = states // 4, 4.0 / states
    side = np.array([1.0, length, 1.0, length])
    k = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / length**3
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) * length / 420.0
    K, M = np.zeros((2 * count + 2, 2 * count + 2)), np.zeros((2 * count + 2, 2 * count + 2))
    for first in range(0, 2 * count, 2):
        part = slice(first, first + 4)
        K[part, part] += k * np.outer(side, side)
        M[part, part] += m * np.outer(side, side)
    K, M = K[2:, 2:], M[2:, 2:]
    n = len(K)
    tip = np.eye(n)[:, [-2]]
    A = np.vstack([np.eye(n, 2 * n, n), -np.linalg.solve(M, np.hstack([K, 1e-6 * K + 1e-2 * M]))])
    B, C = np.vstack([np.zeros((n, 1)), np.linalg.solve(M, tip)]), np.hstack([tip.T, np.zeros((1, n))])
    return control.ss(A, B, C, 0, remove_useless_states=False)


def turned(one: control.StateSpace) -> control.StateSpace:
    """Return a system in orthogonally changed states: no entry of A is zero."""
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=one.A.shape))[0]
    return control.ss(Q @ one.A @ Q.T, Q @ one.B, one.C @ Q.T, one.D)


def without_structure(states: int, inputs: int, outputs: int) -> control.StateSpace:
    """Return a stable random system."""
    rng = np.random.default_rng(states)
    A = rng.normal(size=(states, states)) / np.sqrt(states) - 1.05 * np.eye(states)
    return control.ss(A, rng.normal(size=(states, inputs)), rng.normal(size=(outputs, states)), 0)


# What structures are described by, and by reduced models of them. Sizes are those of SLICOT's collection of models.
LARGE: dict[str, Callable[[], control.StateSpace]] = {
    "48 states, modes, every state mixed": lambda: turned(modal(48, 1, 1, (0.7, 2.0), 2e-2)),
    "120 states, 2 x 2, modes": lambda: modal(120, 2, 2, (0.0, 4.0), 1e-3),
    "120 states, 2 x 2, modes, mixed": lambda: turned(modal(120, 2, 2, (0.0, 4.0), 1e-3)),
    "270 states, 3 x 3, modes": lambda: modal(270, 3, 3, (-0.1, 1.8), 5e-3),
    "270 states, 3 x 3, modes, mixed": lambda: turned(modal(270, 3, 3, (-0.1, 1.8), 5e-3)),
    "270 states, 2 x 2, random": lambda: without_structure(270, 2, 2),
    "348 states, beam of finite elements": lambda: beam(348),
    "348 states, modes, steep, mixed": lambda: turned(modal(348, 1, 1, (-1.0, 2.0), 5e-3, -1.0)),
    "400 states, chain of masses": lambda: masses(400),
    "600 states, 2 x 2, modes, mixed": lambda: turned(modal(600, 2, 2, (-0.3, 2.0), 5e-3)),
    "1000 states, chain of masses": lambda: masses(1000),
    "1006 states, lags and modes": lags_and_modes,
    "1006 states, lags and modes, mixed": lambda: turned(lags_and_modes()),
}


def exact(one: control.StateSpace, w: FloatArray) -> NDArray[Any]:
    """Return responses refined with residuals in long doubles, (p, m, N)."""
    from scipy.linalg import lu_factor, lu_solve
    from scipy.linalg.lapack import dgebal

    # Balanced, which changes no digit.
    A, _, _, scale, _ = dgebal(one.A, scale=1, permute=0)
    A, B, C = (np.asarray(item, dtype=np.longdouble) for item in (A, one.B / scale[:, None], one.C * scale))
    out = np.empty((one.noutputs, one.ninputs, len(w)), dtype=np.complex128)
    for k, frequency in enumerate(w):
        factors = lu_factor(1j * frequency * np.eye(one.nstates) - A.astype(float))
        x = np.zeros(B.shape, dtype=np.clongdouble)
        for _ in range(6):
            residual = (B - 1j * np.longdouble(frequency) * x) + (A @ x.real + 1j * (A @ x.imag))
            x += lu_solve(factors, residual.astype(complex))
        out[:, :, k] = C @ x.real + 1j * (C @ x.imag) + one.D
    return out


def _right(one: control.StateSpace, w: FloatArray) -> Callable[[Any, Any], str]:
    """Return a check against `exact`: the largest errors of ours and theirs, relative as ours are promised to be."""

    def check(ours: Any, theirs: Any) -> str:
        few = np.arange(7, len(w), len(w) // 12)
        truth = exact(one, w[few])
        size = np.maximum(np.abs(truth), 1e-3 * np.abs(truth).max(axis=(0, 1)))
        errors = [
            float((np.abs(np.reshape(answer, ours.shape)[..., few] - truth) / size).max())
            for answer in (ours, *theirs.values())
        ]
        if not errors[0] <= max(1e-9, 2.0 * min(errors[1:])):
            raise DisagreementError(f"ours is wrong by {errors[0]:.1e}, theirs by {min(errors[1:]):.1e}")
        return "wrong by " + ", theirs ".join(f"{error:.0e}" for error in errors)

    return check


def large_responses() -> Iterator[Comparison]:
    """Compare responses of structures at 1,000 frequencies around their modes, and their errors."""
    for name, made in LARGE.items():
        one = made()
        poles = np.abs(np.linalg.eigvals(one.A))
        w = np.geomspace(max(poles.min(), 1e-3 * poles.max()) / 3.0, 3.0 * poles.max(), 1000)
        yield Comparison(
            name=name,
            ours=partial(analysis.frequency_response, one, w),
            theirs={"control": partial(one, 1j * w)},
            target=3.0,
            clock="cpu",
            check=_right(one, w),
            rounds=3,
        )


def time_response() -> Iterator[Comparison]:
    """Compare responses to inputs that are linear between the samples, and of a sampled system."""
    for points in (1000, 10000):
        one = system(16, 3, 3)
        t = np.linspace(0.0, 5.0, points)
        u = np.random.default_rng(1).normal(size=(3, points))
        yield Comparison(
            name=f"16 states, 3 inputs, {points:,} points",
            ours=partial(analysis.time_response, one, t, u),
            theirs={"forced_response": partial(control.forced_response, one, t, u)},
            target=25.0,
            clock="cpu",
            check=lambda ours, theirs: close(1e-9)(ours, {name: y.outputs for name, y in theirs.items()}),
        )


SECTIONS: dict[str, Section] = {
    "frequency-response": frequency_response,
    "large-responses": large_responses,
    "time-response": time_response,
}
