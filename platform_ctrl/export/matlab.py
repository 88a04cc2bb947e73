"""Systems as MATLAB data: a struct each, whose fields are what MATLAB's and Octave's ``ss`` take."""

from __future__ import annotations

import io
import math
import os
import re
import warnings
import zlib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.common.files import write_whole
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.errors import InputError
from platform_ctrl.export.systems import MOST_SYSTEMS, SystemRecord, expect_systems, system_of
from platform_ctrl.plant.mistakes import one_line
from platform_ctrl.plant.source import MOST_OF_ANY, path_of

HEADER_LENGTH = 128
# Bytes that the parts of a file may inflate to.
MOST_INFLATED = 256 * 2**20
# Elements of an array, fields of a struct, and structs or cells within one another.
_MOST_ELEMENTS, _MOST_FIELDS, _DEEPEST = 2**25, 1000, 8

_MATRIX, _COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_WIDTHS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
_UTF8, _UTF_WIDTHS = 16, {17: 2, 18: 4}
_CELL, _STRUCT, _CHAR, _NUMERIC = 1, 2, 4, range(6, 16)
_COMPLEX = 0x800


def structs(content: bytes) -> bytes:
    """Return a file with its structs alone, inflated and in order; what else it holds is no linear system."""
    if len(content) < HEADER_LENGTH or content[126:128] not in (b"IM", b"MI"):
        raise ValueError("it is no MATLAB 5 file")
    little = content[126:128] == b"IM"
    parts, at, room = [content[:HEADER_LENGTH]], HEADER_LENGTH, MOST_INFLATED
    while at < len(content):
        kind, start, size, after = _tag(content, at, len(content), little)
        if kind == _COMPRESSED:
            inflater = zlib.decompressobj()
            part = inflater.decompress(content[start : start + size], room)
            if inflater.unconsumed_tail:
                raise ValueError(f"it inflates to more than {MOST_INFLATED // 2**20} MiB")
            at = start + size  # what is compressed is not padded
        else:
            part, at = content[at:after], after
        room -= len(part)
        if room <= 0:
            raise ValueError(f"it inflates to more than {MOST_INFLATED // 2**20} MiB")
        if _class_of(part, little) == _STRUCT:
            _check(part, 0, len(part), little, 0)
            parts.append(part)
    return b"".join(parts)


def _word(data: bytes, at: int, little: bool) -> int:
    return int.from_bytes(data[at : at + 4], "little" if little else "big")


def _tag(data: bytes, at: int, end: int, little: bool) -> tuple[int, int, int, int]:
    """Type of an element, where its bytes begin, how many they are, and where the next one begins."""
    if at + 8 > end:
        raise ValueError("it ends in the middle of an element")
    word = _word(data, at, little)
    if word >> 16:  # a small one is part of its tag
        kind, size, start, after = word & 0xFFFF, word >> 16, at + 4, at + 8
        if size > 4:
            raise ValueError("an element has a wrong length")
        return kind, start, size, after
    size, start = _word(data, at + 4, little), at + 8
    if start + size > end:
        raise ValueError("it ends in the middle of an element")
    return word, start, size, min(start + size + -size % 8, end)


def _element(data: bytes, at: int, end: int, little: bool, kind: int) -> tuple[int, int, int]:
    found, start, size, after = _tag(data, at, end, little)
    if found != kind:
        raise ValueError(f"an element has the type {found} instead of {kind}")
    return start, size, after


def _class_of(part: bytes, little: bool) -> int:
    if len(part) < 24 or _word(part, 0, little) != _MATRIX:
        return 0
    return _word(part, 16, little) & 0xFF


def _check(data: bytes, at: int, end: int, little: bool, depth: int) -> int:
    """Check the array at `at` with its contents, and return where the next one begins."""
    start, size, after = _element(data, at, end, little, _MATRIX)
    if size == 0:
        return after
    end = start + size
    flags, size, at = _element(data, start, end, little, _UINT32)
    if size != 8:
        raise ValueError("the flags of an array have a wrong length")
    word = _word(data, flags, little)
    start, size, at = _element(data, at, end, little, _INT32)
    if size % 4 or not 8 <= size <= 128:
        raise ValueError("the dimensions of an array have a wrong length")
    count = math.prod(_word(data, start + 4 * k, little) for k in range(size // 4))
    if count > _MOST_ELEMENTS:
        raise ValueError(f"an array has {count} elements")
    at = _element(data, at, end, little, _INT8)[2]
    _check_content(data, at, end, little, depth, word, count)
    return after


def _check_content(data: bytes, at: int, end: int, little: bool, depth: int, word: int, count: int) -> None:
    kind = word & 0xFF
    if kind in _NUMERIC or kind == _CHAR:
        widths = _WIDTHS | _UTF_WIDTHS if kind == _CHAR else _WIDTHS
        for _ in range(2 if word & _COMPLEX else 1):
            if at >= end and count == 0:
                return
            stored, _, size, at = _tag(data, at, end, little)
            # Text in UTF-8 may have more bytes than characters.
            fits = count <= size <= 4 * count if stored == _UTF8 and kind == _CHAR else False
            if not fits and size != count * widths.get(stored, -1):
                raise ValueError("the elements of an array are not as many as its dimensions require")
        return
    if kind not in (_CELL, _STRUCT):
        raise ValueError("a struct holds what is neither numbers, text, cell nor struct")
    if depth >= _DEEPEST:
        raise ValueError("structs and cells lie too deep in one another")
    if kind == _STRUCT:
        start, size, at = _element(data, at, end, little, _INT32)
        length = _word(data, start, little)
        _, size, at = _element(data, at, end, little, _INT8)
        if not 0 < length <= 64 or size % length or size // length > _MOST_FIELDS:
            raise ValueError("the names of a struct's fields have a wrong length")
        count *= size // length
    for _ in range(count):
        at = _check(data, at, end, little, depth + 1)


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
_READABLE = "a MAT file (save -v7) with structs of A, B, C, D"


@check_arguments
def write_mat(systems: Sequence[SystemRecord], path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write systems as a MATLAB 5 file, whole or not at all.

    Every system is a struct with ``A``, ``B``, ``C``, ``D``, ``Ts``, ``InputName``, ``OutputName``, ``StateName``,
    ``InputUnit``, ``OutputUnit``, ``OutputDelay`` (continuous: s; sampled: whole sample periods), ``Delay`` (all of it,
    s), ``Name`` and ``Notes``.

    Parameters
    ----------
    systems
        As from `system_record`, `controller_systems` or `model_systems`.
    path
        Of the file; its folder is there.

    Returns
    -------
    tuple of str
        Names of the structs: the systems' own as far as MATLAB allows.

    Raises
    ------
    ArgumentError
        There are none, or more than 1000.
    InputError
        The file cannot be written there.
    """
    expect_systems(systems, "write_mat")
    names: list[str] = []
    for one in systems:
        names.append(_identifier(one.name, names))
    content = io.BytesIO()
    variables = {name: _struct(one) for name, one in zip(names, systems, strict=True)}
    import_module("scipy.io").savemat(content, variables, long_field_names=True, oned_as="column")
    data = content.getvalue()
    write_whole(path, _HEAD.ljust(_HEAD_LENGTH) + data[_HEAD_LENGTH:])
    return tuple(names)


def read_mat(path: str | os.PathLike[str]) -> tuple[SystemRecord, ...]:
    """Read systems from a MATLAB file: every struct with ``A``, ``B``, ``C`` and ``D``.

    Written by `write_mat`, or by MATLAB or Octave: ``save -v7`` of structs that are made by hand or by
    ``struct("A", sys.A, ...)``. Names may be a char array or a cell, lying or standing; B and C of one state too.

    Parameters
    ----------
    path
        Of the file, at most 64 MiB.

    Returns
    -------
    tuple of SystemRecord
        In the file's order; what has no names gets u1, y1, x1 and so on. A sampled system's delay is ``Delay``, or
        ``OutputDelay`` in sample periods.

    Raises
    ------
    InputError
        The file cannot be read, holds no such struct, or one is not consistent.
    """
    file = path_of(path, "the path of a MAT file")
    label = one_line(str(file))
    content = _bytes(file, label)
    if content[:4] == b"\x89HDF" or b"MATLAB 7.3" in content[:HEADER_LENGTH]:
        raise InputError(f"{label}: is in MATLAB's format 7.3; save {_READABLE}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # two structs of one name: the later one is meant
            variables = import_module("scipy.io").loadmat(io.BytesIO(structs(content)), struct_as_record=True)
    except Exception as error:  # of broken bytes scipy raises whatever came up
        raise InputError(f"{label}: cannot be read: {one_line(str(error))[:200]}; save {_READABLE}") from None
    found = []
    for name, item in variables.items():
        for number, entry in enumerate(item.ravel() if _is_struct(item) else ()):
            where = f"{label}: {one_line(name)}" + (f"({number + 1})" if item.size > 1 else "")
            found.append(_system(where, name if item.size == 1 else f"{name}_{number + 1}", entry))
    if not 0 < len(found) <= MOST_SYSTEMS:
        raise InputError(f"{label}: holds {len(found)} systems; save {_READABLE}, 1 to {MOST_SYSTEMS} of them")
    return tuple(found)


def _identifier(name: str, taken: Sequence[str]) -> str:
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "system"
    plain = (plain if plain[0].isalpha() else f"s_{plain}")[:_LONGEST]
    out, count = plain, 1
    while out in taken:
        count += 1
        out = f"{plain[: _LONGEST - 5]}_{count}"
    return out


def _struct(one: SystemRecord) -> dict[str, Any]:
    # A fraction of a sample period is in Delay alone: MATLAB's sampled systems have none.
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
        raise InputError(f"{label}: is larger than {MOST_OF_ANY // 2**20} MiB; save {_READABLE} in a smaller file")
    return content


def _is_struct(item: object) -> bool:
    return isinstance(item, np.ndarray) and item.dtype.names is not None and {*"ABCD"} <= set(item.dtype.names)


def _system(where: str, name: str, entry: np.void) -> SystemRecord:
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
        raise InputError(f"{where}: {field}: must be a matrix of real numbers")
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
    raise InputError(f"{where}: {field}: must be one number, or several equal ones")


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
    raise InputError(f"{where}: {field}: must be text or a cell of text")
