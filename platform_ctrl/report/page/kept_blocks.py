"""Blocks of the report that are taken from a store instead of being drawn again.

A block is drawn by a function from its arguments alone, and its key is the hash of both, of what decides about the look
and of the code: what is not in the key cannot change the picture.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib import font_manager, ft2font

from platform_ctrl.common.processes import Begun, SecondProcess, Task
from platform_ctrl.common.store import Store, key_of
from platform_ctrl.report import style
from platform_ctrl.report.page import blocks

_KINDS: dict[str, type] = {
    name: kind for name, kind in vars(blocks).items() if isinstance(kind, type) and dataclasses.is_dataclass(kind)
}


class Drawing(NamedTuple):
    """A function of a module that returns blocks, and its arguments."""

    draw: Callable[..., Any]
    arguments: tuple[Any, ...]
    title: str = "Figures"


class Ahead(NamedTuple):
    """Drawings that another process has begun, by their keys."""

    keys: list[str]
    work: Begun


def drawn_ahead(drawings: list[Drawing], store: Store, beside: SecondProcess) -> Ahead:
    """Let another process draw what is not in the store, for `kept_or_drawn`, while this one goes on."""
    keys = keys_of(drawings)
    missing = [k for k, key in enumerate(keys) if key and _taken(store, key) is None]
    return Ahead([keys[k] for k in missing], beside.begin([_task(drawings[k]) for k in missing]))


def kept_or_drawn(
    drawings: list[Drawing], store: Store | None, beside: SecondProcess | None, ahead: Ahead | None = None
) -> list[Any]:
    """Return what each function returns; what is not in the store is drawn, a part of it by another process.

    What was begun `ahead` under the same key is not drawn again.
    """
    keys = [""] * len(drawings) if store is None else keys_of(drawings)
    begun = {} if ahead is None else {key: k for k, key in enumerate(ahead.keys)}
    found = [None if key in begun else _taken(store, key) for key in keys]
    missing = [k for k, one in enumerate(found) if one is None and keys[k] not in begun]
    made = (
        [_in_style(drawings[k]) for k in missing]
        if beside is None
        else beside.results([_task(drawings[k]) for k in missing])
    )
    drawn = dict(zip(missing, made, strict=True))
    if ahead is not None and beside is not None:
        early = beside.finished(ahead.work)
        drawn |= {k: early[begun[key]] for k, key in enumerate(keys) if key in begun}
    for k, one in drawn.items():
        found[k] = one
        if store is not None and keys[k] and not blocks.missing(one):
            packed = zlib.compress(json.dumps(_written(one)).encode(), 1)
            store.keep(keys[k], base64.b64encode(packed).decode())
    return found


def _task(drawing: Drawing) -> Task:
    return _in_style, (drawing,)


def keys_of(drawings: list[Drawing]) -> list[str]:
    """Return the key of each drawing; none where an argument has values that cannot be hashed."""
    look = _look()
    known: dict[int, str] = {}
    out = []
    for draw, arguments, _ in drawings:
        try:
            for one in arguments:
                # Most of them have the same arguments.
                if id(one) not in known:
                    known[id(one)] = key_of(one)
            out.append(key_of("drawn", draw.__module__, draw.__qualname__, look, [known[id(one)] for one in arguments]))
        except TypeError:
            out.append("")
    return out


def _look() -> list[str]:
    """Return what decides about a picture beside its arguments and the code: settings and fonts."""
    with style.settings():
        settings = [f"{name} {setting!r}" for name, setting in sorted(mpl.rcParams.items())]
        fonts = [font_manager.findfont(font_manager.FontProperties(weight=weight)) for weight in ("normal", "bold")]
    return [*settings, *fonts, ft2font.__freetype_version__]


def _in_style(drawing: Drawing) -> Any:
    with style.settings():
        return blocks.attempted(drawing.title, lambda: drawing.draw(*drawing.arguments))


def _taken(store: Store | None, key: str) -> Any:
    content = store.find(key) if store is not None and key else None
    try:
        return None if content is None else _read(json.loads(zlib.decompress(base64.b64decode(content))))
    except (ValueError, TypeError, KeyError, zlib.error):
        return None


def _written(item: Any) -> Any:
    """Return blocks in the types of JSON, each with the name of its kind."""
    if dataclasses.is_dataclass(item):
        fields = {one.name: _written(getattr(item, one.name)) for one in dataclasses.fields(item)}
        return {"": type(item).__name__} | fields
    return [_written(one) for one in item] if isinstance(item, list | tuple) else item


def _read(item: Any) -> Any:
    if isinstance(item, dict):
        return _KINDS[item[""]](**{name: _read(one) for name, one in item.items() if name})
    return tuple(_read(one) for one in item) if isinstance(item, list) else item
