"""The state of the page as text for its address: only what differs from the job file."""

from __future__ import annotations

import base64
import binascii
import json
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from platform_ctrl.app.settings import Conditions, Settings
from platform_ctrl.common.signatures import short
from platform_ctrl.errors import InputError, PlatformCtrlError
from platform_ctrl.job.methods import METHODS, DesignMethod

if TYPE_CHECKING:
    from platform_ctrl.app.backend import Backend
    from platform_ctrl.job.job import LoopSpec

# Most characters of a link, of what it unpacks to, and of a name in it; largest number.
_LONGEST, _LARGEST, _NAME, _HUGE = 20_000, 400_000, 1000, 1e50


def encode_state(backend: Backend, settings: Settings) -> str:
    """Return settings as a short text of letters, digits, - and _ alone."""
    changed = _difference(backend.start().data(), settings.data())
    if not changed:
        return ""
    packed = zlib.compress(json.dumps(changed, separators=(",", ":"), sort_keys=True).encode(), 9)
    return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def decode_state(backend: Backend, text: str) -> Settings:
    """Return the settings of a text from `encode_state`, checked against the job."""
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise InputError(f"link: must be a text of at most {_LONGEST} characters made by the page, got {short(text)}")
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
        raise InputError("link: it is damaged; copy it again from the page") from None
    return judged(backend, changed)


def judged(backend: Backend, changed: object) -> Settings:
    """Return the job's settings with changes from outside, as plain data, checked against the job."""
    start = backend.start()
    known = start.data()
    given = {**known, **_table("", changed, known)}
    specs = {spec.name: spec for spec in backend.read.loops}
    spec = specs[_one("loop", given["loop"], specs)]
    names = [design.name for design in spec.designs]
    design = _one("design", given["design"], names)
    options = {loop: {name: dict(one) for name, one in designs.items()} for loop, designs in start.options.items()}
    for loop, name, numbers, method in _by_design("options", changed, specs):
        table = _table(f"options of {name}", numbers, method.options)
        options[loop][name] |= {key: _number(key, x, above=0.0) for key, x in table.items()}
    optional = {loop: dict(designs) for loop, designs in start.optional.items()}
    for loop, name, parts, method in _by_design("optional", changed, specs):
        optional[loop][name] = tuple(sorted({_one("part", one, method.parts) for one in _list("optional", parts)}))
    closed = {
        loop: _one(f"closed {loop}", name, [one.name for one in specs[loop].designs])
        for loop, name in _table("closed", given["closed"], specs).items()
    }
    spins = {name: _number(f"spin {name}", x) for name, x in _table("spins", given["spins"], start.spins).items()}
    if isinstance(given["axis"], bool) or given["axis"] not in (1, 2, 3):
        raise InputError(f"state: axis must be 1, 2 or 3, got {short(given['axis'])}")
    if not isinstance(given["band"], bool):
        raise InputError(f"state: band must be true or false, got {short(given['band'])}")
    settings = Settings(
        mode="caged",
        loop=spec.name,
        design=design,
        options=options,
        optional=optional,
        rate_hz=start.rate_hz,
        delay=0.0,
        spins={**start.spins, **spins},
        Omega=_rates("Omega", given["Omega"]),
        plant=_text("plant", given["plant"]),
        band=given["band"],
        fixed=frozenset(_text("fixed", name) for name in _list("fixed", given["fixed"])),
        overlays=tuple(_one("overlay", name, names) for name in _list("overlays", given["overlays"])),
        channel=_text("channel", given["channel"]),
        axis=int(given["axis"]),
        closed={**start.closed, **closed},
    )
    try:
        settings = backend.chosen(settings, design=design)
        # Checked as a slider's number would be; the rate first, against which the delay is checked.
        for name in ("rate_hz", "delay"):
            settings = backend.moved(settings, name, _number(name, given[name]))
        backend.check_names(settings)
    except PlatformCtrlError as error:
        raise InputError(f"state: {error}") from None
    return settings.but(designed_for=_designed_for(changed, start, specs))


def _by_design(
    key: str, changed: object, specs: Mapping[str, LoopSpec]
) -> Iterator[tuple[str, str, Any, DesignMethod]]:
    """Yield loop, design, what is given for it under a key, and its method."""
    given = changed.get(key, {}) if isinstance(changed, Mapping) else {}
    for loop, designs in _table(key, given, specs).items():
        methods = {one.name: METHODS[one.method] for one in specs[loop].designs}
        for name, item in _table(f"{key} of {loop}", designs, methods).items():
            yield loop, name, item, methods[name]


def _designed_for(changed: object, start: Settings, specs: Mapping[str, LoopSpec]) -> dict[str, dict[str, Conditions]]:
    """Return the conditions for which the designs of a page were made: those of the job, or those that are given."""
    out = {loop: dict(designs) for loop, designs in start.designed_for.items()}
    for loop, name, item, method in _by_design("designed_for", changed, specs):
        where = f"designed_for {name}"
        own = out.get(loop, {}).get(name)
        whole = {**({} if own is None else own.data()), **_table(where, item, Conditions._fields)}
        if missing := [field for field in Conditions._fields if field not in whole]:
            raise InputError(f"state: {where} must have {', '.join(Conditions._fields)}; {missing[0]} is missing")
        options = _table(f"{where}: options", whole["options"], method.options)
        spins = {**start.spins, **_table(f"{where}: spins", whole["spins"], start.spins)}
        numbers = ({} if own is None else dict(own.options)) | {
            key: _number(key, x, above=0.0) for key, x in options.items()
        }
        out.setdefault(loop, {})[name] = Conditions(
            options=tuple(sorted(numbers.items())),
            rate_hz=_number(f"{where}: rate_hz", whole["rate_hz"], above=0.0),
            delay=_number(f"{where}: delay", whole["delay"], least=0.0),
            spins=tuple(sorted((key, _number(f"{where}: spins", x)) for key, x in spins.items())),
            Omega=_rates(where, whole["Omega"], least=0.0),
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
        raise InputError(f"state: {where or 'it'} must be a table, got {short(given)}")
    for name in given:
        _one(where or "key", name, known)
    return given


def _list(where: str, given: object) -> list[Any]:
    if not isinstance(given, list | tuple):
        raise InputError(f"state: {where} must be a list, got {short(given)}")
    return list(given)


def _one(where: str, given: object, known: Mapping[str, Any] | Sequence[str]) -> str:
    if not isinstance(given, str) or given not in known:
        names = ", ".join(map(repr, list(known)[:12])) or "nothing here"
        raise InputError(f"state: {where}: {short(given)} is unknown; it must be one of {names}")
    return given


def _text(where: str, given: object) -> str:
    if not isinstance(given, str) or len(given) > _NAME:
        raise InputError(f"state: {where} must be a name, got {short(given)}")
    return given


def _rates(where: str, given: object, least: float = -math.inf) -> tuple[float, float, float]:
    rates = [_number(where, x, least=least) for x in _list(where, given)]
    if len(rates) != 3:
        raise InputError(f"state: {where} must have 3 rates, got {len(rates)}")
    return rates[0], rates[1], rates[2]


def _number(where: str, given: object, *, above: float = -math.inf, least: float = -math.inf) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given) or abs(given) > _HUGE:
        raise InputError(f"state: {where} must be a finite number, got {short(given)}")
    if not given > above or given < least:
        raise InputError(f"state: {where} must be {'positive' if above == 0.0 else 'at least 0'}, got {short(given)}")
    return float(given)
