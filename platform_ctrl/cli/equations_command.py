"""``platform-ctrl equations``: a plant's equations in symbols."""

from __future__ import annotations

from typing import Annotated, TypeVar

import typer

from platform_ctrl.cli import completion
from platform_ctrl.cli.job_arguments import Quiet, option
from platform_ctrl.errors import InputError
from platform_ctrl.mechanics.symbolic.options import HIGHEST_ORDER, TERMS, WRITTEN

EXACT = "exact"
ORDERS = (*map(str, range(HIGHEST_ORDER + 1)), EXACT)

Word = TypeVar("Word", bound=str)


def equations(
    plant: Annotated[
        str,
        typer.Argument(
            metavar="PLANT",
            help="A shipped plant's name (see platform-ctrl models), or a plant file (TOML).",
            show_default=False,
            autocompletion=completion.plants,
        ),
    ],
    form: Annotated[
        str,
        option(
            "--format",
            metavar="|".join(WRITTEN),
            help="How they are written; latex is to be put into a document that loads amsmath.",
            default=True,
        ),
    ] = "text",
    order: Annotated[
        str,
        typer.Option(
            metavar="N",
            help=f"Matrices to order 0 to {HIGHEST_ORDER} in the angles, or {EXACT}: in sines and cosines, for small "
            "trees.",
            autocompletion=completion.words(*ORDERS),
        ),
    ] = "1",
    terms: Annotated[
        str,
        typer.Option(
            metavar="|".join(TERMS),
            help="paper: A constant, and in (27) the terms that the paper keeps. exact: all terms.",
            autocompletion=completion.words(*TERMS),
        ),
    ] = "paper",
    as_json: Annotated[bool, option("--json", help="The same as --format json; no progress.", default=True)] = False,
    quiet: Quiet = False,
) -> None:
    """Print the equations of a plant in symbols.

    By the numbers of the paper: B (21), A (23), the rotors' axial inertia (24), Coriolis (25) and gyroscopic matrix
    (26), and the gimbal equations (27), (19) and (15), with every symbol's meaning, unit and number.

    \b
    platform-ctrl equations three_gyro_platform                        to read
    platform-ctrl equations plant.toml --format latex > equations.tex  to print
    platform-ctrl equations plant.toml --terms exact --order 2 --json  all terms to second order, to compute with
    """  # noqa: D301
    chosen_form, chosen_terms = _one_of("--format", form, WRITTEN), _one_of("--terms", terms, TERMS)
    if as_json and chosen_form == "latex":
        raise InputError("--format latex and --json exclude each other; leave one out")
    chosen_order = None if _one_of("--order", order, ORDERS) == EXACT else int(order)
    from platform_ctrl.cli.terminal import progress

    if as_json:
        chosen_form = "json"
    with progress(quiet or as_json, f"deriving the equations of {plant}"):
        from platform_ctrl.common.json_text import json_text
        from platform_ctrl.mechanics.symbolic.equations import equations as found
        from platform_ctrl.plant.reading import read_platform

        written = found(read_platform(plant), chosen_form, chosen_order, chosen_terms)
        if chosen_form == "json":
            written = f"{json_text(written)}\n"
    typer.echo(written, nl=False)


def _one_of(option: str, given: str, known: tuple[Word, ...]) -> Word:
    for word in known:
        if word == given:
            return word
    raise InputError(f"{option}: must be {', '.join(known[:-1])} or {known[-1]}, got {given!r}")
