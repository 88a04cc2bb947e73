"""Arguments against annotations: a value of another kind than the one annotated is refused in a sentence.

What is checked here is the kind (a number, a vector or matrix of numbers, a system, a word among several); shapes and
ranges are checked where they are known. Names that are imported for type checkers only, such as ``control.StateSpace``,
are compared by name: nothing is loaded.
"""

from __future__ import annotations

import builtins
import collections.abc
import dataclasses
import functools
import inspect
import math
import os
import sys
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Annotated, Any, Literal, NamedTuple, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np
import numpy.typing

from platform_ctrl.errors import ArgumentError

P = ParamSpec("P")
R = TypeVar("R")

# Characters of a given value that a message shows.
LONGEST = 60
# Their numbers are looked at every time.
_OF_NUMBERS = (float, np.ndarray, list, tuple)
# No whole number beyond what compiled code and random generators take.
LARGEST = 2**63


def short(given: object) -> str:
    """Return what was given as a line that fits a message."""
    text = " ".join(repr(given).split())
    if len(text) <= LONGEST and " at 0x" not in text:
        return text
    if isinstance(given, np.ndarray):
        return f"an array of shape {given.shape}{'' if given.dtype.kind in 'biufc' else ' of ' + given.dtype.name}"
    if " at 0x" in text or not isinstance(given, str | bytes | list | tuple | Mapping):
        return f"the class {given.__name__}" if isinstance(given, type) else f"a {type(given).__name__}"
    return text[: LONGEST - 3] + "..."


class Kind(NamedTuple):
    """What is expected, in words, and whether a value is that; of a sequence, what each of its items is."""

    words: str
    holds: Callable[[Any], bool]
    items: Any = None
    # Classes whose instances are all of this kind, where that is so: found as they come.
    classes: set[type] | None = None


def check_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function refuse arguments of another kind than annotated, and NaN, with an `ArgumentError`."""
    return _checked(function, nan=False)


def check_kinds(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function refuse arguments of another kind than annotated; NaN is allowed."""
    return _checked(function, nan=True)


def _checked(function: Callable[P, R], nan: bool) -> Callable[P, R]:
    parameters = list(inspect.signature(function).parameters.values())
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    further = next((p.name for p in parameters if p.kind == p.VAR_KEYWORD), "")

    @functools.cache
    def kinds() -> tuple[dict[str, Kind], Kind | None]:
        annotations = {p.name: p.annotation for p in parameters if p.kind != p.VAR_POSITIONAL}
        found = _kinds(annotations, function.__module__)
        return found, found.pop(further, None)

    @functools.wraps(function)
    def checking(*args: P.args, **kwargs: P.kwargs) -> R:
        expected, others = kinds()
        for name, given in zip(names, args, strict=False):
            kind = expected.get(name, others)
            if kind is not None and not (kind.classes and type(given) in kind.classes):
                _judge(name, kind, given, nan)
        for name, given in kwargs.items():
            kind = expected.get(name, others)
            if kind is not None and not (kind.classes and type(given) in kind.classes):
                _judge(name, kind, given, nan)
        return function(*args, **kwargs)

    return checking


def _judge(name: str, kind: Kind, given: object, nan: bool) -> None:
    if not (kind.holds(given) and (nan or not _nan(given))):
        raise ArgumentError(_refusal(name, kind, given))
    if kind.classes is not None and not isinstance(given, _OF_NUMBERS):
        kind.classes.add(type(given))


def check_fields(given: Any) -> None:
    """Judge the fields of a dataclass against their annotations."""
    cls: Any = type(given)
    for name, kind in _field_kinds(cls).items():
        item = getattr(given, name)
        if not kind.holds(item) or _nan(item):
            raise ArgumentError(f"{cls.__name__}: {_refusal(name, kind, item)}")


@functools.cache
def array_fields(cls: Any) -> tuple[str, ...]:
    """Return the fields of a dataclass that are arrays of real numbers, or None."""
    array = _ARRAYS["float64"].words
    return tuple(name for name, kind in _field_kinds(cls).items() if kind.words in (array, f"{array} or None"))


@functools.cache
def _field_kinds(cls: Any) -> dict[str, Kind]:
    found: dict[str, Kind] = {}
    for field in dataclasses.fields(cls):
        home = next(base for base in cls.__mro__ if field.name in inspect.get_annotations(base))
        found |= _kinds({field.name: field.type}, home.__module__)
    return found


def _kinds(annotations: Mapping[str, Any], module: str) -> dict[str, Kind]:
    names = _Names(vars(sys.modules[module]))
    found = {}
    for name, annotation in annotations.items():
        if annotation is not inspect.Parameter.empty:
            kind = _kind(eval(annotation, {}, names) if isinstance(annotation, str) else annotation, names)
            if kind is not None:
                found[name] = kind
    return found


class _ByName(type):
    """Classes that stand for others of the same name."""

    def __instancecheck__(cls, given: object) -> bool:
        return any(base.__name__ == cls.__name__ for base in type(given).__mro__)


class _Module:
    """A module that is imported for type checkers only: python-control; the kinds of its systems are checked later."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> type:
        kind = "InputOutputSystem" if self._name == "control" else name
        return _ByName(kind, (), {"words": f"a {self._name}.{name}"})


class _Numbers:
    """Numpy's ArrayLike in annotations."""


class _Names(dict[str, Any]):
    """The names of a module, those that are there for type checkers only among them."""

    def __getitem__(self, name: str) -> Any:
        if name == "ArrayLike":  # a union itself: within another one it could not be distinguished from its parts
            return _Numbers
        found = super().__getitem__(name)
        return eval(found, {}, self) if isinstance(found, str) else found  # an alias

    def __missing__(self, name: str) -> Any:
        if name.startswith("__"):
            raise KeyError(name)
        for module in (builtins, collections.abc, typing, numpy.typing):
            if hasattr(module, name):
                return getattr(module, name)
        if name == "FloatArray":
            return numpy.typing.NDArray[np.float64]
        return _Module(name) if name[0].islower() else _ByName(name, (), {})


# Where a value comes from that users often replace by its name or by the value before it.
_SOURCES = {"Platform": ", for example from read_platform", "LinearModel": ", from linearise(platform)"}


def _kind(annotation: object, names: _Names) -> Kind | None:
    """Return what an annotation allows; None: anything."""
    while isinstance(annotation, str | typing.ForwardRef):
        annotation = eval(annotation if isinstance(annotation, str) else annotation.__forward_arg__, {}, names)
    if annotation is Any or annotation is object:
        return None
    if annotation in _PLAIN:
        plain: Kind = _PLAIN[annotation]
        return plain
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(parts[0], names)
    if origin is Literal:
        return Kind(
            _either([repr(part) for part in parts]), lambda given: isinstance(given, str | int) and given in parts
        )
    if origin in (Union, types.UnionType):
        like = get_args(numpy.typing.ArrayLike)
        if set(like) <= set(parts):  # an alias of a union with ArrayLike
            parts = (_Numbers, *(part for part in parts if part not in like))
        return _union([_kind(part, names) for part in parts])
    if origin is np.ndarray:
        dtype = next(iter(get_args(parts[1])), None) if len(parts) > 1 else None
        found: Kind = _ARRAYS.get(getattr(dtype, "__name__", ""), _ANY_ARRAY)
        return found
    if isinstance(origin, type) and issubclass(origin, os.PathLike):
        return Kind("a path", lambda given: isinstance(given, os.PathLike))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _mapping(*(_kind(part, names) for part in parts))
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return _sequence(
            [_kind(part, names) for part in parts if part is not ...], fixed=origin is tuple and ... not in parts
        )
    if origin is Callable:
        return Kind("a function", lambda given: callable(given) and not hasattr(given, "ninputs"))  # no system
    if isinstance(annotation, type) and getattr(annotation, "_is_protocol", False):
        members = [name for name in vars(annotation) if name[0] != "_" or name == "__call__"]
        return Kind(f"of kind {annotation.__name__}", lambda given: all(hasattr(given, name) for name in members))
    if isinstance(annotation, type):
        name = annotation.__name__
        words: str = annotation.__dict__.get("words", f"an {name}" if name[0] in "AEIOU" else f"a {name}")
        words += _SOURCES.get(name, "")
        return Kind(words, lambda given: isinstance(given, annotation), classes=set())
    return None


def _refusal(name: str, kind: Kind, given: object) -> str:
    if kind.holds(given) and not isinstance(given, float):
        return f"{name} must be {kind.words}, all finite, got one that is not"
    if isinstance(given, list | tuple) and kind.items is not None:
        wrong = next((item for item in given if not kind.items.holds(item)), given)
        among = "names" if kind.items is _PLAIN[str] else "items"
        return f"{name} must be {kind.words}, got {short(wrong)} among the {among}"
    text = f"the string {given!r}" if isinstance(given, str) and "a sequence" in kind.words else short(given)
    return f"{name} must be {kind.words}, got {text}"


def _number(given: object) -> bool:
    if isinstance(given, np.ndarray):
        return given.ndim == 0 and given.dtype.kind in "iuf"
    if isinstance(given, int):
        return not isinstance(given, bool) and abs(given) <= sys.float_info.max
    return isinstance(given, Real)


def _whole(given: object) -> bool:
    return isinstance(given, int | np.integer) and not isinstance(given, bool) and abs(int(given)) < LARGEST


def _array(kinds: str, given: object) -> bool:
    return isinstance(given, np.ndarray) and given.dtype.kind in kinds


def _like(kinds: str, given: object) -> bool:
    try:
        return np.asarray(given).dtype.kind in kinds
    except Exception:  # what numpy calls to read an object of another library may raise anything
        return False


def _nan(given: object) -> bool:
    if isinstance(given, float):
        return math.isnan(given)
    if isinstance(given, np.ndarray):
        return given.dtype.kind in "fc" and bool(np.isnan(given).any())
    return isinstance(given, list | tuple) and any(_nan(item) for item in given)


_PLAIN: dict[Any, Kind] = {
    None: Kind("None", lambda given: given is None, classes=set()),
    types.NoneType: Kind("None", lambda given: given is None, classes=set()),
    _Numbers: Kind("real numbers", functools.partial(_like, "biufc")),
    float: Kind("a number", _number),
    int: Kind("a whole number", _whole),
    str: Kind("a string", lambda given: isinstance(given, str), classes=set()),
    bool: Kind("True or False", lambda given: isinstance(given, bool | np.bool_), classes=set()),
}
_ANY_ARRAY = Kind("an array", lambda given: isinstance(given, np.ndarray))
_ARRAYS: dict[str, Kind] = {
    "float64": Kind("an array of real numbers", functools.partial(_array, "iuf")),
    "complex128": Kind("an array of numbers", functools.partial(_array, "iufc")),
    "bool": Kind("an array of booleans", functools.partial(_array, "b")),
    "bool_": Kind("an array of booleans", functools.partial(_array, "b")),
    "int64": Kind("an array of whole numbers", functools.partial(_array, "iu")),
}


def _either(words: Sequence[str]) -> str:
    *first, last = dict.fromkeys(words)
    return f"{', '.join(first)} or {last}" if first else last


def _union(kinds: Sequence[Kind | None]) -> Kind | None:
    known = [kind for kind in kinds if kind is not None]
    if len(known) < len(kinds):
        return None
    holds = [kind.holds for kind in known]
    words = [word for kind in known for word in (("True", "False") if kind is _PLAIN[bool] else (kind.words,))]
    items = next((kind.items for kind in known if kind.items is not None), None)
    classes: set[type] | None = set() if all(kind.classes is not None for kind in known) else None
    return Kind(_either(words), lambda given: any(hold(given) for hold in holds), items, classes)


def _mapping(key: Kind | None = None, item: Kind | None = None) -> Kind:
    def holds(given: Any) -> bool:
        return isinstance(given, Mapping) and all(
            (key is None or key.holds(k)) and (item is None or item.holds(v)) for k, v in given.items()
        )

    return Kind("a dictionary" if item is None else f"a dictionary whose values are each {item.words}", holds)


def _sequence(items: Sequence[Kind | None], fixed: bool) -> Kind:
    numbers = not items or items[0] in (None, _PLAIN[int], _PLAIN[float], _PLAIN[str])

    def holds(given: Any) -> bool:
        array = isinstance(given, np.ndarray) and given.ndim > 0 and given.size > 0 and numbers
        if isinstance(given, str | bytes) or not (array or isinstance(given, Sequence)):
            return False
        if fixed:
            return len(given) == len(items) and all(k is None or k.holds(x) for k, x in zip(items, given, strict=True))
        return not items or items[0] is None or all(items[0].holds(item) for item in given)

    words = [] if not items or items[0] is None else [kind.words for kind in items if kind is not None]
    if fixed:
        return Kind(f"({', '.join(words)})", holds)
    if items and items[0] is _PLAIN[str]:
        return Kind("a sequence of names", holds, items[0])
    return Kind(f"a sequence, each {words[0]}", holds, items[0]) if words else Kind("a sequence", holds)
