"""Controllers of a job as C99 source files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.anti_windup import back_calculation
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import System
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.text import at_most
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.sections import flattened
from platform_ctrl.errors import InputError, UnscalableError
from platform_ctrl.export.c99.c_text import FILES, Names, field_names
from platform_ctrl.export.c99.code import Code, Number
from platform_ctrl.export.c99.controller import Controller, controllers_of
from platform_ctrl.export.c99.job_files import drive_inputs, job_files
from platform_ctrl.export.systems import signal_units
from platform_ctrl.job.job import Job

if TYPE_CHECKING:
    import control

# Relative change of the response by coefficients in single precision that causes a note, and an error.
_NOTED, _REFUSED = 1e-3, 1e-2
# A pole this little outside the unit circle lies on it.
_ON_CIRCLE = 1e-6


@value
class Written:
    """The files written, and notes."""

    files: tuple[Path, ...]  # Their paths
    notes: tuple[str, ...] = ()  # A line each for what a user should know: rounding, limits without anti-windup


def write_c(
    job: Job,
    entries: Sequence[Mapping[str, Any] | control.StateSpace],
    folder: str | os.PathLike[str],
    *,
    number: Number = "double",
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
        Type of all numbers: ``"double"`` or ``"float"``.
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
        A controller cannot be written in this number type.
    """
    one_of("number", number, ("double", "float"))
    controllers = controllers_of(job, entries)
    named = [name for one in controllers for name in (*one.inputs, *one.outputs)]
    signals = field_names([*named, *drive_inputs(job, named)])
    prefixes = Names(24, FILES)
    units, notes = [], []
    origin = {"Controllers": f"sha256 {sha256}" if sha256 else ""}
    origin |= {"Versions": ", ".join(map(" ".join, (versions or {}).items())), "Made by": command}
    for one in controllers:
        excess, about_windup, left = _anti_windup(one)
        remark, doubt = _in_single_precision(one) if number == "float" else ("", "")
        design = f"{one.design} (method {one.method})" if one.method else one.design
        about = {"Job": job.name, "Plant": job.platform.name, "Loop": one.name, "Design": design}
        units.append(
            Code(
                controller=one,
                excess=excess,
                number=number,
                prefix=prefixes.new(one.name).lower(),
                signals=signals,
                units=signal_units(job.platform),
                remarks=tuple(text for text in (about_windup, remark) if text),
                origin=about | origin,
            )
        )
        notes += [note for note in (one.note, left, doubt) if note]
    texts = {f"{unit.prefix}.{end}": unit.text(end) for unit in units for end in "hc"}
    prefix = prefixes.new(job.name).lower()
    texts |= job_files(job, prefix, units)
    if job.drives:
        notes.append(f"{prefix}.h: what the drives do is in {prefix}_step, not in the steps of single controllers")
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{target}: {why}; name a folder, or a path where one can be made") from None
    return Written(files=tuple(write_whole(target / name, text) for name, text in texts.items()), notes=tuple(notes))


def _anti_windup(one: Controller) -> tuple[FloatArray, str, str]:
    """Return E of a controller, a paragraph for the header about it, and a note on what it leaves, or nothing."""
    limited = np.isfinite(one.limits)
    found = back_calculation(one.arrays, limited.tolist())
    if not found.time_constant:
        why = "no state integrates" if limited.any() else "no output is limited"
        return found.gain, f"Anti-windup: none, for {why}.", ""
    remark = (
        "Anti-windup: back-calculation. While a torque is at its limit, the integrals follow what acts with the time "
        f"constant {found.time_constant:.4g} s, the integral time: x+ = A x + B y + E (limited - commanded). "
    )
    k, hidden = found.integrals, found.integrals - found.seen
    if not hidden and found.radius < 1.0:
        stays = f"The states then stay bounded: their slowest pole is |z| = {found.radius:.6g}."
        return found.gain, remark + stays, ""
    left = f"{hidden} of {k} integrating states are not protected against windup: no limited output shows them alone"
    return found.gain, f"{remark}{left}.", f"{one.name}: anti-windup: {left}"


def _in_single_precision(one: Controller) -> tuple[str, str]:
    """Return a paragraph for the header about coefficients in single precision, and a note where they change much."""
    change = float_error(one)
    said = f"{one.name}: in single precision the response changes by {change:.2g} of its size"
    if not change <= _REFUSED:
        raise UnscalableError(f"{said}, but {_REFUSED:g} is allowed; use double", one)
    remark = (
        f"Float against double: rounded coefficients change the response by at most {at_most(change, 2)} of its size."
    )
    return remark, said if change > _NOTED else ""


def float_error(one: Controller) -> float:
    """Return the largest relative change of a controller's response by coefficients in single precision."""
    K = one.arrays
    largest = max(float(np.abs(item).max(initial=0.0)) for section in one.sections for item in section.block[:4])
    if not max(largest, *one.limits[np.isfinite(one.limits)], 0.0) <= float(np.finfo(np.float32).max):
        raise UnscalableError(f"{one.name}: the number {largest:.3g} does not fit a float; use double", one)

    def single(block: System) -> System:
        A, B, C, D = (item.astype(np.float32).astype(np.float64) for item in block[:4])
        return System(A, B, C, D, block.dt)

    sections = [section._replace(block=single(section.block)) for section in one.sections]
    rounded = flattened(sections, one.inputs, one.outputs)
    # A resonance changes most at its frequency, which a grid misses where it is narrow. The response of an undamped one
    # is not compared there.
    z = np.concatenate([np.linalg.eigvals(item.A) for item in (K, rounded)])
    own = np.abs(np.angle(z[1.0 - np.abs(z) > _ON_CIRCLE]))
    angles = np.concatenate([np.geomspace(1e-7, np.pi, 400), own[own >= 1e-7]])
    before, after = (frequency_response(item, np.unique(angles) / K.dt, -3) for item in (K, rounded))
    size = np.linalg.norm(before, axis=(1, 2))
    # Gains far below the median are not compared.
    size = np.maximum(size, 1e-3 * np.median(size))
    return float((np.linalg.norm(after - before, axis=(1, 2)) / np.where(size > 0.0, size, 1.0)).max())
