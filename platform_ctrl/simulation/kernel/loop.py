"""The sampled closed loop around the plant: samples, controllers, and the segments between."""

from __future__ import annotations

import math

from platform_ctrl.common.compiling import compiled, inlined, internal
from platform_ctrl.common.simd import Number, anywhere, choose, load, load_one, slots, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine, within
from platform_ctrl.simulation.kernel.arrays import At, Layout, Links, Shared
from platform_ctrl.simulation.kernel.devices import (
    LOSS,
    PHASE_OF_LINE,
    Keys,
    acts,
    hold_equilibrium,
    new_torque,
    put_torques,
    ready_torquers,
    torquers_fail,
    uniforms,
    within_reach,
    work_on,
)
from platform_ctrl.simulation.kernel.dynamics import derivative, joint_momenta, runge_kutta, start_servos
from platform_ctrl.simulation.kernel.flexible import mode_rates
from platform_ctrl.simulation.kernel.forces import begin_surroundings, follow_rotors, hand_on, servo_motor, surround
from platform_ctrl.simulation.kernel.joints import hold, meet_stops, past_stop, settle_friction, strike
from platform_ctrl.simulation.kernel.samples import judge, look, read, resolve, turn_bodies, update_metrics
from platform_ctrl.simulation.kernel.slots import copy, put_where


@inlined
def _note(record: FloatArray, column: int, mem: FloatArray, slot: int, count: int, apart: int) -> None:
    """Write numbers of the first scenario, `apart` slots from one another, into a row from a column on."""
    for i in range(count):
        record[column + i] = load_one(mem, slot + i * apart, 0)


@inlined
def note_sample(links: Links, shared: Shared, mem: FloatArray, at: At, layout: Layout, record: FloatArray) -> None:
    """A row for the first column: see `batch.recorded`."""
    n, nu, column = at.n, shared.targets.shape[0], 3 * at.n + 7
    _note(record, 0, mem, at.state, n, 1)
    _note(record, n, mem, layout.velocity + 3, n, 1)
    _note(record, 2 * n, mem, layout.velocity, 3, 1)
    _note(record, 2 * n + 3, mem, layout.velocity + n + 3, n, 1)
    _note(record, 3 * n + 3, mem, at.state + 2 * n + 3, 4, 1)
    _note(record, column, mem, layout.sensor + arrays.LAST, layout.readings, arrays.SENSOR)
    column += layout.readings
    _note(record, column, mem, layout.command, nu, 1)
    column += 2 * nu
    # The workspace holds the carriers' rates at this sample.
    for r in range(at.servos):
        spin, wanted = servo_motor(links, mem, at, at.state, r)
        limit = load(mem, at.servo + r * arrays.SERVO + arrays.TORQUE_LIMIT)
        store(mem, layout.random, spin)
        store(mem, layout.random + 1, within(wanted, limit))
        record[column + r] = load_one(mem, layout.random, 0)
        record[column + at.servos + r] = load_one(mem, layout.random + 1, 0)
    column += 2 * at.servos
    _note(record, column, mem, layout.sight, shared.sensors.shape[0] - layout.sensors, 1)


@inlined
def note_torques(shared: Shared, mem: FloatArray, at: At, layout: Layout, record: FloatArray, k: int) -> None:
    """Record the torques that act just after a sample."""
    if record.shape[0] > 0:
        nu = shared.targets.shape[0]
        column = 3 * at.n + 7 + layout.readings + nu
        _note(record[k], column, mem, layout.torquer + arrays.TORQUE, nu, arrays.TORQUER)
        for m in range(at.windings):
            current = load_one(mem, at.state + at.currents + 3 * m, 0)
            record[k, column + nu - at.windings + m] = load_one(mem, at.winding + m * arrays.WINDING, 0) * current


@inlined
def _command(shared: Shared, mem: FloatArray, layout: Layout, row: int) -> None:
    """The commands of a sample, in slots behind those of the sensors."""
    end = layout.states + shared.targets.shape[0] + layout.drives
    zero = 0.0 * load(mem, layout.start)
    for j in range(layout.commands):
        slot = layout.sensor + (layout.readings + j) * arrays.SENSOR
        place = shared.first[end] + 2 * row * layout.commands + j
        store(mem, slot + arrays.PATH, zero + shared.number[place])
        store(mem, slot + arrays.LAST, zero + shared.number[place + layout.commands])


@internal
def _driven(shared: Shared, mem: FloatArray, layout: Layout, torquer: int, total: Number) -> Number:
    """The command of a torquer with what its drive, if it has one, makes of it."""
    row = layout.states + shared.targets.shape[0]
    parts = row + layout.drives + 1 + layout.commands
    for d in range(layout.drives):
        if shared.first[parts + d] != torquer:
            continue
        slot, rate = layout.drive + d * arrays.DRIVEN, 0.0 * total
        for j in range(shared.first[row + d], shared.first[row + d + 1]):
            reading = layout.sensor + (shared.column[j] - layout.states) * arrays.SENSOR + arrays.LAST
            rate = rate + shared.number[j] * load(mem, reading)
        share = within(rate * load(mem, slot + arrays.PER_DRIVE_RATE), 0.0 * total + 1.0)
        total = total + load(mem, slot + arrays.DRIVE_FRICTION) * share
    return total


@internal
def _control(shared: Shared, keys: Keys, mem: FloatArray, at: At, layout: Layout, k: int, t: float) -> None:
    """The controllers' commands from the readings, and their next states; a missed sample leaves both as they were."""
    nx, nu = layout.states, shared.targets.shape[0]
    zero = 0.0 * load(mem, at.state)
    missed = zero
    for f in range(shared.faults.shape[0]):
        if shared.faults[f, 0] == arrays.OVERRUN:
            fault = layout.fault + f * arrays.FAULT
            uniforms(keys, mem, k, LOSS + shared.faults[f, 2], layout.random + 2)
            late = acts(mem, fault, t) & (load(mem, layout.random + 2) < load(mem, fault + arrays.FIRST))
            missed = choose(late, zero + 1.0, missed)
    lost = missed > 0.5
    rows = 0
    if layout.cycle > 1:
        rows = shared.first[shared.first.shape[0] - layout.cycle + k % layout.cycle]
    for turn in range(nx + nu):
        # Torques first: their excesses over the limits act on the states.
        row = turn + nx if turn < nu else turn - nu
        total = zero
        for j in range(shared.first[rows + row], shared.first[rows + row + 1]):
            column = shared.column[j]
            slot = (
                layout.controller + column
                if column < nx
                else layout.sensor + (column - nx) * arrays.SENSOR + arrays.LAST
            )
            total = total + shared.number[j] * load(mem, slot)
        if row < nx:
            store(mem, layout.controller + nx + row, choose(lost, load(mem, layout.controller + row), total))
        else:
            excess = layout.sensor + (layout.readings + layout.commands + row - nx) * arrays.SENSOR + arrays.LAST
            store(mem, excess, within_reach(shared, mem, layout, row - nx, total) - total)
            if layout.drives > 0:
                total = _driven(shared, mem, layout, row - nx, total)
            total = total + load(mem, layout.torquer + (row - nx) * arrays.TORQUER + arrays.EQUILIBRIUM)
            put_where(mem, layout.command + row - nx, ~lost, total)
    copy(mem, layout.controller, layout.controller + nx, nx)


@inlined
def _survey(links: Links, mem: FloatArray, at: At, layout: Layout, free: bool) -> None:
    """Rates at a sample into VELOCITY, joint momenta behind them."""
    n = at.n
    v = layout.velocity
    if free:
        joint_momenta(links, mem, at, at.surroundings + 2 * at.block, v + n + 3)
        copy(mem, v, at.state + n, n + 3)
    else:
        for i in range(3):
            rate = load(mem, at.surroundings + 2 * at.block + n + 3 + i)
            store(mem, at.state + n + i, rate)
            store(mem, v + i, rate)
        derivative(links, mem, at, free, at.no, at.no, at.state, at.surroundings + 2 * at.block, at.stages)
        for i in range(n):
            store(mem, v + 3 + i, load(mem, at.stages + i))
            store(mem, v + n + 3 + i, load(mem, at.state + n + 3 + i))
    if at.modes != 0:
        mode_rates(mem, at, at.state, v + 3)


@internal
def _segment(
    links: Links,
    shared: Shared,
    mem: FloatArray,
    at: At,
    layout: Layout,
    free: bool,
    segment: int,
    count: int,
    source: int,
    start: Number,
    contact: bool,
) -> bool:
    """Integrate over one segment of a period; return whether any gimbal lies on a stop at its end."""
    step = load(mem, layout.segments + segment)
    nu = shared.targets.shape[0]
    contacts = layout.metrics + at.n + 3 + 2 * nu
    failing = torquers_fail(shared)
    for m in range(count):
        if failing and m > 0:
            new_torque(shared, mem, layout, segment, source, start + m * step)
        hand_on(shared, mem, at, layout, free)
        if at.course != 0:
            follow_rotors(shared, mem, at, layout, start + (m + 1.0) * step, step)
        for row in range(3):
            if row > 0:
                work_on(shared, mem, layout, segment)
                surround(shared, mem, at, layout, free, row, segment, at.yes, start + (m + 0.5 * row) * step)
            put_torques(shared, mem, at, layout, row)
        if contact:
            copy(mem, layout.begun, at.state, at.size)
        runge_kutta(links, mem, at, free, at.no, step)
        if layout.stops != 0:
            held = at.no
            if contact:
                held = hold(links, mem, at, layout, free, layout.begun, step)
            past = contact
            if not past:
                for k in range(at.n):
                    past = past or anywhere(past_stop(mem, at, layout, k))
            if past:
                end = start + (m + 1.0) * step
                contact = meet_stops(links, mem, at, layout, free, held, contacts, end, step)
        if at.keeps != 0:
            settle_friction(links, mem, at, free, step)
    return contact


@internal
def _begin(links: Links, shared: Shared, keys: Keys, mem: FloatArray, at: At, layout: Layout, free: bool) -> None:
    """Put the scenarios of the memory at t = 0."""
    n, zero = at.n, 0.0 * load(mem, layout.start)
    for i in range(layout.given, layout.end):
        store(mem, i, zero)
    copy(mem, at.state, layout.start, at.size)
    start_servos(links, mem, at)
    copy(mem, layout.start, at.state, at.size)
    store(mem, layout.alive, zero + 1.0)
    ready_torquers(shared, mem, layout)
    hold_equilibrium(shared, mem, at, layout)
    begin_surroundings(shared, mem, at, layout)
    for j in range(shared.lines.shape[0]):
        if shared.lines[j] >= n + 6:
            continue
        uniforms(keys, mem, j, PHASE_OF_LINE + j, layout.random)
        c, s = cosine_and_sine(2.0 * math.pi * load(mem, layout.random))
        store(mem, layout.line + j * arrays.LINE + arrays.PHASE, c)
        store(mem, layout.line + j * arrays.LINE + arrays.PHASE + 1, s)
    for row in range(2, 3):  # the end of the step before the first; no literal: see `At`
        surround(shared, mem, at, layout, free, row, row, at.no, zero)
    if at.course != 0:
        # The moment before the first: a step that leaves everything as it is.
        for _ in range(2):
            follow_rotors(shared, mem, at, layout, zero, zero + 1.0)
            hand_on(shared, mem, at, layout, free)
    if not free:
        end = at.surroundings + 2 * at.block
        copy(mem, at.state + n, end + n + 3, 3)
        joint_momenta(links, mem, at, end, layout.velocity)
        copy(mem, at.state + n + 3, layout.velocity, n)
        copy(mem, layout.start, at.state, at.size)


@inlined
def _sample(
    links: Links,
    shared: Shared,
    keys: Keys,
    mem: FloatArray,
    at: At,
    layout: Layout,
    free: bool,
    k: int,
    record: FloatArray,
) -> bool:
    """Take sample k, note it in the record, and return whether any scenario is still going."""
    nu, t = shared.targets.shape[0], k * shared.period
    strike(links, shared, mem, at, layout, free, k)
    _survey(links, mem, at, layout, free)
    if layout.turns > 0:
        turn_bodies(links, mem, at, layout, k)
    look(shared, mem, at, layout)
    read(shared, keys, mem, at, layout, k, t)
    if layout.resolvers > 0:
        resolve(shared, mem, layout)
    _command(shared, mem, layout, k)
    _control(shared, keys, mem, at, layout, k, t)
    going = judge(mem, at, layout, shared)
    update_metrics(shared, mem, at, layout, k)
    for i in range(nu):
        ring = layout.ring + k % (layout.whole + 2) * nu + i
        store(mem, ring, within_reach(shared, mem, layout, i, load(mem, layout.command + i)))
    if record.shape[0] > 0:
        note_sample(links, shared, mem, at, layout, record[k])
    if going:
        segment = 0 if layout.before > 0 else 1
        start = 0.0 * load(mem, layout.start) + t
        new_torque(shared, mem, layout, segment, k - layout.whole - 1 + segment, start)
        note_torques(shared, mem, at, layout, record, k)
    return going


@internal
def _period(
    links: Links, shared: Shared, mem: FloatArray, at: At, layout: Layout, free: bool, k: int, contact: bool
) -> bool:
    """Go on from sample k to the next; return whether any gimbal lies on a stop then."""
    start = 0.0 * load(mem, layout.start) + k * shared.period
    for segment in range(2):
        count = layout.before if segment == 0 else layout.after
        if count == 0:
            continue
        source = k - layout.whole - 1 + segment
        if segment > 0 and layout.before > 0:
            new_torque(shared, mem, layout, segment, source, start)
        contact = _segment(links, shared, mem, at, layout, free, segment, count, source, start, contact)
        start = start + count * load(mem, layout.segments + segment)
    return contact


@internal
def simulate_samples(
    links: Links, shared: Shared, keys: Keys, mem: FloatArray, at: At, layout: Layout, free: bool, record: FloatArray
) -> None:
    """Simulate the scenarios of the memory; it holds their metrics then.

    At sample k the sensors are read and the controllers evaluated. A period has two segments, before and after the
    command changes: the first holds the command of `whole` + 1 samples ago, the second that of `whole` samples ago.
    """
    _begin(links, shared, keys, mem, at, layout, free)
    contact = at.no  # no literal: see `At`
    for k in range(layout.samples):
        if k > 0:
            contact = _period(links, shared, mem, at, layout, free, k - 1, contact)
        if not _sample(links, shared, keys, mem, at, layout, free, k, record):
            return


@compiled
def simulate_groups(
    links: Links,
    shared: Shared,
    keys: Keys,
    mem: FloatArray,
    at: At,
    layout: Layout,
    free: bool,
    plants: FloatArray,
    given: FloatArray,
    metrics: FloatArray,
    record: FloatArray,
) -> None:
    """Simulate group after group of scenarios in the same memory.

    `keys` (G, LANES, 2); `plants` (G, at.work, LANES) and `given` (G, given, LANES): what the host gives of each;
    `metrics` (G, metrics, LANES): what comes out; `record` (samples, columns), of the first scenario, or no rows.
    """
    for g in range(keys.shape[0]):
        for i in range(plants.shape[1]):
            for j in range(plants.shape[2]):
                mem[i, j] = plants[g, i, j]
        for i in range(given.shape[1]):
            for j in range(given.shape[2]):
                mem[at.end + i, j] = given[g, i, j]
        simulate_samples(links, shared, keys[g], slots(mem), at, layout, free, record)
        for i in range(metrics.shape[1]):
            for j in range(metrics.shape[2]):
                metrics[g, i, j] = mem[layout.metrics + i, j]
