"""Responses over frequency and time beside python-control, which uses slycot for the former where it is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from side_by_side import Comparison, Section, close

from platform_ctrl import analysis
from platform_ctrl.common.values import FloatArray


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


def delayed(one: control.StateSpace, samples: int) -> control.StateSpace:
    """Return a sampled system whose inputs come late: poles at z = 0 that no eigenvectors tell apart."""
    m = one.ninputs
    chain = control.ss(np.eye(samples, k=-1), np.eye(samples)[:, :1], np.eye(samples)[-1:], 0, one.dt)
    return control.ss(one * control.append(*[chain] * m))


def frequency_response() -> Iterator[Comparison]:
    """Compare responses of one system in modal coordinates, and of one with delays from its Schur form."""
    w = np.geomspace(1e-2, 1e4, 1000)
    for ports in (1, 2, 3):
        one = system(16, ports, ports)
        yield _response(f"16 states, {ports} x {ports}, modes", one, 1j * w, w, target=10.0)
    period = 1e-3
    w = np.geomspace(1e-2, np.pi / period, 1000)
    for ports, samples in ((1, 4), (2, 2)):
        one = delayed(system(12, ports, ports, dt=period), samples)
        yield _response(f"16 states, {ports} x {ports}, delays", one, np.exp(1j * w * period), w, target=3.0)


def _response(name: str, one: control.StateSpace, z: NDArray[Any], w: FloatArray, target: float) -> Comparison:
    return Comparison(
        name=f"{name}, 1,000 frequencies",
        ours=partial(analysis.frequency_response, one, w),
        theirs={"control": partial(one, z)},
        target=target,
        clock="cpu",
        check=close(1e-8),
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


def masses(states: int) -> control.StateSpace:
    """Return a chain of masses between walls with proportional damping, from a force to a place."""
    k = states // 2
    K = k**2 * (2.0 * np.eye(k) - np.eye(k, k=1) - np.eye(k, k=-1))
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-K, -2e-5 * K - 1e-2 * np.eye(k)]])
    B, C = np.zeros((states, 1)), np.zeros((1, states))
    B[k + k // 3], C[0, k // 2] = k, 1.0
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


# Structures, and a random matrix.
LARGE: dict[str, Callable[[], control.StateSpace]] = {
    "120 states, 2 x 2, modes, mixed": lambda: turned(modal(120, 2, 2, (0.0, 4.0), 1e-3)),
    "270 states, 2 x 2, random": lambda: without_structure(270, 2, 2),
    "400 states, chain of masses": lambda: masses(400),
    "1000 states, 2 x 2, modes, mixed": lambda: turned(modal(1000, 2, 2, (-0.3, 2.0), 5e-3)),
}


def large_responses() -> Iterator[Comparison]:
    """Compare responses of many states at 1,000 frequencies around their modes."""
    for name, made in LARGE.items():
        one = made()
        poles = np.abs(np.linalg.eigvals(one.A))
        w = np.geomspace(max(poles.min(), 1e-3 * poles.max()) / 3.0, 3.0 * poles.max(), 1000)
        yield Comparison(
            name=name,
            ours=partial(analysis.frequency_response, one, w),
            theirs={"control": partial(one, 1j * w)},
            target=0.8,
            clock="cpu",
            check=close(1e-6),
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
            target=20.0,
            clock="cpu",
            check=lambda ours, theirs: close(1e-9)(ours, {name: y.outputs for name, y in theirs.items()}),
        )


SECTIONS: dict[str, Section] = {
    "frequency-response": frequency_response,
    "large-responses": large_responses,
    "time-response": time_response,
}
