"""Plots of python-control, fed with responses on our grid: poles and zeros without damping are drawn to their peaks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.report.plots.systems import DrawnSystem, Systems, channels, drawn_systems, grid

if TYPE_CHECKING:
    import control


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

    return control.bode_plot(_responses("bode", drawn_systems("bode", systems), frequency), **options)


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
    return control.singular_values_plot(found, **options)


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
    return control.nyquist_plot(parts, **options)


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
