"""A measured frequency response from a CSV file: every pair of output and input in two columns.

::

    frequency_hz, alpha9/Q9 re, alpha9/Q9 im, alpha9/Q10 re, alpha9/Q10 im, ...
    0.5, -0.0012, ...

The first column is ``frequency_hz`` or ``frequency_rad_s``. The others are named output/input and what they hold:
``re`` and ``im``, or ``magnitude`` (or ``magnitude_db``) and ``phase_deg`` (or ``phase_rad``). A ``coherence`` beside
them is not read. Lines that begin with # are comments. Columns are separated by commas, semicolons or tabs.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from platform_ctrl.analysis.logs import column_unit
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import positive, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.plant.mistakes import given, one_line, suggestion
from platform_ctrl.plant.source import path_of, read_text

if TYPE_CHECKING:
    import control

_PARTS = ("re", "im", "magnitude", "magnitude_db", "phase_deg", "phase_rad")
_FORMS = (
    {"re", "im"},
    *({size, phase} for size in ("magnitude", "magnitude_db") for phase in ("phase_deg", "phase_rad")),
)
_FEWEST = 3
# Largest frequency and response in any sensible units.
_LARGEST = 1e100

Line = tuple[int, list[str]]


def read_measurement(source: str | os.PathLike[str] | TextIO, *, period: float | None = None) -> control.FRD:
    """Return a measured frequency response with the names of its signals.

    Parameters
    ----------
    source
        Path of a CSV file, or an open text file. Its header names ``frequency_hz`` or ``frequency_rad_s`` first, then
        two columns for every pair: ``alpha9/Q9 re`` and ``alpha9/Q9 im``, or ``alpha9/Q9 magnitude`` (or
        ``magnitude_db``) and ``alpha9/Q9 phase_deg``. Columns of the ``coherence`` are not read.
    period
        Sample period, s, where commands and pick-off were sampled: the response is then that of the sampled plant, its
        hold included.

    Returns
    -------
    control.FRD
        Inputs and outputs in the order in which the header names them first; ``dt`` the period, or 0.

    Raises
    ------
    InputError
        The file cannot be read, or a line of it makes no sense; the message names the line.
    ArgumentError
        `period` is not a number above zero.
    """
    if hasattr(source, "read"):
        label, text = one_line(str(getattr(source, "name", "measurement"))), str(source.read())
    else:
        path = path_of(source, "the path of a CSV file")
        label, text = one_line(str(path)), read_text(path, "a CSV file")
    (number, header), *lines = _lines(label, text)
    where = f"{label}, line {number}"
    unit = _frequency_unit(where, header[0])
    outputs, inputs, columns = _columns(where, header)
    numbers = np.array([_numbers(f"{label}, line {k}", header, row) for k, row in lines])
    if len(lines) < _FEWEST:
        raise InputError(f"{label}: must have at least {_FEWEST} frequencies, got {len(lines)}")
    _require_rising(label, header[0], [k for k, _ in lines], numbers[:, 0])
    frequency = unit * numbers[:, 0]
    dt = 0.0
    if period is not None:
        dt = positive("read_measurement: period", period)
        if frequency[-1] > np.pi / dt * (1.0 + 1e-9):
            raise InputError(
                f"{label}, line {lines[-1][0]}: {header[0]} must not exceed half the sample rate, "
                f"{np.pi / dt / unit:g}, got {numbers[-1, 0]:g}"
            )
    response = np.empty((len(outputs), len(inputs), len(lines)), dtype=np.complex128)
    for (output, given_input), parts in columns.items():
        values = _value(numbers, parts)
        _require_finite(label, [k for k, _ in lines], f"{output}/{given_input}", numbers, parts, values)
        response[outputs.index(output), inputs.index(given_input)] = values
    return import_module("control").FRD(response, frequency, dt, inputs=inputs, outputs=outputs)


def _frequency_unit(where: str, name: str) -> float:
    """Return rad/s in a unit of the first column."""
    base, unit = column_unit(name)
    if base.lower() != "frequency" or unit is None or unit.quantity != "rate":
        raise InputError(f"{where}: the first column must be frequency_hz or frequency_rad_s, got {given(name)}")
    return unit.factor


def _lines(label: str, text: str) -> list[Line]:
    """Return the lines that are neither empty nor comments, with their numbers; the header is the first."""
    numbered = enumerate(text.removeprefix("\ufeff").splitlines(), 1)
    kept = [(k, line) for k, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    if not kept:
        raise InputError(f"{label}: is empty; write a header such as: frequency_hz,alpha9/Q9 re,alpha9/Q9 im")
    head = kept[0][1]
    mark = max(",;\t", key=head.count)
    out: list[Line] = []
    for k, line in kept:
        try:
            [cells] = csv.reader(io.StringIO(line), delimiter=mark, strict=True)
        except (csv.Error, ValueError) as error:
            raise InputError(f"{label}, line {k}: is not CSV: {one_line(str(error))}") from None
        out.append((k, [cell.strip() for cell in cells]))
    return out


def _columns(where: str, header: list[str]) -> tuple[list[str], list[str], dict[tuple[str, str], dict[str, int]]]:
    """Return the names of outputs and inputs, and the columns of every pair by their part."""
    outputs: list[str] = []
    inputs: list[str] = []
    columns: dict[tuple[str, str], dict[str, int]] = {}
    for k, name in enumerate(header[1:], 1):
        pair, _, part = name.rpartition(" ")
        if part == "coherence":
            continue
        output, slash, an_input = (word.strip() for word in pair.partition("/"))
        if not (output and slash and an_input):
            raise InputError(f'{where}: column {k + 1} must have a name such as "alpha9/Q9 re", got {given(name)}')
        if part not in _PARTS:
            raise InputError(
                f"{where}: column {k + 1} is {given(name)}, which holds {given(part)}: {suggestion(part, _PARTS)}"
            )
        parts = columns.setdefault((output, an_input), {})
        if part in parts:
            raise InputError(f"{where}: the column {given(name)} occurs twice")
        parts[part] = k
        outputs += [output] if output not in outputs else []
        inputs += [an_input] if an_input not in inputs else []
    if not columns:
        raise InputError(f'{where}: the only column is the frequency; add columns such as "alpha9/Q9 re"')
    for output in outputs:
        for an_input in inputs:
            parts = columns.get((output, an_input), {})
            if set(parts) not in _FORMS:
                has = f"has {', '.join(parts)}" if parts else "is missing"
                raise InputError(
                    f"{where}: every pair of output and input must have re and im, or magnitude (or magnitude_db) and "
                    f"phase_deg, but {output}/{an_input} {has}"
                )
    return outputs, inputs, columns


def _numbers(where: str, header: list[str], row: list[str]) -> list[float]:
    if len(row) != len(header):
        raise InputError(f"{where}: must have {len(header)} columns as the header, got {len(row)}")
    out = []
    for name, cell in zip(header, row, strict=True):
        try:
            number = float(cell)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise InputError(f"{where}: {name} must be a finite number, got {given(cell)}")
        out.append(number)
    return out


def _require_rising(label: str, name: str, lines: list[int], frequency: FloatArray) -> None:
    before = 0.0
    for line, f in zip(lines, frequency, strict=True):
        if not f > before:
            raise InputError(f"{label}, line {line}: {name} must be > 0 and rise, got {f:g} after {before:g}")
        before = float(f)
    if before > _LARGEST:
        raise InputError(f"{label}, line {lines[-1]}: {name} must be at most {_LARGEST:g}, got {before:g}")


def _require_finite(
    label: str, lines: list[int], pair: str, numbers: FloatArray, parts: dict[str, int], values: ComplexArray
) -> None:
    if "magnitude" in parts and (below := numbers[:, parts["magnitude"]] < 0.0).any():
        k = int(below.argmax())
        raise InputError(
            f"{label}, line {lines[k]}: {pair} magnitude must be 0 or more, got "
            f"{numbers[k, parts['magnitude']]:g}; a sign is a phase of 180"
        )
    if (wrong := ~(np.abs(values.real) + np.abs(values.imag) < _LARGEST)).any():
        k = int(wrong.argmax())
        raise InputError(f"{label}, line {lines[k]}: {pair} must be less than {_LARGEST:g}")


def _value(numbers: FloatArray, parts: dict[str, int]) -> ComplexArray:
    of = {part: numbers[:, k] for part, k in parts.items()}
    if "re" in of:
        return np.asarray(of["re"] + 1j * of["im"], dtype=np.complex128)
    with np.errstate(over="ignore"):
        size = of["magnitude"] if "magnitude" in of else 10.0 ** (of["magnitude_db"] / 20.0)
    # What is too large is named later, with its line.
    size = np.minimum(size, 10.0 * _LARGEST)
    phase = of["phase_rad"] if "phase_rad" in of else np.radians(of["phase_deg"])
    return np.asarray(size * np.exp(1j * phase), dtype=np.complex128)


FEWEST_POINTS = 10
# Determinants of responses in any sensible units stay finite.
_LARGEST_RESPONSE = 1e50


@value
class Measured:
    """Frequency responses of one plant, or of several that one controller has to serve."""

    frequency: tuple[FloatArray, ...]  # tuple of (N_k,): rad/s, rising, of every plant
    response: tuple[ComplexArray, ...]  # tuple of complex (N_k, n, n): torques to angles, dead time and hold included
    # torques, angles: names of the signals.
    torques: tuple[str, ...]
    angles: tuple[str, ...]
    period: float  # of the controller, s; 0 for a continuous one


def measured_plants(
    measurement: control.FRD | Sequence[control.FRD], dead_time: float, period: float | None, hold: bool
) -> Measured:
    """Return the responses of `measurement` as the controller sees them."""
    dead_time = positive("measured_pid: dead_time", dead_time, zero=True)
    T = 0.0 if period is None else positive("measured_pid: period", period)
    if hold and not T:
        raise ArgumentError("measured_pid: hold = True needs period, the sample period of the hold in s")
    several: list[Any] = list(measurement) if isinstance(measurement, list | tuple) else [measurement]
    if not several:
        raise ArgumentError("measured_pid: measurement must be a control.FRD or several, got none")
    frequency, response = [], []
    first = several[0]
    for k, one in enumerate(several, 1):
        where = "measured_pid: the measurement" if len(several) == 1 else f"measured_pid: measurement {k}"
        w, H, dt = _arrays(one, where)
        if dt > 0.0 and T > 0.0 and abs(dt - T) > 1e-9 * T:
            raise ArgumentError(f"{where} must have dt = period = {T:g} s, got dt = {dt:g} s")
        if dt > 0.0 and hold:
            raise ArgumentError(f"{where} is sampled (dt = {dt:g} s) and contains its hold; set hold = False")
        T = T or dt
        if H.shape[1] != H.shape[2]:
            raise ArgumentError(f"{where} must have as many outputs as inputs, got {H.shape[1]} and {H.shape[2]}")
        if list(one.input_labels) != list(first.input_labels) or list(one.output_labels) != list(first.output_labels):
            raise ArgumentError(
                f"{where} must have the inputs {list(first.input_labels)} and outputs {list(first.output_labels)} of "
                f"the first one in its order, got {list(one.input_labels)} and {list(one.output_labels)}"
            )
        if T > 0.0:
            inside = w <= np.pi / T * (1.0 + 1e-9)
            w, H = w[inside], H[inside]
        if len(w) < FEWEST_POINTS:
            raise ArgumentError(
                f"{where} must have {FEWEST_POINTS} or more frequencies below half the sample rate, got {len(w)}"
            )
        size = np.abs(H).max(axis=(1, 2))
        if not (size.min() > 1.0 / _LARGEST_RESPONSE and size.max() < _LARGEST_RESPONSE):
            k = int(
                (size > 1.0 / _LARGEST_RESPONSE).argmin() if size.min() <= 1.0 / _LARGEST_RESPONSE else size.argmax()
            )
            raise ArgumentError(
                f"{where} must have a response in rad/(N m), not zero and below {_LARGEST_RESPONSE:g}, got "
                f"{size[k]:.3g} at {w[k] / (2.0 * np.pi):.4g} Hz"
            )
        factor = np.exp(-1j * w * dead_time)
        if hold:
            # A held torque: (1 − e^{−jωT})/(jωT). What folds back from above half the sample rate was not measured.
            factor = factor * np.exp(-0.5j * w * T) * np.sinc(0.5 * w * T / np.pi)
        frequency.append(w)
        response.append(np.asarray(H * factor[:, None, None], dtype=np.complex128))
    return Measured(
        frequency=tuple(frequency),
        response=tuple(response),
        torques=tuple(first.input_labels),
        angles=tuple(first.output_labels),
        period=T,
    )


def _arrays(one: control.FRD, where: str) -> tuple[FloatArray, ComplexArray, float]:
    try:
        H, w, dt = np.asarray(one.frdata), np.asarray(one.omega, dtype=np.float64), one.dt
    except AttributeError:
        raise ArgumentError(
            f"{where} must be a control.FRD, see read_measurement, got {short(type(one).__name__)}"
        ) from None
    if dt is True:
        raise ArgumentError(f"{where} is sampled without a period (dt=True); give dt in s")
    if not (np.all(np.isfinite(H)) and np.all(np.isfinite(w)) and np.all(np.diff(w) > 0.0) and w[0] >= 0.0):
        raise ArgumentError(f"{where} must be finite, with frequencies that rise from >= 0")
    kept = w > 0.0
    return w[kept], np.moveaxis(H[:, :, kept], -1, 0), float(dt or 0.0)
