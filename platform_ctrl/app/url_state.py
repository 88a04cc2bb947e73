"""A state of the page as text for its address: what differs from the job as it stands, and nothing else."""

from __future__ import annotations

import base64
import binascii
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from platform_ctrl.app.settings import Conditions, Settings
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import InputError, PlatformCtrlError
from platform_ctrl.job.methods import METHODS

if TYPE_CHECKING:
    from platform_ctrl.app.backend import Backend
    from platform_ctrl.job.job import LoopSpec

# Characters of a link, and of what it unpacks to, at most.
_LONGEST, _LARGEST = 20_000, 400_000
_NUMBERS = ("rate_hz", "delay")
_NAMES = ("loop", "design", "mode", "plant", "channel")


def encode_state(backend: Backend, settings: Settings) -> str:
    """Return settings as a short text of letters, digits, - and _ alone."""
    changed = _difference(backend.start().data(), settings.data())
    if not changed:
        return ""
    packed = zlib.compress(json.dumps(changed, separators=(",", ":"), sort_keys=True).encode(), 9)
    return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def decode_state(backend: Backend, text: str) -> Settings:
    """Return the settings that a text stands for, judged against the job."""
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise InputError(f"link: given {short(text)}; expected at most {_LONGEST} characters that the page has made")
    if not text:
        return backend.start()
    try:
        packed = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
        unpacking = zlib.decompressobj()
        raw = unpacking.decompress(packed, _LARGEST)
        if unpacking.unconsumed_tail:
            raise ValueError
        changed = json.loads(raw.decode())
    except (ValueError, binascii.Error, zlib.error, RecursionError):
        raise InputError("link: is damaged; expected a state of this page, as its address shows it") from None
    return judged(backend, changed)


def judged(backend: Backend, changed: object) -> Settings:
    """Return the job's settings with changes from outside, as plain data, judged against the job."""
    start = backend.start()
    if not isinstance(changed, Mapping):
        raise InputError(f"state: given {short(changed)}; expected a table")
    known = start.data()
    for key in changed:
        if key not in known:
            raise InputError(f"state: {short(key)} is unknown; expected some of {', '.join(known)}")
    given = {**known, **changed}
    names = {name: _text(name, given[name]) for name in _NAMES}
    specs = {spec.name: spec for spec in backend.read.loops}
    closed = {
        loop: _one(f"closed {loop}", design, [d.name for d in specs[loop].designs])
        for loop, design in _table("closed", changed.get("closed", {}), specs).items()
    }
    options: dict[str, dict[str, dict[str, float]]] = {}
    optional: dict[str, dict[str, tuple[str, ...]]] = {}
    for loop, spec in specs.items():
        own = {d.name: d for d in spec.designs}
        mine, parts = (_table(key, changed.get(key, {}), specs).get(loop, {}) for key in ("options", "optional"))
        options[loop] = {name: dict(numbers) for name, numbers in start.options[loop].items()}
        optional[loop] = {name: tuple(on) for name, on in start.optional[loop].items()}
        for name, numbers in _table(f"options {loop}", mine, own).items():
            for option, x in _table(f"options {name}", numbers, METHODS[own[name].method].options).items():
                options[loop][name][option] = _positive(option, x)
        for name, on in _table(f"optional {loop}", parts, own).items():
            known_parts = tuple(METHODS[own[name].method].parts)
            optional[loop][name] = tuple(sorted({_one("part", part, known_parts) for part in _list("part", on)}))
    spins = {
        name: _finite(f"spin {name}", x) for name, x in _table("spins", changed.get("spins", {}), start.spins).items()
    }
    rates = [_finite("Omega", x) for x in _list("Omega", given["Omega"])]
    if len(rates) != 3:
        raise InputError(f"state: Omega has {len(rates)} numbers; expected 3")
    spec = specs[_one("loop", names["loop"], specs)]
    design = _one("design", names["design"], [d.name for d in spec.designs])
    axis = given["axis"]
    if isinstance(axis, bool) or axis not in (1, 2, 3):
        raise InputError(f"state: axis = {short(axis)}; expected 1, 2 or 3")
    if not isinstance(given["band"], bool):
        raise InputError(f"state: band = {short(given['band'])}; expected true or false")
    settings = Settings(
        mode="caged",
        loop=spec.name,
        design=design,
        options=options,
        optional=optional,
        rate_hz=start.rate_hz,
        delay=start.delay,
        spins={**start.spins, **spins},
        Omega=(rates[0], rates[1], rates[2]),
        plant=names["plant"],
        band=given["band"],
        fixed=frozenset(_text("fixed", name) for name in _list("fixed", given["fixed"])),
        overlays=tuple(
            _one("overlay", name, [d.name for d in spec.designs]) for name in _list("overlays", given["overlays"])
        ),
        channel=names["channel"],
        axis=int(axis),
        closed={**start.closed, **closed},
    )
    try:
        # Judged as a slider's number would be; the rate first, by which a delay is judged.
        settings = backend.chosen(settings.but(delay=0.0), design=design)
        for name in _NUMBERS:
            settings = backend.moved(settings, name, _finite(name, given[name]))
        backend.check_names(settings)
    except PlatformCtrlError as error:
        raise InputError(f"state: {error}") from None
    return settings.but(designed_for=_designed_for(changed.get("designed_for", {}), start, specs))


def _designed_for(given: object, start: Settings, specs: Mapping[str, LoopSpec]) -> dict[str, dict[str, Conditions]]:
    """Return for which conditions the designs that a page shows were made: as the job has them, or as is given."""
    out = {loop: dict(designs) for loop, designs in start.designed_for.items()}
    for loop, designs in _table("designed_for", given, specs).items():
        methods = {d.name: d.method for d in specs[loop].designs}
        for name, item in _table(f"designed_for {loop}", designs, methods).items():
            where = f"designed_for {name}"
            parts = _table(where, item, Conditions._fields)
            own = out.get(loop, {}).get(name)
            whole = {**({} if own is None else own.data()), **parts}
            if missing := [field for field in Conditions._fields if field not in whole]:
                raise InputError(f"state: {where} has no {missing[0]}; expected {', '.join(Conditions._fields)}")
            options = _table(f"{where}: options", whole["options"], METHODS[methods[name]].options)
            first = {} if own is None else dict(own.options)
            spins = {**start.spins, **_table(f"{where}: spins", whole["spins"], start.spins)}
            rates = [_positive_or_zero(f"{where}: Omega", x) for x in _list(where, whole["Omega"])]
            if len(rates) != 3:
                raise InputError(f"state: {where}: Omega has {len(rates)} numbers; expected 3")
            out.setdefault(loop, {})[name] = Conditions(
                options=tuple(sorted((first | {key: _positive(key, x) for key, x in options.items()}).items())),
                rate_hz=_positive(f"{where}: rate_hz", whole["rate_hz"]),
                delay=_positive_or_zero(f"{where}: delay", whole["delay"]),
                spins=tuple(sorted((key, _finite(f"{where}: spins", x)) for key, x in spins.items())),
                Omega=tuple(rates),
            )
    return out


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


def _table(where: str, given: object, known: Mapping[str, Any] | Sequence[str]) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise InputError(f"state: {where} = {short(given)}; expected a table")
    for name in given:
        _one(where, name, list(known))
    return given


def _list(where: str, given: object) -> list[Any]:
    if not isinstance(given, list | tuple):
        raise InputError(f"state: {where} = {short(given)}; expected a list")
    return list(given)


def _one(where: str, given: object, known: Mapping[str, Any] | Sequence[str]) -> str:
    if not isinstance(given, str) or given not in known:
        names = ", ".join(map(repr, list(known)[:12])) or "none at all"
        raise InputError(f"state: {where}: given {short(given)}; expected one of {names}")
    return given


def _text(where: str, given: object) -> str:
    if not isinstance(given, str) or len(given) > 1000:
        raise InputError(f"state: {where} = {short(given)}; expected a name")
    return given


def _finite(where: str, given: object) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given) or abs(given) > 1e50:
        raise InputError(f"state: {where} = {short(given)}; expected a finite number")
    return float(given)


def _positive_or_zero(where: str, given: object) -> float:
    number = _finite(where, given)
    if number < 0.0:
        raise InputError(f"state: {where} = {short(given)}; expected a number >= 0")
    return number


def _positive(where: str, given: object) -> float:
    number = _finite(where, given)
    if not number > 0.0:
        raise InputError(f"state: {where} = {short(given)}; expected a number > 0")
    return number
