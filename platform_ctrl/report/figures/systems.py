"""The systems of a plot with their labels, and the frequencies of their responses.

The frequencies come close to every pole and zero, however lightly damped, so that flanks and tip of the sharpest
resonance have their shape; a pole or zero on the stability boundary is approached from both sides.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.frequency_grids import around_resonances
from platform_ctrl.analysis.poles import continuous_poles, poles
from platform_ctrl.analysis.response import LinearSystem, frequency_response, linear_arrays
from platform_ctrl.analysis.system import ComplexArray, System, frequencies, scaled
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

Systems: TypeAlias = "LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem]"

# What python-control calls a system that nobody named, and what it adds to a name when it converts a system.
_NAMELESS = re.compile(r"sys\[\d+\]|\$\w+$")
# Entries times cubed states up to which the zeros of entries are sought: beyond that the grid does without.
_EFFORT = 5e7
# Damping ratio below which a pole or zero counts as on the stability boundary, and how close the grid comes to it.
_ON, _CLOSEST = 1e-10, 1e-6
# The highest frequency that is drawn of a sampled system, over the Nyquist frequency.
_LAST = 0.9995
# Points of the plain grid, before poles and zeros add theirs.
_POINTS = 400
# In place of the titles of python-control, which repeat the names in the legend.
_UNTITLED = {"title": ""}


@value
class DrawnSystem:
    """One system as plots use it."""

    label: str  # What the legend calls it; empty for a single system without a name
    source: Any  # What was given
    dt: float  # Sample period, s; 0: continuous
    arrays: System | None  # None for data
    corners: ComplexArray  # Poles, and zeros of every entry, in the s-plane, rad/s; none of data

    @property
    def nyquist(self) -> float:
        """Highest frequency that the system has, rad/s."""
        return math.pi / self.dt if self.dt > 0.0 else math.inf

    def along(self, grid: FloatArray) -> tuple[FloatArray, ComplexArray]:
        """Return frequencies (N,), rad/s, and the response there, (p, m, N), NaN where it is not finite.

        They are those of `grid` up to the Nyquist frequency; of data, its own between the ends of `grid`.
        """
        if self.arrays is None:
            w = np.asarray(self.source.omega, dtype=np.float64)
            inside = np.flatnonzero((w > 0.0) & (w >= grid[0] * (1.0 - 1e-9)) & (w <= grid[-1] * (1.0 + 1e-9)))
            inside = inside[np.argsort(w[inside])]
            w, response = w[inside], np.asarray(self.source.frdata, dtype=np.complex128)[..., inside]
        else:
            w = grid[grid <= self.nyquist]
            response = frequency_response(self.arrays, w)
        return w, np.where(np.isfinite(response), response, complex(math.nan, math.nan))


def drawn_systems(name: str, systems: Systems, *, loops: bool = False) -> tuple[DrawnSystem, ...]:
    """Return one or several systems in the form that plots use; `loops` have to be square.

    `name` is the plot's and begins every message.
    """
    return tuple(_drawn(name, one, label, loops) for label, one in labelled(name, systems))


def labelled(name: str, given: Any) -> list[tuple[str, Any]]:
    """Return the items of one, a sequence or a mapping, with their labels: keys, or their own names, numbered."""
    if isinstance(given, Mapping):
        items = [(str(key), one) for key, one in given.items()]
    else:
        every = list(given) if isinstance(given, list | tuple) else [given]
        own = [_NAMELESS.sub("", str(getattr(one, "name", None) or "")) for one in every]
        several = len(every) > 1
        items = [
            (text if text and own.count(text) == 1 else f"{text} {k}".strip() if several else text, one)
            for k, (text, one) in enumerate(zip(own, every, strict=True), 1)
        ]
    if not items:
        raise ArgumentError(f"{name}: nothing was given; give at least one")
    return items


def _drawn(name: str, system: Any, label: str, loop: bool) -> DrawnSystem:
    if not all(hasattr(system, needed) for needed in ("input_labels", "output_labels", "dt")):
        raise ArgumentError(
            f"{name}: a system must be a control.StateSpace, TransferFunction or FrequencyResponseData, or several in "
            f"a list, got {short(system)}"
        )
    if system.dt is True:
        raise ArgumentError(f"{name}: the system is sampled but has no sample period (dt=True); give dt in s")
    p, m = system.noutputs, system.ninputs
    if not p or not m or (loop and p != m):
        needed = "a square loop transfer is needed" if loop else "at least one of each is needed"
        raise ArgumentError(f"{name}: the system has {p} outputs and {m} inputs; {needed}")
    dt = 0.0 if system.dt is None else float(system.dt)
    if hasattr(system, "frdata"):
        corners = np.zeros(0, dtype=np.complex128)
        return DrawnSystem(label=label, source=system, dt=dt, arrays=None, corners=corners)
    arrays = linear_arrays(system, name)
    every = [_corners(arrays)]
    if loop and m > 1:
        # Broken at one channel the loop has the poles that the others leave it.
        every += [continuous_poles(poles(_closed(arrays, 1.0 - own).A), dt) for own in np.eye(m)]
    s = np.concatenate(every)
    return DrawnSystem(label=label, source=system, dt=dt, arrays=arrays, corners=s[np.isfinite(s)])


def _corners(arrays: System) -> ComplexArray:
    """Return poles, and transmission zeros of every entry, s-plane."""
    from scipy.linalg import eigvals

    A, B, C = scaled(*arrays[:3])
    n, (p, m) = len(A), arrays.D.shape
    own = np.linalg.eigvals(A).astype(np.complex128)
    found = [own]
    N = np.diag([*np.ones(n), 0.0])
    for i, j in np.ndindex((p, m) if n and p * m * n**3 <= _EFFORT else (0, 0)):
        with np.errstate(all="ignore"):
            zeros = eigvals(np.block([[A, B[:, [j]]], [C[[i]], arrays.D[[i]][:, [j]]]]), N, check_finite=False)
        # What lies far beyond all poles is at infinity but for rounding.
        found.append(zeros[np.isfinite(zeros) & (np.abs(zeros) <= 1e7 * max(np.abs(own).max(), arrays.dt > 0.0))])
    return continuous_poles(np.concatenate(found), arrays.dt)


def _closed(L: System, share: FloatArray) -> System:
    """Return the loop L, some channels closed with negative feedback: from a disturbance at its input to that input."""
    m = len(L.D)
    K = System(np.zeros((0, 0)), np.zeros((0, m)), np.zeros((m, 0)), -np.diag(share), L.dt)
    closed = L.feedback(K).part(range(m), range(m))
    return closed._replace(D=closed.D + np.eye(m))


def sensitivity(L: System) -> System:
    """Return S = (I + L)^-1, with every state of L."""
    return _closed(L, np.ones(len(L.D)))


def channels(L: ComplexArray) -> ComplexArray:
    """Return the loop of every channel with all others closed, 1/S_ii − 1, (m, N), of a response (m, m, N)."""
    if len(L) == 1:
        return np.asarray(L[0])
    out = np.full(L.shape[1:], complex(math.nan, math.nan))
    fine = np.isfinite(L).all(axis=(0, 1))
    S = np.linalg.inv(np.eye(len(L)) + np.moveaxis(L[..., fine], -1, 0))
    with np.errstate(all="ignore"):
        out[:, fine] = 1.0 / np.diagonal(S, axis1=1, axis2=2).T - 1.0
    return out


def grid(systems: Sequence[DrawnSystem], frequency: ArrayLike | None, name: str) -> FloatArray:
    """Return the ascending frequencies > 0, rad/s, at which the responses of all `systems` are drawn.

    `frequency` is None for a range that shows all poles and zeros, and of sampled systems goes up to the Nyquist
    frequency; the two ends of a range; or the frequencies themselves.
    """
    if frequency is None:
        ends = [end for one in systems for end in _range(one)]
        low, high = min(ends), max(ends)
    else:
        given = frequencies(frequency, name)
        if not np.any(given) or not np.all(np.diff(given) > 0.0) or (given.size == 2 and given[0] == 0.0):
            raise ArgumentError(
                f"{name}: frequency must be ascending numbers in rad/s, or the two ends of a range > 0 rad/s"
            )
        if given.size != 2:
            return given[given > 0.0]
        low, high = map(float, given)
    corners = np.concatenate([one.corners for one in systems])
    every = np.concatenate([np.geomspace(low, high, _POINTS), around_resonances(corners, low, high, _ON, _CLOSEST)])
    every = np.unique(every[(every >= low) & (every <= high)])
    on = np.abs(corners.real) <= _ON * np.abs(corners)
    for undamped in np.abs(corners.imag[on & (corners.imag != 0.0)]):
        every = every[np.abs(every - undamped) > 0.5 * _CLOSEST * undamped]
    return every


def _range(one: DrawnSystem) -> tuple[float, float]:
    """Return the frequencies between which all poles and zeros are seen, and crossings of gain 1 beyond them."""
    if one.arrays is None:
        w = np.asarray(one.source.omega, dtype=np.float64)
        return float(w[w > 0.0].min()), float(w.max())
    size = np.abs(one.corners)
    # Integrators come out this large in floats.
    size = size[size > 1e-8 * size.max(initial=0.0)]
    corners = size if size.size else np.array([1.0])
    last = _LAST * one.nyquist
    w = np.geomspace(min(1e-4 * corners.min(), 1e-3 * last), min(1e4 * corners.max(), last), 300)
    crossing = np.any(np.diff((np.abs(one.along(w)[1]) > 1.0).astype(np.int8), axis=-1) != 0, axis=(0, 1))
    shown = np.concatenate([corners, w[:-1][crossing]])
    low, high = 0.1 * float(shown.min()), min(10.0 * float(shown.max()), last)
    return (min(low, 1e-3 * one.nyquist), last) if one.dt else (low, high)


def bode(systems: Systems, frequency: ArrayLike | None = None, **options: Any) -> control.ControlPlot:
    """Bode plot by `control.bode_plot`.

    Parameters
    ----------
    systems
        `control.StateSpace`, `TransferFunction` or `FrequencyResponseData`; several in a list or under their labels in
        a mapping.
    frequency
        The frequencies or both ends of their range, rad/s; None: all poles and zeros, up to the Nyquist frequency.
    **options
        Of `control.bode_plot`, such as ``Hz=True``, ``dB=True`` and ``display_margins=True``.

    Returns
    -------
    control.ControlPlot
        Its ``figure`` is saved by ``figure.savefig``.

    Raises
    ------
    ArgumentError
        No systems, or a range without frequencies.
    """
    import control

    return control.bode_plot(_responses("bode", drawn_systems("bode", systems), frequency), **_UNTITLED | options)


def singular_values(systems: Systems, frequency: ArrayLike | None = None, **options: Any) -> control.ControlPlot:
    """Singular values over frequency by `control.singular_values_plot`.

    Parameters
    ----------
    systems, frequency
        As of `bode`.
    **options
        Of `control.singular_values_plot`.

    Returns
    -------
    control.ControlPlot
        Its ``figure`` is saved by ``figure.savefig``.

    Raises
    ------
    ArgumentError
        No systems, or a range without frequencies.
    """
    import control

    found = []
    for one in _responses("singular_values", drawn_systems("singular_values", systems), frequency):
        response = np.moveaxis(one.frdata, -1, 0)
        sizes = np.full((len(response), min(response.shape[1:])), np.nan)
        fine = np.isfinite(response).all(axis=(1, 2))
        sizes[fine] = np.linalg.svd(response[fine], compute_uv=False)
        # Not by `control.singular_values_response`, which takes no response of a sampled system.
        found.append(control.frd(sizes.T[:, None, :], one.omega, dt=one.dt, name=one.name))
    return control.singular_values_plot(found, **_UNTITLED | options)


def nyquist(loops: Systems, frequency: ArrayLike | None = None, **options: Any) -> control.ControlPlot:
    """Nyquist plot of loop transfers by `control.nyquist_plot`, channel by channel with the others closed.

    Parameters
    ----------
    loops
        Square loop transfers L of the loops 1 + L, as the systems of `bode`.
    frequency
        As of `bode`.
    **options
        Of `control.nyquist_plot`, such as ``unit_circle=True`` and ``ms_circles=[2.0]``.

    Returns
    -------
    control.ControlPlot
        Its ``figure`` is saved by ``figure.savefig``.

    Raises
    ------
    ArgumentError
        No loops, one that is not square, or a range without frequencies.
    """
    import control

    drawn = drawn_systems("nyquist", loops, loops=True)
    parts = [
        control.frd(channel, one.omega, name=" ".join(filter(None, (loop.label, str(name)))) or "loop")
        for loop, one in zip(drawn, _responses("nyquist", drawn, frequency), strict=True)
        for name, channel in zip(one.input_labels, channels(one.frdata), strict=True)
    ]
    # Without a sample period: python-control would close the curve of a sampled loop over the whole circle.
    return control.nyquist_plot(parts, **_UNTITLED | options)


def _responses(
    name: str, systems: Sequence[DrawnSystem], frequency: ArrayLike | None
) -> list[control.FrequencyResponseData]:
    """Return the responses of systems on their common grid, with the names of the systems and of their signals."""
    import control

    every = grid(systems, frequency, name)
    out = []
    for system in systems:
        w, response = system.along(every)
        labels = {"inputs": list(system.source.input_labels), "outputs": list(system.source.output_labels)}
        out.append(control.frd(response, w, dt=system.dt or 0, name=system.label or "system", **labels))
    return out
