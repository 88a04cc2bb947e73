"""What is kept of a run: its figures, a record of its samples, and whether it is still one."""

from __future__ import annotations

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import Number, anywhere, choose, greater, inlined, internal, load, root, store
from platform_ctrl.simulation.kernel.body import GAIN, INTEGRAL, RATE, SERVO, SPIN, TORQUE_LIMIT, WORK, At, C, Links
from platform_ctrl.simulation.kernel.flight import LAST, LIMIT, SENSOR, TORQUE, TORQUER, Flight, Shared


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
def note_figures(shared: Shared, mem: FloatArray, lane: int, at: At, flight: Flight) -> None:
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


@internal
def judge(mem: FloatArray, lane: int, at: At, flight: Flight, shared: Shared) -> bool:
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
def note_sample(links: Links, shared: Shared, mem: FloatArray, at: At, flight: Flight, record: FloatArray) -> None:
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


@inlined
def note_torques(shared: Shared, mem: FloatArray, at: At, flight: Flight, record: FloatArray, k: int) -> None:
    """Record the torques that act just after a sample."""
    if record.shape[0] > 0:
        nu = shared.targets.shape[0]
        for i in range(nu):
            column = 3 * at.n + 7 + shared.sensors.shape[0] + nu + i
            record[k, column] = load(mem, flight.torquer + i * TORQUER + TORQUE, 0)
