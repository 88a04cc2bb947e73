"""Checks of a scenario before it is simulated: the kernel trusts every number that it is given."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.arguments import positive, real_array, short, unit_quaternions, whole
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.faults import FAULT_KINDS, Fault, part_names
from platform_ctrl.job.scenario import Command, Scenario, Sine, Vibration
from platform_ctrl.mechanics.forces import resting_forces, specific_force_at
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.sensors import LOWPASS, Sensor
from platform_ctrl.simulation.added_states import initial_spins, servo_rotors, with_added_states
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.packing import Packed, Skeleton

# Limits of memory and time of a run.
_SAMPLES, _PERIODS, _SUBSTEPS = 1e8, 1e3, 1e8
# A command that begins so little after a sample, s, begins there: times are rounded.
_AT_ONCE = 1e-9


def expect_scenario(scenario: object, period: float) -> None:
    """Refuse what is no scenario, or one that cannot be simulated; steps are checked for a batch at a time."""
    if not isinstance(scenario, Scenario):
        raise ArgumentError(f"scenario must be a Scenario, got {short(scenario)}")
    whole("seed", scenario.seed, 0, 2**64 - 1)
    whole("run", scenario.run, 0, 2**64 - 1)
    for name, most in (("duration", _SAMPLES), ("delay", _PERIODS), ("settle", _SAMPLES), ("fade", _SAMPLES)):
        time = positive(name, getattr(scenario, name), zero=True)
        if time > most * period:
            raise ArgumentError(
                f"{name}: {time:.6g} s are {time / period:.3g} periods, more than the {most:.0e} that a run may have"
            )
    _start(scenario)
    _motion(scenario)
    _commands(scenario)
    for fault in scenario.faults:
        part_of(scenario.platform, fault)


def steps(period: float, step: float) -> tuple[float, float]:
    """Return the sample period and the longest substep."""
    period, step = positive("period", period), positive("step", step)
    if period > _SUBSTEPS * step:
        raise ArgumentError(f"step: {step:.3g} s is too short for a period of {period:.3g} s; take a longer one")
    return period, step


def expect_several(name: str, given: object, kind: type | None = None) -> None:
    """Judge an argument that has to be several things: not one of a `kind`."""
    if kind is not None and isinstance(given, kind):
        raise ArgumentError(f"{name} must be a sequence, got one {kind.__name__}")
    if not isinstance(given, Iterable):
        raise ArgumentError(f"{name} must be a sequence, got {short(given)}")
    for one in given if kind is None else ():
        if not hasattr(one, "input_labels"):
            raise ArgumentError(f"{name} must be a sequence, each a control.StateSpace, got {short(one)} among them")


def _start(scenario: Scenario) -> None:
    gimbals = scenario.platform.gimbals
    real_array("q", scenario.q, (len(gimbals),))
    real_array("rate", scenario.rate, (len(gimbals),))
    real_array("Omega", scenario.Omega, (3,))
    if scenario.spin is not None:
        initial_spins(scenario.platform, scenario.spin, (len(servo_rotors(scenario.platform)),))
    if scenario.attitude.shape != (4,):  # its norm is checked for a batch at a time
        unit_quaternions(scenario.attitude, (4,))
    for gimbal, angle in zip(gimbals, scenario.q, strict=True):
        if gimbal.stops is not None and not gimbal.stops[0] <= angle <= gimbal.stops[1]:
            raise ArgumentError(f"q: {gimbal.angle} starts at {angle:.6g} rad, outside its stops {gimbal.stops}")


def _motion(scenario: Scenario) -> None:
    real_array("torque", scenario.torque, (3,))
    if scenario.mode == "stabilised":
        given = {"profile": scenario.profile is not None, "Omega_table": scenario.Omega_table is not None}
        why = "where the root is free; give torque or torque_table"
    else:
        given = {name: bool(getattr(scenario, name).any()) for name in ("torque", "Omega")}
        given["torque_table"] = scenario.torque_table is not None
        why = "where Omega is prescribed; give profile or Omega_table"
    for name, there in given.items():
        if there:
            raise ArgumentError(f"{name}: has no effect in mode {scenario.mode!r}, {why}")
    moving: tuple[Vibration | Sine, ...] = (*scenario.vibrations, *scenario.sines)
    if scenario.mode == "stabilised" and any(vibration.kind == "rate" for vibration in moving):
        raise ArgumentError(
            "vibration: kind 'rate' has no effect in mode 'stabilised', where the root is free; use 'force'"
        )


def commanded_readings(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the readings that are commanded, in the order of `Scenario.units`."""
    commanded = {command.reading for command in scenario.commands}
    return tuple(name for name in scenario.units if name in commanded)


def courses_of(scenario: Scenario, t: FloatArray) -> FloatArray:
    """Return the commands at times t (N,), s, and what controllers get of them: (N, 2, readings).

    A reference filter F = 1/(1 + τ s)² gets 2 r(t + τ) − r(t) of a path r that is known ahead: it makes r of that, but
    for (τ s)³/3 and smaller. Steps go through the filter as they are.
    """
    readings = commanded_readings(scenario)
    out = np.zeros((len(t), 2, len(readings)))
    for command in scenario.commands:
        ahead, now = scenario.filters.get(command.reading, 0.0), _path(command, t)
        sent = 2.0 * _path_ahead(command, t + ahead, scenario.duration) - now if ahead > 0.0 else now
        steps = np.where(t >= command.at - _AT_ONCE, command.step, 0.0)
        out[:, :, readings.index(command.reading)] += np.stack([steps + now, steps + sent], axis=1)
    return out


def _path_ahead(command: Command, t: FloatArray, end: float) -> FloatArray:
    """Return a path at times that may be past the `end` of the run: one whose table ends there goes on as it came."""
    if not command.t or command.t[-1] < end - _AT_ONCE:
        return _path(command, t)
    turned = 2.0 * _path(command, np.full_like(t, end)) - _path(command, 2.0 * end - t)
    return np.where(t > end, turned, _path(command, t))


def _path(command: Command, t: FloatArray) -> FloatArray:
    """Return what is continuous of a command: ramp, sine and table."""
    out = np.where(t >= command.at - _AT_ONCE, command.ramp * (t - command.at), 0.0)
    out += command.amplitude * np.sin(2.0 * math.pi * command.frequency_hz * t + command.phase)
    if command.smooth:
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(command.t, command.value, bc_type="natural")
        out += spline(np.clip(t, command.t[0], command.t[-1]))
    elif command.t:
        out += np.interp(t, command.t, command.value)
    return out


def _commands(scenario: Scenario) -> None:
    known = scenario.units
    for command in scenario.commands:
        if command.reading not in known:
            raise ArgumentError(f"commands: there is no sensor {command.reading!r}, only {', '.join(known) or 'none'}")


def put_drives(scenarios: Sequence[Scenario], rows: FloatArray) -> None:
    """Friction that is fed forward, and 1 over the rate from which on it acts."""
    if rows.size:
        rows[:] = [[(one.friction, 1.0 / one.friction_rate) for one in s.drives] for s in scenarios]


def part_of(platform: Platform, fault: Fault) -> int:
    """Return the index of the part that a fault happens to; 0 where it is of all controllers."""
    kind = FAULT_KINDS[fault.kind].part
    if kind is None:
        return 0
    names = part_names(platform, kind)
    if fault.part not in names:
        what = "sensor" if kind == "pick-off" else kind
        raise ArgumentError(
            f"fault {fault.name!r}: there is no {what} {fault.part!r}, only {', '.join(names) or 'none'}"
        )
    return names.index(fault.part)


# Action of the kernel, part, and which fault of these it is.
FaultKey = tuple[int, str, int]


class Plants(NamedTuple):
    """The plants of N scenarios, each once, and `which` of them each scenario simulates on, (N,)."""

    made: list[Platform]
    which: NDArray[np.intp]

    def rows(self, numbers: Callable[[Platform], object]) -> FloatArray:
        """Return numbers of the plant of each scenario, (N, ...)."""
        return np.array([numbers(platform) for platform in self.made], dtype=np.float64)[self.which]


def distinct_plants(scenarios: Sequence[Scenario]) -> Plants:
    """Return the plants of scenarios: a plant that several of them share is packed once."""
    places: dict[int, int] = {}
    made: list[Platform] = []
    which = np.empty(len(scenarios), dtype=np.intp)
    for k, scenario in enumerate(scenarios):
        which[k] = places.setdefault(id(scenario.platform), len(made))
        if which[k] == len(made):
            made.append(scenario.platform)
    return Plants(made, which)


def states(scenarios: Sequence[Scenario], packed: Packed) -> FloatArray:
    """States at t = 0, (N, size), v holding the rates."""
    attitudes = unit_quaternions([s.attitude for s in scenarios], (len(scenarios), 4))
    rows = [np.array([getattr(s, name) for s in scenarios]) for name in ("q", "Omega", "rate")]
    states = np.concatenate([*rows, attitudes], axis=1)
    spins = [[r.spin for r in servo_rotors(s.platform)] if s.spin is None else s.spin for s in scenarios]
    return with_added_states(packed, states, np.array(spins).reshape(len(states), packed.at.servos))


def rate(scenario: Scenario) -> list[float]:
    """The half-cosine's rate vector, its rise and hold; the scale of the time table; the time over which lines rise."""
    row = [0.0] * arrays.PROFILE
    if scenario.profile is not None:
        row[scenario.profile.axis - 1] = scenario.profile.rate
        row[arrays.RISE], row[arrays.HOLD] = scenario.profile.rise, scenario.profile.hold
    table = scenario.torque_table if scenario.mode == "stabilised" else scenario.Omega_table
    row[arrays.SCALE] = 1.0 if table is None else table.scale
    row[arrays.FADE] = scenario.fade
    return row


def put_sensors(plants: Plants, rows: FloatArray, period: float, noise: bool) -> None:
    """Noise of a reading, quantisation, and errors of scale and zero."""

    def numbers(sensor: Sensor) -> tuple[float, ...]:
        rms = sensor.sampled_noise(period * samples_apart(sensor, period)) if noise else 0.0
        return rms, sensor.quantisation, 1.0 + sensor.scale_error, sensor.bias

    if rows.size:
        rows[:, :, : arrays.LAST] = plants.rows(lambda p: [numbers(sensor) for sensor in p.sensors])


def put_lowpasses(plants: Plants, rows: FloatArray, period: float) -> None:
    """What the sensors' low-passes do from sample to sample, their input running straight between (ramp-invariant)."""
    known: dict[float, FloatArray] = {}
    for k, platform in enumerate(plants.made):
        bands = [sensor.bandwidth_hz for sensor in platform.sensors if sensor.bandwidth_hz is not None]
        for j, band in enumerate(bands):
            if band not in known:
                known[band] = _lowpass(2.0 * math.pi * band * period)
            rows[plants.which == k, j, : arrays.INPUT] = known[band]


def _lowpass(angle: float) -> FloatArray:
    """Transition (2, 2), and effect of the input before and now (2 each), over a sample of `angle` = w period."""
    from scipy.linalg import expm

    # With the states go u and its change over the sample.
    A = np.zeros((4, 4))
    A[:2, :2], A[1, 2], A[2, 3] = angle * LOWPASS, angle, 1.0
    step = expm(A)
    before, now = step[:2, 2] - step[:2, 3], step[:2, 3]
    return np.concatenate([step[:2, :2].ravel(), before, now])


def rows_of_sensors(platform: Platform, size: int, period: float) -> NDArray[np.int64]:
    """Row of the low-pass, samples late and where they are kept, samples from reading to reading: (size, 4)."""
    rows = np.tile(np.array([-1, 0, 0, 1], dtype=np.int64), (size, 1))
    filtered = kept = 0
    for row, sensor in zip(rows, platform.sensors, strict=False):
        late = math.ceil(sensor.delay / period - 1e-9)  # `periods_late` has half the time that it is held, besides
        if late > _PERIODS:
            raise ArgumentError(
                f"sensor {sensor.name!r}: a delay of {sensor.delay:.6g} s is {late} sample periods, more than the "
                f"{_PERIODS:.0e} that a run may have; give a shorter one"
            )
        row[:] = filtered if sensor.bandwidth_hz is not None else -1, late, kept, samples_apart(sensor, period)
        filtered, kept = filtered + (sensor.bandwidth_hz is not None), kept + late
    return rows


def samples_apart(sensor: Sensor, period: float) -> int:
    """Return the number of samples from one reading of a sensor to the next."""
    if sensor.rate_hz is None:
        return 1
    exact = 1.0 / (sensor.rate_hz * period)
    if exact > _SAMPLES:
        raise ArgumentError(
            f"sensor {sensor.name!r}: a reading every {1.0 / sensor.rate_hz:.6g} s is one in {exact:.3g} samples, more "
            f"than the {_SAMPLES:.0e} that a run may have; give a higher rate_hz"
        )
    whole_number = max(round(exact), 1)
    if abs(exact / whole_number - 1.0) > 1e-6:
        raise ArgumentError(
            f"sensor {sensor.name!r}: a reading every {1e3 / sensor.rate_hz:.6g} ms is not a whole number of sample "
            f"periods of {1e3 * period:.6g} ms; give rate_hz = {1.0 / (whole_number * period):.6g}"
        )
    return whole_number


def put_torquers(plants: Plants, rows: FloatArray, half: FloatArray) -> None:
    """Limits, and how torques follow in half a substep of each segment, `half` (N, 2)."""
    if rows.size == 0:
        return
    # Where there is no limit it is None, as a number NaN.
    limits = plants.rows(lambda p: [(t.limit, t.rate_limit, t.stall, t.lag, t.back_emf, t.gain) for t in p.torquers])
    limit, slew, stall, lag, back_emf, gain = np.where(np.isnan(limits), math.inf, limits).transpose(2, 0, 1)
    rows[:, :, arrays.LIMIT], rows[:, :, arrays.STALL], rows[:, :, arrays.BACK_EMF] = limit, stall, back_emf
    rows[:, :, arrays.PER_COMMAND] = gain
    rows[:, :, arrays.AT_ONCE] = np.where(np.isinf(slew), math.inf, 0.0)
    for segment in range(2):
        step = half[:, segment, None]
        # No limit stays none over a segment of no length.
        with np.errstate(invalid="ignore"):
            rows[:, :, arrays.SLEW + segment] = np.where(np.isinf(slew), math.inf, step * slew)
        lagging = np.where(lag > 0.0, lag, 1.0)
        rows[:, :, arrays.DECAY + segment] = np.where(lag > 0.0, np.exp(-step / lagging), 0.0)


def put_equilibrium(scenarios: Sequence[Scenario], rows: FloatArray) -> None:
    """Constant torques of scenarios that start in equilibrium."""
    for row, scenario in zip(rows, scenarios, strict=True):
        if scenario.start == "equilibrium":
            gains = [torquer.gain for torquer in scenario.platform.torquers]
            row[:, arrays.EQUILIBRIUM] = equilibrium_torques(scenario) / gains


def equilibrium_torques(scenario: Scenario) -> FloatArray:
    """Return the torque of each torquer, N m, that holds force elements and weight at the initial angles, root at rest.

    The first torquer of a gimbal or root axis has it; a gimbal that none turns has to be in equilibrium by itself.
    """
    platform = scenario.platform
    f = specific_force_at(platform, attitude=scenario.attitude)
    forces = resting_forces(platform, scenario.q, f)
    free = 0 if scenario.mode == "stabilised" else 3
    forces[:free] = 0.0
    out = np.zeros(len(platform.torquers))
    for k, place in enumerate(platform.targets):
        out[k], forces[place] = -forces[place], 0.0
    scale = float(np.abs(out).max(initial=0.0))
    for place in np.flatnonzero(np.abs(forces) > 1e-9 * max(scale, 1e-9)).tolist():
        what = f"root axis {place + 1}" if place < 3 else f"gimbal {platform.gimbal_names[place - 3]!r}"
        words = f"{what} is not in equilibrium, {forces[place]:.3g} N m act on it and no torquer turns it"
        raise ArgumentError(f"start: {words}; give it a torquer, balance it or start at rest")
    return out


def put_stops(plants: Plants, rows: FloatArray) -> None:
    """Where the stops are, and what they give back."""
    if rows.size:
        ends = plants.rows(lambda p: [(*(g.stops or (-math.inf, math.inf)), g.restitution) for g in p.gimbals])
        rows[:, :, arrays.LOW], rows[:, :, arrays.HIGH], rows[:, :, arrays.RESTITUTION] = ends.transpose(2, 0, 1)


def put_faults(happening: Sequence[dict[FaultKey, Fault]], order: Sequence[FaultKey], rows: FloatArray) -> None:
    """Begin, end and numbers of what happens to each scenario; `order` are the columns."""
    rows[:, :, : arrays.STUCK] = math.inf, math.inf, 1.0, 1.0  # what does not happen in a run begins never
    column = {key: k for k, key in enumerate(order)}
    for row, faults in zip(rows, happening, strict=True):
        for key, fault in faults.items():
            row[column[key], : arrays.STUCK] = fault.at, fault.until, *fault.numbers


def put_rotors(shape: Skeleton, plants: Plants, rotors: Sequence[int], rows: FloatArray) -> None:
    """L s of rotors that fail, in the kernel's axes; the nominal spin of servo rotors."""
    found = plants.rows(lambda p: [(p.rotors[k].spin, p.rotors[k].angular_momentum) for k in rotors])
    for j, k in enumerate(rotors):
        if k in shape.servos:
            rows[:, j, 0] = found[:, j, 0]
        else:
            rows[:, j, :3] = found[:, j, 1, None] * (shape.frames[shape.carriers[k]] @ shape.spin_axes[k])


def put_lines(scenarios: Sequence[Scenario], rows: FloatArray, half: FloatArray) -> None:
    """Amplitudes of the vibrations' lines, and how far they turn in half a substep of each segment."""
    place, omega = 0, np.zeros(rows.shape[:2])
    for k, vibration in enumerate(scenarios[0].vibrations):
        own = [scenario.vibrations[k] for scenario in scenarios]
        found = {key: one.amplitudes for key, one in {id(one): one for one in own}.items()}
        lines = slice(place, place + vibration.lines)
        omega[:, lines] = found[id(vibration)][0]
        rows[:, lines, arrays.AMPLITUDE] = [found[id(one)][1] for one in own]
        place += vibration.lines
    for j in range(place, rows.shape[1]):
        sines = [scenario.sines[j - place] for scenario in scenarios]
        rows[:, j, arrays.AMPLITUDE] = [sine.amplitude for sine in sines]
        # a sin x = a cos(x - pi/2)
        phase = np.array([sine.phase for sine in sines])
        rows[:, j, arrays.PHASE], rows[:, j, arrays.PHASE + 1] = np.sin(phase), -np.cos(phase)
        omega[:, j] = [2.0 * math.pi * sine.frequency_hz for sine in sines]
    for segment in range(2):
        turn, first = omega * half[:, segment, None], arrays.TURN + 2 * segment
        rows[:, :, first], rows[:, :, first + 1] = np.cos(turn), np.sin(turn)


def component(platform: Platform, vibration: Vibration | Sine) -> int:
    """Return what a vibration adds to: 0 to 2: Omega, 3 to 5: the specific force, 6 + k: the torque on gimbal k."""
    if vibration.gimbal is not None:
        return 6 + platform.gimbal(vibration.gimbal)
    axis = vibration.axis or 1
    return axis - 1 if vibration.kind == "rate" else axis + 2
