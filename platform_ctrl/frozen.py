"""Frozen values: what one stage hands to the next, and nobody writes into."""

from __future__ import annotations

import copy
import dataclasses
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
    for field in dataclasses.fields(self):
        item = getattr(self, field.name)
        if isinstance(item, np.ndarray) and (item.flags.writeable or item.base is not None):
            frozen = item.copy()
            frozen.flags.writeable = False
            object.__setattr__(self, field.name, frozen)


def _set_state(self: Any, state: list[Any]) -> None:
    for field, item in zip(dataclasses.fields(self), state, strict=True):
        object.__setattr__(self, field.name, item)
    # Unpickled arrays come back writeable: freeze them again.
    _freeze_arrays(self)


def _get_state(self: Any) -> list[Any]:
    return [getattr(self, field.name) for field in dataclasses.fields(self)]


def _deep_copy(self: Any, memo: dict[int, Any]) -> Any:
    new = object.__new__(type(self))
    _set_state(new, copy.deepcopy(_get_state(self), memo))
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
