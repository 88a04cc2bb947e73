"""``platform-ctrl export`` and ``import``: a job in the forms that other tools take, a robot description as a plant."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from platform_ctrl.cli import job_arguments as arguments
from platform_ctrl.cli.exits import noted, print_json
from platform_ctrl.common.files import UNFINISHED, write_json, write_whole
from platform_ctrl.common.processes import interrupts_deferred
from platform_ctrl.errors import InputError
from platform_ctrl.export.exporters import FORMS, NUMBERS, RESPONSES, ROOTS, Export, Form
from platform_ctrl.plant.source import read_json

C = Annotated[
    Path | None,
    typer.Option(
        "--c",
        metavar="DIR",
        help="The controllers as C99 source, into this folder: a new or empty one, or one of an earlier export.",
    ),
]
Mat = Annotated[
    Path | None,
    typer.Option("--mat", metavar="FILE", help="Controllers and linear models as MATLAB data, a struct for ss each."),
]
Models = Annotated[
    Path | None,
    typer.Option("--models", metavar="FILE", help="Controllers, where there are some, and linear models as JSON."),
]
Csv = Annotated[
    Path | None,
    typer.Option("--csv", metavar="DIR", help="Frequency responses of plants, controllers and loops, a CSV file each."),
]
Responses = Annotated[
    str,
    typer.Option(
        "--form",
        metavar="FORM",
        help="Responses in CSV: complex (real and imaginary parts) or polar (magnitude and phase).",
    ),
]
Root = Annotated[
    str,
    typer.Option(
        "--root",
        metavar="KIND",
        help="Root of the MuJoCo model: free, prescribed (its angular acceleration is a control) or fixed.",
    ),
]


def export(
    job: arguments.JobFile,
    controllers: arguments.Controllers = None,
    c: C = None,
    mat: Mat = None,
    models: Models = None,
    csv: Csv = None,
    mjcf: Annotated[Path | None, typer.Option("--mjcf", metavar="FILE", help="The plant as a MuJoCo model.")] = None,
    number: Annotated[
        str, typer.Option("--number", metavar="TYPE", help="Numbers of the C source: double or float.")
    ] = NUMBERS[0],
    form: Responses = RESPONSES[0],
    root: Root = ROOTS[0],
    as_json: arguments.Json = False,
    quiet: arguments.Quiet = False,
) -> int:
    """Export controllers and plant for compilers and other tools.

    Several forms can be combined; all of them are written, or none. Default controllers are those of check. A folder
    must be new, empty, or of an earlier export without changes since.

    \b
    platform-ctrl export job.toml --c firmware/gyro
        double precision C99
    platform-ctrl export job.toml --c firmware/gyro --number float
        single precision
    platform-ctrl export job.toml --mat gyro.mat --csv responses
        for MATLAB, Octave, pandas
    platform-ctrl export job.toml --mjcf gyro.xml
        for MuJoCo
    platform-ctrl export job.toml --c gyro --json | jq .written
        with the SHA-256 of every file
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    targets = {"c": c, "mat": mat, "models": models, "csv": csv, "mjcf": mjcf}
    # Files first.
    chosen = {one: at for one in sorted(FORMS, key=lambda one: one.folder) if (at := targets[one.name]) is not None}
    if not chosen:
        raise InputError(f"nothing to write; name at least one of {', '.join(one.flag for one in FORMS)} (see --help)")
    numbers = _how_of("--number", number, NUMBERS, "c", chosen)
    responses = _how_of("--form", form, RESPONSES, "csv", chosen)
    kind = _how_of("--root", root, ROOTS, "mjcf", chosen)
    with progress(quiet or as_json, f"reading {job}") as say:
        work = Export(arguments.job_of(job), job, number=numbers, responses=responses, root=kind)
        uses = {one.controllers for one in chosen}
        used = "" if uses == {"unused"} else "controllers: none"
        there = arguments.existing_controllers(None, job) is not None
        if controllers is not None or "needed" in uses or (there and "optional" in uses):
            work.controller_file, used = arguments.controller_file(controllers, None, job, work.job, quiet or as_json)
        file = work.controller_file
        inputs = [job, job.parent / work.job.plant, *([file] if file else [])]
        for one, target in chosen.items():
            others = [*inputs, *(at for other, at in chosen.items() if other is not one)]
            arguments.expect_target(one.flag, target, others, folder=one.folder)
        work.controller_sha256 = None if file is None else sha256(file)
        owned = {one: own_files(one.flag, target) for one, target in chosen.items() if one.folder}
        about = {
            "schema": 1,
            "job": work.job.name,
            "platform": work.job.platform.name,
            "controllers": None if file is None else {"file": str(file), "sha256": work.controller_sha256},
        }
        made = _write(work, chosen, owned, about, say)
        written = [
            {"format": one.name, "path": str(path), "sha256": sha256(path)}
            for one, paths in made.items()
            for path in paths
        ]
    noted(used)
    if as_json:
        print_json(about | {"written": written, "notes": work.notes})
        return 0
    for one, target in chosen.items():
        typer.echo(f"{one.title}: {target}{f', {len(made[one])} files' if one.folder else ''}")
    for note in work.notes:
        noted(note)
    return 0


def _how_of(
    flag: str, given: str, known: tuple[arguments.Word, ...], of: str, chosen: Mapping[Form, Path]
) -> arguments.Word:
    """Return the word among `known` that an option has, which is one of a form that must be chosen for that."""
    if given != known[0] and of not in [one.name for one in chosen]:
        raise InputError(f"{flag}: is an option of --{of}, which must be given too")
    return arguments.one_of(flag, given, known)


def _write(
    work: Export,
    chosen: Mapping[Form, Path],
    owned: Mapping[Form, Mapping[str, str]],
    about: Mapping[str, object],
    say: Callable[[str], None],
) -> dict[Form, list[Path]]:
    """Write all forms or none, and return the files of each; what a folder has of an earlier export goes."""
    made: dict[Form, list[Path]] = {}
    with TemporaryDirectory() as temporary:
        inside = {form: Path(temporary) / form.name for form in chosen}
        for form, target in chosen.items():
            say(f"writing {target}")
            folder = target if form.folder else target.parent
            inside[form].mkdir()
            try:
                form.write(work, inside[form] if form.folder else inside[form] / target.name, target)
            except OSError as error:  # a full disk
                raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
            if form.folder:
                files = {path.name: sha256(path) for path in sorted(inside[form].iterdir())}
                write_json({"schema": 1, **about, "files": files}, inside[form] / RECORD)
            expect_own(inside[form], folder, owned.get(form))
            made[form] = [folder / one.name for one in sorted(inside[form].iterdir())]
        with interrupts_deferred():
            for form, paths in made.items():
                paths[0].parent.mkdir(exist_ok=True)
                for path in paths:
                    write_whole(path, (inside[form] / path.name).read_bytes())
    for form, before in owned.items():
        for name in before.keys() - {path.name for path in made[form]}:
            (chosen[form] / name).unlink(missing_ok=True)
    return made


# What a folder holds that an export made: the files that are its own.
RECORD = "export.json"


def expect_own(unfinished: Path, folder: Path, own: Mapping[str, str] | None) -> None:
    """Make sure that the files of an unfinished folder can take their places in `folder`.

    With `own`, the files of an earlier export, no others may be there.
    """
    for name in sorted(os.listdir(unfinished)):
        if (folder / name).is_dir() and not (folder / name).is_symlink():
            raise InputError(f"{folder / name}: is a folder, but must be a file or not exist")
        if own is not None and name not in own and os.path.lexists(folder / name):
            raise InputError(f"{folder / name}: is not part of an earlier export; move it elsewhere")


def own_files(option: str, folder: Path) -> dict[str, str]:
    """Return the files of an earlier export in a folder, with their SHA-256; none in one that is empty or not there."""
    where = f"{option} {folder}"
    try:
        present = [path.name for path in folder.iterdir() if not path.name.startswith(UNFINISHED)]
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror or error}") from None
    if not present:
        return {}
    if RECORD not in present:
        raise InputError(f"{where}: holds files of no earlier export; name a new or empty folder")
    _, record = read_json(folder / RECORD, "the record of an export")
    files = record.get("files") if isinstance(record, dict) else None
    # A name that leads out of the folder is not one that an export wrote.
    if not isinstance(files, dict) or any(Path(name).name != name for name in files):
        raise InputError(f"{where}: {RECORD} there is not the record of an export; name a new folder")
    for name in files.keys() & set(present):
        if sha256(folder / name) != files[name]:
            raise InputError(f"{where}: {name} was changed since it was exported; move it elsewhere")
    return {**files, RECORD: ""}


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


Description = Annotated[
    Path, typer.Argument(metavar="FILE", help="A robot description: URDF, MJCF or SDF.", show_default=False)
]


def import_description(
    file: Description,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="PLANT", help="Plant file to write. Default: standard output.")
    ] = None,
    root: Annotated[
        str | None,
        typer.Option(
            "--root", metavar="BODY", help="Body that is the root; what carries it is cut off. Default: base."
        ),
    ] = None,
    tip: Annotated[
        str | None,
        typer.Option("--tip", metavar="BODY", help="Last body: joints that are not on the way to it are held at zero."),
    ] = None,
    as_json: arguments.Json = False,
) -> None:
    """Make a plant file of a robot description in URDF, MJCF or SDF.

    Bodies, offsets, inertias, joints with stops and friction, motors, gyros. Comments at the head of the plant file
    list, a line each, what of the description has no counterpart there, or had to be assumed. URDF and MJCF need the
    extra import.

    \b
    platform-ctrl import gimbal.urdf -o gimbal_plant.toml
        the whole robot
    platform-ctrl import drone.sdf -o gimbal_plant.toml --root gimbal_base --tip camera_link
        one chain of it
    platform-ctrl import gimbal.urdf --json | jq -r '.notes[]'
        what has no counterpart
    """  # noqa: D301
    from platform_ctrl.export.robots.plant_file import import_robot

    if out is not None:
        arguments.expect_target("--out", out, [file])
    made = import_robot(file, root, tip)
    gimbals = made.platform.gimbal_names
    if out is not None:
        write_whole(out, made.text)
    if as_json:
        about = {"schema": 1, "platform": made.platform.name, "gimbals": gimbals, "notes": made.notes}
        print_json(about | ({"text": made.text} if out is None else {"plant": str(out)}))
    elif out is None:
        typer.echo(made.text, nl=False)
    else:
        typer.echo(f"plant: {out}, gimbals {', '.join(gimbals)}")
        noted(f"{len(made.notes)} notes at its head say what has no counterpart in a plant file, or is assumed")
        typer.echo(f"next:  {shlex.join(['platform-ctrl', 'equations', str(out)])}")
