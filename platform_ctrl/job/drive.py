"""Computations besides the controllers: on commands, on the platform's rate, and before a torquer."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args

import numpy as np

from platform_ctrl.analysis.between_samples import Into
from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import kinematics
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import Misfit, missing, strange, unknown, useless
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import gimbal_rate
from platform_ctrl.plant.tables import no_misfits, record_value

# Relative part of a rate that sensors may leave out: rounding.
_ROUNDING = 1e-9
# Friction that is fed forward over the plant's: with more the bearing would be better off without it.
_MOST_FRICTION = 2.0


@input_value
class CommandShaping:
    """What a controller does with commands of its readings before it compares them: see `design.method.shaped`.

    Attributes
    ----------
    filter_hz
        Of the reference filter, a second-order low-pass with damping 1, Hz.
    acceleration
        Whether the torques are fed forward that the loop's inertias, viscous friction and springs need to follow the
        filtered commands.
    """

    filter_hz: Annotated[float, fields.FREQUENCY]
    acceleration: fields.Truth = False


@input_value
class Feedforward:
    """Feedforward of the platform's rate in a design of a rate or pointing loop.

    Attributes
    ----------
    sensors
        Rate sensors of the root, which no torquer moves.
    into
        ``"torque"``: the torques that keep what the loop reads at zero while the platform turns are added to the
        controller's. ``"reading"``: the rates are added to what the loop reads, so that relative rates and angles of
        gimbals become inertial ones (indirect stabilisation).
    bandwidth_hz
        Of the filtered derivative of the rates, into the torque alone, Hz; None: a tenth of the sample rate.
    """

    sensors: fields.Names
    into: Annotated[Into, fields.one_of(get_args(Into))] = "torque"
    bandwidth_hz: fields.Positive | None = None

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if not table["sensors"]:
            yield "sensors", "sensors must be a list of names, rate sensors of the root"
        if table.get("into") == "reading" and "bandwidth_hz" in table:
            yield useless(table, "bandwidth_hz", 'with into = "reading"; leave the key out')


@input_value
class Drive:
    """What a torquer does besides what the loops command: torque = command + friction * sat(v / friction_rate).

    Attributes
    ----------
    torquer
        Name of a torquer on a gimbal.
    friction
        Dry friction that is fed forward, N m.
    friction_rate
        Rate v from which on all of it acts, rad/s.
    sensors
        Rate sensors from which the gimbal's rate v follows: on the root, then v is the rate with which the gimbal
        slides while its body is at rest in inertial space, at zero gimbal angles; or of the gimbal against its parent.
    """

    torquer: fields.Text
    friction: fields.NotNegative = 0.0
    friction_rate: fields.Positive = 0.01
    sensors: fields.Names = ()

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if "friction" not in table:
            yield missing("friction", "a drive feeds it forward")
        elif table["friction"] and not table.get("sensors"):
            yield missing("sensors", "friction is fed forward by the rate that rate sensors of the base or gimbal show")


@record_value
class DriveLaw(Drive):
    """A drive with the weights of its sensors: what a computer needs to know, whatever the plant is like.

    Attributes
    ----------
    torquer, friction, friction_rate, sensors
        As of `Drive`.
    weights
        Of the sensors' readings in v, by their names; dimensionless.
    feedback
        Whether v is the gimbal's own rate, which the torque changes.
    """

    weights: dict[str, float] = dataclasses.field(default_factory=dict)
    feedback: bool = False
    _misfits = staticmethod(no_misfits)  # friction may vary to zero


def drive_law(platform: Platform, drive: Drive) -> DriveLaw:
    """Return a drive with the weights of its sensors, which follow from where these are: see `slide_rates`.

    Parameters
    ----------
    platform
        That has the torquer and the sensors.
    drive
        What is asked for.

    Returns
    -------
    DriveLaw
        With weights, none where no friction is fed forward.

    Raises
    ------
    ArgumentError
        A sensor turns with a gimbal, or the sensors do not give the rate.
    """
    weights: dict[str, float] = {}
    feedback = False
    if drive.friction:
        gimbal = next(one.gimbal for one in platform.torquers if one.name == drive.torquer)
        weights, feedback = _weights(platform, platform.gimbal(str(gimbal)), drive.sensors)
    own = {one.name: getattr(drive, one.name) for one in dataclasses.fields(drive)}
    return DriveLaw(**own, weights=weights, feedback=feedback)


def drive_misfits(platform: Platform, drive: Drive, moved: bool) -> Iterator[Misfit]:
    """Yield what of a drive does not fit the plant; `moved`: whether a loop of the job moves the root."""
    gimbals = {one.name: one.gimbal for one in platform.torquers if one.gimbal is not None}
    if drive.torquer not in gimbals:
        yield unknown("torquer", drive.torquer, "torquer on a gimbal of the plant", gimbals)
        return
    rates = [sensor.name for sensor in platform.rate_sensors]
    if set(drive.sensors) <= set(rates) and drive.friction:
        yield from _friction(platform, gimbals[drive.torquer], drive, moved)
    yield from strange("sensors", drive.sensors, "rate sensor of the plant", rates)


def _friction(platform: Platform, name: str, drive: Drive, moved: bool) -> Iterator[Misfit]:
    """Yield what is wrong with friction that is fed forward: whether there is any, how much, and from which rate."""
    there = platform.breakaway(name)
    if there == 0.0:
        words = f"friction: gimbal {name!r} has no dry friction; add coulomb to its [[friction]] in the plant"
        yield "friction", words
    elif drive.friction > _MOST_FRICTION * there:
        words = f"{drive.friction:g} N m is {drive.friction / there:.3g} times the dry friction of gimbal {name!r}"
        yield "friction", f"friction: {words}, {there:g} N m; give at most twice as much"
    try:
        law = drive_law(platform, drive)
    except ArgumentError as error:
        yield "sensors", f"sensors: {error}"
        return
    if not law.feedback and moved:
        words = f"{', '.join(law.weights)} turn with {platform.root_name!r}, which a loop of the job moves"
        yield "sensors", f"sensors: {words}; use a sensor of the gimbal's rate against its parent"


def _weights(platform: Platform, gimbal: int, names: tuple[str, ...]) -> tuple[dict[str, float], bool]:
    """Return the weights of sensors in the rate of a gimbal, and whether that is its own rate."""
    rates = [gimbal_rate(angle) for angle in platform.angle_names]
    signals = [*OMEGA_NAMES, *rates]
    known = {sensor.name: sensor for sensor in platform.rate_sensors}
    rows = np.zeros((len(names), len(signals)))
    for row, name in zip(rows, names, strict=True):
        # The misalignment is not known to the computer.
        for signal, weight in dataclasses.replace(known[name], misalignment=None).signals(platform).items():
            if signal not in signals:
                raise ArgumentError(
                    f"{name!r} turns with the gimbal {known[name].body!r}; use rate sensors on {platform.root_name!r} "
                    'or of the gimbal against its parent (frame = "parent")'
                )
            row[signals.index(signal)] = weight
    own = np.eye(1, len(signals), 3 + gimbal)[0]
    still = np.concatenate([slide_rates(platform)[gimbal], np.zeros(len(rates))])
    for wanted, feedback in ((own, True), (still, False)):
        found = np.linalg.lstsq(rows.T, wanted)[0]
        if np.linalg.norm(found @ rows - wanted) <= _ROUNDING:
            return {name: float(w) for name, w in zip(names, found, strict=True) if abs(w) > _ROUNDING}, feedback
    axis = " + ".join(f"{-w:.4g} {name}" for name, w in zip(OMEGA_NAMES, still, strict=False) if abs(w) > _ROUNDING)
    raise ArgumentError(
        f"{', '.join(names)} do not give the rate of {platform.gimbal_names[gimbal]!r}, which is that of the base, "
        f"{axis or 'here zero'}; name sensors of it, or one of the gimbal against its parent"
    )


def slide_rates(platform: Platform) -> FloatArray:
    """Return the rates (n, 3) of the gimbals per platform rate at which no body turns about its own gimbal's axis.

    At zero angles: a_k · (Omega + Σ a_j q̇_j) + q̇_k = 0, over the gimbals j between the root and k.
    """
    at = kinematics(platform, np.zeros(len(platform.gimbals)))
    return np.asarray(-np.linalg.solve(np.where(at.tree.on_path[1:], at.axes @ at.axes.T, 0.0), at.axes))
