"""``platform-ctrl export``: controllers and plant of a job in the forms that other tools and compilers take."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from platform_ctrl.cli import completion
from platform_ctrl.cli.held_baseline import way_open, writable
from platform_ctrl.cli.inputs import Controllers, JobFile, Json, Quiet, controller_file, job_of, plant_file
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    import control

    from platform_ctrl.job.job import Job

NUMBERS = ("double", "float", "q31", "q15")
ANTI_WINDUP = ("back-calculation", "proved", "none")
ROOTS = ("free", "prescribed", "fixed")
ACCURACY = 0.02
WHAT, HOW = "What is written", "How"


def export(
    job: JobFile,
    controllers: Controllers = None,
    c: Annotated[
        Path | None,
        typer.Option(
            "--c",
            metavar="DIR",
            help="The controllers as C99 source, into this folder: a new or empty one, or one of an earlier export.",
            show_default=False,
            rich_help_panel=WHAT,
        ),
    ] = None,
    mat: Annotated[
        Path | None,
        typer.Option(
            "--mat",
            metavar="FILE",
            help="Controllers and linear models as MATLAB data, a struct for ss each.",
            show_default=False,
            rich_help_panel=WHAT,
        ),
    ] = None,
    models: Annotated[
        Path | None,
        typer.Option(
            "--models",
            metavar="FILE",
            help="Controllers, where there are some, and linear models as JSON.",
            show_default=False,
            rich_help_panel=WHAT,
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            metavar="DIR",
            help="Frequency responses of plants, controllers and loops, a CSV file each, into this folder.",
            show_default=False,
            rich_help_panel=WHAT,
        ),
    ] = None,
    mjcf: Annotated[
        Path | None,
        typer.Option(
            "--mjcf",
            metavar="FILE",
            help="The plant as a MuJoCo model.",
            show_default=False,
            rich_help_panel=WHAT,
        ),
    ] = None,
    fmu: Annotated[
        Path | None,
        typer.Option(
            "--fmu",
            metavar="FILE",
            help="Plant and controllers as a functional mock-up unit (FMI 3.0, co-simulation).",
            show_default=False,
            rich_help_panel=WHAT,
        ),
    ] = None,
    number: Annotated[
        str,
        typer.Option(
            "--number",
            metavar="TYPE",
            help="Numbers of the C source: double, float, or fixed point, q31 or q15.",
            autocompletion=completion.words(*NUMBERS),
            rich_help_panel=HOW,
        ),
    ] = "double",
    anti_windup: Annotated[
        str,
        typer.Option(
            "--anti-windup",
            metavar="KIND",
            help="What a limited torque does to integrals in the C source: back-calculation, proved or none.",
            autocompletion=completion.words(*ANTI_WINDUP),
            rich_help_panel=HOW,
        ),
    ] = "back-calculation",
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar="SIGNAL=NUMBER",
            help="Fixed point: largest magnitude of an input, SI units. Default: from stops, torque limits, Omega.",
            show_default=False,
            rich_help_panel=HOW,
        ),
    ] = None,
    limits: Annotated[
        list[str] | None,
        typer.Option(
            "--integral-limit",
            metavar="STATE=NUMBER",
            help="Fixed point: where an integral stops. Default: from the torquers' limits.",
            show_default=False,
            rich_help_panel=HOW,
        ),
    ] = None,
    accuracy: Annotated[
        float,
        typer.Option(
            "--accuracy",
            metavar="SHARE",
            help="Fixed point: largest error of a torque, as a share of its limit.",
            rich_help_panel=HOW,
        ),
    ] = ACCURACY,
    form: Annotated[
        str,
        typer.Option(
            "--form",
            metavar="FORM",
            help="Responses in CSV: complex (real and imaginary parts) or polar (magnitude and phase).",
            autocompletion=completion.words("complex", "polar"),
            rich_help_panel=HOW,
        ),
    ] = "complex",
    root: Annotated[
        str,
        typer.Option(
            "--root",
            metavar="KIND",
            help="Root of the MuJoCo model: free, prescribed (its angular acceleration is a control) or fixed.",
            autocompletion=completion.words(*ROOTS),
            rich_help_panel=HOW,
        ),
    ] = "free",
    manoeuvre: Annotated[
        str | None,
        typer.Option(
            "--manoeuvre",
            metavar="NAME",
            help="Manoeuvre that the FMU begins with: of the job, caged or stabilised. Default: the job's first one.",
            show_default=False,
            autocompletion=completion.manoeuvres,
            rich_help_panel=HOW,
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Export controllers and plant for compilers and other tools.

    Any of the forms together; all of them are written, or none. The controllers are those that check takes. A folder
    is written to only if it is new, empty, or of an earlier export that nobody has changed since.

    \b
    platform-ctrl export job.toml --c firmware/gyro              double precision C99
    platform-ctrl export job.toml --c firmware/gyro --number q31  fixed point, with its scaling
    platform-ctrl export job.toml --mat gyro.mat --csv responses  for MATLAB, Octave, pandas
    platform-ctrl export job.toml --mjcf gyro.xml --fmu gyro.fmu  for MuJoCo and simulators
    platform-ctrl export job.toml --c gyro --json | jq .written   with the SHA-256 of every file
    """  # noqa: D301
    from platform_ctrl.cli.staged import all_or_none, own_files, sha256
    from platform_ctrl.cli.terminal import progress

    files: dict[str, Path] = {o: p for o, p in (("mat", mat), ("models", models), ("mjcf", mjcf), ("fmu", fmu)) if p}
    folders: dict[str, Path] = {o: p for o, p in (("c", c), ("csv", csv)) if p}
    if not files and not folders:
        raise InputError("nothing to write; expected one of --c, --mat, --models, --csv, --mjcf, --fmu (see --help)")
    for option, is_given, of in (
        ("--number", number != "double", "c"),
        ("--anti-windup", anti_windup != "back-calculation", "c"),
        ("--range", bool(ranges), "c"),
        ("--integral-limit", bool(limits), "c"),
        ("--accuracy", accuracy != ACCURACY, "c"),
        ("--form", form != "complex", "csv"),
        ("--root", root != "free", "mjcf"),
        ("--manoeuvre", manoeuvre is not None, "fmu"),
    ):
        if is_given and of not in files | folders:
            raise InputError(f"{option}: says how --{of} is written; expected --{of} beside it")
    for option, given, known in (
        ("--number", number, NUMBERS),
        ("--anti-windup", anti_windup, ANTI_WINDUP),
        ("--form", form, ("complex", "polar")),
        ("--root", root, ROOTS),
    ):
        if given not in known:
            raise InputError(f"{option} {given}: expected one of {', '.join(known)}")
    c_options: dict[str, Any] = {"number": number, "anti_windup": anti_windup}
    fixed = {"ranges": _numbers("--range", ranges), "limits": _numbers("--integral-limit", limits)}
    if not (math.isfinite(accuracy) and accuracy > 0.0):
        raise InputError(f"--accuracy {accuracy!r}: expected a finite number > 0, as in 0.02: 2 % of a torque's limit")
    if number in ("q31", "q15"):
        c_options |= fixed | {"accuracy": accuracy}
    elif any(fixed.values()) or accuracy != ACCURACY:
        raise InputError(
            f"--range, --integral-limit and --accuracy are of fixed point; given --number {number}; expected q31 or q15"
        )
    with progress(quiet or as_json, f"reading {job}") as say:
        read = job_of(job)
        needed = bool(folders) or mat is not None or fmu is not None
        wanted = needed or models is not None or controllers is not None
        file = _controllers(controllers, job, needed) if wanted else None
        _judge_targets([job, *plant_file(job, read), *([file] if file else [])], files, folders)
        owned = {option: own_files(f"--{option}", path) for option, path in folders.items()}
        work = _Work(read, job, file, c_options, form, root, manoeuvre)
        made: dict[str, list[Path]] = {}
        with all_or_none() as stage:
            for option, target in (files | folders).items():
                say(f"writing {target}")
                at = stage.file(target) if option in files else stage.folder(target, owned[option])
                _WRITERS[option](work, at, target)
                made[option] = [target] if option in files else [target / one.name for one in sorted(at.iterdir())]
        written = [
            {"format": option, "path": str(path), "sha256": sha256(path)} for option in made for path in made[option]
        ]
    if as_json:
        typer.echo(json.dumps(work.about | {"written": written, "notes": work.notes}, indent=2))
        return 0
    for option, target in (files | folders).items():
        count = f", {len(made[option])} files" if option in folders else ""
        typer.echo(f"{_MEANINGS[option]}: {target}{count}")
    for note in work.notes:
        typer.echo(note, err=True)
    return 0


_MEANINGS = {
    "c": "C source",
    "mat": "MATLAB data",
    "models": "JSON",
    "csv": "responses",
    "mjcf": "MuJoCo model",
    "fmu": "FMU",
}


@dataclass
class _Work:
    """What is exported, and what is told about it."""

    job: Job
    path: Path
    file: Path | None
    c_options: dict[str, Any]
    form: str
    root: str
    manoeuvre: str | None
    notes: list[str] = field(default_factory=list)

    @cached_property
    def controllers(self) -> list[control.StateSpace]:
        from platform_ctrl.verification.given import read_controllers

        return [] if self.file is None else read_controllers(self.file, self.job)

    @cached_property
    def about(self) -> dict[str, Any]:
        from platform_ctrl.cli.staged import sha256

        of = None if self.file is None else {"file": str(self.file), "sha256": sha256(self.file)}
        return {"schema": 1, "job": self.job.name, "platform": self.job.platform.name, "controllers": of}


def _controllers(given: Path | None, job: Path, needed: bool) -> Path | None:
    """Return the file of the controllers; None where they are not needed and there are none."""
    try:
        return controller_file(given, None, job)
    except InputError:
        if needed:
            raise
        return None


def _judge_targets(inputs: list[Path], files: dict[str, Path], folders: dict[str, Path]) -> None:
    """Judge where everything is to be written, before the work; `inputs` are files that the command reads."""
    targets = files | folders
    for option, target in targets.items():
        others = [*inputs, *(other for name, other in targets.items() if name != option)]
        if option in files:
            writable(f"--{option}", target, others)
            continue
        way_open(f"--{option}", target)
        if target.resolve() in [other.resolve() for other in others]:
            raise InputError(f"--{option} {target}: is given for something else too; expected a folder of its own")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--{option} {target}: cannot be written: {error.strerror or error}") from None


def _write_c(work: _Work, at: Path, target: Path) -> None:
    from platform_ctrl.cli.staged import write_folder_record
    from platform_ctrl.export import write_c
    from platform_ctrl.verification.given import opened, read_controllers

    read_controllers(cast(Path, work.file), work.job)  # judged as a file, before its entries are taken
    _, data = opened(cast(Path, work.file))
    versions = data.get("versions")
    words = ["platform-ctrl", "export", str(work.path), "--controllers", str(work.file), "--c", str(target)]
    words += _as_typed(work.c_options)
    written = write_c(
        work.job,
        data["controllers"],
        at,
        sha256=work.about["controllers"]["sha256"],
        versions=versions if isinstance(versions, Mapping) else None,
        command=shlex.join(words),
        **work.c_options,
    )
    work.notes += written.notes
    write_folder_record(at, work.about)


def _as_typed(options: Mapping[str, Any]) -> list[str]:
    """Return the words of the command line that say the options of the C source."""
    words = ["--number", options["number"], "--anti-windup", options["anti_windup"]]
    for option, name in (("--range", "ranges"), ("--integral-limit", "limits")):
        words += [word for key, number in options.get(name, {}).items() for word in (option, f"{key}={number!r}")]
    return [*words, *(["--accuracy", repr(options["accuracy"])] if "accuracy" in options else [])]


def _numbers(option: str, given: list[str] | None) -> dict[str, float]:
    """Return what stands as NAME=NUMBER behind an option, by name."""
    out = {}
    for one in given or []:
        name, _, number = one.rpartition("=")
        try:
            out[name] = float(number)
        except ValueError:
            name = ""
        if not name:
            raise InputError(f"{option} {one}: expected a name, = and a number, as in alpha9=0.01")
        if not (math.isfinite(out[name]) and out[name] > 0.0):
            raise InputError(f"{option} {one}: expected a finite number > 0")
    return out


def _write_csv(work: _Work, at: Path, target: Path) -> None:
    from platform_ctrl.cli.staged import write_folder_record
    from platform_ctrl.export import job_responses, write_responses

    for table in job_responses(work.job, work.controllers):
        name, count = re.sub(r"[^\w.+-]+", "_", table.name), 1
        while (at / f"{name}{f'_{count}' * (count > 1)}.csv").exists():
            count += 1
        path = at / f"{name}{f'_{count}' * (count > 1)}.csv"
        write_responses(table.response, path, form=cast(Any, work.form), notes=table.notes)
    write_folder_record(at, work.about)


def _write_mat(work: _Work, at: Path, target: Path) -> None:
    from platform_ctrl.export import controller_systems, model_systems, write_mat

    write_mat(controller_systems(work.job, work.controllers) + model_systems(work.job), at)


def _write_models(work: _Work, at: Path, target: Path) -> None:
    from platform_ctrl.export import controller_systems, model_systems, write_systems

    write_systems(controller_systems(work.job, work.controllers) + model_systems(work.job), at)


def _write_mjcf(work: _Work, at: Path, target: Path) -> None:
    from platform_ctrl.export import write_mjcf

    notes = write_mjcf(work.job.platform, at, root=cast(Any, work.root))
    work.notes += [f"{target}: {note}" for note in notes]


def _write_fmu(work: _Work, at: Path, target: Path) -> None:
    from platform_ctrl.export import write_fmu

    write_fmu(work.job, work.controllers, at, manoeuvre=work.manoeuvre, result=work.file)


_WRITERS: dict[str, Callable[[_Work, Path, Path], None]] = {
    "c": _write_c,
    "mat": _write_mat,
    "models": _write_models,
    "csv": _write_csv,
    "mjcf": _write_mjcf,
    "fmu": _write_fmu,
}
