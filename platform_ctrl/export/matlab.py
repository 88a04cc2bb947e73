"""Systems as MATLAB data: a struct each, whose fields are what MATLAB's and Octave's ``ss`` take."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.errors import InputError
from platform_ctrl.export.linear_system import MOST_SYSTEMS, LinearSystem, expect_systems, system_of
from platform_ctrl.export.mat_elements import HEADER_LENGTH, structs
from platform_ctrl.reading.mistakes import one_line
from platform_ctrl.reading.source import MOST_OF_ANY, path_of
from platform_ctrl.signatures import check_arguments
from platform_ctrl.writing import write_whole

# The text at the head of the file, in place of the date that would make every file another one.
_HEAD, _HEAD_LENGTH = b"MATLAB 5.0 MAT-file, written by platform_ctrl", 116
# MATLAB's namelengthmax.
_LONGEST = 63
_FIELDS = {
    "inputs": "InputName",
    "outputs": "OutputName",
    "states": "StateName",
    "input_units": "InputUnit",
    "output_units": "OutputUnit",
}
_EXPECTED = "a MAT file (save -v7) with structs of A, B, C, D"


@check_arguments
def write_mat(systems: Sequence[LinearSystem], path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write systems as a MATLAB 5 file, whole or not at all.

    Every system is a struct with ``A``, ``B``, ``C``, ``D``, ``Ts``, ``InputName``, ``OutputName``, ``StateName``,
    ``InputUnit``, ``OutputUnit``, ``OutputDelay`` (continuous: s; sampled: whole sample periods), ``Delay`` (all of it,
    s), ``Name`` and ``Notes``.

    Parameters
    ----------
    systems
        As from `linear_system`, `controller_systems` or `model_systems`.
    path
        Of the file; its folder is there.

    Returns
    -------
    tuple of str
        Names of the structs: the systems' own as far as MATLAB can say them.

    Raises
    ------
    ArgumentError
        There are none, or more than 1000.
    InputError
        The file cannot be written there.

    References
    ----------
    See docs/export.md.
    """
    expect_systems(systems, "write_mat")
    names: list[str] = []
    for one in systems:
        names.append(_identifier(one.name, names))
    content = io.BytesIO()
    held = {name: _struct(one) for name, one in zip(names, systems, strict=True)}
    import_module("scipy.io").savemat(content, held, long_field_names=True, oned_as="column")
    data = content.getvalue()
    write_whole(path, _HEAD.ljust(_HEAD_LENGTH) + data[_HEAD_LENGTH:])
    return tuple(names)


def read_mat(path: str | os.PathLike[str]) -> tuple[LinearSystem, ...]:
    """Read systems from a MATLAB file: every struct with ``A``, ``B``, ``C`` and ``D``.

    Written by `write_mat`, or by MATLAB or Octave: ``save -v7`` of structs that are made by hand or by
    ``struct("A", sys.A, ...)``. Names may be a char array or a cell, lying or standing; B and C of one state too.

    Parameters
    ----------
    path
        Of the file, at most 64 MiB.

    Returns
    -------
    tuple of LinearSystem
        In the file's order; what has no names gets u1, y1, x1 and so on. A sampled system's delay is ``Delay``, or
        ``OutputDelay`` in sample periods.

    Raises
    ------
    InputError
        The file cannot be read, holds no such struct, or one makes no sense: one line says which.

    References
    ----------
    See docs/export.md.
    """
    file = path_of(path, "the path of a MAT file")
    label = one_line(str(file))
    content = _bytes(file, label)
    if content[:4] == b"\x89HDF" or b"MATLAB 7.3" in content[:HEADER_LENGTH]:
        raise InputError(f"{label}: is MATLAB's format 7.3; expected {_EXPECTED}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # two structs of one name: the later one is meant
            held = import_module("scipy.io").loadmat(io.BytesIO(structs(content)), struct_as_record=True)
    except Exception as error:  # of broken bytes scipy raises whatever came up
        raise InputError(f"{label}: cannot be read: {one_line(str(error))[:200]}; expected {_EXPECTED}") from None
    found = []
    for name, item in held.items():
        for number, entry in enumerate(item.ravel() if _is_struct(item) else ()):
            where = f"{label}: {one_line(name)}" + (f"({number + 1})" if item.size > 1 else "")
            found.append(_system(where, name if item.size == 1 else f"{name}_{number + 1}", entry))
    if not 0 < len(found) <= MOST_SYSTEMS:
        raise InputError(f"{label}: holds {len(found)} systems; expected {_EXPECTED}, 1 to {MOST_SYSTEMS}")
    return tuple(found)


def _identifier(name: str, taken: Sequence[str]) -> str:
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "system"
    plain = (plain if plain[0].isalpha() else f"s_{plain}")[:_LONGEST]
    out, count = plain, 1
    while out in taken:
        count += 1
        out = f"{plain[: _LONGEST - 5]}_{count}"
    return out


def _struct(one: LinearSystem) -> dict[str, Any]:
    # A fraction of a sample period is in Delay alone: MATLAB's sampled systems know none.
    whole = one.delay if one.dt == 0.0 else np.floor(one.delay / one.dt * (1.0 + 1e-9))
    out: dict[str, Any] = {key: np.array(getattr(one, key)) for key in "ABCD"}
    out["Ts"] = one.dt
    for key, field in _FIELDS.items():
        out[field] = _cell(getattr(one, key))
    return out | {
        "OutputDelay": np.full((len(one.outputs), 1), float(whole)),
        "Delay": one.delay,
        "Name": one.name,
        "Notes": one.note,
    }


def _cell(names: Sequence[str]) -> np.ndarray[Any, Any]:
    cell = np.empty((len(names), 1), dtype=object)
    cell[:, 0] = names
    return cell


def _bytes(file: Path, label: str) -> bytes:
    try:
        with file.open("rb") as source:
            content = source.read(MOST_OF_ANY + 1)
    except (OSError, ValueError) as error:
        words = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{label}: cannot be read: {one_line(words)}") from None
    if len(content) > MOST_OF_ANY:
        raise InputError(f"{label}: is larger than {MOST_OF_ANY // 2**20} MiB; expected {_EXPECTED} of at most that")
    return content


def _is_struct(item: object) -> bool:
    return isinstance(item, np.ndarray) and item.dtype.names is not None and {*"ABCD"} <= set(item.dtype.names)


def _system(where: str, name: str, entry: np.void) -> LinearSystem:
    fields = {key: entry[key] for key in entry.dtype.names or ()}
    data: dict[str, Any] = {key: _matrix(where, key, fields[key]) for key in "ABCD"}
    _orient(data)
    for key, field in _FIELDS.items():
        data[key] = _strings(where, field, fields.get(field))
    period = _number(where, "Ts", fields.get("Ts"))
    data["dt"] = period
    if "Delay" in fields:
        data["delay"] = _number(where, "Delay", fields["Delay"])
    else:
        data["delay"] = _number(where, "OutputDelay", fields.get("OutputDelay")) * (period or 1.0)
    data["name"] = " ".join(_strings(where, "Name", fields.get("Name"))) or name
    data["note"] = " ".join(_strings(where, "Notes", fields.get("Notes")))
    return system_of(where, data)


def _matrix(where: str, field: str, item: Any) -> Any:
    if not isinstance(item, np.ndarray) or item.dtype.kind not in "iufb" or item.ndim != 2:
        raise InputError(f"{where}: {field}: is no matrix of real numbers; expected one")
    return item


def _orient(data: dict[str, Any]) -> None:
    """Turn B and C of one state that lie the wrong way, as code that squeezes leaves them."""
    if data["A"].size != 1 or data["D"].size == 0:
        return
    p, m = data["D"].shape
    for key, wanted in (("B", (1, m)), ("C", (p, 1))):
        if data[key].shape != wanted and data[key].T.shape == wanted:
            data[key] = data[key].T


def _number(where: str, field: str, item: object) -> float:
    """Return a number; of several that are alike, one. Missing or empty: 0."""
    if item is None or (isinstance(item, np.ndarray) and item.size == 0):
        return 0.0
    if isinstance(item, np.ndarray) and item.dtype.kind in "iufb" and np.all(item == item.ravel()[0]):
        return float(item.ravel()[0])
    raise InputError(f"{where}: {field}: is no number, or several that differ; expected one number")


def _strings(where: str, field: str, item: object) -> list[str]:
    """Return the strings of a char array, a cell, or a cell of cells, lying or standing."""
    if item is None or (isinstance(item, np.ndarray) and item.size == 0):
        return []
    if isinstance(item, np.ndarray) and item.dtype.kind == "U":
        return [str(text).rstrip() for text in item.ravel()]
    if isinstance(item, np.ndarray) and item.dtype.kind == "O" and item.size <= MOST_SYSTEMS:
        nested = [_strings(where, field, entry) for entry in item.ravel()]
        if all(len(texts) <= 1 for texts in nested):
            return [texts[0] if texts else "" for texts in nested]
    raise InputError(f"{where}: {field}: is neither text nor a cell of text; expected names")
