"""What was measured, as arrays: one or several plants with the same signals, dead time and hold put in exactly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.arguments import positive
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.signatures import short

if TYPE_CHECKING:
    import control

_FEWEST = 10
# Determinants of responses in any sensible units stay finite.
_LARGEST = 1e50


@value
class Measured:
    """Frequency responses of one plant, or of several that one controller has to serve.

    Attributes
    ----------
    frequency : tuple of (N_k,)
        rad/s, rising, of every plant.
    response : tuple of complex (N_k, n, n)
        Torques to angles, dead time and hold included.
    torques, angles
        Names of the signals.
    period
        Of the controller, s; 0 for a continuous one.
    """

    frequency: tuple[FloatArray, ...]
    response: tuple[ComplexArray, ...]
    torques: tuple[str, ...]
    angles: tuple[str, ...]
    period: float


def measured_plants(
    measurement: control.FRD | Sequence[control.FRD], dead_time: float, period: float | None, hold: bool
) -> Measured:
    """Return the responses of `measurement` as the controller sees them.

    Raises
    ------
    ArgumentError
        No frequency response, several that do not fit together, or too few frequencies.
    """
    dead_time = positive("measured_pid: dead_time", dead_time, zero=True)
    T = 0.0 if period is None else positive("measured_pid: period", period)
    if hold and not T:
        raise ArgumentError("measured_pid: hold = True without a period; expected the sample period of the hold in s")
    several: list[Any] = list(measurement) if isinstance(measurement, list | tuple) else [measurement]
    if not several:
        raise ArgumentError("measured_pid: given no measurement; expected a control.FRD or several")
    frequency, response = [], []
    first = several[0]
    for k, one in enumerate(several, 1):
        where = "measured_pid: the measurement" if len(several) == 1 else f"measured_pid: measurement {k}"
        w, H, dt = _arrays(one, where)
        if dt > 0.0 and T > 0.0 and abs(dt - T) > 1e-9 * T:
            raise ArgumentError(f"{where} has dt = {dt:g} s and period = {T:g} s; expected the same")
        if dt > 0.0 and hold:
            raise ArgumentError(f"{where} is sampled (dt = {dt:g} s), its hold is in it; expected hold = False")
        T = T or dt
        if H.shape[1] != H.shape[2]:
            raise ArgumentError(f"{where} has {H.shape[1]} outputs and {H.shape[2]} inputs; expected as many of both")
        if list(one.input_labels) != list(first.input_labels) or list(one.output_labels) != list(first.output_labels):
            raise ArgumentError(
                f"{where} has inputs {list(one.input_labels)} and outputs {list(one.output_labels)}, the first one "
                f"{list(first.input_labels)} and {list(first.output_labels)}; expected the same in the same order"
            )
        if T > 0.0:
            inside = w <= np.pi / T * (1.0 + 1e-9)
            w, H = w[inside], H[inside]
        if len(w) < _FEWEST:
            raise ArgumentError(
                f"{where} has {len(w)} frequencies below half the sample rate; expected {_FEWEST} or more"
            )
        size = np.abs(H).max(axis=(1, 2))
        if not (size.min() > 1.0 / _LARGEST and size.max() < _LARGEST):
            k = int((size > 1.0 / _LARGEST).argmin() if size.min() <= 1.0 / _LARGEST else size.argmax())
            raise ArgumentError(
                f"{where} has a response of {size[k]:.3g} at {w[k] / (2.0 * np.pi):.4g} Hz; expected rad/(N m), no "
                f"zeros, nothing above {_LARGEST:g}"
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
            f"{where} is {short(type(one).__name__)}; expected a control.FRD, see read_measurement"
        ) from None
    if dt is True:
        raise ArgumentError(f"{where} is sampled without a period (dt=True); expected dt in s")
    if not (np.all(np.isfinite(H)) and np.all(np.isfinite(w)) and np.all(np.diff(w) > 0.0) and w[0] >= 0.0):
        raise ArgumentError(f"{where} is not finite, or its frequencies do not rise from >= 0; expected both")
    kept = w > 0.0
    return w[kept], np.moveaxis(H[:, :, kept], -1, 0), float(dt or 0.0)
