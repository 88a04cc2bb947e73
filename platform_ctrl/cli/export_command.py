"""``platform-ctrl export``: controllers and plant of a job in the forms that other tools and compilers take."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from contextlib import ExitStack
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
    plant_file,
    writable,
)
from platform_ctrl.errors import InputError
from platform_ctrl.export.exporters import Export, Exporter, Setting, exporters

WHAT, HOW = "What is written", "How"


class ExportCommand:
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

    __name__ = "export"

    def __init__(self) -> None:
        self.__annotations__: dict[str, Any] = {}  # typer takes those of the signature

    @property
    def __signature__(self) -> inspect.Signature:
        """Arguments and options, those of the registered exporters among them: typer reads them from here."""
        one, kind = inspect.Parameter, inspect.Parameter.KEYWORD_ONLY
        own = [
            one("job", kind, annotation=JobFile),
            one("controllers", kind, annotation=Controllers, default=None),
            *(one(e.name, kind, annotation=_target_option(e), default=None) for e in exporters()),
            *(
                one(_keyword(e, s), kind, annotation=_setting_option(s), default=s.default)
                for e in exporters()
                for s in e.settings
            ),
            one("as_json", kind, annotation=Json, default=False),
            one("quiet", kind, annotation=Quiet, default=False),
        ]
        return inspect.Signature(own, return_annotation=int)

    def __call__(self, job: Path, controllers: Path | None, as_json: bool, quiet: bool, **options: Any) -> int:
        """Write what the options ask for, and return the exit code."""
        from platform_ctrl.cli.atomic_output import own_files, sha256
        from platform_ctrl.cli.terminal import progress
        from platform_ctrl.common.json_text import json_text

        chosen = {e: options[e.name] for e in exporters() if options[e.name] is not None}
        chosen = {e: chosen[e] for e in sorted(chosen, key=lambda e: not e.suffix)}  # files first
        settings = _settings(chosen, options)
        with progress(quiet or as_json, f"reading {job}") as say:
            work = Export(job_of(job), job)
            uses = {e.controllers for e in chosen}
            used = "" if uses == {"unused"} else "controllers: none"
            there = existing_controllers(None, job) is not None
            if controllers is not None or "needed" in uses or (there and "optional" in uses):
                work.controller_file, used = controller_file(controllers, None, job, work.job, quiet or as_json)
            file = work.controller_file
            _check_targets([job, *plant_file(job, work.job), *([file] if file else [])], chosen)
            work.controller_sha256 = None if file is None else sha256(file)
            owned = {e: own_files(e.flag, target) for e, target in chosen.items() if not e.suffix}
            about = {
                "schema": 1,
                "job": work.job.name,
                "platform": work.job.platform.name,
                "controllers": None if file is None else {"file": str(file), "sha256": work.controller_sha256},
            }
            made = _write(work, chosen, settings, owned, about, say)
            written = [
                {"format": exporter.name, "path": str(path), "sha256": sha256(path)}
                for exporter, paths in made.items()
                for path in paths
            ]
        noted(used)
        if as_json:
            typer.echo(json_text(about | {"written": written, "notes": work.notes}))
            return 0
        for exporter, target in chosen.items():
            count = "" if exporter.suffix else f", {len(made[exporter])} files"
            typer.echo(f"{exporter.title}: {target}{count}")
        for note in work.notes:
            typer.echo(note, err=True)
        return 0


export = ExportCommand()


def _write(
    work: Export,
    chosen: Mapping[Exporter, Path],
    settings: Mapping[Exporter, Mapping[str, Any]],
    owned: Mapping[Exporter, Mapping[str, str]],
    about: Mapping[str, object],
    say: Callable[[str], None],
) -> dict[Exporter, list[Path]]:
    """Write all forms or none, and return the files of each; what a folder has of an earlier export goes."""
    from platform_ctrl.cli.atomic_output import beside, expect_own, move_together, write_folder_record
    from platform_ctrl.cli.interrupts import interrupts_deferred

    made: dict[Exporter, list[Path]] = {}
    moves: dict[Path, Path] = {}
    with ExitStack() as all_or_none:
        for exporter, target in chosen.items():
            say(f"writing {target}")
            folder = target.parent if exporter.suffix else target
            unfinished = all_or_none.enter_context(beside(folder))
            moves[unfinished] = folder
            path = unfinished / target.name if exporter.suffix else unfinished
            exporter.write(work, path, target, **settings[exporter])
            if not exporter.suffix:
                write_folder_record(path, about)
            expect_own(unfinished, folder, owned.get(exporter))
            made[exporter] = [folder / one.name for one in sorted(unfinished.iterdir())]
        with interrupts_deferred():
            move_together(moves)
    for exporter, before in owned.items():
        for name in before.keys() - {path.name for path in made[exporter]}:
            (chosen[exporter] / name).unlink(missing_ok=True)
    return made


def _keyword(exporter: Exporter, setting: Setting) -> str:
    return f"{exporter.name}_{setting.name}"


def _target_option(exporter: Exporter) -> Any:
    option = typer.Option(
        exporter.flag,
        metavar="FILE" if exporter.suffix else "DIR",
        help=exporter.help,
        show_default=False,
        rich_help_panel=WHAT,
    )
    return Annotated[Path | None, option]


def _setting_option(setting: Setting) -> Any:
    option = typer.Option(
        setting.flag,
        metavar=setting.metavar,
        help=setting.help,
        show_default=setting.default is not None,
        rich_help_panel=HOW,
    )
    return Annotated[setting.kind if setting.default is not None else setting.kind | None, option]


def _settings(chosen: Mapping[Exporter, Path], options: Mapping[str, Any]) -> dict[Exporter, dict[str, Any]]:
    """Return the settings of each exporter that was chosen; those of others must not be given."""
    if not chosen:
        known = ", ".join(e.flag for e in exporters())
        raise InputError(f"nothing to write; name at least one of {known} (see --help)")
    for exporter in exporters():
        for setting in exporter.settings:
            given = options[_keyword(exporter, setting)]
            if given not in (setting.default, []) and exporter not in chosen:
                raise InputError(f"{setting.flag}: is an option of {exporter.flag}, which must be given too")
            if setting.choices and given not in setting.choices:
                raise InputError(f"{setting.flag} {given}: must be one of {', '.join(setting.choices)}")
    return {e: {s.name: options[_keyword(e, s)] for s in e.settings} for e in chosen}


def _check_targets(inputs: list[Path], targets: Mapping[Exporter, Path]) -> None:
    """Check where everything is to be written, before the work; `inputs` are files that the command reads."""
    for exporter, target in targets.items():
        others = [*inputs, *(other for one, other in targets.items() if one is not exporter)]
        if exporter.suffix:
            writable(exporter.flag, target, others)
            continue
        expect_no_file_above(exporter.flag, target)
        if target.resolve() in [other.resolve() for other in others]:
            raise InputError(f"{exporter.flag} {target}: is used for something else too; name another folder")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{exporter.flag} {target}: cannot be written: {error.strerror or error}") from None
