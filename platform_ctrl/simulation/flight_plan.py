"""A Scenario as the kernel wants it: what it shares with others of its batch, and the numbers of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.description import PickOff
from platform_ctrl.frozen import FloatArray
from platform_ctrl.scenario import Fault, FaultKind, Scenario
from platform_ctrl.simulation.attitude import unit_quaternions
from platform_ctrl.simulation.kernel import flight as layout
from platform_ctrl.simulation.kernel.flight import Flight, Shared
from platform_ctrl.simulation.packing import Packed, frames_of, pack
from platform_ctrl.simulation.scenario_checks import expect_scenario, packed_profile, part_of
from platform_ctrl.simulation.servo_rotors import check_step, initial_spins, servo_rotors, with_rotor_states
from platform_ctrl.simulation.step_limit import check_elements

KINDS: tuple[FaultKind, ...] = get_args(FaultKind)

# On one part: what a torquer still gives, what it is stuck at, nothing; what a sensor says too much, what is lost.
_RANK = {
    "torquer weak": 0,
    "torquer stuck": 1,
    "torquer dead": 2,
    "pick-off drift": 0,
    "pick-off dropout": 1,
    "pick-off stuck": 2,
    "pick-off dead": 3,
}

FaultKey = tuple[str, str, int]


class Controller(NamedTuple):
    """All controllers as one state space in the form of rows without zeros: next states, then commands."""

    states: int
    first: NDArray[np.int64]
    column: NDArray[np.int64]
    number: FloatArray


class Timing(NamedTuple):
    """How a period is cut into substeps."""

    samples: int
    whole: int
    substeps: tuple[int, int]
    steps: tuple[float, float]


class Prepared(NamedTuple):
    """A scenario that was judged, and `key`: only scenarios of equal keys fly side by side."""

    scenario: Scenario
    packed: Packed
    timing: Timing
    faults: dict[FaultKey, Fault]
    state: FloatArray
    key: tuple[object, ...]


def controller_rows(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> Controller:
    """Return a discrete state space in the kernel's form."""
    rows = np.block([[A, B], [C, D]])
    row, column = np.nonzero(rows)
    first = np.searchsorted(row, np.arange(len(rows) + 1))
    return Controller(len(A), first.astype(np.int64), column.astype(np.int64), np.ascontiguousarray(rows[row, column]))


def timing(duration: float, period: float, delay: float, longest: float) -> Timing:
    """Cut periods into substeps on whose grid the samples lie and the instants when commands take effect."""
    samples = 1 + math.floor(duration / period + 1e-9)
    # A delay that is a whole number of periods up to rounding leaves no first segment.
    whole = math.floor(delay / period + 1e-9)
    first = delay - whole * period
    first = 0.0 if first < 1e-9 * period else first
    lengths = (first, period - first)
    before, after = (math.ceil(length / longest - 1e-9) for length in lengths)
    return Timing(samples, whole, (before, after), (first / before if before else 0.0, lengths[1] / after))


def prepared(scenario: Scenario, period: float, longest: float) -> Prepared:
    """Judge a scenario.

    Raises
    ------
    ArgumentError
        It is no scenario that can be flown, or the step is too long for the plant.
    """
    expect_scenario(scenario)
    platform, free = scenario.platform, scenario.mode == "stabilised"
    when = timing(scenario.duration, period, scenario.delay, longest)
    check_step(platform, max(when.steps), free)
    check_elements(platform, max(when.steps), free)
    packed = pack(platform)
    state = np.concatenate([scenario.q, scenario.Omega, scenario.rate, unit_quaternions(scenario.attitude, (4,))])
    spins = initial_spins(platform, scenario.spin, (packed.at.servos,))
    if packed.at.servos:
        state = with_rotor_states(packed, state[None], spins[None])[0]
    faults: dict[FaultKey, Fault] = {}
    for fault in scenario.faults:
        part = fault.part or ""
        faults[fault.kind, part, sum(key[:2] == (fault.kind, part) for key in faults)] = fault
    table = scenario.torque_table if free else scenario.Omega_table
    key = (
        free,
        (when.samples, when.whole, when.substeps),
        packed.at,
        tuple(part.tobytes() for part in packed.links),
        tuple((r.name, r.carrier, r.control) for r in platform.rotors),
        tuple(t.name for t in platform.torquers),
        tuple(s.name for s in platform.sensors),
        scenario.profile is not None,
        None if table is None else (table.t.tobytes(), table.values.tobytes(), table.smooth),
        tuple((v.kind, v.axis, v.lines, v.frequencies_hz.tobytes()) for v in scenario.vibrations),
    )
    return Prepared(scenario, packed, when, faults, state, key)


class Batch(NamedTuple):
    """Scenarios of equal keys, for the kernel: `given` (N, slots) of each, and their rows of the plant's constants."""

    packed: Packed
    shared: Shared
    flight: Flight
    free: bool
    plants: FloatArray
    given: FloatArray
    keys: NDArray[np.uint64]


def batch(members: Sequence[Prepared], controller: Controller, period: float, noise: bool) -> Batch:
    """Put scenarios of equal keys together."""
    one = members[0]
    free = one.scenario.mode == "stabilised"
    order = sorted(
        {key for member in members for key in member.faults},
        key=lambda key: (_RANK.get(key[0], 0), KINDS.index(key[0]), key[1], key[2]),
    )
    shared, rotors = _shared(one, order, members, controller, period, free)
    course = len(rotors) > 0
    packed = one.packed._replace(at=one.packed.at._replace(course=course))
    flight = _flight(packed, shared, one, controller)
    given = np.array([_given(member, order, rotors, shared, flight, packed, period, noise) for member in members])
    keys = np.array([(m.scenario.seed & (2**64 - 1), m.scenario.run) for m in members], dtype=np.uint64)
    plants = np.array([member.packed.constants for member in members])
    return Batch(packed, shared, flight, free, plants, given, keys.reshape(-1, 2))


def _shared(
    one: Prepared,
    order: list[FaultKey],
    members: Sequence[Prepared],
    controller: Controller,
    period: float,
    free: bool,
) -> tuple[Shared, list[str]]:
    platform, scenario = one.scenario.platform, one.scenario
    gimbal = platform.gimbal
    sensors = [
        (layout.ANGLE, gimbal(s.gimbal))
        if isinstance(s, PickOff)
        else (layout.ROOT_RATE, s.root_axis - 1)
        if s.root_axis is not None
        else (layout.GIMBAL_RATE, gimbal(str(s.gimbal)))
        for s in platform.sensors
    ]
    targets = [t.root_axis - 1 if t.root_axis is not None else 3 + gimbal(str(t.gimbal)) for t in platform.torquers]
    rotors = list(dict.fromkeys(key[1] for key in order if key[0].startswith(("rotor", "speed"))))
    servos = [r.name for r in servo_rotors(platform)]
    carriers = {r.name: platform.body(r.carrier) for r in platform.rotors}
    rows = [(carriers[name], servos.index(name) if name in servos else -1) for name in rotors]
    faults = []
    for kind, part, again in order:
        index = KINDS.index(kind)
        fault = next(member.faults[kind, part, again] for member in members if (kind, part, again) in member.faults)
        place = rotors.index(part) if index <= layout.RIPPLE else part_of(platform, fault)
        channel = 64 * place + 8 * (index - layout.PICKOFF_DEAD) + again if index >= layout.PICKOFF_DEAD else 0
        faults.append((index, place, channel))
    lines = [(v.axis - 1 if v.kind == "rate" else v.axis + 2) for v in scenario.vibrations for _ in range(v.lines)]
    table = scenario.torque_table if free else scenario.Omega_table
    knots, pieces = np.zeros(0), np.zeros((0, 3, 4))
    if table is not None:
        knots, pieces = np.array(table.t), np.array(table.pieces)
        if len(knots) == 1:
            pieces = np.zeros((1, 3, 4))
            pieces[0, :, 0] = table.values[0]
    shared = Shared(
        sensors=np.array(sensors, dtype=np.int64).reshape(-1, 2),
        targets=np.array(targets, dtype=np.int64),
        faults=np.array(faults, dtype=np.int64).reshape(-1, 3),
        rotors=np.array(rows, dtype=np.int64).reshape(-1, 2),
        lines=np.array(lines, dtype=np.int64),
        first=controller.first,
        column=controller.column,
        number=controller.number,
        knots=knots,
        pieces=np.ascontiguousarray(pieces),
        period=period,
    )
    return shared, rotors


def _flight(packed: Packed, shared: Shared, one: Prepared, controller: Controller) -> Flight:
    at = packed.at
    n, nu, ny = at.n, len(shared.targets), len(shared.sensors)
    place = at.end

    def take(count: int) -> int:
        nonlocal place
        place += count
        return place - count

    return Flight(
        samples=one.timing.samples,
        whole=one.timing.whole,
        before=one.timing.substeps[0],
        after=one.timing.substeps[1],
        states=controller.states,
        stops=any(g.stops is not None for g in one.scenario.platform.gimbals),
        profile=one.scenario.profile is not None,
        start=take(at.size),
        steady=take(at.block),
        rate=take(layout.PROFILE),
        segments=take(2),
        sensor=take(ny * layout.SENSOR),
        torquer=take(nu * layout.TORQUER),
        stop=take(n * layout.STOP),
        fault=take(len(shared.faults) * layout.FAULT),
        rotor=take(len(shared.rotors) * layout.ROTOR),
        line=take(len(shared.lines) * layout.LINE),
        given=place,
        controller=take(2 * controller.states),
        command=take(nu),
        ring=take((one.timing.whole + 2) * nu),
        velocity=take(2 * n + 3),
        table=take(9),
        alive=take(1),
        random=take(4),
        spare_state=take(2 * at.size),
        spare_block=take(at.block),
        figures=take(figure_slots(n, nu)),
        end=place,
    )


def figure_slots(n: int, nu: int) -> int:
    """Return how many figures come out: |q|, |rotation vector|, shares and saturated samples, contacts, samples."""
    return n + 3 + 2 * nu + n + 1


def _given(
    member: Prepared,
    order: list[FaultKey],
    rotors: list[str],
    shared: Shared,
    flight: Flight,
    packed: Packed,
    period: float,
    noise: bool,
) -> FloatArray:
    """What the host gives of one scenario, in the order of `Flight`."""
    scenario, at = member.scenario, packed.at
    platform = scenario.platform
    out = np.zeros(flight.given - at.end)

    def part(first: int, count: int, size: int) -> FloatArray:
        return out[first - at.end : first - at.end + count * size].reshape(count, size)

    out[: at.size] = member.state
    steady = part(flight.steady, 1, at.block)[0]
    steady[:] = member.packed.around
    steady[:3] = scenario.torque
    rate = part(flight.rate, 1, layout.PROFILE)[0]
    if scenario.profile is not None:
        rate[: layout.SCALE] = packed_profile(scenario.profile)
    table = scenario.torque_table if scenario.mode == "stabilised" else scenario.Omega_table
    rate[layout.SCALE] = 1.0 if table is None else table.scale
    half = 0.5 * np.array(member.timing.steps)
    part(flight.segments, 1, 2)[0] = member.timing.steps
    for row, sensor in zip(part(flight.sensor, len(shared.sensors), layout.SENSOR), platform.sensors, strict=True):
        row[layout.RMS] = sensor.sampled_noise(period) if noise else 0.0
        row[layout.QUANTISATION] = sensor.quantisation
    for row, torquer in zip(part(flight.torquer, len(shared.targets), layout.TORQUER), platform.torquers, strict=True):
        row[layout.LIMIT] = math.inf if torquer.limit is None else torquer.limit
        slow = torquer.rate_limit is not None
        row[layout.AT_ONCE] = 0.0 if slow else math.inf
        row[layout.SLEW : layout.SLEW + 2] = half * torquer.rate_limit if torquer.rate_limit is not None else math.inf
        row[layout.DECAY : layout.DECAY + 2] = np.exp(-half / torquer.lag) if torquer.lag > 0.0 else 0.0
    for row, gimbal in zip(part(flight.stop, at.n, layout.STOP), platform.gimbals, strict=True):
        row[:2] = (-math.inf, math.inf) if gimbal.stops is None else gimbal.stops
        row[layout.RESTITUTION] = gimbal.restitution
    for row, key in zip(part(flight.fault, len(order), layout.FAULT), order, strict=True):
        row[: layout.STUCK] = _numbers(member.faults.get(key), key)
    by_name = {r.name: r for r in platform.rotors}
    frames = frames_of(platform) if rotors else np.zeros((0, 3, 3))
    for row, name, (body, servo) in zip(
        part(flight.rotor, len(rotors), layout.ROTOR), rotors, shared.rotors, strict=True
    ):
        rotor = by_name[name]
        row[:3] = (rotor.spin, 0.0, 0.0) if servo >= 0 else rotor.angular_momentum * (frames[body] @ rotor.axis)
    _put_lines(scenario, part(flight.line, len(shared.lines), layout.LINE), half)
    return out


def _numbers(fault: Fault | None, key: FaultKey) -> tuple[float, float, float, float]:
    """Begin, end and the two numbers of a fault; one that does not happen in this run begins never."""
    if fault is None:
        return math.inf, math.inf, 1.0, 1.0
    first, second = {
        "rotor run-down": (fault.share, fault.time_constant),
        "rotor run-up": (fault.share, fault.time_constant),
        "speed ripple": (fault.amplitude, 2.0 * math.pi * fault.frequency_hz),
        "torquer weak": (fault.share, 0.0),
        "pick-off drift": (fault.rate, 0.0),
        "pick-off dropout": (fault.probability, 0.0),
        "controller overrun": (fault.probability, 0.0),
        "stop contact": (fault.impulse, 0.0),
    }.get(fault.kind, (0.0, 0.0))
    return fault.at, fault.until, first, second


def _put_lines(scenario: Scenario, rows: FloatArray, half: FloatArray) -> None:
    """Amplitudes of the vibrations' lines, and how far they turn in half a substep of each segment."""
    place = 0
    for vibration in scenario.vibrations:
        omega, amplitude = vibration.amplitudes
        own = rows[place : place + vibration.lines]
        own[:, layout.AMPLITUDE] = amplitude
        for segment in range(2):
            own[:, layout.TURN + 2 * segment] = np.cos(omega * half[segment])
            own[:, layout.TURN + 2 * segment + 1] = np.sin(omega * half[segment])
        place += vibration.lines
