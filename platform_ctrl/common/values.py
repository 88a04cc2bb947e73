"""Frozen values, which one stage hands to the next and nobody changes."""

from __future__ import annotations

import copyreg
import dataclasses
import functools
import math
import reprlib
import types
from collections.abc import Iterator, Mapping
from typing import Any, Literal, TypeVar, Union, dataclass_transform, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.arguments import instance, number, one_of, real_numbers
from platform_ctrl.errors import ArgumentError

FloatArray = NDArray[np.float64]

T = TypeVar("T")

# Lines and columns of a value's repr at most, and numbers of a vector that it shows.
_LINES, _COLUMNS, _NUMBERS = 20, 110, 6
# Functions that python-control makes anew for every StateSpace: neither copied nor pickled.
_OWN = ("updfcn", "outfcn")


def read_only(array: object) -> FloatArray:
    """Return a float64 copy of `array` that cannot be written to."""
    out = np.array(array, dtype=np.float64, copy=True)
    out.flags.writeable = False
    return out


def _freeze_arrays(self: Any) -> None:
    for name in self._fields:
        item = getattr(self, name)
        if isinstance(item, np.ndarray) and (item.flags.writeable or item.base is not None):
            frozen = item.copy()
            frozen.flags.writeable = False
            object.__setattr__(self, name, frozen)


def _within(item: Any) -> Iterator[Any]:
    """Go through what is in tuples, lists and dictionaries, or through the item alone."""
    if not isinstance(item, tuple | list | dict):
        yield item
        return
    for one in item.values() if isinstance(item, dict) else item:
        yield from _within(one)


def _set_state(self: Any, state: list[Any]) -> None:
    for name, item in zip(self._fields, state, strict=True):
        object.__setattr__(self, name, item)
    # Unpickled arrays come back writeable: freeze them again.
    _freeze_arrays(self)
    for item in _within(state):
        if isinstance(item, np.ndarray):
            item.flags.writeable = False


def _get_state(self: Any) -> list[Any]:
    return portable([getattr(self, name) for name in self._fields])


def portable(item: T) -> T:
    """Return `item`, after which every `control.StateSpace` can be pickled and copied if it is one.

    python-control 0.10 gives each system functions of its own matrices: `pickle` refuses them, and a deep copy goes on
    computing with the matrices of the original. Systems within tuples, lists and dictionaries count as well.
    """
    for one in _within(item):
        if type(one).__name__ == "StateSpace" and type(one).__module__ == "control.statesp":
            copyreg.dispatch_table.setdefault(type(one), _reduced)
    return item


def _reduced(system: Any) -> tuple[Any, ...]:
    return _new_system, (type(system),), {name: item for name, item in vars(system).items() if name not in _OWN}


def _new_system(kind: Any) -> Any:
    # Any matrices: the state that is put in next has all that depends on them.
    return portable(kind(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), 0.0, remove_useless_states=False))


class _Short(reprlib.Repr):
    """Parts of a value in a line: arrays and systems by their sizes, other values by their names."""

    def repr_ndarray(self, item: NDArray[Any], level: int) -> str:
        short = item.ndim == 1 and item.size <= _NUMBERS
        return np.array2string(item, precision=6, separator=", ") if short else f"<{item.dtype} array {item.shape}>"

    def repr_StateSpace(self, item: Any, level: int) -> str:
        sizes = f"{item.nstates} states, {item.ninputs} inputs, {item.noutputs} outputs"
        return f"<StateSpace {item.name!r}: {sizes}, dt = {item.dt}>"

    def repr_instance(self, item: Any, level: int) -> str:
        if not dataclasses.is_dataclass(item) or isinstance(item, type):
            text = " ".join(repr(item).split())  # in one line, as matrices of SymPy are not
            return text if len(text) <= self.maxother else f"{text[: self.maxother - 3]}..."
        name = getattr(item, "name", "")
        return f"<{type(item).__qualname__}{f' {name!r}' if isinstance(name, str) and name else ''}>"


def _summary(self: Any) -> str:
    """Return a summary in at most twenty lines, or one where it fits: numbers, names, and sizes of arrays."""
    short, kind = _Short(), type(self).__qualname__
    short.maxlist = short.maxtuple = short.maxdict = 3
    short.maxlevel, short.maxstring, short.maxother = 2, _COLUMNS // 2, _COLUMNS - 10
    names = [field.name for field in dataclasses.fields(self) if not field.name.startswith("_")]
    shown = names if len(names) <= _LINES - 2 else names[: _LINES - 3]
    items = [f"{name}={short.repr(getattr(self, name))}"[:_COLUMNS] for name in shown]
    items += [f"... {', '.join(names[len(shown) :])}"[:_COLUMNS]] if len(shown) < len(names) else []
    line = f"{kind}({', '.join(items)})"
    return line if len(line) <= _COLUMNS else "\n".join([f"{kind}(", *(f"    {item}," for item in items), ")"])


def replaced(item: T, changes: Mapping[str, Any]) -> T:
    """Return a value with other items under the names of fields: `dataclasses.replace`, faster, without checks."""
    new = object.__new__(type(item))
    for name in item._fields:  # type: ignore[attr-defined]
        object.__setattr__(new, name, changes[name] if name in changes else getattr(item, name))
    new._settled()  # type: ignore[attr-defined]
    return new


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
def value(cls: type[T]) -> type[T]:
    """Make `cls` a frozen dataclass with slots whose arrays are read-only.

    Equality is identity: the `==` that dataclasses generate raises on arrays. Pickle and deepcopy give
    writeable arrays back, so both freeze again. The repr is a summary: arrays and systems by their sizes.
    """
    own = cls.__dict__.get("__post_init__")

    def settled(self: Any) -> None:
        if own is not None:
            own(self)
        _freeze_arrays(self)

    cls.__post_init__ = settled  # type: ignore[attr-defined]
    if "__repr__" not in cls.__dict__:
        cls.__repr__ = _summary  # type: ignore[method-assign]
    made = dataclasses.dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)(cls)
    # Not `__dataclass_fields__`, which lists class variables as well.
    made._fields = tuple(field.name for field in dataclasses.fields(made))  # type: ignore[attr-defined,arg-type]
    made._settled = settled  # type: ignore[attr-defined]
    made.__setstate__ = _set_state  # type: ignore[attr-defined]
    made.__getstate__ = _get_state  # type: ignore[method-assign]
    return made


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
def input_value(cls: type[T]) -> type[T]:
    """Make `cls` a `value` that users make: numbers, arrays and words out of a few are checked (`ArgumentError`)."""
    made = value(cls)
    settled = made.__post_init__  # type: ignore[attr-defined]

    def checked(self: Any) -> None:
        for name, kind in _checked_fields(type(self)):  # type: ignore[arg-type]
            item, where = getattr(self, name), f"{cls.__name__}: {name}"
            if isinstance(kind, tuple):
                one_of(where, item, kind)
            elif item is None:  # left out, as its annotation allows
                continue
            elif kind is float and math.isnan(number(where, item, finite=False)):
                raise ArgumentError(f"{where} must be a number, got nan")
            elif kind == FloatArray:
                array = real_numbers(where, item)
                if np.isnan(array).any():
                    raise ArgumentError(f"{where} must be real numbers, got NaN among them")
                object.__setattr__(self, name, read_only(array))
            elif kind is not float:
                instance(where, item, kind)
        settled(self)

    made.__post_init__ = checked  # type: ignore[attr-defined]
    return made


@functools.cache
def _checked_fields(cls: type) -> list[tuple[str, Any]]:
    """Return the fields that are numbers (float), arrays, records, or words out of a few (these words)."""
    out: list[tuple[str, Any]] = []
    for name, kind in get_type_hints(cls).items():
        parts = [part for part in get_args(kind) if part is not types.NoneType]
        if get_origin(kind) in (Union, types.UnionType) and len(parts) == 1:
            [kind] = parts
        if get_origin(kind) is Literal and isinstance(parts[0], str):
            out.append((name, tuple(parts)))
        elif kind in (float, FloatArray) or dataclasses.is_dataclass(kind):
            out.append((name, kind))
    return out
