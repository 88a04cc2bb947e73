"""Controllers of a job as C99 source files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from platform_ctrl.common.files import write_whole
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import at_most
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError
from platform_ctrl.export.c99.c_text import FILES, Names, field_names
from platform_ctrl.export.c99.controller_files import ControllerFiles, job_files
from platform_ctrl.export.c99.float_error import NOTED, float_error
from platform_ctrl.export.c99.floating_files import (
    FloatingFiles,
    Number,
    cost_of,
    drive_inputs,
    drive_notes,
    drive_words,
)
from platform_ctrl.export.c99.from_design import entries_of, scheme_of, with_excess
from platform_ctrl.export.c99.scheme import Entry, Scheme, excess_gain
from platform_ctrl.export.c99.windup import Windup, back_calculation, proved
from platform_ctrl.job.job import Job

if TYPE_CHECKING:
    import control


AntiWindup = Literal["back-calculation", "proved", "none"]


@value
class Written:
    """The files written, and notes."""

    files: tuple[Path, ...]  # Their paths
    notes: tuple[str, ...] = ()  # A line each for what a user should know: rounding, limits without anti-windup


@check_arguments
def write_c(
    job: Job,
    entries: Sequence[Mapping[str, Any] | control.StateSpace],
    folder: str | os.PathLike[str],
    *,
    number: Number = "double",
    anti_windup: AntiWindup = "back-calculation",
    sha256: str = "",
    versions: Mapping[str, str] | None = None,
    command: str = "",
) -> Written:
    """Write the controllers of a job as C99: a header and a source file for each, and one pair that runs all.

    Parameters
    ----------
    job
        The job that they belong to.
    entries
        Entries of ``controllers`` in ``result.json``, or `control.StateSpace`, in order of evaluation.
    folder
        Where to; made if it is not there.
    number
        Type of all numbers: ``"double"``, or ``"float"``.
    anti_windup
        What the excess of a limited torque does: ``"back-calculation"`` takes integrators back, ``"proved"`` is
        the gain of `design.anti_windup` where there is one, ``"none"``.
    sha256
        Of the result file, hexadecimal digits, for the headers.
    versions
        ``versions`` of the result file, for the headers.
    command
        The command that writes, for the headers.

    Returns
    -------
    Written
        The files, and what to know about them. The same arguments give the same bytes.

    Raises
    ------
    InputError
        A controller does not fit the job, or the folder cannot be written to.
    ArgumentError
        An option is none of those above.
    DesignError
        A controller cannot be written with an unchanged response, or not in this number type.
    """
    schemes, remarks = [], []
    notes: list[str] = []
    for entry in entries_of(job, entries):
        scheme = scheme_of(job, entry, sha256=sha256, versions=dict(versions or {}), command=command)
        windup = _windup(job, scheme, entry, anti_windup)
        schemes.append(with_excess(scheme, windup.gain))
        remarks.append(windup.remark)
        notes += windup.notes
    named = [name for scheme in schemes for name in (*scheme.inputs, *scheme.outputs)]
    signals = field_names([*named, *drive_inputs(job, named)])
    prefixes = Names(24, FILES)
    units: list[ControllerFiles] = []
    for scheme, remark in zip(schemes, remarks, strict=True):
        own: dict[str, Any] = {"prefix": prefixes.new(scheme.name).lower(), "signals": signals}
        words, doubts = _in_single_precision(scheme) if number == "float" else ([], [])
        units.append(FloatingFiles(scheme=scheme, number=number, remarks=(remark, *words), **own))
        notes += doubts
    texts: dict[str, str] = {}
    for unit in units:
        texts |= {f"{unit.prefix}.h": unit.header(), f"{unit.prefix}.c": unit.source()}
    prefix = prefixes.new(job.name).lower()
    texts |= job_files(prefix, units, job.sampling.period, cost=cost_of(schemes), **drive_words(job, units))
    notes += drive_notes(job, prefix)
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{target}: {why}; name a folder, or a path where one can be made") from None
    files = tuple(write_whole(target / name, text) for name, text in texts.items())
    return Written(files=files, notes=tuple(notes))


def _windup(job: Job, scheme: Scheme, entry: Entry, requested: AntiWindup) -> Windup:
    if entry.excess is not None and requested != "none":
        remark = "Anti-windup: the gain E that came with the controller, x+ = A x + B y + E (limited - commanded)."
        return Windup(gain=excess_gain(scheme), remark=remark)
    if requested == "none":
        gain = np.zeros((len(scheme.states), len(scheme.outputs)))
        remark = "Anti-windup: none, as requested: integrals wind up while an output is at its limit."
        return Windup(gain=gain, remark=remark)
    return proved(job, scheme) if requested == "proved" else back_calculation(scheme)


def _in_single_precision(scheme: Scheme) -> tuple[list[str], list[str]]:
    """Return a paragraph for the header about the errors of float, and notes on large ones."""
    error = float_error(scheme)
    words = (
        f"Float against double: rounded coefficients change the response by at most {at_most(error.response, 2)} of "
        f"its size, and a pole by {at_most(error.pole, 2)} of its distance from z = 1."
    )
    notes = []
    if max(error.response, error.pole) > NOTED:
        notes.append(
            f"{scheme.name}: as float, the response changes by {error.response:.2g} of its size and a pole by "
            f"{error.pole:.2g} of its distance from z = 1"
        )
    return [words], notes
