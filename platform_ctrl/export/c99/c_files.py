"""Controllers of a job as C99 source files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from platform_ctrl.common.arguments import known_names
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import at_most
from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError
from platform_ctrl.export.c99.c_text import FILES, Names, field_names
from platform_ctrl.export.c99.controller_files import ControllerFiles, job_files
from platform_ctrl.export.c99.float_error import NOTED, float_error
from platform_ctrl.export.c99.floating_files import FloatingFiles, cost_of, drive_inputs, drive_notes, drive_words
from platform_ctrl.export.c99.from_design import entries_of, scheme_of, with_excess
from platform_ctrl.export.c99.scheme import Entry, Scheme, excess_gain
from platform_ctrl.export.c99.windup import Windup, back_calculation, proved
from platform_ctrl.job.job import Job

if TYPE_CHECKING:
    import control

    from platform_ctrl.export.fixed_point.model import FixedPoint

AnyNumber = Literal["double", "float", "q31", "q15"]
AntiWindup = Literal["back-calculation", "proved", "none"]

# The remark on anti-windup is about the controller in real numbers.
_ROUNDED = " So in real arithmetic: rounding, and the ends of integrals and excess below, come on top."


@value
class Written:
    """The files written, and notes."""

    files: tuple[Path, ...]  # Their paths
    notes: tuple[str, ...] = ()  # A line each for what a user should know: rounding, limits without anti-windup


@check_arguments
def write_c(  # noqa: PLR0913 - options by keyword
    job: Job,
    entries: Sequence[Mapping[str, Any] | control.StateSpace],
    folder: str | os.PathLike[str],
    *,
    number: AnyNumber = "double",
    anti_windup: AntiWindup = "back-calculation",
    sha256: str = "",
    versions: Mapping[str, str] | None = None,
    command: str = "",
    ranges: Mapping[str, float] | None = None,
    limits: Mapping[str, float] | None = None,
    accuracy: float = 0.02,
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
        Type of all numbers: ``"double"``, ``"float"``, or fixed point.
    anti_windup
        What the excess of a limited torque does: ``"back-calculation"`` takes integrators back, ``"proved"`` is
        the gain of `design.anti_windup` where there is one, ``"none"``.
    sha256
        Of the result file, hexadecimal digits, for the headers.
    versions
        ``versions`` of the result file, for the headers.
    command
        The command that writes, for the headers.
    ranges
        Fixed point alone: largest magnitudes of inputs, in SI units, that the plant does not have, or other ones.
    limits
        Fixed point alone: where integrals stop, by state, in units of the state; default from the torquers' limits.
    accuracy
        Fixed point alone: largest bound of a torque's error as a share of its limit.

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
    signals = field_names([*named, *drive_inputs(job, named, number)])
    known_names("ranges", list(ranges or {}), [name for scheme in schemes for name in scheme.inputs])
    known_names("limits", list(limits or {}), [name for scheme in schemes for name in scheme.states])
    prefixes = Names(24, FILES)
    units: list[ControllerFiles] = []
    for scheme, remark in zip(schemes, remarks, strict=True):
        own: dict[str, Any] = {"prefix": prefixes.new(scheme.name).lower(), "signals": signals}
        if number == "q31" or number == "q15":
            fixed = _fixed(job, scheme, number, ranges, limits, accuracy)
            units.append(_integer_files(fixed, remark, own))
            notes.append(_integer_note(fixed))
        else:
            words, doubts = _in_single_precision(job, scheme) if number == "float" else ([], [])
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


def _in_single_precision(job: Job, scheme: Scheme) -> tuple[list[str], list[str]]:
    """Return a paragraph for the header about the errors of float, and notes on large ones."""
    ranges = {name: _range(job, name) for name in scheme.inputs}
    error = float_error(scheme, ranges)
    inputs = ", ".join(
        f"{name} {size:.3g} {what}" for (name, size), what in zip(ranges.items(), scheme.input_units, strict=True)
    )
    outputs = ", ".join(
        f"{name} {at_most(size, 2)} {what}"
        for name, size, what in zip(scheme.outputs, error.bound, scheme.output_units, strict=True)
    )
    differ = (
        f"inputs within ({inputs}), integrals worth no more than the limits, same states at first: after {error.steps} "
        f"samples outputs differ by at most ({outputs}), while no limit acts"
        if np.all(np.isfinite(error.bound))
        else "the controller is unstable by itself, so that outputs differ ever more; the loop keeps them together"
    )
    words = (
        f"Float against double: {differ}. Rounded "
        f"coefficients change the response by at most {at_most(error.response, 2)} of its size, and a pole "
        f"by {at_most(error.pole, 2)} of its distance from z = 1."
    )
    notes = []
    if error.unseen.any():
        lost = ", ".join(
            f"{name} {size:.2g} {what}"
            for name, size, what in zip(scheme.inputs, error.unseen, scheme.input_units, strict=True)
        )
        words += f" Smaller than ({lost}) and constant, an input may be lost in the last digit of an integral."
        still = {pickoff.name: max(pickoff.noise_rms, 0.5 * pickoff.quantisation) for pickoff in job.platform.pickoffs}
        for name, size in zip(scheme.inputs, error.unseen, strict=True):
            # Larger noise acts as dither: the integral then follows on average.
            if size > max(still.get(name, 0.0), 1e-4 * ranges[name]):
                notes.append(
                    f"{scheme.name}: as float, an integral may lose a constant {name} of {size:.2g}; use double"
                )
    if max(error.response, error.pole) > NOTED:
        notes.append(
            f"{scheme.name}: as float, the response changes by {error.response:.2g} of its size and a pole by "
            f"{error.pole:.2g} of its distance from z = 1"
        )
    return [words], notes


def _range(job: Job, name: str) -> float:
    from platform_ctrl.export.fixed_point.splitting import input_ranges

    try:
        return input_ranges((name,), job)[name]
    except InputError:
        # Neither stops nor a limit: errors per unit.
        return 1.0


def _fixed(
    job: Job,
    scheme: Scheme,
    number: Literal["q31", "q15"],
    ranges: Mapping[str, float] | None,
    limits: Mapping[str, float] | None,
    accuracy: float,
) -> FixedPoint:
    from platform_ctrl.export.fixed_point.lowering import fixed_point
    from platform_ctrl.export.fixed_point.splitting import input_ranges

    own = {name: limit for name, limit in (limits or {}).items() if name in scheme.states}
    found = input_ranges(scheme.inputs, job, ranges)
    return fixed_point(scheme, found, number=number, limits=own, accuracy=accuracy)


def _integer_files(fixed: FixedPoint, remark: str, own: dict[str, Any]) -> ControllerFiles:
    # Ball arithmetic is loaded when it is needed.
    from platform_ctrl.export.fixed_point.integer_files import IntegerFiles

    return IntegerFiles(scheme=fixed.scheme, fixed=fixed, remarks=(remark + _ROUNDED,), **own)


def _integer_note(made: FixedPoint) -> str:
    scheme = made.scheme
    worst = ", ".join(
        f"{name} {at_most(made.error[name], 2)} {what}"
        for name, what in zip(scheme.outputs, scheme.output_units, strict=True)
    )
    return f"{scheme.name}: {made.number}, no overflow; torques, integrals aside, are off by at most {worst}"
