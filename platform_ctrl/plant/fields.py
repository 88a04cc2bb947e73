"""How single values are judged: numbers, names, vectors, inertias. The words that a message expects come along."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cache, partial
from typing import Annotated, Any, TypeVar, get_args

import numpy as np
from annotated_types import MaxLen
from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from platform_ctrl.common.arguments import nearest
from platform_ctrl.common.values import FloatArray, read_only
from platform_ctrl.plant.mistakes import Mistake, Path, given, suggestion

# Relative rounding that a printed number may carry: symmetry, the triangle inequality, C = 2 A.
ROUNDING = 1e-9

# No platform has numbers beyond these, and products of a few of them neither overflow nor vanish.
SMALLEST, LARGEST = 1e-50, 1e50


class Unfit(Exception):
    """A value is refused; the text says what is wrong with it beyond not being what was expected."""


class Expected:
    """Annotation of a key: `judge` returns the value or raises `Unfit`; `words` name what is expected."""

    def __init__(self, words: str | Callable[[], str], judge: Callable[[Any], Any]) -> None:
        self._words = words
        self.judge = judge

    @property
    def words(self) -> str:
        """What is expected, as messages say it."""
        return self._words if isinstance(self._words, str) else self._words()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let pydantic ask `judge` alone."""
        return core_schema.no_info_plain_validator_function(self._validate)

    def _validate(self, item: object) -> Any:
        try:
            return self.judge(item)
        except Unfit as error:
            detail = f"{error}; " if str(error) else ""
            raise ValueError(f"{detail}expected {self.words}") from None


def number(item: object) -> float:
    """Return a float that is 0 or of a magnitude that something can have."""
    out = finite(item)
    if abs(out) > LARGEST:
        raise Unfit(f"larger than {LARGEST:g}")
    if 0.0 < abs(out) < SMALLEST:
        raise Unfit(f"smaller than {SMALLEST:g} and not 0")
    return out


def finite(item: object) -> float:
    """Return a finite float."""
    if isinstance(item, bool) or not isinstance(item, int | float):
        raise Unfit
    try:
        out = float(item)
    except OverflowError:
        raise Unfit("too large for a floating-point number") from None
    if not math.isfinite(out):
        raise Unfit("not finite")
    return out


def _number(fits: Callable[[float], bool]) -> Callable[[object], float]:
    def judge(item: object) -> float:
        out = number(item)
        if not fits(out):
            raise Unfit
        return out

    return judge


def integer(lowest: int, highest: int) -> Callable[[object], int]:
    """Return the judge of an integer between two bounds."""

    def judge(item: object) -> int:
        if isinstance(item, bool) or not isinstance(item, int) or not lowest <= item <= highest:
            raise Unfit
        return item

    return judge


def numbers(item: object, count: int, judge: Callable[[object], float] = number) -> list[float]:
    """Return `count` floats that a judge accepts."""
    if not isinstance(item, list):
        raise Unfit
    if len(item) != count:
        raise Unfit(f"has {len(item)} element{'' if len(item) == 1 else 's'}")
    out = []
    for k, entry in enumerate(item):
        try:
            out.append(judge(entry))
        except Unfit as error:
            raise Unfit(f"element {k + 1}, {given(entry)}, is {str(error) or 'not a number'}") from None
    return out


def numbers_of_any_count(least: int, fits: Callable[[list[float]], bool]) -> Callable[[object], tuple[float, ...]]:
    """Return the judge of `least` finite floats or more that fit together."""

    def judge(item: object) -> tuple[float, ...]:
        if not isinstance(item, list):
            raise Unfit
        found = numbers(item, len(item))
        if len(found) < least:
            raise Unfit(f"has {len(item)} element{'' if len(item) == 1 else 's'}")
        if not fits(found):
            raise Unfit
        return tuple(found)

    return judge


def _increasing(found: list[float]) -> bool:
    return all(x < y for x, y in itertools.pairwise(found))


def text(item: object) -> str:
    """Return a line of text that is not empty."""
    if not isinstance(item, str):
        raise Unfit
    if not item.strip():
        raise Unfit("empty")
    if not item.isprintable():
        raise Unfit("holds characters that cannot be printed")
    return item


def _system_name(item: object) -> str:
    """Return a text that may name a `control.StateSpace`."""
    name = text(item)
    if "." in name:
        raise Unfit("has a full stop, which no controller's name may have")
    return name


def _any_text(item: object) -> str:
    if not isinstance(item, str):
        raise Unfit
    return item


def _truth(item: object) -> bool:
    if not isinstance(item, bool):
        raise Unfit
    return item


def one_of(names: Collection[str]) -> Expected:
    """Return the annotation of a key that takes one of a few words; names that are added later count, too."""

    def judge(item: object) -> str:
        if isinstance(item, str) and item in names:
            return item
        raise Unfit

    return Expected(lambda: " or ".join(f'"{name}"' for name in names), judge)


def vector(item: object) -> FloatArray:
    """Return a vector, which may be zero."""
    return read_only(numbers(item, 3))


def coulomb(item: object) -> tuple[float, float]:
    """Return the dry friction against negative and against positive rates."""
    low, high = numbers(item, 2) if isinstance(item, list) else (number(item), number(item))
    if min(low, high) < 0:
        raise Unfit("negative")
    return low, high


def axis(item: object) -> FloatArray:
    """Return a unit vector."""
    given_axis = numbers(item, 3, finite)
    largest = max(map(abs, given_axis))
    if largest == 0:
        raise Unfit("of length zero")
    scaled = [entry / largest for entry in given_axis]  # its length neither overflows nor vanishes
    return read_only([entry / math.hypot(*scaled) for entry in scaled])


def inertia(item: object) -> FloatArray:
    """Return the 3 x 3 inertia matrix of a body that can exist."""
    if isinstance(item, list) and item and all(isinstance(row, list) for row in item):
        if len(item) != 3:
            raise Unfit(f"has {len(item)} row{'' if len(item) == 1 else 's'}")
        rows = []
        for k, row in enumerate(item):
            try:
                rows.append(numbers(row, 3))
            except Unfit as error:
                raise Unfit(f"row {k + 1} {error}") from None
        matrix = np.array(rows)
        # A singular matrix has eigenvalues of rounding size, not zero.
        zero = 1e-12
    else:
        matrix = np.diag(numbers(item, 3))
        zero = 0.0
    largest = np.abs(matrix).max()
    if largest == 0:
        raise Unfit("not positive definite (for a frame without mass take a millionth of what it carries)")
    scaled = matrix / largest
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if abs(scaled[i, j] - scaled[j, i]) > ROUNDING:
            raise Unfit(f"not symmetric, element ({i + 1}, {j + 1}) differs from ({j + 1}, {i + 1})")
    symmetric = (scaled + scaled.T) / 2
    low, middle, high = np.sort(np.diag(symmetric)) if zero == 0 else np.linalg.eigvalsh(symmetric)
    if low <= zero:
        raise Unfit(f"not positive definite, its smallest principal moment is {low * largest:.4g}")
    if high > (low + middle) * (1 + ROUNDING):
        raise Unfit(
            f"no body has it, the principal moment {high * largest:.4g} exceeds the sum of the others, "
            f"{low * largest:.4g} + {middle * largest:.4g}"
        )
    return read_only(matrix / 2 + matrix.T / 2)


def stops(item: object) -> tuple[float, float]:
    """Return the lowest and the highest angle."""
    low, high = numbers(item, 2)
    if not low < high:
        raise Unfit("the lower is not below the upper")
    if not low <= 0 <= high:
        raise Unfit("0 is not between them")
    return low, high


def _rates(item: object) -> FloatArray:
    rates = numbers(item, 3)
    if min(rates) < 0:
        raise Unfit
    return read_only(rates)


def _names(item: object) -> tuple[str, ...]:
    if not isinstance(item, list) or not all(isinstance(name, str) for name in item):
        raise Unfit
    return tuple(item)


def _plant(item: object) -> Any:
    return item if isinstance(item, dict) else text(item)


NUMBER = Expected("a number", number)
POSITIVE = Expected("a number > 0", _number(lambda x: x > 0))
NOT_NEGATIVE = Expected("a number >= 0", _number(lambda x: x >= 0))

Number = Annotated[float, NUMBER]
Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, NOT_NEGATIVE]
Text = Annotated[str, Expected("a name: a line of text that is not empty", text)]
SystemName = Annotated[str, Expected("a name: a line of text that is not empty, without full stops", _system_name)]
AnyText = Annotated[str, Expected("a text", _any_text)]
Truth = Annotated[bool, Expected("true or false", _truth)]
SchemaOne = Annotated[int, Expected("1, the format that this version reads", integer(1, 1))]
RootAxis = Annotated[int, Expected("1, 2 or 3", integer(1, 3))]
Axis = Annotated[FloatArray, Expected("a vector of three numbers that is not zero", axis)]
Vector = Annotated[FloatArray, Expected("three numbers", vector)]
Coulomb = Annotated[
    tuple[float, float], Expected("a torque >= 0, N m, or two: against negative and positive rates", coulomb)
]
Inertia = Annotated[FloatArray, Expected("three principal moments > 0 or a symmetric 3 x 3 matrix, kg m2", inertia)]
Stops = Annotated[tuple[float, float], Expected("[lower, upper] with 0 between them", stops)]
NotZero = Annotated[float, Expected("a number other than 0", _number(lambda x: x != 0))]
Frequency = Annotated[float, Expected("a number > 0, Hz", _number(lambda x: x > 0))]
Share = Annotated[float, Expected("a number from 0 to 0.9", _number(lambda x: 0 <= x <= 0.9))]
Part = Annotated[float, Expected("a share from 0 to 1", _number(lambda x: 0 <= x <= 1))]
SomePart = Annotated[float, Expected("a share > 0, up to 1", _number(lambda x: 0 < x <= 1))]
Samples = Annotated[int, Expected("a whole number from 0 to 1000", integer(0, 1000))]
GridPoints = Annotated[int, Expected("a whole number from 2 to 9", integer(2, 9))]
Seed = Annotated[int, Expected("a whole number >= 0", integer(0, 2**63 - 1))]
Rates = Annotated[FloatArray, Expected("the largest rate about each root axis, three numbers >= 0, rad/s", _rates)]
Numbers = Annotated[tuple[float, ...], Expected("one or more numbers", numbers_of_any_count(1, lambda found: True))]
Times = Annotated[
    tuple[float, ...], Expected("two or more times that increase, s", numbers_of_any_count(2, _increasing))
]
Frequencies = Annotated[
    tuple[float, ...],
    Expected(
        "two or more frequencies > 0 that increase, Hz",
        numbers_of_any_count(2, lambda found: found[0] > 0 and _increasing(found)),
    ),
]
Densities = Annotated[
    tuple[float, ...],
    Expected("a density > 0 for each frequency", numbers_of_any_count(1, lambda found: min(found) > 0)),
]
Lines = Annotated[int, Expected("a whole number from 1 to 4096", integer(1, 4096))]
Runs = Annotated[int, Expected("a whole number from 1 to 2^30", integer(1, 2**30))]
Names = Annotated[tuple[str, ...], Expected("a list of names", _names)]
Plant = Annotated[
    str | dict[str, Any], Expected("the name of a shipped model, a path relative to this file, or a table", _plant)
]


# Keys of a table at most: no format has half as many.
MOST_KEYS = 500


class Table(BaseModel):
    """A table of an input file: no key beyond those named here."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, arbitrary_types_allowed=True)


AnyTable = TypeVar("AnyTable", bound=Table)


def overfull(model: type[BaseModel], data: object, path: Path = ()) -> Iterator[Mistake]:
    """Walk the tables that have more keys, and the arrays of tables that have more of them, than may be judged."""
    if not isinstance(data, dict):
        return
    if len(data) > MOST_KEYS:
        yield Mistake((*path, next(iter(data))), f"has {len(data)} keys; expected at most {MOST_KEYS}")
        return
    for key, field in _fields(model).items():
        item, kinds = data.get(key), _tables_in(field)
        if not kinds:
            continue
        most = next((mark.max_length for mark in field.metadata if isinstance(mark, MaxLen)), None)
        if most is not None and isinstance(item, list) and len(item) > most:
            yield Mistake((*path, key), f"{key}: has {len(item)} elements; expected at most {most}")
        elif isinstance(item, list):
            for k, entry in enumerate(item):
                yield from overfull(kinds[0], entry, (*path, key, k))
        else:
            yield from overfull(kinds[0], item, (*path, key))


def structure(model: type[AnyTable], data: dict[str, Any]) -> tuple[AnyTable | None, list[Mistake]]:
    """Return `data` as `model`, or None and what is wrong with its keys and values."""
    try:
        return model.model_validate(data), []
    except ValidationError as error:
        found = error.errors(include_url=False)
    missing = dict.fromkeys(tuple(e["loc"]) for e in found if e["type"] == "missing")
    unknown = Counter(tuple(e["loc"][:-1]) for e in found if e["type"] == "extra_forbidden")
    mistakes = []
    for e in found:
        path: Path = tuple(e["loc"])
        if e["type"] == "extra_forbidden":
            known = keys_of(_model_at(model, path[:-1]))
            # A misspelt key is one mistake, not an unknown one and a missing one.
            if unknown[path[:-1]] <= len(known):
                missing.pop((*path[:-1], nearest(str(path[-1]), known) or ""), None)
            mistakes.append(unknown_key(path, e["input"], known))
        elif e["type"] != "missing":
            mistakes.append(Mistake(path, partial(_wrong_value, path, e["input"], e["type"], e.get("ctx", {}))))
    for path in missing:
        field = _fields(_model_at(model, path[:-1]))[str(path[-1])]
        mistakes.append(Mistake(path, _missing(path, field)))
    return None, mistakes


def unknown_key(path: Path, item: object, known: list[str]) -> Mistake:
    """Return the mistake of a key or table that nobody knows."""

    def words() -> str:
        is_table = isinstance(item, Mapping) or (isinstance(item, list) and any(isinstance(x, Mapping) for x in item))
        what = "table" if is_table else "key"
        return f"unknown {what} {given(path[-1])}; {suggestion(str(path[-1]), known)}"

    return Mistake(path, words)


def keys_of(model: type[BaseModel]) -> list[str]:
    """Return the keys of a table as the file spells them."""
    return list(_fields(model))


@cache
def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _model_at(model: type[BaseModel], path: Path) -> type[BaseModel]:
    for step in path:
        if isinstance(step, str):
            model = _tables_in(_fields(model)[step])[0]
    return model


def _tables_in(field: FieldInfo) -> list[type[BaseModel]]:
    """Return the table that a field holds, alone or in an array; nothing for a plain value."""
    kinds = [field.annotation, *get_args(field.annotation)]
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _missing(path: Path, field: FieldInfo) -> str:
    words = [mark.words for mark in field.metadata if isinstance(mark, Expected)]
    if words:
        return f'missing key "{path[-1]}": expected {words[0]}'
    is_array = field.annotation is not _tables_in(field)[0]
    return f"missing table {f'[[{_header(path)}]]' if is_array else f'[{_header(path)}]'}"


def _header(path: Path) -> str:
    return ".".join(step for step in path if isinstance(step, str))


def _wrong_value(path: Path, item: object, kind: str, context: Mapping[str, Any]) -> str:
    key = next(step for step in reversed(path) if isinstance(step, str))
    match kind:
        case "value_error":
            return f"{key} = {given(item)}: {context['error']}"
        case "list_type":
            return f"{key} = {given(item)}: expected an array of tables, each headed [[{_header(path)}]]"
        case "too_short":
            return f"{key} = {given(item)}: expected at least one [[{_header(path)}]]"
        case _:
            return f"{key} = {given(item)}: expected a table"
