"""The commands, and those to start with: ``new``, ``models``, ``equations`` and ``warm-up``.

Each imports what it needs when it runs, so that ``--help`` and ``models`` answer at once. In their help a line with a
backspace, click's own mark, keeps the lines below it as they are.
"""

from __future__ import annotations

import os
import re
import shlex
import time
from pathlib import Path
from typing import Annotated

import typer

from platform_ctrl.cli.budget_command import budget
from platform_ctrl.cli.campaign_command import campaign
from platform_ctrl.cli.design_commands import check, design
from platform_ctrl.cli.exits import print_json
from platform_ctrl.cli.export_command import export, import_description
from platform_ctrl.cli.job_arguments import Json, Quiet, folder_option, one_of, prepare_folder
from platform_ctrl.cli.serve_command import serve
from platform_ctrl.cli.simulate_command import simulate
from platform_ctrl.errors import InputError
from platform_ctrl.mechanics.symbolic import HIGHEST_ORDER, TERMS, WRITTEN

# Valid as a file name on all systems and, unquoted, in a text.
_NAME = re.compile(r"\w[\w.-]*")
EXACT = "exact"
ORDERS = (*map(str, range(HIGHEST_ORDER + 1)), EXACT)


# What `new` copies, by what people have: jobs of the folder examples, each with its plant.
KINDS = {
    "caged-gyro": "caged_gyro",
    "camera-gimbal": "camera_gimbal",
    "multirotor-gimbal": "multirotor_gimbal",
    "drone-gimbal": "drone_gimbal",
    "telescope-mount": "telescope_mount",
    "seeker-head": "seeker_head",
    "steering-mirror": "fast_steering_mirror",
    "floated-gyro": "floated_gyro_platform",
    "stabilised-platform": "three_gyro_platform",
    "control-moment-gyro": "control_moment_gyro",
}
_PLANT = re.compile(r'^plant = "(\w+)(\.toml)?"', re.MULTILINE)


Name = Annotated[
    str, typer.Argument(metavar="NAME", help="What the two files will be called: NAME_plant.toml and NAME.toml.")
]
Out = Annotated[Path, folder_option("Folder for both; made if needed.")]
Kind = Annotated[str, typer.Option("--kind", metavar="KIND", help=f"What you have: {', '.join(KINDS)}.")]


def new(
    name: Name,
    out: Out = Path("."),
    kind: Kind = "caged-gyro",
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that are there.")] = False,
    as_json: Json = False,
) -> None:
    """Copy a commented plant and a job for it, to start from.

    NAME_plant.toml describes the bodies, rotors, torquers and sensors; NAME.toml defines the loops to be designed,
    their methods and their requirements. Both work as they are; then put in your own numbers.

    \b
    platform-ctrl new gyro
        gyro_plant.toml and gyro.toml
    platform-ctrl design gyro.toml
        designs and checks its loop: out/report.html
    platform-ctrl new eye --kind camera-gimbal
        by what you have
    """  # noqa: D301
    from platform_ctrl.common.files import write_whole

    title, known = _title(name), one_of("--kind", kind, tuple(KINDS))
    files = (f"{title}_plant.toml", f"{title}.toml")
    for file in files:
        if os.path.lexists(out / file) and not force:
            raise InputError(f"{out / file}: exists already; choose another NAME or -o DIR, or overwrite with --force")
    prepare_folder(out, files)
    for file, text in zip(files, _copied(KINDS[known], title), strict=True):
        write_whole(out / file, text)
    plant, job = (out / file for file in files)
    commands = [
        shlex.join(["platform-ctrl", word, str(file)]) for word, file in (("design", job), ("equations", plant))
    ]
    if as_json:
        print_json({"schema": 1, "plant": str(plant), "job": str(job), "kind": kind, "next": commands})
        return
    typer.echo(f"plant: {plant}\njob:   {job}\nnext:  {commands[0]}\nalso:  {commands[1]}")


def _copied(example: str, title: str) -> tuple[str, str]:
    """Return the texts of the plant and of the job of an example under another name."""
    from platform_ctrl.plant.source import example_source, platform_source

    job = example_source(example)
    found = _PLANT.search(job)
    assert found is not None, example
    plant = example_source(found[1]) if found[2] else platform_source(found[1])
    job = _PLANT.sub(f'plant = "{title}_plant.toml"', job, count=1)
    job = re.sub(r'^name = ".*?"', f'name = "{title}"', job, count=1, flags=re.MULTILINE)
    return tuple(  # type: ignore[return-value]
        re.sub(rf"(examples/)?\b{example}(_plant)?\.toml", rf"{title}\2.toml", text) for text in (plant, job)
    )


def _title(name: str) -> str:
    title = name.removesuffix(".toml")
    if not _NAME.fullmatch(title):
        raise InputError(f"NAME: {name!r} may contain only letters, digits, _, - and .; name a folder by -o DIR")
    return title


def models(as_json: Json = False) -> None:
    """List the plants that come with the package.

    \b
    platform-ctrl models                            to read
    platform-ctrl models --json | jq -r '.[].name'  the names alone
    """  # noqa: D301
    import tomllib

    from platform_ctrl.cli.terminal import screen, show_pairs
    from platform_ctrl.job.quantities import count
    from platform_ctrl.plant.source import platform_source, shipped_models

    listed = []
    for name in shipped_models():
        plant = tomllib.loads(platform_source(name))
        parts = {key: len(plant.get(key, [])) for key in ("gimbal", "rotor", "torquer", "pickoff")}
        listed.append({"name": name, "title": plant["name"], "source": plant.get("source", ""), **parts})
    if as_json:
        print_json(listed)
        return
    pairs = [(m["name"], f"{m['title']}: {count(m['gimbal'], 'gimbal')}, {count(m['rotor'], 'rotor')}") for m in listed]
    show_pairs(screen(), pairs)


Plant = Annotated[
    str,
    typer.Argument(metavar="PLANT", help="A shipped plant's name (see platform-ctrl models), or a plant file (TOML)."),
]
Form = Annotated[
    str,
    typer.Option(
        "--format",
        metavar="|".join(WRITTEN),
        help="How they are written; latex is to be put into a document that loads amsmath.",
    ),
]
Order = Annotated[
    str,
    typer.Option(
        metavar="N",
        help=f"Matrices to order 0 to {HIGHEST_ORDER} in the angles, or {EXACT}: in sines and cosines, for small "
        "trees.",
    ),
]
Terms = Annotated[
    str,
    typer.Option(
        metavar="|".join(TERMS), help="paper: A constant, and in (27) the terms that the paper keeps. exact: all terms."
    ),
]


def equations(
    plant: Plant,
    form: Form = "text",
    order: Order = "1",
    terms: Terms = "paper",
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json; no progress.")] = False,
    quiet: Quiet = False,
) -> None:
    """Print the equations of a plant in symbols.

    By the numbers of the paper: B (21), A (23), the rotors' axial inertia (24), Coriolis (25) and gyroscopic matrix
    (26), and the gimbal equations (27), (19) and (15), with every symbol's meaning, unit and number.

    \b
    platform-ctrl equations three_gyro_platform
        to read
    platform-ctrl equations plant.toml --format latex > equations.tex
        to print
    platform-ctrl equations plant.toml --terms exact --order 2 --json
        all terms to second order, to compute with
    """  # noqa: D301
    chosen_form, chosen_terms = one_of("--format", form, WRITTEN), one_of("--terms", terms, TERMS)
    if as_json and chosen_form == "latex":
        raise InputError("--format latex and --json exclude each other; leave one out")
    chosen_order = None if one_of("--order", order, ORDERS) == EXACT else int(order)
    from platform_ctrl.cli.terminal import progress

    chosen_form = "json" if as_json else chosen_form
    with progress(quiet or as_json, f"deriving the equations of {plant}"):
        from platform_ctrl.mechanics.symbolic import equations as found
        from platform_ctrl.plant.reading import read_platform

        written = found(read_platform(plant), chosen_form, chosen_order, chosen_terms)
    if chosen_form == "json":
        print_json(written)
    else:
        typer.echo(written, nl=False)


def warm_up(as_json: Json = False, quiet: Quiet = False) -> None:
    """Compile what the other commands need, once an installation.

    The simulation is compiled where it is first used, which takes about half a minute, and kept beside the installed
    package. This compiles it before anybody waits for it: in an image, before CI runs its tests, after an update. What
    is compiled already is not compiled again.

    \b
    platform-ctrl warm-up
        once an installation
    platform-ctrl warm-up --quiet
        in a Dockerfile: RUN platform-ctrl warm-up --quiet
    """  # noqa: D301
    from platform_ctrl.cli.terminal import progress

    start = time.monotonic()
    with progress(quiet or as_json, "compiling the simulation"):
        from platform_ctrl.plant.reading import read_platform
        from platform_ctrl.simulation.batch import compile_kernel
        from platform_ctrl.simulation.free_motion import rollout

        compile_kernel()
        rollout(read_platform("rate_gyro"), q=[[0.0]], velocity=[[0.0] * 4], step=1e-4, steps=1)
    seconds = time.monotonic() - start
    if as_json:
        print_json({"schema": 1, "seconds": seconds})
    else:
        typer.echo(f"compiled in {seconds:.0f} s")


app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
    epilog="Exit code: 0 done, every requirement met; 1 done, a requirement not met, or no controller found; 2 the "
    "input is wrong; 130 interrupted. COMMAND --help gives examples.",
)


def _print_version(requested: bool) -> None:
    if requested:
        from platform_ctrl import __version__

        typer.echo(f"platform-ctrl {__version__}")
        raise typer.Exit


@app.callback()
def platform_ctrl(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Design the control loops of gimballed platforms and check them on the coupled non-linear plant.

    \b
    platform-ctrl new gyro
        a plant and a job to start from
    platform-ctrl design gyro.toml
        design, check, report: out/report.html
    platform-ctrl check gyro.toml
        the verdicts again, without designing
    platform-ctrl simulate gyro.toml --manoeuvre turn
        one run with these controllers
    platform-ctrl campaign gyro.toml --runs 1000
        many runs with variations
    """  # noqa: D301


app.command()(new)
app.command()(models)
app.command("import")(import_description)
app.command()(equations)
app.command("warm-up")(warm_up)
app.command()(design)
app.command()(check)
app.command()(budget)
app.command()(serve)
app.command(short_help="Simulate one manoeuvre, or one run of a campaign again.")(simulate)
app.command(short_help="Simulate many runs, with variations.")(campaign)
app.command()(export)
