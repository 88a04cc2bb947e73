"""A Scenario in the form of the kernel: what it shares with others of its batch, and the numbers of its own."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.faults import FAULT_KINDS, Fault
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.simulation import scenarios as scenario_arrays
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import Layout, Shared, widths_of_metrics
from platform_ctrl.simulation.packing import Packed, Skeleton, numbers, skeleton
from platform_ctrl.simulation.step_limit import check_steps

# Which random numbers an action draws: the upper digits of its channel.
_STREAM = {arrays.PICKOFF_DROPOUT: 3, arrays.OVERRUN: 4}


class ControllerRows(NamedTuple):
    """All controllers as one state space in the form of rows without zeros: next states, torques, rates of drives.

    `others` are the bounds of the rows of next states and torques at samples at which not all of them are computed, and
    `cycle` says of each sample until they repeat which of these counts, −1 for `first`.
    """

    states: int
    first: NDArray[np.int64]
    column: NDArray[np.int64]
    number: FloatArray
    others: NDArray[np.int64]
    cycle: tuple[int, ...]


class Timing(NamedTuple):
    """How a period is cut into substeps."""

    samples: int
    whole: int
    substeps: tuple[int, int]
    steps: tuple[float, float]


class PreparedRun(NamedTuple):
    """A scenario that was checked, and `key`: only scenarios of equal keys are computed side by side."""

    scenario: Scenario
    skeleton: Skeleton
    timing: Timing
    faults: dict[scenario_arrays.FaultKey, Fault]
    key: tuple[object, ...]


def controller_rows(by_sample: Sequence[System], rates: FloatArray) -> ControllerRows:
    """Return discrete state spaces, and the weights (drives, inputs) in the rates of drives, in the kernel's form.

    There is one of every sample until they repeat; those that are one object are stored once.
    """
    kinds = list({id(one): one for one in by_sample}.values())
    states = len(kinds[0].A)
    none, parts = np.zeros((len(rates), states)), []
    for k, (A, B, C, D, _) in enumerate(kinds):
        rows = np.block([[A, B], [C, D]] + ([] if k else [[none, rates]]))
        row, column = np.nonzero(rows)
        parts.append((np.searchsorted(row, np.arange(len(rows) + 1)), column, rows[row, column]))
    # What `first` bounds comes last: the kernel finds the commands of the samples behind it.
    (first, *others), columns, numbers = zip(*parts, strict=True)
    ends = np.cumsum([0, *(len(one) for one in columns[1:])])
    order = [*range(1, len(kinds)), 0]
    width = states + len(kinds[0].C) + 1
    place = {id(one): k - 1 for k, one in enumerate(kinds)}
    return ControllerRows(
        states,
        (first + ends[-1]).astype(np.int64),
        np.concatenate([columns[k] for k in order]).astype(np.int64),
        np.ascontiguousarray(np.concatenate([numbers[k] for k in order])),
        np.array([one + end for one, end in zip(others, ends, strict=False)], dtype=np.int64).reshape(
            len(others), width
        ),
        tuple(place[id(one)] for one in by_sample),
    )


def timing(duration: float, period: float, delay: float, longest: float) -> Timing:
    """Cut periods into substeps on whose grid the samples lie and the instants when commands take effect."""
    samples = 1 + math.floor(duration / period + 1e-9)
    # A delay that is a whole number of periods up to rounding leaves no first segment.
    whole = math.floor(delay / period + 1e-9)
    first = delay - whole * period
    first = 0.0 if first < 1e-9 * period else first
    lengths = (first, period - first)
    before, after = (max(math.ceil(length / longest - 1e-9), int(length > 0.0)) for length in lengths)
    return Timing(samples, whole, (before, after), (first / before if before else 0.0, lengths[1] / after))


def prepared_run(scenario: Scenario, period: float, longest: float) -> PreparedRun:
    """Check a scenario, but for the length of its steps, which is checked for a batch at a time."""
    scenario_arrays.expect_scenario(scenario, period)
    platform, free = scenario.platform, scenario.mode == "stabilised"
    when = timing(scenario.duration, period, scenario.delay, min(longest, scenario.longest_step))
    shape = skeleton(platform)
    faults: dict[scenario_arrays.FaultKey, Fault] = {}
    for fault in scenario.faults:
        action, part = arrays.ACTIONS[FAULT_KINDS[fault.kind].action], fault.part or ""
        again = sum(key[:2] == (action, part) for key in faults)
        faults[action, part, again] = fault
    table = scenario.torque_table if free else scenario.Omega_table
    key = (
        free,
        (when.samples, when.whole, when.substeps),
        shape,
        tuple(torquer.limit is None for torquer in platform.torquers),
        scenario.profile is not None,
        scenario.fade > 0.0,
        None if table is None else (table.t.tobytes(), table.values.tobytes(), table.smooth),
        tuple((v.kind, v.axis, v.gimbal, v.lines, v.frequencies_hz.tobytes()) for v in scenario.vibrations),
        tuple((sine.kind, sine.axis, sine.gimbal) for sine in scenario.sines),
        tuple((gimbal, course.tobytes()) for gimbal, course in scenario.gimbal_torques),
        tuple(dataclasses.astuple(command) for command in scenario.commands),
        tuple(sorted(scenario.filters.items())),
        tuple((one.torquer, tuple(one.weights.items())) for one in scenario.drives),
        (*_resolving(scenario), *scenario.units),
    )
    return PreparedRun(scenario, shape, when, faults, key)


class Batch(NamedTuple):
    """Scenarios of equal keys, for the kernel: `given` (N, slots) of each, and their rows of the plant's constants."""

    packed: Packed
    shared: Shared
    layout: Layout
    free: bool
    plants: FloatArray
    given: FloatArray
    keys: NDArray[np.uint64]


def batch(members: Sequence[PreparedRun], controller: ControllerRows, period: float, noise: bool) -> Batch:
    """Put scenarios of equal keys together."""
    one = members[0]
    shape, free = one.skeleton, one.scenario.mode == "stabilised"
    scenarios = [member.scenario for member in members]
    plants = scenario_arrays.distinct_plants(scenarios)
    lengths = np.array([member.timing.steps for member in members])
    longest = np.zeros(len(plants.made))
    np.maximum.at(longest, plants.which, lengths.max(axis=1))
    check_steps(plants.made, longest, free)
    constants, around = numbers(shape, plants.made)

    order = sorted({key for member in members for key in member.faults})
    shared, rotors = _shared(one, order, members, controller, period, free)
    packed = Packed(shape.links, shape.at._replace(course=len(rotors) > 0), constants[0], around[0])
    layout = _layout(packed, shared, one, controller)
    given = np.zeros((len(members), layout.given - shape.at.end))

    def part(slot: int, count: int, size: int) -> FloatArray:
        begin = slot - shape.at.end
        return given[:, begin : begin + count * size].reshape(len(given), count, size)

    part(layout.start, 1, shape.at.size)[:, 0] = scenario_arrays.states(scenarios, packed)
    steady = part(layout.steady, 1, shape.at.block)[:, 0]
    steady[:] = around[plants.which]
    steady[:, :3] = [scenario.torque for scenario in scenarios]
    part(layout.rate, 1, arrays.PROFILE)[:, 0] = [scenario_arrays.rate(scenario) for scenario in scenarios]
    part(layout.segments, 1, 2)[:, 0] = lengths
    part(layout.settle, 1, 1)[:, 0, 0] = [math.ceil(scenario.settle / period - 1e-9) for scenario in scenarios]
    scenario_arrays.put_sensors(plants, part(layout.sensor, layout.sensors, arrays.SENSOR), period, noise)
    scenario_arrays.put_lowpasses(plants, part(layout.lowpass, _filtered(shared), arrays.LOWPASS), period)
    scenario_arrays.put_torquers(plants, part(layout.torquer, len(shared.targets), arrays.TORQUER), 0.5 * lengths)
    scenario_arrays.put_equilibrium(scenarios, part(layout.torquer, len(shared.targets), arrays.TORQUER))
    scenario_arrays.put_drives(scenarios, part(layout.drive, layout.drives, arrays.DRIVEN))
    scenario_arrays.put_stops(plants, part(layout.stop, shape.at.n, arrays.STOP))
    scenario_arrays.put_faults(
        [member.faults for member in members], order, part(layout.fault, len(order), arrays.FAULT)
    )
    scenario_arrays.put_rotors(shape, plants, rotors, part(layout.rotor, len(rotors), arrays.ROTOR))
    scenario_arrays.put_lines(scenarios, part(layout.line, len(shared.lines), arrays.LINE), 0.5 * lengths)
    keys = np.array([(scenario.seed & (2**64 - 1), scenario.run) for scenario in scenarios], dtype=np.uint64)
    return Batch(packed, shared, layout, free, constants[plants.which], given, keys.reshape(-1, 2))


def _shared(
    one: PreparedRun,
    order: list[scenario_arrays.FaultKey],
    members: Sequence[PreparedRun],
    controller: ControllerRows,
    period: float,
    free: bool,
) -> tuple[Shared, list[int]]:
    platform, scenario, shape = one.scenario.platform, one.scenario, one.skeleton
    rotors = list(dict.fromkeys(key[1] for key in order if key[0] <= arrays.RIPPLE))
    names = [r.name for r in platform.rotors]
    places = [names.index(name) for name in rotors]
    rows = [(shape.carriers[k], shape.servos.index(k) if k in shape.servos else -1) for k in places]
    faults = []
    for key in order:
        action, part, again = key
        fault = next(member.faults[key] for member in members if key in member.faults)
        place = rotors.index(part) if action <= arrays.RIPPLE else scenario_arrays.part_of(platform, fault)
        faults.append((action, place, 64 * place + 8 * _STREAM.get(action, 0) + again))
    lines = [scenario_arrays.component(platform, v) for v in scenario.vibrations for _ in range(v.lines)]
    lines += [len(platform.gimbals) + 6 + scenario_arrays.component(platform, sine) for sine in scenario.sines]
    table = scenario.torque_table if free else scenario.Omega_table
    knots, pieces = np.zeros(0), np.zeros((0, 3, 4))
    if table is not None:
        knots, pieces = np.array(table.t), np.array(table.pieces)
    if scenario.gimbal_torques:
        knots, pieces = _with_gimbals(scenario, knots, pieces)
    sums = (*shape.sensors, *shape.sight)
    terms = [term for one in sums for term in one]
    ends = np.cumsum([len(one) for one in sums], dtype=np.int64)
    bounds = np.stack([np.concatenate([[0], ends])[:-1], ends], axis=1).astype(np.int64)
    readings, torquers = [*scenario.units], [torquer.name for torquer in platform.torquers]
    of_resolvers, numbers_of_resolvers = _resolving(scenario)
    parts = [readings.index(name) for name in scenario_arrays.commanded_readings(scenario)]
    parts += [torquers.index(law.torquer) for law in scenario.drives]
    parts += of_resolvers
    courses = scenario_arrays.courses_of(scenario, period * np.arange(one.timing.samples, dtype=np.float64))
    shared = Shared(
        sensors=np.concatenate([bounds, scenario_arrays.rows_of_sensors(platform, len(bounds), period)], axis=1),
        signals=np.array([signal for signal, _ in terms], dtype=np.int64),
        weights=np.array([*(weight for _, weight in terms), *numbers_of_resolvers], dtype=np.float64),
        targets=np.array(shape.targets, dtype=np.int64),
        faults=np.array(faults, dtype=np.int64).reshape(-1, 3),
        rotors=np.array(rows, dtype=np.int64).reshape(-1, 2),
        lines=np.array(lines, dtype=np.int64),
        first=_bounds(controller, np.array(parts, np.int64)),
        column=controller.column,
        number=np.concatenate([controller.number, courses.ravel()]),
        knots=knots,
        pieces=np.ascontiguousarray(pieces),
        period=period,
    )
    return shared, places


def _with_gimbals(scenario: Scenario, knots: FloatArray, pieces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a time table, which may be empty, with the torques on the gimbals as further columns (k − 1, 3 + n, 4)."""
    every = np.unique(np.concatenate([knots, *(course[:, 0] for _, course in scenario.gimbal_torques)]))
    every = every if len(every) > 1 else np.append(every, every + 1.0)
    out = np.zeros((len(every) - 1, 3 + len(scenario.platform.gimbals), 4))
    if len(knots) > 1:
        from scipy.interpolate import PPoly

        cubic, begin = PPoly(pieces.transpose(2, 0, 1)[::-1], knots), every[:-1]
        inside = (begin >= knots[0]) & (begin < knots[-1])
        for power in range(4):
            found = cubic(np.clip(begin, knots[0], knots[-1]), power) / math.factorial(power)
            out[:, :3, power] = np.where(inside[:, None] | (power == 0), found, 0.0)
    elif len(knots):
        out[:, :3, 0] = pieces[0, :, 0]
    for gimbal, course in scenario.gimbal_torques:
        column, values = 3 + scenario.platform.gimbal(gimbal), np.interp(every, course[:, 0], course[:, 1])
        out[:, column, 0] += values[:-1]
        out[:, column, 1] += np.diff(values) / np.diff(every)
    return every, out


def _resolving(scenario: Scenario) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return what turns readings to joint axes: behind the drives in `Shared.first`, the terms in `Shared.weights`."""
    sensors = [sensor.name for sensor in scenario.platform.sensors]
    parts, numbers = list[int](), list[float]()
    for law in scenario.resolvers:
        parts += [len(law.names), len(law.base), *map(sensors.index, law.base)]
        numbers += [law.least, *law.of_base.T.ravel().tolist()]
        for name, (axis, steps) in zip(law.sensors, law.paths, strict=True):
            parts += [sensors.index(name), len(steps)]
            numbers += axis.tolist()
            for own, column, encoder in steps:
                parts += [column, -1 if encoder < 0 else sensors.index(law.encoders[encoder])]
                numbers += own.tolist()
    return tuple(parts), tuple(numbers)


def _bounds(controller: ControllerRows, parts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return `Shared.first`."""
    if len(controller.cycle) == 1:
        return np.concatenate([controller.first, parts])
    behind, width = len(controller.first) + len(parts), controller.others.shape[1]
    cycle = [0 if k < 0 else behind + k * width for k in controller.cycle]
    return np.concatenate([controller.first, parts, controller.others.ravel(), np.array(cycle, np.int64)])


def _layout(packed: Packed, shared: Shared, one: PreparedRun, controller: ControllerRows) -> Layout:
    at = packed.at
    n, nu, ny, sight = at.n, len(shared.targets), len(one.skeleton.sensors), len(one.skeleton.sight)
    commands, drives = len(scenario_arrays.commanded_readings(one.scenario)), len(one.scenario.drives)
    readings, resolvers = len(one.scenario.units), len(one.scenario.resolvers)
    take = arrays.Slots(at.end)
    return Layout(
        samples=one.timing.samples,
        whole=one.timing.whole,
        before=one.timing.substeps[0],
        after=one.timing.substeps[1],
        states=controller.states,
        cycle=len(controller.cycle),
        stops=one.skeleton.stops,
        profile=one.scenario.profile is not None,
        fade=one.scenario.fade > 0.0,
        sensors=ny,
        readings=readings,
        commands=commands,
        drives=drives,
        resolvers=resolvers,
        start=take(at.size),
        steady=take(at.block),
        rate=take(arrays.PROFILE),
        segments=take(2),
        settle=take(1),
        sensor=take((readings + commands + nu) * arrays.SENSOR),
        lowpass=take(_filtered(shared) * arrays.LOWPASS),
        torquer=take(nu * arrays.TORQUER),
        drive=take(drives * arrays.DRIVEN),
        stop=take(n * arrays.STOP),
        fault=take(len(shared.faults) * arrays.FAULT),
        rotor=take(len(shared.rotors) * arrays.ROTOR),
        line=take(len(shared.lines) * arrays.LINE),
        given=take.end,
        controller=take(2 * controller.states),
        command=take(nu),
        ring=take((one.timing.whole + 2) * nu),
        late=take(int(shared.sensors[:, arrays.LATE].sum())),
        turned=take(arrays.TURNED if resolvers else 0),
        velocity=take(2 * n + 3),
        sight=take(sight),
        turns=take(21 * (n + 1)) if one.skeleton.turned else 0,
        table=take(9),
        pushed=take(3 * n),
        alive=take(1),
        random=take(4 + n),
        begun=take(at.size),
        metrics=take(sum(widths_of_metrics(n, nu, sight))),
        following=take(commands),
        end=take.end,
    )


def _filtered(shared: Shared) -> int:
    return int((shared.sensors[:, arrays.FILTERED] >= 0).sum())
