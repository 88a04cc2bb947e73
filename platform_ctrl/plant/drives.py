"""What drives a platform: torquers, motors and servos. Values only; SI units."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import POSITIVE, Refers, default_torquer
from platform_ctrl.plant.force_elements import Spring
from platform_ctrl.plant.mistakes import Misfit, missing, useless, wrong
from platform_ctrl.plant.tables import TABLE, Instead, either

# A current loop has at least so many samples for a period of its bandwidth.
_PER_BANDWIDTH = 10.0
# Torques about the root's axes.
ROOT_TORQUE_NAMES = ("M1", "M2", "M3")

# What data sheets state in place of a value, of which the motor's torque constant K is made first.
_PER_VOLT = Instead("kv", POSITIVE, lambda rpm, _: 60.0 / (2.0 * math.pi * rpm))
_FROM_HEAT = Instead("motor_constant", POSITIVE, lambda k, motor: (motor["torque_constant"] / k) ** 2)
_PEAK, _CONTINUOUS = (
    Instead(key, POSITIVE, lambda torque, motor: torque / motor["torque_constant"])
    for key in ("peak_torque", "continuous_torque")
)
_INSTEAD = {"torque_constant": "kv", "resistance": "motor_constant"}
_CURRENTS = ("current_limit", "peak_torque", "continuous_current", "continuous_torque")


def _harmonics(size: str, fit: Callable[[float], bool]) -> fields.Expected:
    judge = fields.rows(lambda x: x > 0, fit, lambda x: True)
    return fields.Expected(f"rows [order > 0, {size}, phase]", judge)


class Winding(NamedTuple):
    """A motor's winding and current loop, at the joint: L i' = v − R i − K q̇, the torque is `per_ampere` i.

    States are i, the loop's integral x and d: the loop wants u = proportional (i* − i) + x, x' = integral (i* − i), and
    v = 2 d − u with d' = 2 (u − d)/delay is u after a delay (Padé). u and v are within the supply; x stays where u is
    at it and would go further.
    """

    per_ampere: float  # N m/A
    back_emf: float  # K, V s
    resistance: float  # ohm
    inductance: float  # H
    supply: float  # V
    proportional: float  # V/A
    integral: float  # V/(A s)
    delay: float  # s
    swell: float = 1.0  # torque of the current over its mean, where ripple makes it more or less

    @property
    def matrices(self) -> tuple[FloatArray, FloatArray]:
        """Of the states [i, x, d] within the supply: (3, 3), and (3, 2) for [i*, q̇]."""
        P, L, pace = self.proportional, self.inductance, 2.0 / self.delay
        A = [[(P - self.resistance) / L, -1.0 / L, 2.0 / L], [-self.integral, 0.0, 0.0], [-P * pace, pace, -pace]]
        return np.array(A), np.array([[-P / L, -self.back_emf / L], [self.integral, 0.0], [P * pace, 0.0]])


@input_value
class Torquer:
    """A motor that turns a gimbal against its parent, or the root against inertial space.

    Attributes
    ----------
    name
        Signal name; default ``Q`` + gimbal or ``M`` + root axis.
    gimbal, root_axis
        Exactly one is given: the gimbal's name, or 1, 2 or 3.
    limit
        Largest torque, N m, or None.
    lag
        Time constant of the first-order lag from command to torque, s.
    rate_limit
        Largest rate at which the torque follows its command, N m/s, or None.
    added
        Whether the real device lacks it: every verdict and report states that.
    stall, back_emf
        Of a motor: torque between −stall − back_emf q̇ and stall − back_emf q̇ is what its supply allows, N m and N m s;
        stall None: any.
    command, gain
        Of a servo: what takes the place of the torque, ``"rate"`` or ``"angle"``, and the torque for a unit of it. Its
        limits are those of the command.
    winding
        Of a motor whose current is a state, or None.
    least_share, lasting
        Of a motor: share of its torque that ripple leaves at any angle, and the torque that it bears for ever, N m.
    """

    name: fields.Text = ""
    gimbal: Annotated[fields.Text | None, Refers(hint="root_axis turns the root")] = None
    root_axis: fields.RootAxis | None = None
    limit: fields.Positive | None = None
    lag: fields.NotNegative = 0.0
    rate_limit: fields.Positive | None = None
    added: fields.Truth = False
    stall: float | None = None
    back_emf: float = 0.0
    command: str = ""
    gain: float = 1.0
    winding: Winding | None = None
    least_share: float = 1.0
    lasting: float = math.inf

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if ("gimbal" in table) == ("root_axis" in table):
            yield (), either("gimbal", "root_axis", "gimbal" in table)

    def __post_init__(self) -> None:
        """Name the signal."""
        if not self.name:
            object.__setattr__(self, "name", default_torquer(self.gimbal, self.root_axis))

    @property
    def driven(self) -> bool:
        """Whether it is the drive of a motor or a servo, which make it."""
        return self.stall is not None or bool(self.command)

    @property
    def unit(self) -> str:
        """SI unit of what it takes."""
        return {"rate": "rad/s", "angle": "rad"}.get(self.command, "N m")

    @property
    def signal(self) -> str:
        """Name of the linear model's input that it drives: its own, or M1, M2 or M3 on the root."""
        return self.name if self.root_axis is None else ROOT_TORQUE_NAMES[self.root_axis - 1]


@input_value
class CurrentLoop:
    """The loop that sets a motor's current.

    Attributes
    ----------
    bandwidth_hz
        Where the current is 3 dB down, its delay included, Hz.
    rate_hz
        Sample rate of the loop, Hz, which delays the voltage by 1.5 samples: the current is a state of models and runs
        then. None: it is a lag of that bandwidth, without back-EMF behind the loop.
    proportional, integral
        In place of the bandwidth: gains of the loop, V/A and V/(A s); None: those that cancel the winding's pole.
    """

    bandwidth_hz: fields.Positive | None = None
    rate_hz: fields.Positive | None = None
    proportional: fields.Positive | None = None
    integral: fields.NotNegative | None = None

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        bandwidth, rate = table.get("bandwidth_hz"), table.get("rate_hz")
        if (bandwidth is None) == ("proportional" not in table):
            yield (), either("bandwidth_hz", "proportional", bandwidth is not None)
        if ("integral" in table) != ("proportional" in table):
            yield (), 'give "proportional" and "integral" together'
        if "proportional" in table and rate is None:
            yield missing("rate_hz", "gains need the rate at which the loop is computed")
        if bandwidth is not None and rate is not None and bandwidth > rate / _PER_BANDWIDTH:
            yield wrong(table, "bandwidth_hz", f"at most a tenth of rate_hz, {rate / _PER_BANDWIDTH:g}")


@input_value
class Motor:
    """A rotor in a gimbal's parent that a gear turns about the joint's axis: φ̇ = gear q̇; with a current loop it drives.

    T has ½ rotor_inertia (a·ω_parent + gear q̇)². The current loop makes it a torquer, `drive`, whose torque on the
    gimbal is efficiency gear torque_constant i. The current is limited, and the voltage: |supply| ≥ resistance i +
    torque_constant gear q̇.

    Attributes
    ----------
    name
        Signal name of its torque on the gimbal; default ``Q`` + gimbal.
    gimbal
        Name of the gimbal that it turns against its parent.
    gear
        Turns of the motor for a turn of the gimbal; negative where the gear turns the motor the other way.
    rotor_inertia
        About its axis, kg m²; its mass and transverse inertia are part of the parent's.
    torque_constant, resistance, inductance, supply
        N m/A (V s/rad), ohm, H and V, or None.
    current_limit, continuous_current
        A, or None; the second is the rms that the motor's heat allows, which every run is compared with.
    thermal_time
        Time constant of the winding's heat, s: the rms is that of i² behind a lag of it, at its largest. None: of the
        whole run.
    current_loop
        None: nothing drives it, or a [[torquer]] says what does.
    efficiency
        Share of the motor's torque that arrives at the gimbal.
    cogging : (h, 3)
        Harmonics of the torque without current, in runs: order per turn of the motor, amplitude, N m, and phase at
        angle 0, rad.
    ripple : (h, 3)
        The same of the torque of the current, amplitudes as shares of it.
    swell
        Torque of the current over its mean in linear models.
    """

    name: fields.Text = ""
    gimbal: Annotated[fields.Text, Refers()]
    rotor_inertia: fields.NotNegative = 0.0
    gear: fields.NotZero = 1.0
    torque_constant: Annotated[fields.Positive | None, _PER_VOLT] = None
    resistance: Annotated[fields.Positive | None, _FROM_HEAT] = None
    inductance: fields.Positive | None = None
    supply: fields.Positive | None = None
    current_limit: Annotated[fields.Positive | None, _PEAK] = None
    continuous_current: Annotated[fields.Positive | None, _CONTINUOUS] = None
    thermal_time: fields.Positive | None = None
    current_loop: Annotated[CurrentLoop | None, TABLE] = None
    efficiency: fields.SomePart = 1.0
    cogging: Annotated[FloatArray | None, _harmonics("amplitude >= 0", lambda x: x >= 0)] = None
    ripple: Annotated[FloatArray | None, _harmonics("0 <= share < 1", lambda x: 0 <= x < 1)] = None
    swell: float = 1.0

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        loop, needed = table.get("current_loop"), ["torque_constant", "resistance", "supply"]
        by_constant = [key for key in ("motor_constant", "peak_torque", "continuous_torque") if key in table]
        if loop is not None:
            needed += ["inductance"] if "rate_hz" in loop else []
            lacking = [key for key in needed if key not in table and _INSTEAD.get(key) not in table]
            yield from (missing(key, "a current loop needs it") for key in lacking)
            if not lacking and {"proportional", "integral", "rate_hz"} <= loop.keys():
                K = table.get("torque_constant") or _PER_VOLT.value(table["kv"], {})
                R = table.get("resistance") or _FROM_HEAT.value(table["motor_constant"], {"torque_constant": K})
                winding = _winding(CurrentLoop(**loop), R, table["inductance"], 1.0, 0.0, 1.0)
                if np.abs(np.linalg.eigvals(_sampled(winding))).max() > 1.0:
                    yield "current_loop", "current_loop is not stable: take smaller gains, or a higher rate_hz"
            if "ripple" in table and "rate_hz" not in loop:
                yield wrong(table, "ripple", "with rate_hz in current_loop: it is a share of what the current does")
        else:
            if "rotor_inertia" not in table:
                yield missing("rotor_inertia", "a motor without current_loop is a rotor alone, of so many kg m²")
            if by_constant and not {"torque_constant", "kv"} & table.keys():
                yield missing("torque_constant", f"{by_constant[0]} needs it")
        for most, lasting in (("current_limit", "continuous_current"), ("peak_torque", "continuous_torque")):
            if lasting in table and table[lasting] > table.get(most, math.inf):
                yield wrong(table, lasting, f"at most {most}, {table[most]:g}")
        if sum(share for _, share, _ in table.get("ripple", ())) >= 1.0:
            yield wrong(table, "ripple", "of shares that sum to less than 1")
        if "thermal_time" in table and not {"continuous_current", "continuous_torque"} & table.keys():
            yield missing("continuous_current", "thermal_time is about how long a larger one may flow")
        for key in (*_CURRENTS, "efficiency", "ripple", "name"):
            if key in table and "current_loop" not in table:
                yield useless(table, key, 'without "current_loop"')

    def __post_init__(self) -> None:
        """Name the signal after the gimbal, not after its motor side."""
        if not self.name and self.current_loop is not None:
            object.__setattr__(self, "name", default_torquer(self.gimbal, None))

    @property
    def per_ampere(self) -> float:
        """Torque on the gimbal for an ampere, N m/A; 0 without `torque_constant`."""
        return abs(self.gear) * (self.torque_constant or 0.0) * self.efficiency

    @property
    def least_share(self) -> float:
        """Share of the torque of a current that ripple leaves where it takes most away, dimensionless."""
        return 1.0 if self.ripple is None else 1.0 - float(self.ripple[:, 1].sum())

    @property
    def drive(self) -> Torquer | None:
        """The torquer that it is, with what its supply allows; None without a current loop."""
        loop, constant, resistance, supply = self.current_loop, self.torque_constant, self.resistance, self.supply
        if loop is None or constant is None or resistance is None or supply is None:
            return None
        per_ampere, K = self.per_ampere, abs(self.gear) * constant
        winding = None
        if loop.rate_hz is not None and self.inductance is not None:
            winding = _winding(loop, resistance, self.inductance, per_ampere, K, supply)._replace(swell=self.swell)
        return Torquer(
            name=self.name,
            gimbal=self.gimbal,
            limit=per_ampere * min(supply / resistance, self.current_limit or math.inf),
            lag=0.0 if winding else 1.0 / (2.0 * math.pi * (loop.bandwidth_hz or math.inf)),
            stall=per_ampere * supply / resistance,
            back_emf=per_ampere * K / resistance,
            winding=winding,
            least_share=self.least_share,
            lasting=per_ampere * (self.continuous_current or math.inf),
        )


def _winding(
    loop: CurrentLoop, resistance: float, inductance: float, per_ampere: float, back_emf: float, supply: float
) -> Winding:
    """Return a winding with its current loop, which is 3 dB down at its bandwidth or has the gains that it states."""
    delay, P, integral = 1.5 / (loop.rate_hz or math.inf), loop.proportional, loop.integral
    if P is None or integral is None:
        # |ω_c/(jω + ω_c e^(−jφ))|² = 1/2, φ the phase of the delay at ω.
        w = 2.0 * math.pi * (loop.bandwidth_hz or 0.0)
        sine = math.sin(2.0 * math.atan(0.5 * w * delay))
        crossover = w * (math.sqrt(1.0 + sine * sine) - sine)
        P, integral = inductance * crossover, resistance * crossover
    return Winding(per_ampere, back_emf, resistance, inductance, supply, P, integral, delay)


def _sampled(one: Winding) -> FloatArray:
    """Return the matrix (3, 3) of [i, x, v] from sample to sample of its loop, which sets v a sample late."""
    period = one.delay / 1.5
    decay = math.exp(-one.resistance * period / one.inductance)
    return np.array(
        [
            [decay, 0.0, (1.0 - decay) / one.resistance],
            [-one.integral * period, 1.0, 0.0],
            [-one.proportional, 1.0, 0.0],
        ]
    )


@input_value
class Servo:
    """A drive that takes a rate or an angle of a gimbal, and has a loop of its own that turns it there.

    Its torque on the gimbal is inertia ω (command − q̇) or, of an angle, inertia (ω² (command − q) − √2 ω q̇), and the
    opposite on what carries the gimbal: a command arrives 3 dB down at ω = 2π bandwidth_hz where the gimbal has that
    inertia. Other torques T turn the gimbal at T/(inertia ω), or by T/(inertia ω²): the loop has no integral.

    Attributes
    ----------
    name
        Signal name of the command; default ``rate_`` or ``angle_`` + gimbal.
    gimbal
        Name of the gimbal that it turns against its parent.
    command
        ``"rate"`` or ``"angle"``.
    bandwidth_hz
        Where the response to a command is 3 dB down, Hz.
    rate_limit
        Largest rate, rad/s: that of the command or, of an angle, how fast the command is followed; None: any.
    acceleration_limit
        How fast a command of a rate is followed, rad/s², and so the largest acceleration; None: at once.
    inertia
        About the axis, kg m²; default that of all that turns with the gimbal at zero angles.
    """

    name: fields.Text = ""
    gimbal: Annotated[fields.Text, Refers()]
    command: Annotated[Literal["rate", "angle"], fields.one_of(("rate", "angle"))]
    bandwidth_hz: fields.Positive
    rate_limit: fields.Positive | None = None
    acceleration_limit: fields.Positive | None = None
    inertia: fields.Positive | None = None

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        if "acceleration_limit" in table and table["command"] == "angle":
            yield useless(table, "acceleration_limit", 'with command = "angle": rate_limit and bandwidth_hz bound it')

    def __post_init__(self) -> None:
        """Name the signal after the gimbal, not after its motor side."""
        if not self.name:
            object.__setattr__(self, "name", f"{self.command}_{self.gimbal}")

    @property
    def spring(self) -> Spring:
        """What its loop makes of the joint where the command is 0."""
        if self.inertia is None:
            raise ArgumentError(f"servo of gimbal {self.gimbal!r}: give its inertia, or read the plant from a dict")
        w = 2.0 * math.pi * self.bandwidth_hz
        if self.command == "rate":
            return Spring(gimbal=self.gimbal, stiffness=0.0, damping=self.inertia * w)
        return Spring(gimbal=self.gimbal, stiffness=self.inertia * w**2, damping=math.sqrt(2.0) * self.inertia * w)

    @property
    def drive(self) -> Torquer:
        """The torquer that it is, of commands in place of torques."""
        rate, spring = self.command == "rate", self.spring
        return Torquer(
            name=self.name,
            gimbal=self.gimbal,
            limit=self.rate_limit if rate else None,
            rate_limit=self.acceleration_limit if rate else self.rate_limit,
            command=self.command,
            gain=spring.damping if rate else spring.stiffness,
        )
