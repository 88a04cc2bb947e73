"""``platform-ctrl export``: controllers and plant of a job in the forms that other tools and compilers take."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from platform_ctrl.cli.error_lines import noted
from platform_ctrl.cli.job_arguments import (
    Controllers,
    JobFile,
    Json,
    Quiet,
    controller_file,
    existing_controllers,
    expect_no_file_above,
    job_of,
    one_of,
    option,
    plant_file,
    writable,
)
from platform_ctrl.errors import InputError
from platform_ctrl.export.exporters import FORMS, NUMBERS, RESPONSES, ROOTS, Export, Form

WHAT, HOW = "What is written", "How"


def _target(flag: str, metavar: str, help: str) -> Any:
    return option(flag, metavar=metavar, help=help, panel=WHAT)


def _how(flag: str, metavar: str, help: str) -> Any:
    return option(flag, metavar=metavar, help=help, panel=HOW, default=True)


def export(
    job: JobFile,
    controllers: Controllers = None,
    c: Annotated[
        Path | None,
        _target(
            "--c",
            "DIR",
            "The controllers as C99 source, into this folder: a new or empty one, or one of an earlier export.",
        ),
    ] = None,
    mat: Annotated[
        Path | None, _target("--mat", "FILE", "Controllers and linear models as MATLAB data, a struct for ss each.")
    ] = None,
    models: Annotated[
        Path | None,
        _target("--models", "FILE", "Controllers, where there are some, and linear models as JSON."),
    ] = None,
    csv: Annotated[
        Path | None,
        _target("--csv", "DIR", "Frequency responses of plants, controllers and loops, a CSV file each."),
    ] = None,
    mjcf: Annotated[Path | None, _target("--mjcf", "FILE", "The plant as a MuJoCo model.")] = None,
    number: Annotated[str, _how("--number", "TYPE", "Numbers of the C source: double or float.")] = NUMBERS[0],
    form: Annotated[
        str,
        _how("--form", "FORM", "Responses in CSV: complex (real and imaginary parts) or polar (magnitude and phase)."),
    ] = RESPONSES[0],
    root: Annotated[
        str,
        _how(
            "--root",
            "KIND",
            "Root of the MuJoCo model: free, prescribed (its angular acceleration is a control) or fixed.",
        ),
    ] = ROOTS[0],
    as_json: Json = False,
    quiet: Quiet = False,
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
    from platform_ctrl.cli.atomic_output import own_files, sha256
    from platform_ctrl.cli.terminal import progress
    from platform_ctrl.common.files import json_text

    targets = {"c": c, "mat": mat, "models": models, "csv": csv, "mjcf": mjcf}
    # Files first.
    chosen = {one: at for one in sorted(FORMS, key=lambda one: one.folder) if (at := targets[one.name]) is not None}
    if not chosen:
        raise InputError(f"nothing to write; name at least one of {', '.join(one.flag for one in FORMS)} (see --help)")
    for flag, given, default, of in (
        ("--number", number, NUMBERS[0], "c"),
        ("--form", form, RESPONSES[0], "csv"),
        ("--root", root, ROOTS[0], "mjcf"),
    ):
        if given != default and targets[of] is None:
            raise InputError(f"{flag}: is an option of --{of}, which must be given too")
    numbers, responses, kind = (
        one_of("--number", number, NUMBERS),
        one_of("--form", form, RESPONSES),
        one_of("--root", root, ROOTS),
    )
    with progress(quiet or as_json, f"reading {job}") as say:
        work = Export(job_of(job), job, number=numbers, responses=responses, root=kind)
        uses = {one.controllers for one in chosen}
        used = "" if uses == {"unused"} else "controllers: none"
        there = existing_controllers(None, job) is not None
        if controllers is not None or "needed" in uses or (there and "optional" in uses):
            work.controller_file, used = controller_file(controllers, None, job, work.job, quiet or as_json)
        file = work.controller_file
        _check_targets([job, *plant_file(job, work.job), *([file] if file else [])], chosen)
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
        typer.echo(json_text(about | {"written": written, "notes": work.notes}))
        return 0
    for one, target in chosen.items():
        typer.echo(f"{one.title}: {target}{f', {len(made[one])} files' if one.folder else ''}")
    for note in work.notes:
        noted(note)
    return 0


def _write(
    work: Export,
    chosen: Mapping[Form, Path],
    owned: Mapping[Form, Mapping[str, str]],
    about: Mapping[str, object],
    say: Callable[[str], None],
) -> dict[Form, list[Path]]:
    """Write all forms or none, and return the files of each; what a folder has of an earlier export goes."""
    from platform_ctrl.cli.atomic_output import expect_own, write_folder_record, written_together

    made: dict[Form, list[Path]] = {}
    folders = [target if form.folder else target.parent for form, target in chosen.items()]
    with written_together(*folders) as places:
        for (form, target), folder, unfinished in zip(chosen.items(), folders, places, strict=True):
            say(f"writing {target}")
            path = unfinished if form.folder else unfinished / target.name
            form.write(work, path, target)
            if form.folder:
                write_folder_record(path, about)
            expect_own(unfinished, folder, owned.get(form))
            made[form] = [folder / one.name for one in sorted(unfinished.iterdir())]
    for form, before in owned.items():
        for name in before.keys() - {path.name for path in made[form]}:
            (chosen[form] / name).unlink(missing_ok=True)
    return made


def _check_targets(inputs: list[Path], targets: Mapping[Form, Path]) -> None:
    """Check where everything is to be written, before the work; `inputs` are files that the command reads."""
    for form, target in targets.items():
        others = [*inputs, *(other for one, other in targets.items() if one is not form)]
        if not form.folder:
            writable(form.flag, target, others)
            continue
        expect_no_file_above(form.flag, target)
        if target.resolve() in [other.resolve() for other in others]:
            raise InputError(f"{form.flag} {target}: is used for something else too; name another folder")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{form.flag} {target}: cannot be written: {error.strerror or error}") from None
