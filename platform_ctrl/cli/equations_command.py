"""``platform-ctrl equations``: a plant's equations in symbols."""

from __future__ import annotations

from typing import Annotated

import typer

from platform_ctrl.errors import InputError

FORMATS = ("text", "latex", "json")
TERMS = ("paper", "exact")
EXACT = "exact"


def equations(
    plant: Annotated[
        str, typer.Argument(metavar="PLANT", help="A shipped plant's name, or a plant file (TOML).", show_default=False)
    ],
    form: Annotated[
        str, typer.Option("--format", metavar="|".join(FORMATS), help="latex: a fragment that needs amsmath.")
    ] = "text",
    order: Annotated[
        str,
        typer.Option(
            metavar="N",
            help="Matrices to order 0, 1, 2 or 3 in the angles, or exact: in sines and cosines, for small trees.",
        ),
    ] = "1",
    terms: Annotated[
        str,
        typer.Option(
            metavar="|".join(TERMS),
            help="paper: A constant, and in (27) the terms that the paper keeps. exact: all terms.",
        ),
    ] = "paper",
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
) -> None:
    """Print the equations of a plant in symbols.

    By the numbers of the paper: B (21), A (23), the rotors' axial inertia (24), Coriolis (25) and gyroscopic matrix
    (26), and the gimbal equations (27), (19) and (15), with every symbol's meaning, unit and number.

    \b
    platform-ctrl equations three_gyro_platform
    platform-ctrl equations plant.toml --format latex > equations.tex
    platform-ctrl equations plant.toml --terms exact --order 2 --json
    """  # noqa: D301
    for option, given, known in (("--format", form, FORMATS), ("--terms", terms, TERMS)):
        if given not in known:
            raise InputError(f"{option}: given {given!r}; expected {', '.join(known[:-1])} or {known[-1]}")
    if order not in ("0", "1", "2", "3", EXACT):
        raise InputError(f"--order: given {order!r}; expected 0, 1, 2, 3 or {EXACT}")
    from platform_ctrl.reading import read_platform
    from platform_ctrl.symbolic import equations as found

    platform, to = read_platform(plant), None if order == EXACT else int(order)
    if as_json or form == "json":
        import json

        record = found(platform, "json", order=to, terms="exact" if terms == "exact" else "paper")
        typer.echo(json.dumps(record, indent=2))
        return
    shown = found(platform, "latex" if form == "latex" else "text", to, "exact" if terms == "exact" else "paper")
    typer.echo(shown, nl=False)
