"""The settings of a page as text in its address."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

from platform_ctrl.app.backend import Backend
from platform_ctrl.app.settings import LARGEST, Settings
from platform_ctrl.common.arguments import short
from platform_ctrl.design.methods import METHODS
from platform_ctrl.errors import InputError, PlatformCtrlError


def encode_state(backend: Backend, settings: Settings) -> str:
    """Return settings as a short text of letters, digits, - and _ alone."""
    changed = _difference(backend.start().data(), settings.data())
    if not changed:
        return ""
    packed = zlib.compress(json.dumps(changed, separators=(",", ":"), sort_keys=True).encode(), 9)
    return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def decode_state(backend: Backend, text: str) -> Settings:
    """Return the settings of a text from `encode_state`, checked against the job."""
    if not text:
        return backend.start()
    try:
        changed = json.loads(zlib.decompress(base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))))
    except (ValueError, zlib.error, RecursionError):
        raise InputError("link: it is damaged; copy it again from the page") from None
    return checked_settings(backend, changed)


def checked_settings(backend: Backend, changed: object) -> Settings:
    """Return the job's settings with changes from outside, as plain data, checked against the job."""
    given = _merged("", backend.start().data(), changed)
    specs = {spec.name: spec for spec in backend.read.loops}
    spec = specs[_one("loop", given["loop"], specs)]
    names = [design.name for design in spec.designs]
    for loop in backend.read.loops:
        _one(f"closed {loop.name}", given["closed"][loop.name], [one.name for one in loop.designs])
        for design in loop.designs:
            for part in given["optional"][loop.name][design.name]:
                _one("part", part, METHODS[design.method].parts)
    for name in given["overlays"]:
        _one("overlay", name, names)
    if given["axis"] not in (1, 2, 3):
        raise InputError(f"state: axis must be 1, 2 or 3, got {short(given['axis'])}")
    optional = {
        loop: {name: tuple(sorted(set(parts))) for name, parts in designs.items()}
        for loop, designs in given["optional"].items()
    }
    more = {
        "axis": int(given["axis"]),
        "fixed": frozenset(given["fixed"]),
        "overlays": tuple(given["overlays"]),
        "optional": optional,
    }
    try:
        settings = backend.chosen(Settings(**(given | more)), design=_one("design", given["design"], names))
        backend.check_names(settings)
    except PlatformCtrlError as error:
        raise InputError(f"state: {error}") from None
    return settings


def _merged(where: str, known: Any, given: object) -> Any:
    """Return known plain data with those that are given in their place, of the same kinds; numbers are positive."""
    if isinstance(known, Mapping):
        if not isinstance(given, Mapping):
            raise InputError(f"state: {where or 'it'} must be a table, got {short(given)}")
        for name in given:
            _one(where or "key", name, known)
        return {name: _merged(name, item, given[name]) if name in given else item for name, item in known.items()}
    if isinstance(known, list):
        if not isinstance(given, list) or not all(isinstance(one, str) for one in given):
            raise InputError(f"state: {where} must be a list of names, got {short(given)}")
    elif isinstance(known, bool):
        if not isinstance(given, bool):
            raise InputError(f"state: {where} must be true or false, got {short(given)}")
    elif isinstance(known, str):
        if not isinstance(given, str):
            raise InputError(f"state: {where} must be a name, got {short(given)}")
    elif isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 < given <= LARGEST:
        raise InputError(f"state: {where} must be a positive finite number, got {short(given)}")
    return given


def _difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, item in new.items():
        if isinstance(item, Mapping) and isinstance(old.get(key), Mapping):
            inner = _difference(old[key], item)
            if inner:
                out[key] = inner
        elif key not in old or old[key] != item:
            out[key] = item
    return out


def _one(where: str, given: object, known: Mapping[str, Any] | Sequence[str]) -> str:
    if not isinstance(given, str) or given not in known:
        names = ", ".join(map(repr, list(known)[:12])) or "nothing here"
        raise InputError(f"state: {where}: {short(given)} is unknown; it must be one of {names}")
    return given
