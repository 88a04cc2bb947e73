"""Sensors of a platform. A kind is a class here and a field of `Platform`; what it reads is one linear combination.

`Sensor.signals` names what a kind reads by signals of the plant. The linear models take their output row from it
(`mechanics.outputs`), simulations the reading (`simulation.packing`), and exports the unit. Signals are

    angle, angle_rate          a gimbal's angle and rate against its parent
    Omega1 to Omega3           the root's rate in its own axes
    NAME_Omega1 to 3           the rate of the gimbal's body NAME against inertial space, in the body's own axes
    NAME_theta1 to 3           its small rotation against inertial space since the start, in the body's own axes

With the rotation R(t) from body to inertial axes and E = R(0)ᵀ R(t), theta_i is (E_kj − E_jk)/2 for i, j, k = 1, 2, 3
and cyclic: the sine of the angle times its axis, linear in small rotations.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from operator import attrgetter
from typing import Annotated, Any, Literal, get_args

import numpy as np

from platform_ctrl.common.arguments import whole
from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import NOT_NEGATIVE, Refers
from platform_ctrl.plant.gimbals import GimbalTree
from platform_ctrl.plant.mistakes import Misfit, missing, useless
from platform_ctrl.plant.tables import Instead

Frame = Literal["inertial", "parent"]

# A sensor's low-pass of bandwidth w: x' = w (LOWPASS x + [0, u]), x the reading and its rate over w.
LOWPASS = np.array([[0.0, 1.0], [-1.0, -math.sqrt(2.0)]])
_BANDWIDTH = 1000.0
# Sample periods that a reading may be old in a linear model, which has a state for each.
_MOST_LATE = 1000
# How far from a whole number, relative, a ratio of rates may be that counts as one.
_WHOLE = 1e-6
_DENSITY = Instead(
    "noise_density",
    NOT_NEGATIVE,
    lambda density, sensor: density * math.sqrt(sensor.get("noise_bandwidth_hz", _BANDWIDTH)),
)


@input_value
class Sensor:
    """The fields of all kinds of sensors: a name, and how well they measure.

    Attributes
    ----------
    name
        Signal name of the reading. A platform fills in that of the first of its `signals` where it is left out.
    noise_rms, noise_bandwidth_hz
        White noise: its rms, units, within the bandwidth, Hz. A plant file may give the one-sided density instead,
        ``noise_density`` = noise_rms/√bandwidth: of a gyro √2 times its angle random walk in rad/√s.
    quantisation
        Step of the reading, units; 0 for none.
    bias, scale_error
        Constant error, units, and relative error of the scale factor.
    bandwidth_hz
        Where the sensor, a second-order low-pass of damping 1/sqrt(2), has lost 3 dB, Hz; None: it follows at once.
    delay
        Age of the reading, s; it counts in whole sample periods of the controllers, rounded up.
    """

    unit = ""  # of the reading
    name: str = ""
    noise_rms: Annotated[fields.NotNegative, _DENSITY] = 0.0
    noise_bandwidth_hz: fields.Positive = _BANDWIDTH
    quantisation: fields.NotNegative = 0.0
    bias: fields.Number = 0.0
    scale_error: fields.Number = 0.0
    bandwidth_hz: fields.Positive | None = None
    delay: fields.NotNegative = 0.0

    @property
    def rate_hz(self) -> float | None:
        """Rate of new readings, which are held between, Hz; None: at every sample, as of kinds without such a field."""
        return None

    @property
    def place(self) -> tuple[object, ...]:
        """Kind, name and place: what sensors of plants that differ in numbers alone have in common."""
        kind: type = type(self)
        lags = (self.bandwidth_hz is not None, self.delay)
        items = _placed(kind)(self)
        return (kind, *lags, *(item.tobytes() if isinstance(item, np.ndarray) else item for item in items))

    def signals(self, platform: GimbalTree) -> Mapping[str, float]:
        """Return the reading without its errors as a sum: weights of signals of the plant."""
        raise NotImplementedError

    def sampled_noise(self, period: float, every: int = 1) -> float:
        """Return the rms of one sample behind a filter at the Nyquist frequency.

        Parameters
        ----------
        period
            Sample period, s.
        every
            At every how many samples the reading is used. A sensor with samples of its own is filtered for these;
            where it is used more often, the rms is that of independent samples with the density of the readings held.

        Returns
        -------
        float
            In the unit of the reading: rad or rad/s.
        """
        own = period * min(self._held(period), whole("sampled_noise: every", every, 1))
        return float(self.noise_rms * np.sqrt(0.5 / own / self.noise_bandwidth_hz))

    def _held(self, period: float) -> float:
        """Return the number of sample periods for which a reading is held."""
        return 1.0 if self.rate_hz is None else max(1.0, 1.0 / (self.rate_hz * period))

    def periods_late(self, period: float, every: int = 1) -> int:
        """Return the age of the reading in sample periods, rounded up, with the mean age of readings that are held.

        Parameters
        ----------
        period
            Sample period, s.
        every
            At every how many samples the reading is used: one that is measured just then is not held at all.

        Returns
        -------
        int
            0 or more.

        Raises
        ------
        ArgumentError
            The reading is older than linear models with a state for every period can show.
        """
        every = whole("periods_late: every", every, 1)
        held = self._held(period)
        # Both begin at t = 0: the ages at the samples where it is used are multiples of the common divisor.
        step = math.gcd(round(held), every) if abs(held - round(held)) < _WHOLE * held else 1
        late = self.delay / period + 0.5 * max(held - step, 0.0)
        if late > _MOST_LATE:
            held_long = late - self.delay / period > _MOST_LATE
            cure = "a higher rate_hz" if held_long else f"a shorter delay than {self.delay:g} s"
            raise ArgumentError(
                f"sensor {self.name!r}: its reading is {late:.4g} sample periods old, more than the {_MOST_LATE} of a "
                f"linear model; give it {cure}"
            )
        return math.ceil(late - 1e-9)


# Fields of a sensor that say how well it measures, not what.
ERRORS = frozenset(field.name for field in dataclasses.fields(Sensor)) - {"name"}


@input_value
class _GimbalAngle(Sensor):
    unit = "rad"
    gimbal: str

    def signals(self, platform: GimbalTree) -> Mapping[str, float]:
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
class PickOff(_GimbalAngle):
    """A sensor of a gimbal's angle against its parent.

    Attributes
    ----------
    name
        Signal name: the angle that it measures. A platform fills it in where it is left out.
    gimbal
        Name of the gimbal.
    noise_rms, noise_bandwidth_hz, quantisation, bias, scale_error, bandwidth_hz, delay
        See `Sensor`; rad.
    added
        Whether the real device lacks it: every verdict and report states that.
    """

    gimbal: Annotated[fields.Text, Refers()]
    added: fields.Truth = False


@input_value
class AngleSensor(_GimbalAngle):
    """An encoder or resolver: a further sensor of a gimbal's angle against its parent, with a name of its own.

    Attributes
    ----------
    name
        Signal name of the reading.
    gimbal
        Name of the gimbal.
    noise_rms, noise_bandwidth_hz, quantisation, bias, scale_error, bandwidth_hz, delay
        See `Sensor`; rad.
    """

    name: fields.Text
    gimbal: Annotated[fields.Text, Refers()]


@input_value
class RateSensor(Sensor):
    """A sensor of a rate: of any body about any of its axes, of the root, or of a gimbal against its parent.

    Attributes
    ----------
    name
        Signal name; default Omega1, Omega2 or Omega3 on the root, the angle's name + ``_rate`` of a gimbal against its
        parent, the body's name + ``_Omega1`` (2, 3) against inertial space.
    gimbal, root_axis, body
        Exactly one is given: the gimbal whose rate against its parent is measured; 1, 2 or 3; or a body, with `axis`.
    axis : (3,)
        Sensing axis in the axes of `body`, a unit vector; None without `body`.
    frame
        Of `body`: its rate against ``"inertial"`` space, as a gyro measures it, or against its ``"parent"``.
    misalignment : (3,)
        Small rotation of the sensing axis, body axes, rad: the sensor measures about axis + misalignment × axis.
    noise_rms, noise_bandwidth_hz, quantisation, bias, scale_error, bandwidth_hz, delay
        See `Sensor`; rad/s.
    """

    unit = "rad/s"
    name: Annotated[str, fields.TEXT] = ""
    gimbal: Annotated[fields.Text | None, Refers(hint="root_axis measures the root")] = None
    root_axis: fields.RootAxis | None = None
    body: Annotated[fields.Text | None, Refers(root=True)] = None
    axis: fields.Axis | None = None
    frame: Annotated[Frame, fields.one_of(get_args(Frame))] = "inertial"
    misalignment: fields.Vector | None = None

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        places = [key for key in ("gimbal", "root_axis", "body") if key in table]
        if len(places) != 1:
            which = "not " + " and ".join(f'"{key}"' for key in places) if places else "one of them is needed"
            yield (), f'give one of "gimbal", "root_axis" and "body", {which}'
        elif places == ["body"] and "axis" not in table:
            yield missing("axis", "it must be the sensing axis in the body's axes")
        elif places != ["body"]:
            for key in {"axis", "frame", "misalignment"} & table.keys():
                yield useless(table, key, 'without "body"')

    def signals(self, platform: GimbalTree) -> Mapping[str, float]:
        """Return the signals that are read, and their weights.

        Parameters
        ----------
        platform
            The platform that has the sensor.

        Returns
        -------
        mapping
            The root's rate about one axis, the gimbal's rate, or components of the body's inertial rate.

        Raises
        ------
        ArgumentError
            The platform has no such gimbal or body.
        """
        if self.root_axis is not None:
            return {f"Omega{self.root_axis}": 1.0}
        if self.gimbal is not None:
            return {gimbal_rate(platform.angle_names[platform.gimbal(self.gimbal)]): 1.0}
        axis = sensing_axis(self.axis, self.misalignment)
        body = platform.body(self.body or "")
        if self.frame == "parent" and body > 0:
            gimbal = platform.gimbals[body - 1]
            return {gimbal_rate(gimbal.angle): float(gimbal.axis @ axis)}
        return components(body_rates(platform, body), axis)


@input_value
class AttitudeSensor(Sensor):
    """A sensor of a small rotation of a body against inertial space: a tracker, star sensor or autocollimator.

    It reads the rotation about its axis since the start: of a camera's tracker the angle between the line of sight and
    a target at rest in inertial space, at which it looks at the start.

    Attributes
    ----------
    name
        Signal name; default the body's name + ``_theta1`` (2, 3).
    body
        Name of a gimbal or of the root.
    axis : (3,)
        Axis of the rotation that is measured, in the body's axes, a unit vector.
    misalignment : (3,)
        As of a rate sensor, rad.
    noise_rms, noise_bandwidth_hz, quantisation, bias, scale_error, bandwidth_hz, delay
        See `Sensor`; rad.
    rate_hz
        Rate at which the sensor takes new readings, which it holds between, Hz; None: at every sample.
    """

    unit = "rad"
    name: Annotated[str, fields.TEXT] = ""
    body: Annotated[fields.Text, Refers(root=True)]
    axis: fields.Axis
    misalignment: fields.Vector | None = None
    rate_hz: fields.Positive | None = None

    def signals(self, platform: GimbalTree) -> Mapping[str, float]:
        """Return the signals that are read, and their weights.

        Parameters
        ----------
        platform
            The platform that has the sensor.

        Returns
        -------
        mapping
            Components of the body's small rotation against inertial space.

        Raises
        ------
        ArgumentError
            The platform has no such body.
        """
        return components(
            body_rotations(platform, platform.body(self.body)), sensing_axis(self.axis, self.misalignment)
        )


@input_value
class LineOfSight:
    """The direction in which a platform's payload looks.

    Its outputs are the rates and the small rotations against inertial space about two axes across it and about itself:
    ``los_rate1``, ``los_rate2``, ``los_roll_rate``, rad/s, and ``los_angle1``, ``los_angle2``, ``los_roll``, rad. The
    first axis across is the next body axis after the one that the line of sight is nearest to (after 1: 2, after 2: 3,
    after 3: 1), made normal to it; the second completes the right-handed triple.

    Attributes
    ----------
    body
        Name of a gimbal or of the root.
    direction : (3,)
        Unit vector in the body's axes; dimensionless.
    """

    body: Annotated[fields.Text, Refers(root=True)]
    direction: fields.Axis

    @property
    def across(self) -> FloatArray:
        """The two axes across the line of sight and the line of sight itself, (3, 3), unit vectors in body axes."""
        first = np.eye(3)[(int(np.abs(self.direction).argmax()) + 1) % 3]
        first = first - (first @ self.direction) * self.direction
        first /= np.linalg.norm(first)
        return np.array([first, np.cross(self.direction, first), self.direction])

    def signals(self, platform: GimbalTree) -> Mapping[str, Mapping[str, float]]:
        """Return of each output the signals of the plant that it is the sum of, and their weights.

        Parameters
        ----------
        platform
            The platform that has it.

        Returns
        -------
        mapping
            By output: rates first, then angles; weights are dimensionless.

        Raises
        ------
        ArgumentError
            The platform has no such body.
        """
        body = platform.body(self.body)
        return {
            name: components(signals, axis)
            for names, signals in (
                (LOS_RATES, body_rates(platform, body)),
                (LOS_ANGLES, body_rotations(platform, body)),
            )
            for name, axis in zip(names, self.across, strict=True)
        }


# The small rotations of the root against inertial space, which are states of models in which it moves under gravity.
ROOT_ROTATIONS = ("theta1", "theta2", "theta3")
LOS_RATES = ("los_rate1", "los_rate2", "los_roll_rate")
LOS_ANGLES = ("los_angle1", "los_angle2", "los_roll")


def sensing_axis(axis: FloatArray | None, misalignment: FloatArray | None) -> FloatArray:
    """Return an axis that a small rotation has turned."""
    given = np.zeros(3) if axis is None else np.asarray(axis)
    return given if misalignment is None else given + np.cross(misalignment, given)


def components(signals: tuple[str, ...], axis: FloatArray) -> dict[str, float]:
    """Return the weights of a vector's components along an axis, the largest first, without zeros."""
    order = sorted(range(3), key=lambda k: -abs(axis[k]))
    return {signals[k]: float(axis[k]) for k in order if axis[k] != 0.0}


def body_rates(platform: GimbalTree, body: int) -> tuple[str, ...]:
    """Return the signals of a body's rate against inertial space, in its own axes."""
    owner = f"{platform.gimbal_names[body - 1]}_" if body else ""
    return tuple(f"{owner}Omega{k}" for k in (1, 2, 3))


def body_rotations(platform: GimbalTree, body: int) -> tuple[str, ...]:
    """Return the signals of a body's small rotation against inertial space, in its own axes."""
    owner = f"{platform.gimbal_names[body - 1]}_" if body else ""
    return tuple(f"{owner}{name}" for name in ROOT_ROTATIONS)


@cache
def _placed(kind: type) -> Callable[[Sensor], tuple[object, ...]]:
    return attrgetter(*(field.name for field in dataclasses.fields(kind) if field.name not in ERRORS))


def gimbal_rate(angle: str) -> str:
    """Return the signal name of a gimbal's rate, from that of its angle."""
    return f"{angle}_rate"
