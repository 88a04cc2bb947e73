"""``platform-ctrl new``: a commented plant and job file to start from."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import Annotated

import typer

from platform_ctrl.cli import completion
from platform_ctrl.cli.job_arguments import Json, Quiet, option, prepare_folder
from platform_ctrl.errors import InputError

# Valid as a file name on all systems and, unquoted, in a text.
_NAME = re.compile(r"\w[\w.-]*")


def new(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="What the two files will be called: NAME_plant.toml and NAME.toml.", show_default=False
        ),
    ],
    out: Annotated[
        Path, option("--out", "-o", metavar="DIR", help="Folder for both; made if needed. Default: here.")
    ] = Path("."),
    like: Annotated[
        str | None,
        option(
            "--like",
            metavar="PLANT",
            help="Start from this plant: a shipped name or a plant file. Default: one gyro in two gimbals.",
            words=completion.plants,
        ),
    ] = None,
    force: Annotated[bool, option("--force", help="Overwrite files that are there.", default=True)] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented plant and a job for it, to start from.

    NAME_plant.toml describes the bodies, rotors, torquers and pick-offs; NAME.toml defines the loops to be designed,
    their methods and their requirements. Both work as they are; then put in your own numbers. With --like the
    loops are the subsystems of that plant, with starting values from rules of thumb.

    \b
    platform-ctrl new gyro                              gyro_plant.toml and gyro.toml
    platform-ctrl design gyro.toml                      designs and checks its loop: out/report.html
    platform-ctrl new pyramid --like vscmg_pyramid      from a plant that platform-ctrl models lists
    platform-ctrl new mine --like plants/mine.toml      a job for a plant of your own
    """  # noqa: D301
    from platform_ctrl.cli.atomic_output import written_together
    from platform_ctrl.cli.starting_files import own_start, start_like
    from platform_ctrl.cli.terminal import progress
    from platform_ctrl.common.json_text import json_text

    title = _title(name)
    files = (f"{title}_plant.toml", f"{title}.toml")
    for file in files:
        if os.path.exists(out / file) and not force:
            raise InputError(f"{out / file}: exists already; choose another NAME or -o DIR, or overwrite with --force")
    with progress(quiet or as_json, "reading the plant") as say:
        made = own_start(title, *files) if like is None else start_like(like, title, *files, say)
        prepare_folder(out, files)
        with written_together(out) as folder:
            for file, text in zip(files, (made.plant, made.job), strict=True):
                (folder / file).write_text(text, encoding="utf-8", newline="\n")
    plant, job = (out / file for file in files)
    then = [["design", job], ["equations", plant], ["simulate", job, "--manoeuvre", "turn"]]
    commands = [shlex.join(["platform-ctrl", *map(str, words)]) for words in then]
    if as_json:
        record = {"schema": 1, "plant": str(plant), "job": str(job), "like": like, "loops": made.loops}
        typer.echo(json_text(record | {"added": made.added, "next": commands}))
        return
    typer.echo(f"plant: {plant}{f' (like {like})' if like else ''}")
    for line in made.added:
        typer.echo(f"  added: {line}, which a caging loop needs and the plant does not have")
    typer.echo(f"job:   {job} ({', '.join(made.loops)})")
    for word, command in zip(("next:", "also:", "then:"), commands, strict=True):
        typer.echo(f"{word:<6} {command}")


def _title(name: str) -> str:
    title = name.removesuffix(".toml")
    if not _NAME.fullmatch(title):
        raise InputError(f"NAME: {name!r} may contain only letters, digits, _, - and .; name a folder by -o DIR")
    return title
