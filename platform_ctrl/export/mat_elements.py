"""What a MATLAB 5 file is made of, judged before it is read: SciPy trusts all lengths, and crashes on wrong ones."""

from __future__ import annotations

import math
import zlib

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
    """Return a file with its structs alone, inflated and in order; what else it holds is no linear system.

    Raises
    ------
    ValueError
        It is no such file, is broken, holds something in a struct that is neither numbers, text, cell nor struct, or
        inflates to too much.
    """
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
            _judge(part, 0, len(part), little, 0)
            parts.append(part)
    return b"".join(parts)


def _word(data: bytes, at: int, little: bool) -> int:
    return int.from_bytes(data[at : at + 4], "little" if little else "big")


def _tag(data: bytes, at: int, end: int, little: bool) -> tuple[int, int, int, int]:
    """Type of an element, where its bytes begin, how many they are, and where the next one begins."""
    if at + 8 > end:
        raise ValueError("it ends in the middle of an element")
    word = _word(data, at, little)
    if word >> 16:  # a small one stands within its tag
        kind, size, start, after = word & 0xFFFF, word >> 16, at + 4, at + 8
        if size > 4:
            raise ValueError("an element has a wrong length")
        return kind, start, size, after
    size, start = _word(data, at + 4, little), at + 8
    if start + size > end:
        raise ValueError("it ends in the middle of an element")
    return word, start, size, min(start + size + -size % 8, end)


def _expected(data: bytes, at: int, end: int, little: bool, kind: int) -> tuple[int, int, int]:
    found, start, size, after = _tag(data, at, end, little)
    if found != kind:
        raise ValueError(f"an element of type {found} stands where {kind} is expected")
    return start, size, after


def _class_of(part: bytes, little: bool) -> int:
    if len(part) < 24 or _word(part, 0, little) != _MATRIX:
        return 0
    return _word(part, 16, little) & 0xFF


def _judge(data: bytes, at: int, end: int, little: bool, depth: int) -> int:
    """Judge the array at `at` with all that it holds, and return where the next one begins."""
    start, size, after = _expected(data, at, end, little, _MATRIX)
    if size == 0:
        return after
    end = start + size
    flags, size, at = _expected(data, start, end, little, _UINT32)
    if size != 8:
        raise ValueError("the flags of an array have a wrong length")
    word = _word(data, flags, little)
    start, size, at = _expected(data, at, end, little, _INT32)
    if size % 4 or not 8 <= size <= 128:
        raise ValueError("the dimensions of an array have a wrong length")
    count = math.prod(_word(data, start + 4 * k, little) for k in range(size // 4))
    if count > _MOST_ELEMENTS:
        raise ValueError(f"an array has {count} elements")
    at = _expected(data, at, end, little, _INT8)[2]
    _judge_content(data, at, end, little, depth, word, count)
    return after


def _judge_content(data: bytes, at: int, end: int, little: bool, depth: int, word: int, count: int) -> None:
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
                raise ValueError("the elements of an array are not as many as its dimensions say")
        return
    if kind not in (_CELL, _STRUCT):
        raise ValueError("a struct holds what is neither numbers, text, cell nor struct")
    if depth >= _DEEPEST:
        raise ValueError("structs and cells lie too deep in one another")
    if kind == _STRUCT:
        start, size, at = _expected(data, at, end, little, _INT32)
        length = _word(data, start, little)
        _, size, at = _expected(data, at, end, little, _INT8)
        if not 0 < length <= 64 or size % length or size // length > _MOST_FIELDS:
            raise ValueError("the names of a struct's fields have a wrong length")
        count *= size // length
    for _ in range(count):
        at = _judge(data, at, end, little, depth + 1)
