"""The systems of a plot, checked and brought to one form with labels and units, and the frequencies of their responses.

The frequencies come close to every pole and zero, however lightly damped, so that flanks and tip of the sharpest
resonance have their shape; a pole or zero on the stability boundary is approached from both sides.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, frequencies, scaled
from platform_ctrl.analysis.frequency_grids import around_resonances
from platform_ctrl.analysis.poles import continuous_poles, poles
from platform_ctrl.analysis.response import (
    LinearSystem,
    frequency_response,
    is_proper,
    is_rational,
    linear_arrays,
    rational_response,
)
from platform_ctrl.analysis.singular_values import boundary_poles
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

# States up to which poles next to the stability boundary are computed with more digits, and effort, entries times cubed
# states, up to which the zeros of entries are sought: beyond that the grid does without.
_PRECISE, _EFFORT = 60, 5e7
# Relative distance from the stability boundary below which a pole or zero counts as on it.
ON = 1e-10
_LONGEST = 48
# What python-control calls a system that nobody named.
_NAMELESS = re.compile(r"sys\[\d+\]")
# What it adds to a name when it converts a system.
_CONVERTED = re.compile(r"\$\w+$")


@value
class DrawnSystem:
    """One system as plots use it."""

    label: str  # What the legend calls it; empty for a single system without a name
    # Signal names
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float  # Sample period, s; 0: continuous
    # s-plane equivalents, rad/s, finite ones; zeros of every entry and of the whole. Empty for data
    poles: ComplexArray
    zeros: ComplexArray
    undamped: FloatArray  # (k,), Frequencies > 0 of poles and zeros on the stability boundary, rad/s
    arrays: StateArrays | None  # State-space arrays; None for data and for improper transfer functions
    source: Any  # What was given

    @property
    def nyquist(self) -> float:
        """Highest frequency that the system has, rad/s."""
        return math.pi / self.dt if self.dt > 0.0 else math.inf

    @property
    def is_data(self) -> bool:
        """Whether it is known at some frequencies only."""
        return hasattr(self.source, "frdata")

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return len(self.outputs), len(self.inputs)

    def along(self, grid: FloatArray) -> tuple[FloatArray, ComplexArray]:
        """Return frequencies (N,), rad/s, and the response there, (p, m, N): NaN where it is not finite.

        They are those of `grid` up to the Nyquist frequency; of data, its own between the ends of `grid`.
        """
        if self.is_data:
            own, response = sorted_data(self.source)
            inside = (own >= grid[0] * (1.0 - 1e-9)) & (own <= grid[-1] * (1.0 + 1e-9))
            return own[inside], gaps(response[..., inside])
        frequency = grid[grid <= self.nyquist]
        return frequency, self.response(frequency)

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Return the response of a system that is no data at `frequency` (N,), rad/s, as (p, m, N)."""
        if self.arrays is not None:
            return gaps(frequency_response(self.arrays, frequency))
        return gaps(rational_response(self.source, frequency))


def drawn_systems(
    name: str,
    systems: LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem],
    labels: Sequence[str] | None = None,
    *,
    square: bool = False,
    data: bool = True,
) -> tuple[DrawnSystem, ...]:
    """Return one or several systems in the form that plots use.

    `name` is the plot's and begins every message. With `square` each needs as many outputs as inputs (a loop transfer);
    `data`: whether `control.FrequencyResponseData` are accepted.
    """
    given, texts = listed(name, systems, labels)
    if labels is None and not isinstance(systems, Mapping):
        texts = _own_names(given)
    return tuple(
        _drawn(name if len(given) == 1 else f"{name}: system {k + 1}", system, text or "", square, data)
        for k, (system, text) in enumerate(zip(given, texts, strict=True))
    )


def listed(name: str, given: Any, labels: Sequence[str] | None) -> tuple[list[Any], list[str | None]]:
    """Return the items of one, a sequence or a mapping, with their labels, None where there is none."""
    if isinstance(given, Mapping):
        if labels is not None:
            raise ArgumentError(f"{name}: labels are given twice; give them as keys or as labels, not both")
        labels, given = [str(key) for key in given], list(given.values())
    items = list(given) if _several(given) and not isinstance(given, str) else [given]
    if not items:
        raise ArgumentError(f"{name}: nothing was given; give at least one")
    if labels is None:
        return items, [None] * len(items)
    texts = [labels] if isinstance(labels, str) else list(labels) if _several(labels) else []
    if not texts or not all(isinstance(text, str) for text in texts):
        raise ArgumentError(f"{name}: labels must be strings, got {short(labels)}")
    if len(texts) != len(items):
        raise ArgumentError(f"{name}: labels must be {len(items)}, one for each, got {len(texts)}")
    return items, [drawable(text) for text in texts]


def _several(given: object) -> bool:
    return isinstance(given, Sequence) or (isinstance(given, np.ndarray) and given.ndim > 0)


def _own_names(systems: Sequence[Any]) -> list[str | None]:
    """Return the names of systems, numbered where several have none or the same."""
    known = [str(getattr(system, "name", None) or "") for system in systems]
    known = ["" if _NAMELESS.search(text) else _CONVERTED.sub("", text) for text in known]
    if len(systems) > 1:
        known = [text if text and known.count(text) == 1 else f"{text} {k + 1}" for k, text in enumerate(known)]
    return [drawable(text.strip()) for text in known]


def _drawn(where: str, system: Any, label: str, square: bool, data: bool) -> DrawnSystem:
    if not all(hasattr(system, needed) for needed in ("input_labels", "output_labels", "dt")):
        kinds = "control.StateSpace, TransferFunction" + (" or FrequencyResponseData" if data else "")
        raise ArgumentError(f"{where}: a system must be a {kinds}, or several in a list, got {short(system)}")
    if system.dt is True:
        raise ArgumentError(f"{where}: the system is sampled but has no sample period (dt=True); give dt in s")
    p, m = system.noutputs, system.ninputs
    if not p or not m or (square and p != m):
        needed = "a square loop transfer is needed" if square else "at least one of each is needed"
        raise ArgumentError(f"{where}: the system has {p} outputs and {m} inputs; {needed}")
    dt = 0.0 if system.dt is None else float(system.dt)
    arrays = None
    nothing = np.zeros(0, dtype=np.complex128)
    poles, zeros, undamped = nothing, nothing, np.zeros(0)
    if hasattr(system, "frdata"):
        if not data:
            raise ArgumentError(f"{where}: data cannot be used here; give a control.StateSpace or TransferFunction")
        if not np.any(sorted_data(system)[0]):
            raise ArgumentError(f"{where}: the data have no frequency above 0; at least one is needed")
    elif is_rational(system) and not is_proper(system, where):
        poles, zeros = (_finite_roots(rows, dt) for rows in (system.den_list, system.num_list))
    else:
        arrays = linear_arrays(system, where)
    if arrays is not None:
        poles, zeros, undamped = features(arrays)
    return DrawnSystem(
        label=label,
        inputs=tuple(system.input_labels),
        outputs=tuple(system.output_labels),
        dt=dt,
        poles=poles,
        zeros=zeros,
        undamped=undamped,
        arrays=arrays,
        source=system,
    )


def features(arrays: StateArrays) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Return finite poles and zeros (s-plane), and the frequencies > 0 of those on the stability boundary."""
    A, B, C, D, dt = arrays
    A, B, C = scaled(A, B, C)
    on = np.zeros(len(A), dtype=np.bool_)
    if len(A) <= _PRECISE:
        own, on = boundary_poles(A, dt)
    else:
        own = continuous_poles(poles(A), dt)
    p, m = D.shape
    entries = [([i], [j]) for i in range(p) for j in range(m)] if p * m * len(A) ** 3 <= _EFFORT else []
    if 1 < p == m:
        entries.append((list(range(p)), list(range(m))))
    nothing = np.zeros(0, dtype=np.complex128)
    found = [transmission_zeros(A, B[:, j], C[i], D[np.ix_(i, j)], dt) for i, j in entries] if len(A) else []
    zeros = np.concatenate([nothing, *found])
    both = np.concatenate([own, zeros])
    with np.errstate(invalid="ignore"):
        on = np.concatenate([on, np.zeros(len(zeros), dtype=np.bool_)]) | (np.abs(both.real) <= ON * np.abs(both))
    undamped = np.unique(np.abs(both.imag[on & np.isfinite(both) & (both.imag != 0.0)]))
    return _finite(own), _finite(zeros), undamped


def transmission_zeros(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> ComplexArray:
    """Return the finite transmission zeros, s-plane."""
    from scipy.linalg import eigvals

    n, size = len(A), len(A) + len(D)
    M, N = np.zeros((size, size)), np.zeros((size, size))
    largest = np.abs(A).max(initial=0.0) or 1.0
    # Inputs and outputs in units that make all blocks alike.
    columns, rows = (np.abs(block).max(axis=axis, initial=0.0) for block, axis in ((B, 0), (C, 1)))
    columns, rows = (np.where(item > 0.0, item, 1.0) / largest for item in (columns, rows))
    M[:n, :n], M[:n, n:], M[n:, :n] = A, B / columns, C / rows[:, None]
    M[n:, n:] = D * (largest / columns) / rows[:, None] / largest
    N[:n, :n] = np.eye(n)
    with np.errstate(all="ignore"):
        found = eigvals(M, N, check_finite=False)
    found = found[np.isfinite(found)]
    bound = 1e7 * max(float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)), 1.0 if dt else 0.0)
    return continuous_poles(found[np.abs(found) <= bound], dt)


def _finite(s: ComplexArray) -> ComplexArray:
    return np.asarray(s[np.isfinite(s)])


def _trimmed(polynomial: Any) -> FloatArray:
    return np.trim_zeros(np.asarray(polynomial, dtype=np.float64), "f")


def _finite_roots(rows: Any, dt: float) -> ComplexArray:
    every = [np.roots(_trimmed(polynomial)).astype(np.complex128) for row in rows for polynomial in row]
    return _finite(continuous_poles(np.concatenate(every), dt))


def sorted_data(system: Any) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies > 0, ascending, and the response of data there."""
    frequency = np.asarray(system.omega, dtype=np.float64)
    order = np.argsort(frequency, kind="stable")
    order = order[frequency[order] > 0.0]
    return frequency[order], np.asarray(system.frdata, dtype=np.complex128)[..., order]


def gaps(response: ComplexArray) -> ComplexArray:
    """Return `response` with NaN where it is not finite: nothing is drawn there."""
    out = np.array(response, dtype=np.complex128)
    out[~np.isfinite(out)] = complex(math.nan, math.nan)
    return out


def drawable(text: str) -> str:
    """Return a name as one short line of letters that the figures' font has."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    line = "".join(c if ord(c) < 128 or _has_glyph(c) else "\ufffd" for c in line)
    return line if len(line) <= _LONGEST else line[: _LONGEST - 1] + "…"


@lru_cache(maxsize=4096)
def _has_glyph(letter: str) -> bool:
    return bool(_font().get_char_index(ord(letter)))


@lru_cache(maxsize=1)
def _font() -> Any:
    from matplotlib.font_manager import findfont, get_font

    return get_font(findfont("DejaVu Sans"))


def as_state_space(name: str, system: DrawnSystem) -> control.StateSpace:
    """Return a system as a `control.StateSpace` with its names; `name` begins messages."""
    import control

    if system.arrays is None:
        raise ArgumentError(f"{name}: an improper transfer function has no state space; add poles")
    if hasattr(system.source, "A"):
        return system.source
    A, B, C, D, _ = system.arrays
    names = {"inputs": list(system.inputs), "outputs": list(system.outputs)}
    return control.StateSpace(A, B, C, D, system.source.dt, remove_useless_states=False, **names)


# Relative distance up to which a pole or zero on the stability boundary is come close to.
CLOSEST = 1e-6
# The range without a single pole or zero, Hz.
_PLAIN = 2.0 * np.pi * np.array([0.01, 100.0])
# The highest frequency that is drawn of a sampled system, over the Nyquist frequency.
LAST = 0.9995


def grid(
    systems: Sequence[DrawnSystem],
    frequency: ArrayLike | None = None,
    *,
    name: str = "frequency",
    loops: bool = False,
    points: int = 400,
) -> FloatArray:
    """Return the ascending frequencies > 0, rad/s, at which the responses of all `systems` are drawn.

    `frequency` is None for a range that shows all poles and zeros (of loops also the crossings of gain 1; of sampled
    systems up to the Nyquist frequency), the two ends of a range, or the frequencies themselves. `points` counts those
    of the plain grid, before poles and zeros add theirs.
    """
    if frequency is None:
        low, high = _range(systems, loops)
    else:
        given = frequencies(frequency, name)
        if not np.any(given) or not np.all(np.diff(given) > 0.0) or (given.size == 2 and given[0] == 0.0):
            raise ArgumentError(
                f"{name}: frequency must be ascending numbers in rad/s, or the two ends of a range > 0 rad/s"
            )
        given = given[given > 0.0]
        low, high = float(given[0]), float(given[-1])
        if given.size != 2:
            _judge(systems, low, high, name)
            return given
    _judge(systems, low, high, name)
    own = [around_resonances(s, low, high, ON, CLOSEST) for one in systems for s in (one.poles, one.zeros)]
    edges = [np.array([LAST * one.nyquist]) for one in systems if low < LAST * one.nyquist < high]
    every = np.unique(np.concatenate([np.geomspace(low, high, points), *own, *edges]))
    every = every[(every >= low) & (every <= high)]
    for one in systems:
        for undamped in one.undamped:
            every = every[np.abs(every - undamped) > 0.5 * CLOSEST * undamped]
    return every


def _judge(systems: Sequence[DrawnSystem], low: float, high: float, name: str) -> None:
    for one in systems:
        first, last = (0.0, one.nyquist)
        if one.is_data:
            own = sorted_data(one.source)[0]
            first, last = float(own[0]), float(own[-1])
        if low > last * (1.0 + 1e-9) or high < first * (1.0 - 1e-9):
            raise ArgumentError(
                f"{name}: frequency: {low:.6g} to {high:.6g} rad/s is outside the range of "
                f"{one.label or 'the system'}, {first:.6g} to {last:.6g} rad/s"
            )


def _range(systems: Sequence[DrawnSystem], loops: bool) -> tuple[float, float]:
    ends: list[float] = []
    fixed: list[float] = []
    for one in systems:
        if one.is_data:
            own = sorted_data(one.source)[0]
            fixed += [float(own[0]), float(own[-1])]
            continue
        corners = np.abs(one.poles)
        corners = corners[corners > 1e-12 * corners.max(initial=0.0)]
        zeros = np.abs(one.zeros)
        if corners.size:
            zeros = zeros[(zeros > 1e-2 * corners.min()) & (zeros < 1e2 * corners.max())]
        else:
            zeros = zeros[zeros > 1e-12 * zeros.max(initial=0.0)]
        corners = np.concatenate([corners, zeros])
        own = _crossed(one, corners) if loops or not corners.size else np.zeros(0)
        shown = np.concatenate([corners, own])
        if shown.size:
            ends += [0.1 * float(shown.min()), min(10.0 * float(shown.max()), LAST * one.nyquist)]
        if one.dt:
            ends.append(LAST * one.nyquist)
            ends.append(min([1e-3 * one.nyquist, *ends]))
    if not ends and not fixed:
        return float(_PLAIN[0]), float(_PLAIN[1])
    if fixed:
        return min(fixed + ends), max(fixed + ends)
    return min(ends), max(ends)


def _crossed(one: DrawnSystem, corners: ComplexArray | FloatArray) -> FloatArray:
    """Return the frequencies where gains cross 1 next to a grid, as far out as four decades beyond all corners."""
    if corners.size:
        low, high = 1e-4 * float(np.min(corners)), 1e4 * float(np.max(corners))
    else:
        low, high = 1e-6, 1e6
    high = min(high, LAST * one.nyquist)
    if not low < high:
        return np.zeros(0)
    w = np.geomspace(low, high, 300)
    gain = np.abs(one.response(w))
    with np.errstate(invalid="ignore"):
        crossing = np.any(np.diff((gain > 1.0).astype(np.int8), axis=-1) != 0, axis=(0, 1))
    return np.asarray(w[:-1][crossing])
