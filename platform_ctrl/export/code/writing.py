"""Controllers of a job as C99 source files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.export.code.emission import Unit, header, source
from platform_ctrl.export.code.entries import Entry, entries_of
from platform_ctrl.export.code.from_design import scheme_of
from platform_ctrl.export.code.identifiers import Names
from platform_ctrl.export.code.scheme import Provenance, Scheme
from platform_ctrl.frozen import value
from platform_ctrl.job import Job
from platform_ctrl.writing import write_whole

if TYPE_CHECKING:
    import control

AnyNumber = Literal["double", "float", "q31", "q15"]
AntiWindup = Literal["back-calculation", "proved", "none"]

_NUMBERS = ("double", "float", "q31", "q15")
_ANTI_WINDUP = ("back-calculation", "proved", "none")


@value
class Written:
    """What was written.

    Attributes
    ----------
    files
        Their paths.
    notes
        A line each for what a reader should know: rounding, limits without anti-windup.

    References
    ----------
    See docs/generated-code.md.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


def write_c(
    job: Job,
    entries: Sequence[Mapping[str, Any] | control.StateSpace],
    folder: str | os.PathLike[str],
    *,
    number: AnyNumber = "double",
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
        A controller could not be shown to be written out as it is, or does not stand the number type.

    References
    ----------
    See docs/generated-code.md.
    """
    for name, given, known in (("number", number, _NUMBERS), ("anti_windup", anti_windup, _ANTI_WINDUP)):
        if given not in known:
            raise ArgumentError(f"{name}: given {given!r}; expected one of {', '.join(known)}")
    judged = entries_of(job, entries)
    schemes = [_scheme(job, entry, sha256, dict(versions or {}), command) for entry in judged]
    signals = Names(40)
    identifiers = {name: signals[name] for scheme in schemes for name in (*scheme.inputs, *scheme.outputs)}
    prefixes = Names(24)
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{target}: {error.strerror or error}; expected a folder, or a path where one can be"
        ) from None
    files = []
    for scheme in schemes:
        unit = Unit(scheme=scheme, number=number, prefix=prefixes[scheme.name].lower(), signals=identifiers)  # type: ignore[arg-type]
        files.append(write_whole(target / f"{unit.prefix}.h", header(unit)))
        files.append(write_whole(target / f"{unit.prefix}.c", source(unit)))
    return Written(files=tuple(files))


def _scheme(job: Job, entry: Entry, sha256: str, versions: dict[str, str], command: str) -> Scheme:
    origin = Provenance(
        job=job.name,
        plant=job.platform.name,
        loop=entry.loop,
        design=entry.design,
        method=entry.method,
        sha256=sha256,
        versions=versions,
        command=command,
    )
    return scheme_of(job, entry, origin)
