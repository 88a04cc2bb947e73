"""Sections of a controller: sampled blocks with a meaning and named signals, which generated code keeps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray


class Section(NamedTuple):
    """A block: name, kind (lead, notch, ...), meaning in continuous time (frequencies in Hz), sampled, signal names."""

    name: str
    kind: str
    note: str
    block: System
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def states(self) -> list[str]:
        """Names of its states."""
        n = len(self.block.A)
        return [f"{self.name}_x{k + 1}" if n > 1 else f"{self.name}_x" for k in range(n)]

    def record(self) -> dict[str, Any]:
        """Return the section in the types of result.json."""
        matrices = dict(zip("ABCD", self.block[:4], strict=True))
        signals = {"inputs": list(self.inputs), "outputs": list(self.outputs)}
        return {"name": self.name, "kind": self.kind, "note": self.note, **matrices, **signals}


def flattened(sections: Sequence[Section], inputs: Sequence[str], outputs: Sequence[str]) -> System:
    """Return the sections from `inputs` to `outputs` as one system; its states are theirs in their order."""
    n, m = sum(len(section.block.A) for section in sections), len(inputs)
    rows: dict[str, FloatArray] = dict(zip(inputs, np.eye(m, n + m, n), strict=True))
    later = np.zeros((n, n + m))
    first = 0
    for section in sections:
        a, b, c, d, _ = section.block
        last = first + len(a)
        taken = np.array([rows[name] for name in section.inputs])
        shown = d @ taken
        if last > first:
            later[first:last] = b @ taken
            later[first:last, first:last] += a
            shown[:, first:last] += c
        rows.update(zip(section.outputs, shown, strict=True))
        first = last
    given = np.array([rows[name] for name in outputs])
    period = max(section.block.dt for section in sections)
    return System(later[:, :n], later[:, n:], given[:, :n], given[:, n:], period)


def first_order(b1: float, b0: float, a1: float, a0: float, period: float) -> System:
    """Return (b1 s + b0)/(a1 s + a0), sampled by Tustin's rule."""
    two = 2.0 / period
    lead, last = a1 * two + a0, a0 - a1 * two
    high, low = b1 * two + b0, b0 - b1 * two
    pole = -last / lead
    direct = high / lead
    return System(
        np.array([[pole]]), np.array([[1.0]]), np.array([[low / lead + direct * pole]]), np.array([[direct]]), period
    )


def notch(frequency: float, depth: float, width: float, period: float) -> System:
    """Return (s² + 2 depth width f s + f²)/(s² + 2 width f s + f²), by Tustin's rule prewarped at f = `frequency`."""
    f2, damping = frequency**2, 2.0 * width * frequency
    return _prewarped((1.0, depth * damping, f2), (1.0, damping, f2), frequency, period)


def low_pass(frequency: float, damping: float, period: float, order: int = 0) -> System:
    """Return sᵏ f²/(s² + 2 damping f s + f²), k = `order`, by Tustin's rule prewarped at f = `frequency`, rad/s."""
    f2 = frequency**2
    numerator = ((0.0, 0.0, f2), (0.0, f2, 0.0), (f2, 0.0, 0.0))[order]
    return _prewarped(numerator, (1.0, 2.0 * damping * frequency, f2), frequency, period)


def _prewarped(
    numerator: tuple[float, float, float], denominator: tuple[float, float, float], frequency: float, period: float
) -> System:
    """Return (b2 s² + b1 s + b0)/(a2 s² + a1 s + a0), by Tustin's rule prewarped at `frequency`, rad/s."""
    two = frequency / np.tan(0.5 * frequency * period)
    b, a = (
        np.array([c2 * two**2 + c1 * two + c0, 2.0 * (c0 - c2 * two**2), c2 * two**2 - c1 * two + c0])
        for c2, c1, c0 in (numerator, denominator)
    )
    a, b = a / a[0], b / a[0]
    A, C = np.array([[-a[1], -a[2]], [1.0, 0.0]]), np.array([[b[1] - b[0] * a[1], b[2] - b[0] * a[2]]])
    return System(A, np.array([[1.0], [0.0]]), C, np.array([[b[0]]]), period)


def gain(matrix: FloatArray | float) -> System:
    """Return a static gain, or a stack of them: `dt` is 0, whatever it is joined with."""
    D = np.atleast_2d(np.asarray(matrix, dtype=np.float64))
    return System(np.zeros((0, 0)), np.zeros((0, D.shape[-1])), np.zeros((D.shape[-2], 0)), D)


def side_by_side(*systems: System) -> System:
    """Return one system of several, each with its own inputs and outputs."""
    from scipy.linalg import block_diag

    A, B, C, D = (block_diag(*(system[k] for system in systems)) for k in range(4))
    return System(A, B, C, D, systems[0].dt)


def between(first: FloatArray, system: System, last: FloatArray) -> System:
    """Return last · system · first, with matrices for the other signals."""
    A, B, C, D, dt = system
    return System(A, B @ first, last @ C, last @ D @ first, dt)
