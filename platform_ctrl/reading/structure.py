"""Keys and types by pydantic, its errors turned into our mistakes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache, partial
from typing import Any, TypeVar, get_args

from annotated_types import MaxLen
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from platform_ctrl.arguments import nearest
from platform_ctrl.reading.fields import Expected
from platform_ctrl.reading.mistakes import Mistake, Path, given, suggestion

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
