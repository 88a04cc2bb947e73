"""Frozen values: what one stage hands to the next, and nobody writes into."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

T = TypeVar("T")


def read_only(array: object) -> FloatArray:
    """Return a float64 copy of `array` that cannot be written to."""
    out = np.array(array, dtype=np.float64, copy=True)
    out.flags.writeable = False
    return out


def _freeze_arrays(self: Any) -> None:
    for name in self.__dataclass_fields__:
        item = getattr(self, name)
        if isinstance(item, np.ndarray) and (item.flags.writeable or item.base is not None):
            frozen = item.copy()
            frozen.flags.writeable = False
            object.__setattr__(self, name, frozen)


def _set_state(self: Any, state: list[Any]) -> None:
    for name, item in zip(self.__dataclass_fields__, state, strict=True):
        object.__setattr__(self, name, item)
    # Unpickled arrays come back writeable: freeze them again.
    _freeze_arrays(self)


def _get_state(self: Any) -> list[Any]:
    return [getattr(self, name) for name in self.__dataclass_fields__]


def _deep_copy(self: Any, memo: dict[int, Any]) -> Any:
    new = object.__new__(type(self))
    _set_state(new, copy.deepcopy(_get_state(self), memo))
    return new


def replaced(item: T, changes: Mapping[str, Any]) -> T:
    """Return a value with other items under the names of fields: `dataclasses.replace`, faster."""
    new = object.__new__(type(item))
    for name in item.__dataclass_fields__:  # type: ignore[attr-defined]  # of `value`, which makes a dataclass
        object.__setattr__(new, name, changes[name] if name in changes else getattr(item, name))
    new.__post_init__()  # type: ignore[attr-defined]
    return new


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
def value(cls: type[T]) -> type[T]:
    """Make `cls` a frozen dataclass with slots whose arrays are read-only.

    Equality is identity: the `==` that dataclasses generate raises on arrays. Pickle and deepcopy give
    writeable arrays back, so both freeze again.
    """
    if "__post_init__" not in cls.__dict__:
        cls.__post_init__ = _freeze_arrays  # type: ignore[attr-defined]
    made = dataclasses.dataclass(frozen=True, eq=False, slots=True, kw_only=True)(cls)
    made.__setstate__ = _set_state  # type: ignore[attr-defined]
    made.__getstate__ = _get_state  # type: ignore[method-assign]
    made.__deepcopy__ = _deep_copy  # type: ignore[attr-defined]
    return made
