"""A state of the page as a job file and its controllers: the user's own comments stay, `check` finds both."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.app.background import NamedController
from platform_ctrl.app.controllers import ALWAYS
from platform_ctrl.app.settings import Settings
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError
from platform_ctrl.job.job import Job
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.old_names import renamed
from platform_ctrl.job.reading import read_job
from platform_ctrl.plant.reading import open_plant
from platform_ctrl.plant.source import is_shipped_name, read_text
from platform_ctrl.verification.records import SCHEMA, write_record

if TYPE_CHECKING:
    from tomlkit import TOMLDocument

# Ending of the file of a job's controllers.
SUFFIX = ".controllers.json"


@value
class SavedController:
    """A controller of a loop, as it is closed."""

    loop: str
    design: str
    method: str
    controller: StateArrays
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    options: dict[str, float]
    note: str = ""

    def named(self, name: str) -> NamedController:
        """Return it under a name, for a task in another process."""
        return NamedController(controller=self.controller, inputs=self.inputs, outputs=self.outputs, name=name)


@value
class Saved:
    """Paths of both files that were written, and lines about loops that close another design than the job did."""

    job: Path
    controllers: Path
    notes: tuple[str, ...] = ()


def controllers_beside(job: Path) -> Path:
    """Return the path of the controllers of a job file."""
    return job.with_name(job.stem + SUFFIX)


def write_job(
    source: Path | None,
    path: Path,
    overwrite: bool,
    settings: Settings,
    start: Settings,
    job: Job,
    used: Mapping[str, Mapping[str, Mapping[str, float]]],
    controllers: Sequence[SavedController],
) -> Saved:
    """Write the job with the settings of the page, and its controllers beside it.

    `source` is the file that the job was read from, `start` its settings, and `job` what the new file has to be read
    as. `used` are the options of the designs that sliders build, by loop and design. `overwrite` allows to replace
    files.
    """
    if source is None:
        raise InputError("save: the job was not read from a file; open the page with a job file, whose text is kept")
    path = Path(path)
    if path.suffix != ".toml":
        raise InputError(f"{path}: the name of a job file must end in .toml")
    beside = controllers_beside(path)
    plant = (source.parent / job.plant).resolve()
    for one in (path, beside):
        if one.resolve() == plant:
            raise InputError(f"{one}: the job reads its plant from it; choose another name")
        if one.exists() and not one.is_file():
            raise InputError(f"{one}: is not a file; choose another name")
        if not overwrite and os.path.lexists(one):
            raise InputError(f"{one}: exists already; choose another name or overwrite it")
    text = job_text(source, path.parent, settings, start, used)
    data = tomllib.loads(text)
    # That its keys are old was written when the job was read.
    renamed(data)
    try:
        read_job(data, folder=path.parent)
    except InputError as error:
        raise InputError(str(error).replace("job given as a dict", str(path))) from None
    record = {"schema": SCHEMA, "controllers": [_entry(one, job) for one in controllers]}
    before = beside.read_bytes() if beside.exists() else None
    write_record(record, beside)
    try:
        write_whole(path, text)
    except InputError:
        # Without the job file its controllers are useless.
        if before is None:
            beside.unlink(missing_ok=True)
        else:
            write_whole(beside, before)
        raise
    return Saved(job=path, controllers=beside)


def job_text(
    source: Path,
    folder: Path,
    settings: Settings,
    start: Settings,
    used: Mapping[str, Mapping[str, Mapping[str, float]]],
) -> str:
    """Return the text of the job with the changes of the page; all else stays, also comments."""
    tomlkit = _tomlkit()
    document = tomlkit.parse(read_text(source, "a job file"))
    if settings.rate_hz != start.rate_hz:
        document["sampling"]["rate_hz"] = settings.rate_hz
    if settings.delay != start.delay:
        document["sampling"]["delay"] = settings.delay
    for k, (old, new) in enumerate(zip(list(document["operation"]["Omega"]), settings.Omega, strict=True)):
        if abs(new) > float(old):
            document["operation"]["Omega"][k] = abs(new)
    for loop in document["loop"]:
        name = str(loop["name"])
        if loop["use"] != settings.closed[name]:
            loop["use"] = settings.closed[name]
        for design in loop["design"]:
            numbers = used.get(name, {}).get(str(design["name"]))
            if numbers is not None:
                _put(design, numbers)
            elif dict(settings.options[name][str(design["name"])]) != dict(start.options[name][str(design["name"])]):
                _put(design, settings.options[name][str(design["name"])])
    _plant(document, source.parent, folder, settings, start)
    return str(tomlkit.dumps(document))


def _put(design: Any, numbers: Mapping[str, float]) -> None:
    """Write the options of a design; existing keys keep their place and comment."""
    # The method would refuse options of parts that are off, and those of stopped gyros.
    method = METHODS[str(design["method"])]
    known = method.options if method.parts else {}
    for key in [key for key in design if key in known and key not in (*numbers, ALWAYS)]:
        del design[key]
    for key, x in numbers.items():
        if key not in design or float(design[key]) != x:
            design[key] = int(x) if float(x).is_integer() and abs(x) < 1e15 else x
    if design.get("tune"):
        # They are final values now, not starting values.
        design["tune"] = False


def _plant(document: TOMLDocument, old: Path, new: Path, settings: Settings, start: Settings) -> None:
    plant: Any = document["plant"]
    moved = {name: spin for name, spin in settings.spins.items() if spin != start.spins[name]}
    if moved:
        whole: Any = dict(open_plant(str(plant), old).data) if isinstance(plant, str) else plant
        for rotor in whole["rotor"]:
            if rotor["name"] in moved:
                rotor.pop("angular_momentum", None)
                rotor["spin"] = moved[rotor["name"]]
        if isinstance(plant, str):
            # At the end: keys of the job after it would belong to the plant.
            del document["plant"]
            document.add("plant", _tomlkit().item(whole))
    elif isinstance(plant, str) and not is_shipped_name(str(plant)) and old.resolve() != new.resolve():
        file = Path(str(plant))
        if not file.is_absolute():
            document["plant"] = Path(os.path.relpath((old / file).resolve(), new.resolve())).as_posix()


def _entry(one: SavedController, job: Job) -> dict[str, Any]:
    K = one.controller
    return {
        "name": one.loop,
        "design": one.design,
        "method": one.method,
        "dt": job.sampling.period,
        **{name: np.asarray(getattr(K, name), dtype=np.float64) for name in "ABCD"},
        "inputs": list(one.inputs),
        "outputs": list(one.outputs),
        "delay": job.sampling.delay,
        "options": one.options,
    }


def _tomlkit() -> Any:
    try:
        import tomlkit
    except ImportError:
        raise InputError(
            "saving needs tomlkit, which is not there; install it with: pip install 'platform_ctrl[designer]'"
        ) from None
    return tomlkit
