"""Arguments and options that several commands have, and the files that they name."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from platform_ctrl.common.files import remove_unfinished
from platform_ctrl.errors import InputError

if TYPE_CHECKING:
    from platform_ctrl.job.job import Job

Word = TypeVar("Word", bound=str)

DESIGNED = Path("out")
CAMPAIGN = Path("campaign")
RESULT = "result.json"
REPORT = "report.html"


def folder_option(help: str) -> Any:
    """Return the option of the folder that a command writes to."""
    return typer.Option("--out", "-o", metavar="DIR", help=help)


JobFile = Annotated[Path, typer.Argument(metavar="JOB", help="Job file (TOML); platform-ctrl new writes one.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON alone on standard output; no progress.")]
Prove = Annotated[
    bool,
    typer.Option(
        "--prove",
        help="Prove stability and disk margins in interval arithmetic as well; takes minutes, needs the extra proofs.",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
Controllers = Annotated[
    Path | None,
    typer.Option(
        "--controllers",
        metavar="FILE",
        help=f"Controllers: a {RESULT}, or a JSON file with its keys schema and controllers alone. Default: JOB with "
        f".controllers.json in place of .toml if that file exists, else {DESIGNED / RESULT}; these have to be those of "
        "this job and its plant as they are now.",
    ),
]
CampaignFolder = Annotated[
    Path | None,
    typer.Option(
        "--campaign",
        metavar="DIR",
        help="Folder of a campaign of this job with these controllers: the report gets a section about it, and a run "
        "that violates a limit counts in the verdict.",
    ),
]


def job_of(path: Path) -> Job:
    """Return the job in a file."""
    from platform_ctrl.design.methods import read_job

    try:
        return read_job(path)
    except InputError as error:
        raise InputError(_not_a_job(path) or str(error)) from None


def _not_a_job(path: Path) -> str | None:
    """Return a message for a file that is no job; None where the message of its reader is better."""
    from platform_ctrl.plant.mistakes import one_line
    from platform_ctrl.plant.source import shipped_models

    name = one_line(str(path))
    try:
        there, absent = path.is_file(), not os.path.lexists(path)
    except OSError:  # a path that no file can have
        return None
    tables = _tables(path) if there else {}
    if "root" in tables and "loop" not in tables:
        return f"{name}: is a plant, not a job; platform-ctrl new NAME writes a job to start from"
    if absent and name in shipped_models():
        return f"{name}: is a shipped plant, not a job; platform-ctrl new NAME writes a job to start from"
    return None


def _tables(path: Path) -> dict[str, Any]:
    from platform_ctrl.plant.source import open_file

    try:
        return open_file(path).data
    except InputError:
        return {}


def controller_file(given: Path | None, folder: Path | None, path: Path, job: Job, quiet: bool) -> tuple[Path, str]:
    """Return the file that controllers come from, and a line for the end of the command that says which one it was.

    The line is empty where the file was given to a command that is `quiet`.
    That is the given file, or the one saved beside the job file at `path`, or the result in `folder`, or that of
    design. One that was not given must be of this job and its plant, and not older than what design made of them.
    """
    file = given or existing_controllers(folder, path)
    if file is None:
        raise InputError(
            f"{DESIGNED / RESULT}: there is no such file; run platform-ctrl design first, which writes controllers, or "
            "name a file with --controllers"
        )
    from platform_ctrl.verification.controllers import differing_origin

    wrong = differing_origin(file, job)
    if given is None:
        _expect_newest(file, _result_in(folder), path, job)
        if wrong:
            raise InputError(
                f"{file}: {wrong}; run platform-ctrl design {path}, or name the file with --controllers to use it as "
                "it is"
            )
    said = given is None or not quiet
    return file, f"controllers: {file}{f', which {wrong}' if wrong else ''}" if said else ""


def existing_controllers(folder: Path | None, path: Path) -> Path | None:
    """Return the file that controllers come from where none is named, or None where there is none."""
    from platform_ctrl.app.saving import controllers_beside

    files = (controllers_beside(path), _result_in(folder))
    return next((file for file in files if file.exists()), None)


def _result_in(folder: Path | None) -> Path:
    named = None if folder is None else folder / RESULT
    return named if named is not None and named.exists() else DESIGNED / RESULT


def _expect_newest(file: Path, result: Path, path: Path, job: Job) -> None:
    """Refuse controllers that are older than what design made of the same job and plant."""
    from platform_ctrl.verification.controllers import is_of_job

    # That of this folder, and that of the folder of the job.
    for made in dict.fromkeys((result, path.parent / DESIGNED / RESULT)):
        newer = file != made and made.is_file() and made.stat().st_mtime_ns > file.stat().st_mtime_ns
        if newer and is_of_job(made, job):
            words = f"{file}: is older than {made}, which platform-ctrl design {path} wrote for this job"
            raise InputError(f"{words}; name one of the two with --controllers, or remove {file}")


def one_of(option: str, given: str, known: tuple[Word, ...]) -> Word:
    """Return the word among `known` that an option has."""
    for word in known:
        if word == given:
            return word
    raise InputError(f"{option}: must be {', '.join(known[:-1])} or {known[-1]}, got {given!r}")


def files_read(job: Path) -> list[Path]:
    """Return a job's file and all that its texts may name beside it: a plant, measured responses, logs."""
    tables: list[Any] = [_tables(job)]
    texts: dict[str, None] = {}
    for item in tables:  # it grows
        if isinstance(item, str):
            texts[item] = None
        elif isinstance(item, dict | list):
            tables.extend(item.values() if isinstance(item, dict) else item)
    return [job, *(job.parent / text for text in texts)]


def prepare_folder(folder: Path, files: Sequence[str] = ()) -> None:
    """Make the folder and try to write there: before the work, not after it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_unfinished(folder)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"-o {folder}: is no folder, or its path leads through a file; name a folder") from None
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written to: {error.strerror or error}; name another folder") from None
    for name in files:
        if os.path.isdir(folder / name):
            raise InputError(f"-o {folder}: {name} is a folder there, but must be a file or not exist")


def expect_target(option: str, target: Path, others: Sequence[Path], folder: bool = False) -> None:
    """Make the folder of a target and try to write there: before the work, not after it.

    None of `others`, which the command reads or writes, may be the target.
    """
    where, kind = f"{option} {target}", "folder" if folder else "file"
    try:
        blocked = next((part for part in target.parents if part.exists() and not part.is_dir()), None)
        if blocked is not None:
            raise InputError(f"{where}: {blocked} is a file, but must be a folder or not exist")
        if target.resolve() in [other.resolve() for other in others]:
            raise InputError(f"{where}: the command reads or writes it for something else too; name another {kind}")
        if os.path.lexists(target) and not (target.is_dir() if folder else target.is_file()):
            raise InputError(f"{where}: is no {kind}, but must be a {kind} or not exist")
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as error:
        raise InputError(f"{where}: cannot be written: {error.strerror or error}; name another {kind}") from None
