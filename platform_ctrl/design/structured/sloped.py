"""Matrices with their derivatives by parameters, and state-space blocks of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from platform_ctrl.frozen import FloatArray


class Sloped(NamedTuple):
    """A matrix (r, c) and its derivatives (r, c, n)."""

    at: FloatArray
    slope: FloatArray

    def __matmul__(self, other: Sloped) -> Sloped:
        slope = np.einsum("ijx,jk->ikx", self.slope, other.at) + np.einsum("ij,jkx->ikx", self.at, other.slope)
        return Sloped(self.at @ other.at, slope)

    def widened(self, before: int, after: int) -> Sloped:
        """Return the same matrix among more parameters."""
        return Sloped(self.at, np.pad(self.slope, ((0, 0), (0, 0), (before, after))))


def constant(matrix: FloatArray, parameters: int) -> Sloped:
    """Return a matrix that depends on none of so many parameters."""
    return Sloped(np.asarray(matrix, dtype=np.float64), np.zeros((*np.shape(matrix), parameters)))


def tiled(rows: Sequence[Sequence[Sloped]]) -> Sloped:
    """Return the matrix made of blocks."""
    return Sloped(
        np.block([[block.at for block in row] for row in rows]),
        np.concatenate([np.concatenate([block.slope for block in row], axis=1) for row in rows], axis=0),
    )


class SlopedBlock(NamedTuple):
    """A, B, C, D of a block."""

    A: Sloped
    B: Sloped
    C: Sloped
    D: Sloped

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A.at)

    @property
    def joined(self) -> Sloped:
        """The matrix [A, B; C, D]."""
        return tiled([[self.A, self.B], [self.C, self.D]])


def in_series(first: SlopedBlock, second: SlopedBlock) -> SlopedBlock:
    """Return `second` after `first`; the parameters of `first` stand first."""
    n1, n2 = first.D.slope.shape[2], second.D.slope.shape[2]
    a, b, c, d = (m.widened(0, n2) for m in first)
    A, B, C, D = (m.widened(n1, 0) for m in second)
    zero = constant(np.zeros((first.order, second.order)), n1 + n2)
    return SlopedBlock(tiled([[a, zero], [B @ c, A]]), tiled([[b], [B @ d]]), tiled([[D @ c, C]]), D @ d)
