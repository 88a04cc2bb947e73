"""Sensors of a platform. A kind is a class here and a field of `Platform`; what it reads is one linear combination.

`Sensor.signals` names what a kind reads by signals of the plant. The linear models take their output row from it
(`mechanics.state_space.output_rows`), simulations the reading (`simulation.packing`), and exports the unit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import input_value
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Refers

if TYPE_CHECKING:
    from platform_ctrl.plant.platform import Platform

# Fields of a sensor that say how well it measures, not what.
_ERRORS = ("noise_rms", "noise_bandwidth_hz", "quantisation", "added")


class Sensor:
    """What all kinds of sensors have in common.

    Attributes
    ----------
    name
        Signal name of the reading. A platform fills in that of the first of its `signals` where it is left out.
    noise_rms, noise_bandwidth_hz
        White noise: `noise_rms` units within `noise_bandwidth_hz` Hz (one-sided density noise_rms / sqrt(bandwidth)).
    quantisation
        Step of the reading, units; 0 for none.
    unit
        Of the reading.
    """

    __slots__ = ()

    unit: ClassVar[str]
    name: str
    noise_rms: float
    noise_bandwidth_hz: float
    quantisation: float

    @property
    def place(self) -> tuple[object, ...]:
        """Kind, name and place: what sensors of plants that differ in numbers alone have in common."""
        kind: type = type(self)
        return (kind, *_placed(kind)(self))

    def signals(self, platform: Platform) -> Mapping[str, float]:
        """Return the reading without its errors as a sum: weights of angles, gimbals' rates and Omega1 to Omega3."""
        raise NotImplementedError

    @check_arguments
    def sampled_noise(self, period: float) -> float:
        """Return the rms of one sample behind a filter at the Nyquist frequency.

        Parameters
        ----------
        period
            Sample period, s.

        Returns
        -------
        float
            In the unit of the reading: rad or rad/s.
        """
        return float(self.noise_rms * np.sqrt(0.5 / period / self.noise_bandwidth_hz))


@input_value
class PickOff(Sensor):
    """A sensor of a gimbal's angle.

    Attributes
    ----------
    name
        Signal name: the angle that it measures. A platform fills it in where it is left out.
    gimbal
        Name of the gimbal.
    noise_rms, noise_bandwidth_hz
        White noise: `noise_rms` rad within `noise_bandwidth_hz` Hz (one-sided density noise_rms / sqrt(bandwidth)).
    quantisation
        Step of the reading, rad; 0 for none.
    added
        Whether the device itself does not have it.
    """

    unit = "rad"
    name: str = ""
    gimbal: Annotated[fields.Text, Refers(once="pick-off")]
    noise_rms: fields.NotNegative = 0.0
    noise_bandwidth_hz: fields.Positive = 1000.0
    quantisation: fields.NotNegative = 0.0
    added: fields.Truth = False

    @check_arguments
    def signals(self, platform: Platform) -> Mapping[str, float]:
        """Return the signal that is read, and its weight.

        Parameters
        ----------
        platform
            The platform that has the sensor.

        Returns
        -------
        mapping
            The gimbal's angle, weight 1.

        Raises
        ------
        ArgumentError
            The platform has no such gimbal.
        """
        return {platform.angle_names[platform.gimbal(self.gimbal)]: 1.0}


@input_value
class RateSensor(Sensor):
    """A sensor of a rate: of the root about one of its axes, or of a gimbal against its parent.

    Attributes
    ----------
    name
        Signal name: Omega1, Omega2 or Omega3 on the root; on a gimbal its angle's name + ``_rate``. A platform fills it
        in where it is left out.
    gimbal, root_axis
        Exactly one is given: the gimbal's name, or 1, 2 or 3.
    noise_rms, noise_bandwidth_hz
        White noise: `noise_rms` rad/s within `noise_bandwidth_hz` Hz (one-sided density noise_rms / sqrt(bandwidth)).
    quantisation
        Step of the reading, rad/s; 0 for none.
    """

    unit = "rad/s"
    name: str = ""
    gimbal: Annotated[fields.Text | None, Refers(once="rate sensor", hint="root_axis measures the root")] = None
    root_axis: fields.RootAxis | None = None
    noise_rms: fields.NotNegative = 0.0
    noise_bandwidth_hz: fields.Positive = 1000.0
    quantisation: fields.NotNegative = 0.0

    @check_arguments
    def signals(self, platform: Platform) -> Mapping[str, float]:
        """Return the signal that is read, and its weight.

        Parameters
        ----------
        platform
            The platform that has the sensor.

        Returns
        -------
        mapping
            The root's rate about one axis or the gimbal's rate, weight 1.

        Raises
        ------
        ArgumentError
            The platform has no such gimbal.
        """
        if self.gimbal is None:
            return {f"Omega{self.root_axis}": 1.0}
        return {gimbal_rate(platform.angle_names[platform.gimbal(self.gimbal)]): 1.0}


@cache
def _placed(kind: type) -> Callable[[Sensor], tuple[object, ...]]:
    return attrgetter(*(field.name for field in dataclasses.fields(kind) if field.name not in _ERRORS))


@check_arguments
def gimbal_rate(angle: str) -> str:
    """Return the signal name of a gimbal's rate, from that of its angle."""
    return f"{angle}_rate"
