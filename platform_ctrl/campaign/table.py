"""A campaign's table: its columns, read from Parquet files or from memory."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.run_metrics import RUN_METRICS
from platform_ctrl.common.arguments import short
from platform_ctrl.errors import ArgumentError, InputError

# What a run's row holds besides its inputs.
RUN, MANOEUVRE, PASSED, ENDED = "run", "manoeuvre", "passed", "ended"
# How a run ended begins with one of these words.
COMPLETED, DIVERGED, NOT_SIMULATED = "completed", "diverged", "not simulated"
OUTCOMES = frozenset(
    {RUN, *RUN_METRICS, *(f"{name}_passed" for name in RUN_METRICS), "stop_contacts", "saturated", PASSED, ENDED}
)

Array = NDArray[Any]
Columns = dict[str, Array]
Kind = Literal["whole", "number", "answer", "word"]  # of a column
# A folder or file of Parquet, several files, or the columns themselves.
Table = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Mapping[str, Any]


def arrow() -> Any:
    """Return the module pyarrow."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            "a campaign's table is Parquet and pyarrow is not installed: pip install 'platform_ctrl[campaign]'"
        ) from None
    return pyarrow


def column_names(table: Table) -> tuple[str, ...]:
    """Return the names of the table's columns."""
    return tuple(table) if isinstance(table, Mapping) else tuple(_dataset(table).schema.names)


def input_names(table: Table) -> tuple[str, ...]:
    """Return the columns that went into the runs: all that are no outcome."""
    return tuple(name for name in column_names(table) if name not in OUTCOMES)


def read_columns(table: Table, names: Sequence[str]) -> dict[str, Array]:
    """Return the named columns (N,), in the table's order.

    Numbers are float64 (`run` is int64), words objects, yes and no int8 where −1 says neither.
    """
    known = column_names(table)
    for name in names:
        if name not in known:
            raise ArgumentError(f"table has no column {name!r}: it must have {short(tuple(names))}")
    if isinstance(table, Mapping):
        columns = {name: np.asarray(table[name]) for name in names}
        lengths = {name: column.shape for name, column in columns.items()}
        if len(set(lengths.values())) != 1 or any(len(shape) != 1 for shape in lengths.values()):
            raise ArgumentError(f"table: columns must be vectors of one length, got {short(lengths)}")
    else:
        data = _dataset(table).to_table(columns=list(names))
        columns = {name: data.column(name).to_numpy() for name in names}
    return {name: _column(name, column) for name, column in columns.items()}


def _column(name: str, column: Array) -> Array:
    if name == RUN:
        return column.astype(np.int64)
    if name == PASSED or name.endswith("_passed"):
        return _answers(column)
    if column.dtype.kind == "b":
        return column.astype(np.int8)
    if column.dtype.kind in "iuf":
        return column.astype(np.float64)
    if column.dtype.kind in "US":
        return column.astype(object)
    if all(isinstance(item, bool | np.bool_ | None) for item in column):
        return _answers(column)
    return column


def _answers(column: Array) -> Array:
    """Return 1 for yes, 0 for no, −1 where there is no answer (None, a missing number)."""
    if column.dtype.kind in "biu":
        return column.astype(np.int8)
    return np.fromiter((-1 if item is None or item != item else int(bool(item)) for item in column), np.int8)


def _dataset(table: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> Any:
    pa = arrow()
    from pyarrow import dataset

    given = os.fspath(table) if isinstance(table, str | os.PathLike) else [os.fspath(path) for path in table]
    try:
        return dataset.dataset(given, format="parquet")
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(f"{short(given)}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None


def was_simulated(columns: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return which runs were simulated."""
    ended = columns[ENDED]
    return np.fromiter((not str(one).startswith(NOT_SIMULATED) for one in ended), bool, len(ended))
