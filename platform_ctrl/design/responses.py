"""Measured frequency responses: from a CSV file, and what they say of the stability of a closed loop.

Of a file every pair of output and input is in two columns:

::

    frequency_hz, alpha9/Q9 re, alpha9/Q9 im, alpha9/Q10 re, alpha9/Q10 im, ...
    0.5, -0.0012, ...

The first column is ``frequency_hz`` or ``frequency_rad_s``. The others are named output/input and what they hold:
``re`` and ``im``, or ``magnitude`` (or ``magnitude_db``) and ``phase_deg`` (or ``phase_rad``). A ``coherence`` beside
them is not read. Lines that begin with # are comments. Columns are separated by commas, semicolons or tabs.

The contour of the Nyquist criterion goes through the data along the axis, and round poles that lie on it in half
circles. A resonance narrower than the distance of the frequencies changes the sign of the response from one frequency
to the next, and the data do not show on which side of the axis its pole is. It counts as stable: between the two
frequencies the contour leaves the axis to the right, with the response of one pole fitted to the data. Limits on the
half circle are no further restriction: what is bounded on the axis is bounded to the right of it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from importlib import import_module
from itertools import product
from typing import TYPE_CHECKING, TextIO

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.logs import column_unit
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import InputError, NotCertifiedError
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
# Fewest frequencies of a design, and what its signals may be, by the units in which the names of columns state them.
_FEWEST_POINTS, _SIGNALS = 10, ("angle", "rate", "torque")


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
    dt = 0.0 if period is None else positive("read_measurement: period", period)
    found = parsed(label, text, dt)
    H, names = np.moveaxis(found.response, 0, -1), {"inputs": list(found.inputs), "outputs": list(found.outputs)}
    return import_module("control").FRD(H, found.frequency, dt, **names)


@value
class MeasuredResponses:
    """Responses of a plant, of a loop in the order of its signals."""

    frequency: FloatArray  # (F,): rad/s
    response: ComplexArray  # complex (F, p, m)
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def parsed(label: str, text: str, period: float) -> MeasuredResponses:
    """Return the responses in the text of a file, in the order in which its header names the signals first."""
    (number, header), *lines = _lines(label, text)
    at = [f"{label}, line {k}" for k, _ in lines]
    unit, columns = _columns(f"{label}, line {number}", header)
    numbers = np.array([_numbers(where, header, row) for where, (_, row) in zip(at, lines, strict=True)])
    if len(lines) < _FEWEST:
        raise InputError(f"{label}: must have at least {_FEWEST} frequencies, got {len(lines)}")
    rising = np.append(0.0, numbers[:, 0])
    for k in np.flatnonzero(~(np.diff(rising) > 0.0))[:1]:
        raise InputError(f"{at[k]}: {header[0]} must be > 0 and rise, got {rising[k + 1]:g} after {rising[k]:g}")
    if period * unit * rising[-1] > np.pi * (1.0 + 1e-9):
        most = np.pi / period / unit
        raise InputError(f"{at[-1]}: {header[0]} must not exceed half the sample rate, {most:g}, got {rising[-1]:g}")
    outputs, inputs = (tuple(dict.fromkeys(names)) for names in zip(*columns, strict=True))
    response = np.array([[_values(numbers, columns[one, other]) for other in inputs] for one in outputs])
    for i, j, k in np.argwhere(~np.isfinite(response))[:1]:
        raise InputError(f"{at[k]}: {outputs[i]}/{inputs[j]} is not finite, or its magnitude is below 0")
    H = np.asarray(np.moveaxis(response, -1, 0), dtype=np.complex128)
    return MeasuredResponses(frequency=unit * rising[1:], response=H, inputs=inputs, outputs=outputs)


def read_responses(
    text: str, label: str, torques: Sequence[str], readings: Sequence[str], period: float
) -> MeasuredResponses:
    """Return the responses of a file's text, its signals in the order of a loop's; an InputError says what is wrong."""
    data = parsed(label, text, period)
    inputs, per_input = _in_SI(data.inputs, torques)
    outputs, per_output = _in_SI(data.outputs, readings)
    for what, needed, there in (("inputs", torques, inputs), ("outputs", readings, outputs)):
        if sorted(needed) != sorted(there):
            raise InputError(f"{label}: must have the {what} {', '.join(needed)} of the loop, got {', '.join(there)}")
    rows, columns = [outputs.index(name) for name in readings], [inputs.index(name) for name in torques]
    P = (data.response * (per_output[:, None] / per_input))[:, rows][..., columns]
    if len(P) < _FEWEST_POINTS:
        raise InputError(f"{label}: must have {_FEWEST_POINTS} or more frequencies, got {len(P)}")
    if not np.all(np.abs(P).max(axis=(1, 2)) > 0.0):
        raise InputError(f"{label}: must have a response that is not zero at every frequency")
    return MeasuredResponses(frequency=data.frequency, response=P, inputs=tuple(torques), outputs=tuple(readings))


def _in_SI(labels: Sequence[str], names: Sequence[str]) -> tuple[list[str], FloatArray]:
    """Return the labels of a file without their units, except those that are names as they are; and the units in SI."""
    out, factors = [], []
    for label in labels:
        name, unit = column_unit(label)
        stated = label not in names and name in names and unit is not None and unit.quantity in _SIGNALS
        out.append(name if stated else label)
        factors.append(unit.factor if stated and unit is not None else 1.0)
    return out, np.array(factors)


def _lines(label: str, text: str) -> list[tuple[int, list[str]]]:
    """Return the lines that are neither empty nor comments, with their numbers; the header is the first."""
    numbered = enumerate(text.removeprefix("\ufeff").splitlines(), 1)
    kept = [(k, line) for k, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    if not kept:
        raise InputError(f"{label}: is empty; write a header such as: frequency_hz,alpha9/Q9 re,alpha9/Q9 im")
    mark = max(",;\t", key=kept[0][1].count)
    return [(k, [cell.strip().strip('"') for cell in line.split(mark)]) for k, line in kept]


def _columns(where: str, header: list[str]) -> tuple[float, dict[tuple[str, str], dict[str, int]]]:
    """Return rad/s in a unit of the first column, and the other columns by (output, input) and by their part."""
    base, unit = column_unit(header[0])
    if base.lower() != "frequency" or unit is None or unit.quantity != "rate":
        raise InputError(f"{where}: the first column must be frequency_hz or frequency_rad_s, got {given(header[0])}")
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
    if not columns:
        raise InputError(f'{where}: the only column is the frequency; add columns such as "alpha9/Q9 re"')
    for output, an_input in product(*zip(*columns, strict=True)):
        parts = columns.get((output, an_input), {})
        if set(parts) not in _FORMS:
            has = f"has {', '.join(parts)}" if parts else "is missing"
            raise InputError(
                f"{where}: every pair of output and input must have re and im, or magnitude (or magnitude_db) and "
                f"phase_deg, but {output}/{an_input} {has}"
            )
    return unit.factor, columns


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


def _values(numbers: FloatArray, parts: dict[str, int]) -> ComplexArray:
    """Return a response of its parts; nan where a magnitude is negative."""
    of = {part: numbers[:, k] for part, k in parts.items()}
    if "re" in of:
        return np.asarray(of["re"] + 1j * of["im"], dtype=np.complex128)
    with np.errstate(over="ignore"):
        size = of["magnitude"] if "magnitude" in of else 10.0 ** (of["magnitude_db"] / 20.0)
    phase = of["phase_rad"] if "phase_rad" in of else np.radians(of["phase_deg"])
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(size < 0.0, np.nan, size) * np.exp(1j * phase), dtype=np.complex128)


# A pole between two frequencies: the response turns by more than this, rad, and exceeds its neighbours by this factor.
_RESONANCE_TURN = np.radians(110.0)
_RESONANCE_PEAK = 1.5
# Towards the pole the contour first follows the axis, halving the distance so many times.
_HALVINGS = 6
# ... but not nearer than this share of the distance between the two frequencies.
_NEAREST_APPROACH = 5e-3
_ARC_POINTS = 5
# Singular values of a residue that are smaller than this share of the largest one are noise.
_RESIDUE_NOISE = 0.2


@value
class Contour:
    """Points along the contour, upwards, and the response there."""

    s: ComplexArray  # complex (N,): 1/s; on the axis, and to the right of it round poles
    P: ComplexArray  # complex (N, n, n): response at s
    # (N,): size of the residue of the pole that a point was put there for; 0 at measured frequencies.
    residue: FloatArray

    @property
    def frequency(self) -> FloatArray:
        """Imaginary part of s, rad/s, (N,)."""
        return np.asarray(self.s.imag, dtype=np.float64)


def contour(frequency: FloatArray, P: ComplexArray) -> Contour:
    """Return the contour through the response P (N, n, n) at `frequency`, rad/s."""
    s: ComplexArray = np.asarray(1j * frequency, dtype=np.complex128)
    along, residue = P, np.zeros(len(frequency))
    for k in reversed(np.flatnonzero(_jumps(P))):
        round_pole, there, size = _around(frequency, P, int(k))
        s, along = np.insert(s, k + 1, round_pole), np.insert(along, k + 1, there, axis=0)
        residue = np.insert(residue, k + 1, np.full(len(there), size))
    return Contour(s=s, P=along, residue=residue)


def _jumps(P: ComplexArray) -> NDArray[np.bool_]:
    """Return whether a pole is between two neighbouring frequencies, (N − 1,)."""
    U, sizes, V = np.linalg.svd(P)
    size = sizes[:, 0]
    left = size[:-1] > size[1:]
    u, v = (np.where(left[:, None], item[:-1], item[1:]) for item in (U[:, :, 0], V[:, 0]))
    # In the direction of the largest singular value of the larger response.
    here, there = (np.einsum("ki,kij,kj->k", u.conj(), item, v.conj()) for item in (P[:-1], P[1:]))
    higher = np.maximum(size[1:], size[:-1])
    beyond = np.concatenate([[0.0], size, [0.0]])
    # Dead time turns the response as well; a pole raises it above what is on both sides.
    turned = np.abs(np.angle(there * here.conj())) > _RESONANCE_TURN
    return np.asarray(turned & (higher > _RESONANCE_PEAK * np.maximum(beyond[:-3], beyond[3:])))


def _around(w: FloatArray, P: ComplexArray, k: int) -> tuple[ComplexArray, ComplexArray, float]:
    """Return points between frequencies k and k + 1, round the pole there, the response, and the residue's size."""
    p = _pole(w, P, k)
    approach = 0.5 * min(p.imag - w[k], w[k + 1] - p.imag) * 0.5 ** np.arange(_HALVINGS)
    near = int(np.sum(approach > _NEAREST_APPROACH * (w[k + 1] - w[k])))
    approach = approach[: max(near, 1)]
    arc = approach[-1] / 2.0 * np.exp(1j * np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ARC_POINTS))
    s = 1j * p.imag + np.concatenate([-1j * approach, arc, 1j * approach[::-1]])
    # P = B + R/(s − p) with B and R from the two neighbours, and R without what is noise.
    left, right = 1.0 / (1j * w[k] - p), 1.0 / (1j * w[k + 1] - p)
    U, sizes, V = np.linalg.svd((P[k + 1] - P[k]) / (right - left))
    R = (U * np.where(sizes >= _RESIDUE_NOISE * sizes[0], sizes, 0.0)) @ V
    B = 0.5 * (P[k] - R * left + P[k + 1] - R * right)
    return s, np.asarray(B + R / (s - p)[:, None, None]), float(sizes[0])


def _pole(w: FloatArray, P: ComplexArray, k: int) -> complex:
    """Return the pole between frequencies k and k + 1, on the axis or left of it."""
    near = np.arange(max(k - 1, 0), min(k + 3, len(w)))
    if len(near) == 4:
        # P (s − p) = C0 + C1 s at four frequencies, linear in p, C0 and C1.
        s, H = 1j * w[near], P[near].reshape(4, -1)
        lines = np.stack([np.ones(4), s / s[0]], axis=1)
        # The residual of a straight line over s, of s P and of P.
        rest = np.eye(4) - lines @ np.linalg.pinv(lines)
        moved, still = (rest @ (s[:, None] * H)).ravel(), (rest @ H).ravel()
        p = complex(np.vdot(still, moved) / np.vdot(still, still))
        if w[k] < p.imag < w[k + 1]:
            return complex(min(p.real, 0.0), p.imag)
    size = np.linalg.norm(P[k : k + 2], 2, axis=(-2, -1))
    return complex(0.0, w[k] + (w[k + 1] - w[k]) * size[1] / size.sum())


# Largest turn of an eigenvalue between two frequencies, rad.
_LARGEST_TURN = np.radians(140.0)
# Largest distance of the slope of |det P| at the lowest frequencies from a whole number, and of its phase from that of
# a real number, rad.
_SLOPE_TOLERANCE = 0.3
_PHASE_TOLERANCE = np.radians(60.0)
# Points between 0 and the lowest frequency at which the controller alone is followed, and how far down.
_LOW_POINTS, _LOWEST_SHARE = 400, 1e-8
# Points with a larger real part over the imaginary one lie on half circles, not on the axis.
_OFF_AXIS = 1e-12
_HZ = 1.0 / (2.0 * np.pi)

# The controller's response at points s.
Controller = Callable[[ComplexArray], ComplexArray]


def unstable_poles(plant: Contour, controller: Controller, unstable: int = 0) -> int:
    """Return the number of unstable poles of the closed loop u = K y, y = P u, with P along the contour.

    K integrates in every channel; its own poles are not unstable. `unstable` is the number of unstable poles of the
    plant; that of its poles at s = 0 (z = 1) is read from the slope of det P at the lowest frequencies.
    """
    frequency, P = plant.frequency, plant.P
    L = P @ controller(plant.s)
    _require_gains_at_ends(frequency, L)
    # The closed-loop pole must not be between the half circle and the axis.
    k = np.flatnonzero(plant.s.real > _OFF_AXIS * plant.frequency)
    weak = np.abs(np.linalg.eigvals(L[k])).max(axis=-1, initial=0.0) < 1.0
    if weak.any():
        raise NotCertifiedError(
            f"stability from data: the gain of P K next to the resonance at {plant.frequency[k[weak][0]] * _HZ:.4g} "
            "Hz must exceed 1; measure more frequencies there, or require resonance_damping"
        )
    turned = _below(frequency, P, L, controller)
    turned += _between(frequency, np.asarray(np.eye(P.shape[-1]) - L, dtype=np.complex128))
    turned -= float(np.angle(1.0 - np.linalg.eigvals(L[-1])).sum())
    return unstable - round(turned / np.pi)


def _require_gains_at_ends(frequency: FloatArray, L: ComplexArray) -> None:
    low, high = np.linalg.svd(L[0], compute_uv=False)[-1], np.abs(np.linalg.eigvals(L[-1])).max()
    if not low > 1.0:
        raise NotCertifiedError(
            f"stability from data: at the lowest frequency, {frequency[0] * _HZ:.3g} Hz, the least gain of P K must "
            f"exceed 1, but is {low:.2g}; measure lower frequencies, or require a faster loop"
        )
    if not high < 1.0:
        raise NotCertifiedError(
            f"stability from data: at the highest frequency, {frequency[-1] * _HZ:.3g} Hz, the gain of P K must be "
            f"below 1, but is {high:.2g}; measure higher frequencies, or limit torque_per_noise"
        )


def plant_integrators(frequency: FloatArray, P: ComplexArray) -> int:
    """Return the number of poles at s = 0 that det P shows at its lowest frequencies."""
    near = max(3, int(np.searchsorted(frequency, 2.0 * frequency[0])))
    w, size = np.log(frequency[:near]), np.log(np.abs(np.linalg.det(P[:near])))
    slope = -float(np.polyfit(w, size, 1)[0])
    if abs(slope - round(slope)) > _SLOPE_TOLERANCE or round(slope) < 0:
        raise NotCertifiedError(
            f"stability from data: below {frequency[near - 1] * _HZ:.3g} Hz det P must fall with a whole power of "
            f"frequency, but falls with {slope:.2f}; measure lower frequencies"
        )
    return round(slope)


def _below(frequency: FloatArray, P: ComplexArray, L: ComplexArray, controller: Controller) -> float:
    """Return the phase of s^k det Z from 0 to the lowest frequency, less the k quarter turns of s^k."""
    n, w0 = P.shape[-1], frequency[0]
    k = plant_integrators(frequency, P)
    at_rest = np.linalg.det(-P[0]) * (1j) ** k
    of_plant = float(np.angle(at_rest**2)) / 2.0
    if abs(of_plant) > _PHASE_TOLERANCE:
        raise NotCertifiedError(
            f"stability from data: at {w0 * _HZ:.3g} Hz the phase of s^{k} det P must be near 0 or 180°, but is "
            f"{np.degrees(of_plant):.0f}° off; measure lower frequencies"
        )
    down = w0 * np.geomspace(_LOWEST_SHARE, 1.0, _LOW_POINTS)
    K = np.asarray(controller(np.asarray(1j * down, dtype=np.complex128)) * down[:, None, None], dtype=np.complex128)
    start = np.linalg.det(1j * K[0])
    of_controller = float(np.angle(start**2)) / 2.0
    of_controller += float(_steps(K).sum())
    of_rest = float(np.angle(1.0 - np.linalg.eigvals(np.linalg.inv(L[0]))).sum())
    return float(of_plant + of_controller + of_rest - 0.5 * np.pi * (k + n))


def _steps(Z: ComplexArray) -> FloatArray:
    """Phases of the eigenvalues of Z_k⁻¹ Z_{k+1}, (N − 1, n)."""
    return np.asarray(np.angle(np.linalg.eigvals(np.linalg.solve(Z[:-1], Z[1:]))))


def _between(frequency: FloatArray, Z: ComplexArray) -> float:
    turns = _steps(Z)
    widest = np.abs(turns).max(axis=-1)
    k = int(widest.argmax())
    if widest[k] > _LARGEST_TURN:
        raise NotCertifiedError(
            f"stability from data: between {frequency[k] * _HZ:.4g} and {frequency[k + 1] * _HZ:.4g} Hz the phase of "
            f"I − P K jumps by {np.degrees(widest[k]):.0f}°, more than {np.degrees(_LARGEST_TURN):.0f}°; measure more "
            "frequencies there"
        )
    return float(turns.sum())
