"""The settings of a page as a job file with its controllers, and what of them is not as the job has it."""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from platform_ctrl.app.controllers import ALWAYS, DesignOptions
from platform_ctrl.app.plants import JobPlants
from platform_ctrl.app.settings import LARGEST, Limits, Settings, number, put_into
from platform_ctrl.common.arguments import known_name, short
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import value
from platform_ctrl.design.loop import Design
from platform_ctrl.design.methods import METHODS, read_job
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.job import Job
from platform_ctrl.job.reading import job_hashes
from platform_ctrl.plant.source import is_shipped_name, read_text
from platform_ctrl.verification.result_file import SCHEMA, controller_record, write_record

# Ending of the file of a job's controllers.
SUFFIX = ".controllers.json"


@value
class Saved:
    """Paths of the files that were written, and a line for every value that differs without a change on the page.

    `controllers` is None where nothing was changed and the page has not all controllers of the job.
    """

    job: Path
    controllers: Path | None
    notes: tuple[str, ...] = ()


_UNCHANGED = (
    "nothing was changed on the page, so the job is as it was; no controllers are written, because the page has not "
    "those of its designs: platform-ctrl design makes them"
)
# Options of designs by loop and design.
Options = Mapping[str, Mapping[str, Mapping[str, float]]]
# Relative difference up to which an option is the same, and how often options that follow from others are looked at.
_SAME, _ROUNDS = 1e-12, 4


def controllers_beside(job: Path) -> Path:
    """Return the path of the controllers of a job file."""
    return job.with_name(job.stem + SUFFIX)


class JobSource:
    """The file that a page's job was read from: its text goes into every job that is saved, with the page's changes."""

    def __init__(self, path: Path, job: Job) -> None:
        self.path = path
        self._text = read_text(path, "a job file")
        self._read = job_hashes(job)["job"]
        self._saved: str | None = None

    def text(self) -> str:
        """Return the text; an InputError where job or plant on disk are no longer those that the page read or saved."""
        why = ""
        try:
            text = read_text(self.path, "a job file")
            now = job_hashes(_read(text, self.path.parent, self.path))["job"]
            if now == self._read:
                return text  # comments may have changed
            if now == self._saved:
                return self._text
        except (InputError, tomllib.TOMLDecodeError) as error:
            why = f" ({error})"
        raise InputError(
            f"{self.path}: the job or its plant was changed on disk since the page read it{why}; nothing was saved: "
            f"start platform-ctrl serve {self.path} again, and put its link's token into the page's address to keep "
            "the sliders, or put back what was changed"
        )

    def replaced(self, job: Job) -> None:
        """Note that the page itself has saved a job in the place of the file."""
        self._saved = job_hashes(job)["job"]


def is_unchanged(settings: Settings, start: Settings) -> bool:
    """Return whether nothing was changed on a page that a job has."""
    return all(getattr(settings, name) == getattr(start, name) for name in ("closed", "options", "optional", "limits"))


def write_job(
    source: JobSource | None,
    path: Path,
    overwrite: bool,
    settings: Settings,
    start: Settings,
    wanted: Options,
    controllers: Sequence[Design] | None,
) -> Saved:
    """Write the job with the settings of the page, and its controllers beside it.

    `source` is the file that the job was read from, `start` its settings. `wanted` are the options of designs, by loop
    and design, that a reader of the new file has to find. `controllers` are None where nothing was changed and they are
    not designed yet. `overwrite` allows to replace files.
    """
    if source is None:
        raise InputError("save: the job was not read from a file; open the page with a job file, whose text is kept")
    path = Path(path)
    if path.suffix != ".toml":
        raise InputError(f"{path}: the name of a job file must end in .toml")
    beside, before = controllers_beside(path), source.text()
    plant = tomllib.loads(before)["plant"]
    for one in (path, beside):
        if isinstance(plant, str) and one.resolve() == (source.path.parent / plant).resolve():
            raise InputError(f"{one}: the job reads its plant from it; choose another name")
        if one.exists() and not one.is_file():
            raise InputError(f"{one}: is not a file; choose another name")
        if not overwrite and os.path.lexists(one):
            raise InputError(f"{one}: exists already; choose another name or overwrite it")
    text = _complete_text(before, source.path, path, settings, start, wanted)
    if is_unchanged(settings, start):
        same = _job_text(before, source.path, path.parent, {}, {}, {}, {})
        if text != same or controllers is None:
            # Controllers of other designs, or of numbers that are to be tuned, are not those of this job.
            write_whole(path, same)
            return Saved(job=path, controllers=None, notes=(_UNCHANGED,))
    job = _read(text, path.parent, path)
    record = {
        "schema": SCHEMA,
        "sha256": job_hashes(job),
        "controllers": [
            {"name": one.loop, "design": one.name, "method": one.method}
            | controller_record(one.controller, job)
            | {"options": one.options}
            for one in controllers or ()
        ],
    }
    there = beside.read_bytes() if beside.exists() else None
    write_record(record, beside)
    try:
        write_whole(path, text)
    except InputError:
        # Without the job file its controllers are useless.
        if there is None:
            beside.unlink(missing_ok=True)
        else:
            write_whole(beside, there)
        raise
    if path.resolve() == source.path.resolve():
        source.replaced(job)
    return Saved(job=path, controllers=beside, notes=_unasked(before, text, settings, start))


def _read(text: str, folder: Path, path: Path) -> Job:
    """Return the job of a text in a folder; `path` is its name in messages."""
    data = tomllib.loads(text)
    try:
        return read_job(data, folder=folder)
    except InputError as error:
        raise InputError(str(error).replace("job given as a dict", str(path))) from None


def _complete_text(before: str, old: Path, new: Path, settings: Settings, start: Settings, wanted: Options) -> str:
    """Return the text of the job of which a reader finds the options that are wanted.

    Options that the file does not have, and would have by themselves, are not written.
    """
    written = {
        loop: {
            design: {key: x for key, x in numbers.items() if x != start.options[loop][design].get(key)}
            for design, numbers in designs.items()
        }
        for loop, designs in wanted.items()
    }
    limits = {name: x for name, x in settings.limits.items() if x != start.limits[name]}
    text = ""
    # Options that follow from others are right once these are.
    for _ in range(_ROUNDS):
        text = _job_text(before, old, new.parent, settings.closed, limits, written, wanted)
        missing = _not_found(_read(text, new.parent, new), wanted)
        if not missing:
            return text
        for loop, designs in missing.items():
            for design, numbers in designs.items():
                written[loop][design] |= numbers
    return _job_text(before, old, new.parent, settings.closed, limits, wanted, wanted)


def _not_found(job: Job, wanted: Options) -> dict[str, dict[str, dict[str, float]]]:
    """Return the options that a page that reads a job does not find as they are wanted."""
    options = DesignOptions(JobPlants(job))
    out: dict[str, dict[str, dict[str, float]]] = {}
    for spec in job.loops:
        for design in spec.designs:
            numbers = wanted.get(spec.name, {}).get(design.name)
            if numbers is None:
                continue
            found = options.used(options.start, spec, design)
            other = {
                key: x for key, x in numbers.items() if not math.isclose(found.get(key, math.nan), x, rel_tol=_SAME)
            }
            if other:
                out.setdefault(spec.name, {})[design.name] = other
    return out


def _job_text(
    before: str, old: Path, folder: Path, closed: Mapping[str, str], limits: Limits, written: Options, wanted: Options
) -> str:
    """Return the text of the job in a folder with the changes of the page; all else stays, also comments."""
    import tomlkit

    document = tomlkit.parse(before)
    for loop in document["loop"]:
        name = str(loop["name"])
        if loop["use"] != closed.get(name, loop["use"]):
            loop["use"] = closed[name]
        for design in loop["design"]:
            numbers = wanted.get(name, {}).get(str(design["name"]))
            if numbers is not None:
                _put(design, numbers, written[name][str(design["name"])])
    put_into(document, limits)
    plant: Any = document["plant"]
    if isinstance(plant, str) and not is_shipped_name(str(plant)) and old.parent.resolve() != folder.resolve():
        file = Path(str(plant))
        if not file.is_absolute():
            document["plant"] = Path(os.path.relpath((old.parent / file).resolve(), folder.resolve())).as_posix()
    return str(tomlkit.dumps(document))


def _put(design: Any, wanted: Mapping[str, float], written: Mapping[str, float]) -> None:
    """Write options of a design; existing keys keep their place and comment, those that are not `wanted` go."""
    # The method would refuse options of parts that are off.
    method = METHODS[str(design["method"])]
    known = method.options if method.parts else {}
    for key in [key for key in design if key in known and key not in (*wanted, ALWAYS)]:
        del design[key]
    for key, x in written.items():
        if key not in design or float(design[key]) != x:
            design[key] = number(x)
    if design.get("tune"):
        # They are final values now, not starting values.
        design["tune"] = False


def _unasked(before: str, after: str, settings: Settings, start: Settings) -> tuple[str, ...]:
    """Return a line for every value that differs from the job's text without a change on the page."""
    old, new = tomllib.loads(before), tomllib.loads(after)
    lines = []
    for was, now in zip(old["loop"], new["loop"], strict=True):
        name = was["name"]
        if was["use"] != now["use"] and settings.closed[name] == start.closed[name]:
            lines.append(f"{name}: {now['use']} is closed in place of {was['use']}, which is not designed")
        for own, written in zip(was["design"], now["design"], strict=True):
            asked = {
                key
                for key, x in settings.options[name][own["name"]].items()
                if x != start.options[name][own["name"]].get(key)
            }
            changed = [key for key, item in written.items() if own.get(key) != item and key not in asked]
            if changed:
                keys = ", ".join(f"{key} = {json.dumps(written[key])}" for key in changed)
                lines.append(f"{name}, {own['name']}: {keys}, for the controller to be that of the page")
    if old["plant"] != new["plant"]:
        lines.append(f"plant = {json.dumps(new['plant'])}, seen from the new folder")
    return tuple(lines)


_KINDS: dict[type, str] = {list: "a list of names", bool: "true or false", str: "a name"}


def merged(where: str, known: Any, given: object) -> Any:
    """Return known plain data with those that are given in their place, of the same kinds; numbers are positive."""
    if isinstance(known, Mapping):
        if not isinstance(given, Mapping):
            raise ArgumentError(f"{where} must be a table, got {short(given)}")
        for name in given:
            known_name(where, name, tuple(known))
        return {name: merged(name, item, given[name]) if name in given else item for name, item in known.items()}
    words = _KINDS.get(type(known), "a positive finite number")
    if type(known) in _KINDS:
        fits = type(given) is type(known) and (not isinstance(given, list) or all(isinstance(k, str) for k in given))
    else:
        fits = isinstance(given, int | float) and not isinstance(given, bool) and 0.0 < given <= LARGEST
    if not fits:
        raise ArgumentError(f"{where} must be {words}, got {short(given)}")
    return given


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Return what differs of two plain data of settings."""
    out: dict[str, Any] = {}
    for key, item in new.items():
        if isinstance(item, Mapping) and isinstance(old.get(key), Mapping):
            inner = difference(old[key], item)
            if inner:
                out[key] = inner
        elif key not in old or old[key] != item:
            out[key] = item
    return out
