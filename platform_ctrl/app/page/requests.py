"""The requests of a page: every message is checked before anything is done with it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError

# Characters of a message, sliders moved by one, and the largest count of either.
LONGEST = 20_000
MOVES = 64
LARGEST_COUNT = 2**53

# Every request, and what belongs to it.
REQUESTS: Mapping[str, Mapping[str, type]] = {
    "ready": {},
    "dark": {"dark": bool},
    "move": {"moves": list, "gesture": int},
    "fix": {"slider": str, "fixed": bool},
    "free": {"free": bool},
    "part": {"part": str, "on": bool},
    "reset": {"slider": str},
    "set": {"name": str, "value": object},
    "undo": {},
    "redo": {},
    "tune": {},
    "cancel": {},
    "save": {"name": str, "overwrite": bool},
    "simulate": {"manoeuvre": str},
}
_WORDS = {bool: "true or false", int: "a whole number", str: "a text", list: "a list"}


@value
class Request:
    """A message of a page.

    Attributes
    ----------
    count
        The page's count of its messages; the answer names it.
    what
        One of `REQUESTS`.
    more
        What belongs to it, of the right types.
    """

    count: int
    what: str
    more: dict[str, Any]


def parse_request(message: object) -> Request:
    """Return a message of a page, judged."""
    if not isinstance(message, str) or len(message) > LONGEST:
        raise InputError(f"the page sent {short(message)}; expected a JSON text of at most {LONGEST} characters")
    try:
        read = json.loads(message, parse_constant=_no_constant)
    except (ValueError, RecursionError):
        raise InputError(f"the page sent {short(message)}; expected JSON with finite numbers") from None
    what = read.get("what") if isinstance(read, dict) else None
    if not isinstance(what, str) or what not in REQUESTS:
        raise InputError(f"the page requested {short(what)}; expected one of {', '.join(REQUESTS)}")
    more = {}
    for name, kind in REQUESTS[what].items():
        more[name] = _of_kind(f"{what}: {name}", read.get(name), kind)
    if what == "move":
        more["moves"] = tuple(_move(one) for one in _few(more["moves"]))
    count = _of_kind(f"{what}: n", read.get("n"), int)
    if not 0 <= count <= LARGEST_COUNT:
        raise InputError(f"{what}: n: given {short(count)}; expected a count")
    return Request(count=count, what=what, more=more)


def request_count(message: object) -> int | None:
    """Return the count of a message, also of one that makes no sense otherwise: it has to be answered."""
    try:
        read = json.loads(message) if isinstance(message, str) and len(message) <= LONGEST else None
    except (ValueError, RecursionError):
        return None
    count = read.get("n") if isinstance(read, dict) else None
    return count if isinstance(count, int) and not isinstance(count, bool) and 0 <= count <= LARGEST_COUNT else None


def number(name: str, given: object) -> float:
    """Return a finite number."""
    try:
        out = float(given) if isinstance(given, int | float) and not isinstance(given, bool) else math.nan
    except OverflowError:
        out = math.inf
    if not math.isfinite(out):
        raise InputError(f"{name}: given {short(given)}; expected a finite number")
    return out


def _of_kind(name: str, given: object, kind: type) -> Any:
    if not isinstance(given, kind) or (kind is int and isinstance(given, bool)):
        raise InputError(f"{name}: given {short(given)}; expected {_WORDS[kind]}")
    return given


def _few(moves: list[Any]) -> list[Any]:
    if len(moves) > MOVES:
        raise InputError(f"move: given {len(moves)} moves; expected at most {MOVES}")
    return moves


def _move(one: object) -> tuple[str, float]:
    if not isinstance(one, dict):
        raise InputError(f"move: given {short(one)}; expected a slider and its number")
    slider = _of_kind("move: slider", one.get("slider"), str)
    return slider, number(slider, one.get("value"))


def _no_constant(text: str) -> float:
    raise ValueError(text)
