"""Frequency responses as CSV: the form that `platform_ctrl.design.read_measurement` and pandas read."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis import frequency_response
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.signatures import check_arguments, short
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

Form = Literal["complex", "polar"]

_HZ = 2.0 * np.pi
# The fewest frequencies that are read back.
_FEWEST = 3


def response_data(system: control.StateSpace, frequency: ArrayLike) -> control.FRD:
    """Return the frequency response of a system, with the names of its signals; frequency in rad/s."""
    response = frequency_response(system, frequency)
    control = import_module("control")
    names = {"inputs": list(system.input_labels), "outputs": list(system.output_labels), "name": str(system.name)}
    return control.FRD(response, np.atleast_1d(np.asarray(frequency, dtype=np.float64)), system.dt or 0.0, **names)


@check_arguments
def write_responses(
    response: control.FRD, path: str | os.PathLike[str], *, form: Form = "complex", notes: Sequence[str] = ()
) -> Path:
    """Write a frequency response as CSV, whole or not at all.

    The header is ``frequency_hz``, then for every pair of signals ``alpha9/Q9 re`` and ``alpha9/Q9 im``, or
    ``alpha9/Q9 magnitude`` and ``alpha9/Q9 phase_deg``. Numbers keep all their digits. ``read_measurement`` of
    `platform_ctrl.design` reads it back; so does ``pandas.read_csv(path, comment="#")``.

    Parameters
    ----------
    response
        As from `response_data`, measured, or made by python-control; frequencies above zero, in rad/s.
    path
        Of the file; its folder is there.
    form
        ``"complex"``: real and imaginary parts; ``"polar"``: magnitude and phase, the phase without jumps, degrees.
    notes
        Lines of comment at the head: what it is, and its units.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ArgumentError
        It is no frequency response, is not finite, has fewer than 3 frequencies above zero, or names that the header
        cannot hold.
    InputError
        The file cannot be written there.
    """
    where = "write_responses"
    one_of(f"{where}: form", form, ("complex", "polar"))
    try:
        values, w = np.asarray(response.frdata), np.asarray(response.omega, dtype=np.float64)
        outputs, inputs = list(response.output_labels), list(response.input_labels)
    except AttributeError:
        raise ArgumentError(f"{where}: response must be a control.FRD, got {short(type(response).__name__)}") from None
    if len(w) < _FEWEST or not (w[0] > 0.0 and np.all(np.diff(w) > 0.0) and np.isfinite(w[-1])):
        raise ArgumentError(f"{where}: the response needs {_FEWEST} finite frequencies > 0 that increase, rad/s")
    if not np.isfinite(values).all():
        k = int(np.argwhere(~np.isfinite(values))[0][-1])
        raise ArgumentError(f"{where}: the response at {w[k]:g} rad/s is not finite; leave the frequency out")
    for name in (*outputs, *inputs):
        # The first slash parts output and input, and the reader takes the blanks around names away.
        if not name.isprintable() or name != name.strip() or not name or (name in outputs and "/" in name):
            raise ArgumentError(
                f"{where}: {short(name)}: cannot be in the header; use one printable line, in outputs without /"
            )
    for note in notes:
        if not isinstance(note, str) or not note.isprintable():
            raise ArgumentError(f"{where}: notes must be lines of text, got {short(note)}")
    header, columns = ["frequency_hz"], [w / _HZ]
    for i, output in enumerate(outputs):
        for j, name in enumerate(inputs):
            header += [f"{output}/{name} {part}" for part in _PARTS[form]]
            columns += _columns(values[i, j], form)
    out = io.StringIO()
    out.writelines(f"# {note}\n" for note in notes)
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([repr(float(number)) for number in row] for row in zip(*columns, strict=True))
    return write_whole(path, out.getvalue())


_PARTS = {"complex": ("re", "im"), "polar": ("magnitude", "phase_deg")}


def _columns(values: np.ndarray[tuple[int], np.dtype[np.complex128]], form: Form) -> list[np.ndarray]:
    if form == "complex":
        return [values.real, values.imag]
    return [np.abs(values), np.degrees(np.unwrap(np.angle(values)))]
