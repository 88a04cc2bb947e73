"""``platform-ctrl import``: a robot description as a plant file."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from platform_ctrl.cli.exits import noted, print_json
from platform_ctrl.cli.job_arguments import Json, expect_target

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
    as_json: Json = False,
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
    from platform_ctrl.common.files import write_whole
    from platform_ctrl.export.robots.plant_file import import_robot

    if out is not None:
        expect_target("--out", out, [file])
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
