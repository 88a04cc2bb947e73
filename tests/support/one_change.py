"""Values that differ from another one in a single place, for tests of what a hash covers."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

import control
import numpy as np

Place = tuple[str | int, ...]


def leaves(item: Any, path: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Walk everything that a value consists of: numbers, names, flags, and what is left out."""
    if dataclasses.is_dataclass(item):
        for field in dataclasses.fields(item):
            if field.init:
                yield from leaves(getattr(item, field.name), (*path, field.name))
    elif isinstance(item, Mapping):
        for key, one in item.items():
            yield from leaves(one, (*path, key))
    elif isinstance(item, tuple | list):
        for k, one in enumerate(item):
            yield from leaves(one, (*path, k))
    else:
        yield path, item


def other(item: Any) -> Any:
    """Return another value of the same kind, a number as little away as doubles can be."""
    match item:
        case bool():
            return not item
        case int():
            return item + 1
        case float() if not math.isfinite(item):
            return 1.0
        case float():
            return float(np.nextafter(item, 0.0)) if item else 5e-324
        case str():
            return item + "'"
        case None:
            return 0.5
        case np.ndarray():
            out = item.copy() if item.size else np.zeros(1)
            out.flat[-1] = other(out.flat[-1].item())
            return out
        case complex():
            return complex(item.real, other(item.imag))
        case control.StateSpace():
            matrices = (item.A, item.B, item.C, other(item.D))
            labels = (item.input_labels, item.output_labels, item.state_labels)
            names = dict(zip(("inputs", "outputs", "states"), labels, strict=True))
            return control.StateSpace(*matrices, item.dt, name=item.name, remove_useless_states=False, **names)
    raise AssertionError(type(item))


def mutated(item: Any, path: Place) -> Any:
    """Return `item` with another value at a place; whether that makes sense is not judged."""
    if not path:
        return other(item)
    at, rest = path[0], path[1:]
    if dataclasses.is_dataclass(item):
        new = copy.copy(item)
        object.__setattr__(new, str(at), mutated(getattr(item, str(at)), rest))
        return new
    if isinstance(item, Mapping):
        return {key: mutated(one, rest) if key == at else one for key, one in item.items()}
    return tuple(mutated(one, rest) if k == at else one for k, one in enumerate(item))
