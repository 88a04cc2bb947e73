"""Judging the arguments of Python calls: shape, finiteness, names. One line says what was given and expected."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray


def real_array(name: str, given: ArrayLike | None, shape: tuple[int, ...], default: float | None = None) -> FloatArray:
    """Return `given` as a finite float64 array of `shape`.

    Parameters
    ----------
    name
        What the caller calls the argument.
    given
        The argument; None stands for an array filled with `default` where there is one.
    shape
        The expected shape.
    default
        Fill value for None.

    Raises
    ------
    ArgumentError
        Not numbers, another shape, or not finite.
    """
    if given is None and default is not None:
        return np.full(shape, default)
    try:
        array = np.asarray(given)
        if array.dtype.kind not in "iuf":
            raise TypeError
        array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: given {_short(given)}; expected real numbers of shape {shape}") from None
    if array.shape != shape:
        raise ArgumentError(f"{name}: given shape {array.shape}; expected {shape}")
    if not np.all(np.isfinite(array)):
        raise ArgumentError(f"{name}: given a number that is not finite; expected {shape} finite numbers")
    return array


def known_name(kind: str, given: str, known: Sequence[str]) -> int:
    """Return the index of `given` in `known`.

    Raises
    ------
    ArgumentError
        `given` is not among `known`; the message names the nearest one.
    """
    if given in known:
        return list(known).index(given)
    near = difflib.get_close_matches(str(given), known, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise ArgumentError(
        f"{kind}: given {given!r}; expected one of {', '.join(map(repr, known)) or 'none at all'}{hint}"
    )


def _short(given: object) -> str:
    text = " ".join(repr(given).split())
    return text if len(text) <= 60 else text[:57] + "..."
