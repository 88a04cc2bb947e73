"""Responses over frequency and time beside python-control, which uses slycot for the former where it is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from side_by_side import Comparison, Section, close

from platform_ctrl import analysis
from platform_ctrl.frozen import FloatArray


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


SECTIONS: dict[str, Section] = {"frequency-response": frequency_response, "time-response": time_response}
