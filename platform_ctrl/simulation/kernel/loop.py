"""The sampled closed loop around the plant: sensors, controllers, torquers, what fails, what is recorded."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import (
    Mask,
    Number,
    anywhere,
    apart,
    choose,
    compiled,
    greater,
    inlined,
    internal,
    lesser,
    load,
    root,
    store,
    whole,
)
from platform_ctrl.simulation.kernel.body import GAIN, INTEGRAL, RATE, SERVO, SPIN, TORQUE_LIMIT, WORK, At, C, Links
from platform_ctrl.simulation.kernel.dynamics import derivative, joint_momenta, runge_kutta
from platform_ctrl.simulation.kernel.flight import (
    ANGLE,
    AT_ONCE,
    BEGIN,
    DECAY,
    FAULT,
    FIRST,
    GIMBAL_RATE,
    HELD,
    LAST,
    LIMIT,
    LINE,
    OVERRUN,
    PHASE,
    PICKOFF_DEAD,
    PICKOFF_DRIFT,
    PICKOFF_DROPOUT,
    PICKOFF_STUCK,
    QUANTISATION,
    RMS,
    SENSOR,
    SLEW,
    SLEWED,
    STOP,
    STUCK,
    TORQUE,
    TORQUER,
    TORQUER_DEAD,
    TORQUER_WEAK,
    UNTIL,
    Flight,
    Shared,
)
from platform_ctrl.simulation.kernel.functions import cosine_and_sine
from platform_ctrl.simulation.kernel.noise import LOSS, PHASE_OF_LINE, PICKOFF, normals, uniforms
from platform_ctrl.simulation.kernel.stops import hold, meet_stops, strike
from platform_ctrl.simulation.kernel.surroundings import begin_surroundings, follow_rotors, hand_on, surround

Keys = NDArray[np.uint64]


@inlined
def _on(mem: FloatArray, lane: int, slot: int, t: float) -> Mask:
    return (load(mem, slot + BEGIN, lane) <= t) & (load(mem, slot + UNTIL, lane) > t)


@internal
def _read(shared: Shared, keys: Keys, mem: FloatArray, lane: int, at: At, flight: Flight, k: int, t: float) -> None:
    """Put what every sensor says at sample k into its LAST."""
    for i in range(shared.sensors.shape[0]):
        slot, kind, index = flight.sensor + i * SENSOR, shared.sensors[i, 0], shared.sensors[i, 1]
        if kind == ANGLE:
            value = load(mem, at.state + index, lane)
        elif kind == GIMBAL_RATE:
            value = load(mem, flight.velocity + 3 + index, lane)
        else:
            value = load(mem, flight.velocity + index, lane)
        rms = load(mem, slot + RMS, lane)
        if anywhere(rms > 0.0):
            if i % 2 == 0 or not anywhere(load(mem, slot - SENSOR + RMS, lane) > 0.0):
                normals(keys, mem, lane, k, PICKOFF + i // 2, flight.random)
            value = value + rms * load(mem, flight.random + i % 2, lane)
        for f in range(shared.faults.shape[0]):
            if shared.faults[f, 0] == PICKOFF_DRIFT and shared.faults[f, 1] == i:
                fault = flight.fault + f * FAULT
                drift = load(mem, fault + FIRST, lane) * (t - load(mem, fault + BEGIN, lane))
                value = choose(_on(mem, lane, fault, t), value + drift, value)
        step = load(mem, slot + QUANTISATION, lane)
        fine = step > 0.0
        unit = choose(fine, step, 0.0 * step + 1.0)
        value = choose(fine, unit * whole(value / unit + 0.5), value)
        for f in range(shared.faults.shape[0]):
            failing = shared.faults[f, 0]
            if failing < PICKOFF_DEAD or failing > PICKOFF_DROPOUT or shared.faults[f, 1] != i:
                continue
            fault = flight.fault + f * FAULT
            on = _on(mem, lane, fault, t)
            if failing == PICKOFF_DEAD:
                value = choose(on, 0.0 * value, value)
            elif failing == PICKOFF_STUCK:
                value = choose(on, load(mem, slot + LAST, lane), value)
            elif failing == PICKOFF_DROPOUT:
                uniforms(keys, mem, lane, k, LOSS + shared.faults[f, 2], flight.random + 2)
                lost = on & (load(mem, flight.random + 2, lane) < load(mem, fault + FIRST, lane))
                value = choose(lost, load(mem, slot + LAST, lane), value)
        store(mem, slot + LAST, lane, value)


@internal
def _control(shared: Shared, keys: Keys, mem: FloatArray, lane: int, at: At, flight: Flight, k: int, t: float) -> None:
    """The controllers' commands from the readings, and their next states; a missed sample leaves both as they were."""
    nx, nu = flight.states, shared.targets.shape[0]
    zero = 0.0 * load(mem, at.state, lane)
    missed = zero
    for f in range(shared.faults.shape[0]):
        if shared.faults[f, 0] == OVERRUN:
            fault = flight.fault + f * FAULT
            uniforms(keys, mem, lane, k, LOSS + shared.faults[f, 2], flight.random + 2)
            late = _on(mem, lane, fault, t) & (load(mem, flight.random + 2, lane) < load(mem, fault + FIRST, lane))
            missed = choose(late, zero + 1.0, missed)
    lost = missed > 0.5
    for row in range(nx + nu):
        total = zero
        for j in range(shared.first[row], shared.first[row + 1]):
            column = shared.column[j]
            slot = flight.controller + column if column < nx else flight.sensor + (column - nx) * SENSOR + LAST
            total = total + shared.number[j] * load(mem, slot, lane)
        if row < nx:
            store(
                mem, flight.controller + nx + row, lane, choose(lost, load(mem, flight.controller + row, lane), total)
            )
        else:
            command = flight.command + row - nx
            store(mem, command, lane, choose(lost, load(mem, command, lane), total))
    for i in range(nx):
        store(mem, flight.controller + i, lane, load(mem, flight.controller + nx + i, lane))


@internal
def _new_torque(
    shared: Shared, mem: FloatArray, lane: int, flight: Flight, segment: int, source: int, t: Number
) -> None:
    """What the torquers work towards in a segment: the limited command of sample `source`, and what fails of it."""
    nu = shared.targets.shape[0]
    for i in range(nu):
        slot = flight.torquer + i * TORQUER
        held = 0.0 * t
        if source >= 0:
            held = load(mem, flight.ring + source % (flight.whole + 2) * nu + i, lane)
        for f in range(shared.faults.shape[0]):
            kind = shared.faults[f, 0]
            if kind < TORQUER_DEAD or kind > TORQUER_WEAK or shared.faults[f, 1] != i:
                continue
            fault = flight.fault + f * FAULT
            on = (load(mem, fault + BEGIN, lane) <= t) & (load(mem, fault + UNTIL, lane) > t)
            if kind == TORQUER_DEAD:
                held = choose(on, 0.0 * held, held)
            elif kind == TORQUER_WEAK:
                held = choose(on, load(mem, fault + FIRST, lane) * held, held)
            else:
                stuck = choose(on, load(mem, fault + STUCK, lane), load(mem, slot + TORQUE, lane))
                store(mem, fault + STUCK, lane, stuck)
                held = choose(on, stuck, held)
        store(mem, slot + HELD, lane, held)
        slewed, at_once = load(mem, slot + SLEWED, lane), load(mem, slot + AT_ONCE, lane)
        slewed = slewed + lesser(greater(held - slewed, -at_once), at_once)
        store(mem, slot + SLEWED, lane, slewed)
        lagging = load(mem, slot + DECAY + segment, lane) > 0.0
        store(mem, slot + TORQUE, lane, choose(lagging, load(mem, slot + TORQUE, lane), slewed))


@inlined
def _torques(shared: Shared, mem: FloatArray, lane: int, at: At, flight: Flight, row: int) -> None:
    """Put [M, Q] into block `row`."""
    T = at.surroundings + row * at.block
    for i in range(3):
        store(mem, T + i, lane, load(mem, flight.table + 3 * row + i, lane))
    for i in range(3, at.n + 3):
        store(mem, T + i, lane, load(mem, flight.steady + i, lane))
    for i in range(shared.targets.shape[0]):
        target = T + shared.targets[i]
        torque = load(mem, flight.torquer + i * TORQUER + TORQUE, lane)
        store(mem, target, lane, load(mem, target, lane) + torque)


@inlined
def _work_on(shared: Shared, mem: FloatArray, lane: int, flight: Flight, segment: int) -> None:
    """Let the torquers go on by half a substep of the segment."""
    for i in range(shared.targets.shape[0]):
        slot = flight.torquer + i * TORQUER
        held, slewed = load(mem, slot + HELD, lane), load(mem, slot + SLEWED, lane)
        slew, decay = load(mem, slot + SLEW + segment, lane), load(mem, slot + DECAY + segment, lane)
        slewed = slewed + lesser(greater(held - slewed, -slew), slew)
        store(mem, slot + SLEWED, lane, slewed)
        store(mem, slot + TORQUE, lane, slewed + (load(mem, slot + TORQUE, lane) - slewed) * decay)


@inlined
def _half_turn(sine: Number, cosine: Number) -> tuple[Number, Number]:
    """Angle a in [0, pi/2] of sin a and cos a, and a / sin a."""
    t = sine / (1.0 + cosine)
    u = t / (1.0 + root(1.0 + t * t))
    v = u / (1.0 + root(1.0 + u * u))
    z = v * v
    series = 1.0 / 21.0 + 0.0 * z
    for i in range(19, 0, -2):
        series = 1.0 / i - z * series
    angle = 8.0 * v * series
    return angle, choose(sine > 1e-9, angle / sine, 0.0 * sine + 1.0)


@internal
def _figures(shared: Shared, mem: FloatArray, lane: int, at: At, flight: Flight) -> None:
    """Largest angles, rotation vector and shares of torque so far, of the scenarios that are still going."""
    n, nu = at.n, shared.targets.shape[0]
    alive = load(mem, flight.alive, lane)
    going = alive > 0.5
    for i in range(n):
        q, slot = load(mem, at.state + i, lane), flight.figures + i
        q = choose(q < 0.0, -q, q)
        store(mem, slot, lane, choose(going, greater(load(mem, slot, lane), q), load(mem, slot, lane)))
    e = at.state + 2 * n + 3
    e0, e1 = load(mem, e, lane), load(mem, e + 1, lane)
    e2, e3 = load(mem, e + 2, lane), load(mem, e + 3, lane)
    _, per_sine = _half_turn(root(e1 * e1 + e2 * e2 + e3 * e3), choose(e0 < 0.0, -e0, e0))
    for i in range(3):
        part, slot = 2.0 * per_sine * load(mem, e + 1 + i, lane), flight.figures + n + i
        part = choose(part < 0.0, -part, part)
        store(mem, slot, lane, choose(going, greater(load(mem, slot, lane), part), load(mem, slot, lane)))
    for i in range(nu):
        limit = load(mem, flight.torquer + i * TORQUER + LIMIT, lane)
        command, slot = load(mem, flight.command + i, lane), flight.figures + n + 3 + i
        command = choose(command < 0.0, -command, command)
        share = command / limit
        store(mem, slot, lane, choose(going, greater(load(mem, slot, lane), share), load(mem, slot, lane)))
        slot += nu
        store(mem, slot, lane, load(mem, slot, lane) + choose(command >= limit, alive, 0.0 * alive))


@inlined
def _survey(links: Links, mem: FloatArray, lane: int, at: At, flight: Flight, free: bool) -> None:
    """Rates at a sample into VELOCITY, joint momenta behind them."""
    n = at.n
    v = flight.velocity
    if free:
        joint_momenta(links, mem, lane, at, at.state, at.surroundings + 2 * at.block, v + n + 3)
        for i in range(n + 3):
            store(mem, v + i, lane, load(mem, at.state + n + i, lane))
    else:
        for i in range(3):
            rate = load(mem, at.surroundings + 2 * at.block + n + 3 + i, lane)
            store(mem, at.state + n + i, lane, rate)
            store(mem, v + i, lane, rate)
        derivative(links, mem, lane, at, free, at.no, at.no, at.state, at.surroundings + 2 * at.block, at.stages)
        for i in range(n):
            store(mem, v + 3 + i, lane, load(mem, at.stages + i, lane))
            store(mem, v + n + 3 + i, lane, load(mem, at.state + n + 3 + i, lane))


@internal
def _judge(mem: FloatArray, lane: int, at: At, flight: Flight, shared: Shared) -> bool:
    """Let go of scenarios that diverge: a number that is not finite, or a rate above one radian per substep.

    They start again from t = 0 so as not to compute with such numbers, and count no more. Returns whether any is left.
    """
    n = at.n
    step = greater(load(mem, flight.segments, lane), load(mem, flight.segments + 1, lane))
    sound = step > 0.0
    for i in range(at.size):
        y = load(mem, at.state + i, lane)
        sound = sound & (y - y == 0.0)
    for i in range(n + 3):
        turn = load(mem, flight.velocity + i, lane) * step
        sound = sound & (turn < 1.0) & (turn > -1.0)
    for i in range(shared.targets.shape[0]):
        command = load(mem, flight.command + i, lane)
        sound = sound & (command - command == 0.0)
    alive = load(mem, flight.alive, lane)
    if anywhere(~sound):
        for i in range(at.size):
            y = at.state + i
            store(mem, y, lane, choose(sound, load(mem, y, lane), load(mem, flight.start + i, lane)))
        for i in range(n + 3):
            slot = flight.velocity + i
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
        for i in range(flight.states):
            slot = flight.controller + i
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
        for i in range(shared.targets.shape[0]):
            slot = flight.command + i
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
            slot = flight.torquer + i * TORQUER + TORQUE
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
    alive = choose(sound, alive, 0.0 * alive)
    store(mem, flight.alive, lane, alive)
    done = flight.figures + 2 * n + 3 + 2 * shared.targets.shape[0]
    store(mem, done, lane, load(mem, done, lane) + alive)
    return bool(anywhere(alive > 0.5))


@inlined
def _record(links: Links, shared: Shared, mem: FloatArray, at: At, flight: Flight, record: FloatArray) -> None:
    """A row for the first column: q, rates, Omega, p, attitude, reading, command, torque, spins, motors' torques."""
    n, nu, column = at.n, shared.targets.shape[0], 0
    for i in range(n):
        record[i] = load(mem, at.state + i, 0)
        record[n + i] = load(mem, flight.velocity + 3 + i, 0)
        record[2 * n + 3 + i] = load(mem, flight.velocity + n + 3 + i, 0)
    for i in range(3):
        record[2 * n + i] = load(mem, flight.velocity + i, 0)
    for i in range(4):
        record[3 * n + 3 + i] = load(mem, at.state + 2 * n + 3 + i, 0)
    column = 3 * n + 7
    for i in range(shared.sensors.shape[0]):
        record[column + i] = load(mem, flight.sensor + i * SENSOR + LAST, 0)
    column += shared.sensors.shape[0]
    for i in range(nu):
        record[column + i] = load(mem, flight.command + i, 0)
    column += 2 * nu
    # The workspace holds the carriers' rates at this sample.
    for r in range(at.servos):
        row, work = at.servo + r * SERVO, at.work + links.servo_carrier[r] * WORK + RATE
        spin = load(mem, at.state + 2 * n + 7 + r, 0) / load(mem, row + C, 0)
        for i in range(3):
            spin -= load(mem, row + i, 0) * load(mem, work + i, 0)
        wanted = -load(mem, row + GAIN, 0) * (spin - load(mem, row + SPIN, 0))
        wanted -= load(mem, row + INTEGRAL, 0) * load(mem, at.state + 2 * n + 7 + at.servos + r, 0)
        record[column + r] = spin
        limit = load(mem, row + TORQUE_LIMIT, 0)
        record[column + at.servos + r] = min(max(wanted, -limit), limit)


@internal
def _segment(
    links: Links,
    shared: Shared,
    mem: FloatArray,
    lane: int,
    at: At,
    flight: Flight,
    free: bool,
    segment: int,
    count: int,
    start: Number,
    contact: bool,
) -> bool:
    """Integrate over one segment of a period; return whether any gimbal lies on a stop at its end."""
    apart()
    step = load(mem, flight.segments + segment, lane)
    nu = shared.targets.shape[0]
    contacts = flight.figures + at.n + 3 + 2 * nu
    for m in range(count):
        hand_on(shared, mem, lane, at, flight, free)
        if at.course != 0:
            follow_rotors(shared, mem, lane, at, flight, start + (m + 1.0) * step, step)
        _torques(shared, mem, lane, at, flight, 0)
        for row in range(1, 3):
            _work_on(shared, mem, lane, flight, segment)
            surround(shared, mem, lane, at, flight, free, row, segment, at.yes, start + (m + 0.5 * row) * step)
            _torques(shared, mem, lane, at, flight, row)
        if contact:
            for i in range(at.size):
                store(mem, flight.spare_state + at.size + i, lane, load(mem, at.state + i, lane))
        runge_kutta(links, mem, lane, at, free, at.no, at.state, step)
        if flight.stops != 0:
            held = at.no
            if contact:
                held = hold(links, mem, lane, at, flight, free, flight.spare_state + at.size, step)
            past = contact
            if not past:
                for k in range(at.n):
                    q, stop = load(mem, at.state + k, lane), flight.stop + k * STOP
                    past = past or anywhere((q < load(mem, stop, lane)) | (q > load(mem, stop + 1, lane)))
            if past:
                contact = meet_stops(links, mem, lane, at, flight, free, held, contacts)
    return contact


@inlined
def _note_torques(shared: Shared, mem: FloatArray, at: At, flight: Flight, record: FloatArray, k: int) -> None:
    """Record the torques that act just after a sample."""
    if record.shape[0] > 0:
        nu = shared.targets.shape[0]
        for i in range(nu):
            column = 3 * at.n + 7 + shared.sensors.shape[0] + nu + i
            record[k, column] = load(mem, flight.torquer + i * TORQUER + TORQUE, 0)


@internal
def fly(
    links: Links,
    shared: Shared,
    keys: Keys,
    mem: FloatArray,
    lane: int,
    at: At,
    flight: Flight,
    free: bool,
    record: FloatArray,
) -> None:
    """Fly the scenarios of the memory from t = 0 to the end; the figures stand in the memory then.

    At sample k the sensors are read and the controllers evaluated. A period has two segments, before and after the
    command changes: the first holds the command of `whole` + 1 samples ago, the second that of `whole` samples ago.
    """
    n, nu, period = at.n, shared.targets.shape[0], shared.period
    zero = 0.0 * load(mem, flight.start, lane)
    for i in range(flight.given, flight.end):
        store(mem, i, lane, zero)
    for i in range(at.size):
        store(mem, at.state + i, lane, load(mem, flight.start + i, lane))
    store(mem, flight.alive, lane, zero + 1.0)
    begin_surroundings(shared, mem, lane, at, flight)
    for j in range(shared.lines.shape[0]):
        uniforms(keys, mem, lane, j, PHASE_OF_LINE + j, flight.random)
        c, s = cosine_and_sine(2.0 * math.pi * load(mem, flight.random, lane))
        store(mem, flight.line + j * LINE + PHASE, lane, c)
        store(mem, flight.line + j * LINE + PHASE + 1, lane, s)
    for row in range(2, 3):  # the end of the step before the first
        surround(shared, mem, lane, at, flight, free, row, row, at.no, zero)
    if at.course != 0:
        # The moment before the first: a step that leaves everything as it is.
        for _ in range(2):
            follow_rotors(shared, mem, lane, at, flight, zero, zero + 1.0)
            hand_on(shared, mem, lane, at, flight, free)
    if not free:
        end = at.surroundings + 2 * at.block
        for i in range(3):
            store(mem, at.state + n + i, lane, load(mem, end + n + 3 + i, lane))
        joint_momenta(links, mem, lane, at, at.state, end, flight.velocity)
        for i in range(n):
            store(mem, at.state + n + 3 + i, lane, load(mem, flight.velocity + i, lane))
        for i in range(at.size):
            store(mem, flight.start + i, lane, load(mem, at.state + i, lane))
    contact = at.no
    for k in range(flight.samples):
        t = k * period
        strike(links, shared, mem, lane, at, flight, free, t)
        _survey(links, mem, lane, at, flight, free)
        _read(shared, keys, mem, lane, at, flight, k, t)
        _control(shared, keys, mem, lane, at, flight, k, t)
        going = _judge(mem, lane, at, flight, shared)
        _figures(shared, mem, lane, at, flight)
        for i in range(nu):
            slot = flight.torquer + i * TORQUER
            limit = load(mem, slot + LIMIT, lane)
            command = lesser(greater(load(mem, flight.command + i, lane), -limit), limit)
            ring = flight.ring + k % (flight.whole + 2) * nu + i
            store(mem, ring, lane, command)
        if record.shape[0] > 0:
            _record(links, shared, mem, at, flight, record[k])
        if not going:
            return
        start, noted = zero + t, False
        for segment in range(2):
            count = flight.before if segment == 0 else flight.after
            if count == 0:
                continue
            _new_torque(shared, mem, lane, flight, segment, k - flight.whole - 1 + segment, start)
            if not noted:
                _note_torques(shared, mem, at, flight, record, k)
                noted = True
            if k < flight.samples - 1:
                contact = _segment(links, shared, mem, lane, at, flight, free, segment, count, start, contact)
                start = start + count * load(mem, flight.segments + segment, lane)


@compiled
def fly_groups(
    links: Links,
    shared: Shared,
    keys: NDArray[np.uint64],
    mem: FloatArray,
    lane: int,
    at: At,
    flight: Flight,
    free: bool,
    plants: FloatArray,
    flights: FloatArray,
    figures: FloatArray,
    record: FloatArray,
) -> None:
    """Fly group after group of scenarios in the same memory.

    `keys` (G, LANES, 2); `plants` (G, at.work, LANES) and `flights` (G, given, LANES): what the host gives of each;
    `figures` (G, figures, LANES): what comes out; `record` (samples, columns), of the first scenario, or no rows.
    """
    for g in range(plants.shape[0]):
        for i in range(plants.shape[1]):
            for j in range(plants.shape[2]):
                mem[i, j] = plants[g, i, j]
        for i in range(flights.shape[1]):
            for j in range(flights.shape[2]):
                mem[at.end + i, j] = flights[g, i, j]
        fly(links, shared, keys[g], mem, lane, at, flight, free, record)
        for i in range(figures.shape[1]):
            for j in range(figures.shape[2]):
                figures[g, i, j] = mem[flight.figures + i, j]
