"""Frequency responses of systems for scripts: python-control's plots of them on grids of our own.

The frequencies come close to every pole, however lightly damped, so that flanks and tip of the sharpest resonance have
their shape; between them no response turns by more than 2°.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.curves import refined
from platform_ctrl.analysis.feedback import each_alone
from platform_ctrl.analysis.poles import continuous_poles, following_grid, poles
from platform_ctrl.analysis.response import StateSystem, frequency_response, linear_arrays
from platform_ctrl.analysis.system import ComplexArray, System, frequencies, period_of
from platform_ctrl.common.arguments import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.sections import gain
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

LinearSystem: TypeAlias = "StateSystem | control.FrequencyResponseData"
Systems: TypeAlias = "LinearSystem | Sequence[LinearSystem] | Mapping[str, LinearSystem]"

# What python-control calls a system that nobody named, and what it adds to a name when it converts a system.
_NAMELESS = re.compile(r"sys\[\d+\]|\$\w+$")
# The highest frequency that is drawn of a sampled system, over the Nyquist frequency.
_LAST = 0.9995
# Points of the plain grid, before poles add theirs; degrees from one point to the next.
_POINTS, _TURN = 400, 2.0


@value
class DrawnSystem:
    """One system as plots use it."""

    label: str  # What the legend calls it; empty for a single system without a name
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    arrays: System | None  # None for data
    frequency: FloatArray  # (N,), rad/s, ascending
    response: ComplexArray  # (p, m, N)

    def frd(self) -> control.FrequencyResponseData:
        """Return the response with the names of the system and of its signals."""
        import control

        names = {"inputs": list(self.inputs), "outputs": list(self.outputs), "name": self.label or "system"}
        # Without a sample period: python-control takes no singular values of a sampled response, and would close the
        # Nyquist curve of a sampled loop over the whole circle.
        return control.frd(self.response, self.frequency, dt=0, **names)


def drawn_systems(
    name: str, systems: Systems, frequency: ArrayLike | None, *, loops: bool = False
) -> tuple[DrawnSystem, ...]:
    """Return one or several systems in the form that plots use; `loops` have to be square.

    `name` is the plot's and begins every message; labels are keys, or the systems' own names, or numbers. `frequency`
    is None for a range that shows all poles, and of sampled systems goes up to the Nyquist frequency; the two ends of a
    range; or the frequencies themselves.
    """
    if isinstance(systems, Mapping):
        items = [(str(key), one) for key, one in systems.items()]
    else:
        every = list(systems) if isinstance(systems, list | tuple) else [systems]
        numbers = [str(k) for k in range(1, len(every) + 1)] if len(every) > 1 else [""]
        items = [
            (_NAMELESS.sub("", str(getattr(one, "name", None) or "")) or number, one)
            for number, one in zip(numbers, every, strict=False)
        ]
    if not items:
        raise ArgumentError(f"{name}: nothing was given; give at least one")
    return tuple(_drawn(name, label, one, frequency, loops) for label, one in items)


def _drawn(name: str, label: str, system: Any, frequency: ArrayLike | None, loop: bool) -> DrawnSystem:
    if not all(hasattr(system, needed) for needed in ("input_labels", "output_labels", "dt")):
        raise ArgumentError(
            f"{name}: a system must be a control.StateSpace, TransferFunction or FrequencyResponseData, or several in "
            f"a list, got {short(system)}"
        )
    period_of(system, name)
    p, m = system.noutputs, system.ninputs
    if not p or not m or (loop and p != m):
        needed = "a square loop transfer is needed" if loop else "at least one of each is needed"
        raise ArgumentError(f"{name}: the system has {p} outputs and {m} inputs; {needed}")
    given = None if frequency is None else frequencies(frequency, name)
    if given is not None and (not np.any(given) or not np.all(np.diff(given) > 0.0) or given[0] < 0.0):
        raise ArgumentError(
            f"{name}: frequency must be ascending numbers in rad/s, or the two ends of a range > 0 rad/s"
        )
    if hasattr(system, "frdata"):
        arrays, w, response = None, np.asarray(system.omega), np.asarray(system.frdata, dtype=np.complex128)
        ends = (0.0, math.inf) if given is None else (given[0] * (1.0 - 1e-9), given[-1] * (1.0 + 1e-9))
        inside = (w > 0.0) & (w >= ends[0]) & (w <= ends[1])
        w, response = w[inside], response[..., inside]
    else:
        arrays = linear_arrays(system, name)
        w, response = _along(arrays, given)
    finite = np.isfinite(response).all(axis=(0, 1))
    about: dict[str, Any] = {
        "label": label,
        "inputs": tuple(system.input_labels),
        "outputs": tuple(system.output_labels),
    }
    return DrawnSystem(arrays=arrays, frequency=w[finite], response=response[..., finite], **about)


def _along(system: System, given: FloatArray | None) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies up to the Nyquist frequency, and the response there."""
    last = math.pi / system.dt if system.dt > 0.0 else math.inf
    if given is not None and given.size != 2:
        w = given[(given > 0.0) & (given <= last)]
        return w, frequency_response(system, w)
    s = continuous_poles(poles(system.A), system.dt)
    s = s[np.isfinite(s)]
    low, high = _range(system, s, _LAST * last) if given is None else (float(given[0]), min(float(given[1]), last))
    grid = following_grid(s, low, high, _POINTS)

    def turned(h: ComplexArray) -> FloatArray:
        return np.asarray(np.degrees(np.abs(np.angle(h[1:] / h[:-1]))).max(axis=(1, 2)) / _TURN)

    w, h = refined(
        np.unique(grid[(grid >= low) & (grid <= high)]),
        lambda w: np.moveaxis(frequency_response(system, w), -1, 0),
        turned,
    )
    return w, np.moveaxis(h, 0, -1)


def _range(system: System, s: ComplexArray, last: float) -> tuple[float, float]:
    """Return the frequencies between which all poles are seen, and crossings of gain 1 beyond them."""
    size = np.abs(s)
    # Integrators come out this large in floats.
    size = size[size > 1e-8 * size.max(initial=0.0)]
    corners = size if size.size else np.array([1.0])
    w = np.geomspace(min(1e-4 * corners.min(), 1e-3 * last), min(1e4 * corners.max(), last), 300)
    crossing = np.any(np.diff((np.abs(frequency_response(system, w)) > 1.0).astype(np.int8), axis=-1) != 0, axis=(0, 1))
    shown = np.concatenate([corners, w[:-1][crossing]])
    low, high = 0.1 * float(shown.min()), min(10.0 * float(shown.max()), last)
    return (min(low, 1e-3 * last), last) if system.dt else (low, high)


def sensitivity(L: System) -> System:
    """Return S = (I + L)^-1, with every state of L."""
    m = len(L.D)
    return L.feedback(gain(-np.eye(m))).part(range(m), range(m), 1.0)


def channels(L: ComplexArray) -> ComplexArray:
    """Return the loop of every channel with all others closed, 1/S_ii − 1, (m, N), of a response (m, m, N)."""
    if len(L) == 1:
        return np.asarray(L[0])
    S = np.linalg.inv(np.eye(len(L)) + np.moveaxis(L, -1, 0))
    return each_alone(S.astype(np.complex128))


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

    drawn = [one.frd() for one in drawn_systems("bode", systems, frequency)]
    return _plotted(control.bode_plot, drawn, options)


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

    drawn = drawn_systems("singular_values", systems, frequency)
    # Of a response `control.singular_values_plot` would draw the entries.
    responses = [control.singular_values_response(one.frd()) for one in drawn]
    return _plotted(control.singular_values_plot, responses, options)


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

    parts = [
        control.frd(channel, one.frequency, name=" ".join(filter(None, (one.label, str(name)))) or "loop")
        for one in drawn_systems("nyquist", loops, frequency, loops=True)
        for name, channel in zip(one.inputs, channels(one.response), strict=True)
    ]
    return _plotted(control.nyquist_plot, parts, options)


def _plotted(plot: Callable[..., Any], drawn: Sequence[Any], options: Mapping[str, Any]) -> control.ControlPlot:
    """Draw on a new figure, where python-control takes pyplot's current one; its titles repeat the legend."""
    from matplotlib import pyplot

    if "ax" not in options:
        pyplot.figure()
    return plot(drawn, **{"title": ""} | dict(options))
