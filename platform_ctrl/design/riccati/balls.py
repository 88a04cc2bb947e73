"""Matrices of numbers with many bits (Arb by python-flint), made from doubles without rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# flint ships no types: a matrix of balls.
Balls = Any


def balls(array: NDArray[Any]) -> Balls:
    """Return a matrix of doubles as balls of radius zero."""
    import flint

    rows, columns = array.shape
    return flint.arb_mat(array.tolist()) if rows and columns else flint.arb_mat(rows, columns)


def identity(n: int) -> Balls:
    """Return the identity."""
    return balls(np.eye(n))


def blocks(rows: list[list[Balls]]) -> Balls:
    """Return a matrix put together from blocks."""
    import flint

    out = [[x for part in row for x in part.tolist()[i]] for row in rows for i in range(row[0].nrows())]
    columns = sum(part.ncols() for part in rows[0])
    return flint.arb_mat(out) if out and columns else flint.arb_mat(len(out), columns)
