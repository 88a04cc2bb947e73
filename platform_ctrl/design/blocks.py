"""Controller blocks as sampled state-space arrays, and how they are put together without doubling a state."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray

Block = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
# Real or complex matrices.
Numbers = TypeVar("Numbers", FloatArray, ComplexArray)


def first_order(b1: float, b0: float, a1: float, a0: float, period: float) -> Block:
    """Return (b1 s + b0)/(a1 s + a0), sampled by Tustin's rule."""
    two = 2.0 / period
    lead, last = a1 * two + a0, a0 - a1 * two
    high, low = b1 * two + b0, b0 - b1 * two
    pole = -last / lead
    direct = high / lead
    return (
        np.array([[pole]]),
        np.array([[1.0]]),
        np.array([[low / lead + direct * pole]]),
        np.array([[direct]]),
    )


def notch(frequency: float, depth: float, width: float, period: float) -> Block:
    """Return (s² + 2 depth width f s + f²)/(s² + 2 width f s + f²), by Tustin's rule prewarped at f = `frequency`."""
    two = frequency / np.tan(0.5 * frequency * period)
    f2, damping = frequency**2, 2.0 * width * frequency
    a = np.array([two**2 + damping * two + f2, 2.0 * (f2 - two**2), two**2 - damping * two + f2])
    b = np.array([two**2 + depth * damping * two + f2, 2.0 * (f2 - two**2), two**2 - depth * damping * two + f2])
    a, b = a / a[0], b / a[0]
    return (
        np.array([[-a[1], -a[2]], [1.0, 0.0]]),
        np.array([[1.0], [0.0]]),
        np.array([[b[1] - b[0] * a[1], b[2] - b[0] * a[2]]]),
        np.array([[b[0]]]),
    )


def gain(matrix: FloatArray | float) -> Block:
    """Return a static gain."""
    D = np.atleast_2d(np.asarray(matrix, dtype=np.float64))
    return np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0)), D


def series(
    first: tuple[Numbers, Numbers, Numbers, Numbers], *others: tuple[Numbers, Numbers, Numbers, Numbers]
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Return the blocks one after another, `first` first."""
    A, B, C, D = first
    for a, b, c, d in others:
        A = np.block([[A, np.zeros((len(A), len(a)))], [b @ C, a]])
        B, C, D = np.vstack([B, b @ D]), np.hstack([d @ C, c]), d @ D
    return A, B, C, D


def stacked(*blocks: Block) -> Block:
    """Return blocks that share their input, outputs below one another."""
    A = _diagonal([block[0] for block in blocks])
    return (
        A,
        np.vstack([block[1] for block in blocks]),
        _diagonal([block[2] for block in blocks]),
        np.vstack([block[3] for block in blocks]),
    )


def side_by_side(*blocks: Block) -> Block:
    """Return blocks with inputs and outputs of their own."""
    A, B, C, D = (_diagonal([block[k] for block in blocks]) for k in range(4))
    return A, B, C, D


def _diagonal(parts: list[FloatArray]) -> FloatArray:
    out = np.zeros((sum(p.shape[0] for p in parts), sum(p.shape[1] for p in parts)))
    row = column = 0
    for part in parts:
        out[row : row + part.shape[0], column : column + part.shape[1]] = part
        row, column = row + part.shape[0], column + part.shape[1]
    return out
