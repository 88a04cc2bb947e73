"""Computations at a sample: sensors and line of sight with lags, errors and faults; resolved readings; metrics.

Readings of body sensors are turned to joint axes by the angles that encoders read: `platform_ctrl.job.resolve`.
"""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Mask, Number, anywhere, choose, greater, lesser, load, root, store, whole
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine
from platform_ctrl.simulation.kernel.arrays import At, Layout, Links, Shared
from platform_ctrl.simulation.kernel.axes import from_parent
from platform_ctrl.simulation.kernel.devices import LOSS, PICKOFF, Keys, acts, normals, uniforms
from platform_ctrl.simulation.kernel.slots import add, copy, put, put_where, vector
from platform_ctrl.simulation.kernel.vectors import Vector, cross, dot, plus, scaled, turned


@internal
def turn_bodies(links: Links, mem: FloatArray, at: At, layout: Layout, k: int) -> None:
    """How far every body has turned since sample 0, with the joints' cosines and sines of sample k in the workspace.

    The inertial axes in the body's axes, T_j, and those of sample 0, S_j, give E = sum of S_j T_j', the rotation in
    between; the sensors see sin(angle) times its axis, (E_kj - E_jk) / 2.
    """
    e, bodies = at.state + 2 * at.n + 3, at.n + 1
    axes = layout.turns + 3 * bodies
    w, (x, y, z) = load(mem, e), vector(mem, e + 1)
    put(mem, axes, (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)))
    put(mem, axes + 3, (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)))
    put(mem, axes + 6, (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)))
    for m in range(at.n):
        body, up = links.tree[m, arrays.GIMBAL] + 1, axes + 9 * links.tree[m, arrays.PARENT]
        work = at.work + body * arrays.WORK
        c, s = load(mem, work + arrays.COS), load(mem, work + arrays.SIN)
        for j in range(3):
            put(mem, axes + 9 * body + 3 * j, turned(c, s, from_parent(links, mem, m, up + 3 * j)))
    start = axes + 9 * bodies
    if k == 0:
        copy(mem, start, axes, 9 * bodies)
    for body in range(bodies):
        r = 0.0 * w, 0.0 * w, 0.0 * w
        for j in range(3):
            row = 9 * body + 3 * j
            r = plus(r, cross(vector(mem, axes + row), vector(mem, start + row)))
        put(mem, layout.turns + 3 * body, scaled(0.5, r))


@inlined
def _signal(at: At, layout: Layout, index: int) -> int:
    """Slot of an entry of [q, Omega, rates, bodies' rates, bodies' rotations, modes and their rates in turn]."""
    n = at.n
    if index < n:
        return at.state + index
    if index < 2 * n + 3:
        return layout.velocity + index - n
    if index < 5 * n + 6:
        body, axis = (index - 2 * n - 3) // 3, (index - 2 * n - 3) % 3
        return at.work + body * arrays.WORK + arrays.RATE + axis
    if index < 8 * n + 9:
        return layout.turns + index - 5 * n - 6
    mode = (index - 8 * n - 9) // 2
    return at.swing + mode if (index - 8 * n - 9) % 2 else at.swings + at.state + 2 * mode


@inlined
def _sum(shared: Shared, mem: FloatArray, at: At, layout: Layout, i: int) -> Number:
    first, last = shared.sensors[i, arrays.BEGIN_TERMS], shared.sensors[i, arrays.END_TERMS]
    value = shared.weights[first] * load(mem, _signal(at, layout, shared.signals[first]))
    for j in range(first + 1, last):
        value = value + shared.weights[j] * load(mem, _signal(at, layout, shared.signals[j]))
    return value


@inlined
def look(shared: Shared, mem: FloatArray, at: At, layout: Layout) -> None:
    """Put the rates and angles of the line of sight into SIGHT."""
    for i in range(layout.sensors, shared.sensors.shape[0]):
        store(mem, layout.sight + i - layout.sensors, _sum(shared, mem, at, layout, i))


@internal
def _lagging(mem: FloatArray, slot: int, k: int, value: Number) -> Number:
    """Output of the low-pass at a slot; its input runs straight from sample to sample and is settled at t = 0."""
    before = load(mem, slot + arrays.INPUT)
    store(mem, slot + arrays.INPUT, value)
    if k == 0:
        store(mem, slot + arrays.LAGGING, value)
        store(mem, slot + arrays.LAGGING + 1, 0.0 * value)
        return value
    x, v = load(mem, slot + arrays.LAGGING), load(mem, slot + arrays.LAGGING + 1)
    for i in range(2):
        turn = slot + arrays.TRANSITION + 2 * i
        new = load(mem, turn) * x + load(mem, turn + 1) * v
        new = new + load(mem, slot + arrays.BEFORE + i) * before + load(mem, slot + arrays.NOW + i) * value
        store(mem, slot + arrays.LAGGING + i, new)
    return load(mem, slot + arrays.LAGGING)


@internal
def _late(mem: FloatArray, slot: int, periods: int, k: int, value: Number) -> Number:
    """The value of `periods` samples ago, at first that of t = 0; `slot` holds the values on their way."""
    if k == 0:
        for i in range(periods):
            store(mem, slot + i, value)
    old = load(mem, slot + k % periods)
    store(mem, slot + k % periods, value)
    return old


@inlined
def _faulty(
    shared: Shared, keys: Keys, mem: FloatArray, layout: Layout, i: int, k: int, t: float, value: Number
) -> Number:
    """The output of a failing sensor in place of its reading."""
    last = layout.sensor + i * arrays.SENSOR + arrays.LAST
    for f in range(shared.faults.shape[0]):
        failing = shared.faults[f, 0]
        if failing < arrays.PICKOFF_DROPOUT or failing > arrays.PICKOFF_DEAD or shared.faults[f, 1] != i:
            continue
        fault = layout.fault + f * arrays.FAULT
        on = acts(mem, fault, t)
        if failing == arrays.PICKOFF_DEAD:
            value = choose(on, 0.0 * value, value)
        elif failing == arrays.PICKOFF_STUCK:
            value = choose(on, load(mem, last), value)
        elif failing == arrays.PICKOFF_DROPOUT:
            uniforms(keys, mem, k, LOSS + shared.faults[f, 2], layout.random + 2)
            lost = on & (load(mem, layout.random + 2) < load(mem, fault + arrays.FIRST))
            value = choose(lost, load(mem, last), value)
    return value


@internal
def read(shared: Shared, keys: Keys, mem: FloatArray, at: At, layout: Layout, k: int, t: float) -> None:
    """Put the reading of every sensor at sample k into its LAST."""
    drawn = -1  # the last sensor for which a pair of normal numbers was drawn
    for i in range(layout.sensors):
        slot = layout.sensor + i * arrays.SENSOR
        value = _sum(shared, mem, at, layout, i)
        if shared.sensors[i, arrays.FILTERED] >= 0:
            value = _lagging(mem, layout.lowpass + shared.sensors[i, arrays.FILTERED] * arrays.LOWPASS, k, value)
        if shared.sensors[i, arrays.LATE] > 0:
            value = _late(mem, layout.late + shared.sensors[i, arrays.KEPT], shared.sensors[i, arrays.LATE], k, value)
        if shared.sensors[i, arrays.EVERY] > 1 and k % shared.sensors[i, arrays.EVERY] != 0:
            continue
        value = load(mem, slot + arrays.SENSOR_SCALE) * value + load(mem, slot + arrays.BIAS)
        rms = load(mem, slot + arrays.RMS)
        if anywhere(rms > 0.0):
            if i % 2 == 0 or drawn != i - 1:
                normals(keys, mem, k, PICKOFF + i // 2, layout.random)
                drawn = i
            value = value + rms * load(mem, layout.random + i % 2)
        sound = reading = _in_steps(mem, slot, value)
        for f in range(shared.faults.shape[0]):
            if shared.faults[f, 0] == arrays.PICKOFF_DRIFT and shared.faults[f, 1] == i:
                fault = layout.fault + f * arrays.FAULT
                drift = load(mem, fault + arrays.FIRST) * (t - load(mem, fault + arrays.BEGIN))
                value = choose(acts(mem, fault, t), value + drift, value)
                reading = _in_steps(mem, slot, value)
        reading = _faulty(shared, keys, mem, layout, i, k, t, reading)
        store(mem, slot + arrays.LAST, reading)
        store(mem, slot + arrays.FAILED, reading - sound)


@inlined
def _in_steps(mem: FloatArray, slot: int, value: Number) -> Number:
    """Return a value in steps of a sensor's quantisation."""
    step = load(mem, slot + arrays.QUANTISATION)
    fine = step > 0.0
    unit = choose(fine, step, 0.0 * step + 1.0)
    return choose(fine, unit * whole(value / unit + 0.5), value)


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


@inlined
def _keep_largest(mem: FloatArray, slot: int, counts: Mask, value: Number) -> None:
    """Keep the largest magnitude of a value, of the scenarios that count."""
    put_where(mem, slot, counts, greater(load(mem, slot), choose(value < 0.0, -value, value)))


@internal
def update_metrics(shared: Shared, mem: FloatArray, at: At, layout: Layout, k: int) -> None:
    """The metrics up to sample k, of the scenarios that are still going."""
    n, nu = at.n, shared.targets.shape[0]
    alive = load(mem, layout.alive)
    going = alive > 0.5
    for i in range(n):
        _keep_largest(mem, layout.metrics + i, going, load(mem, at.state + i))
    e = at.state + 2 * n + 3
    w, v = load(mem, e), vector(mem, e + 1)
    _, per_sine = _half_turn(root(dot(v, v)), choose(w < 0.0, -w, w))
    for i in range(3):
        _keep_largest(mem, layout.metrics + n + i, going, 2.0 * per_sine * load(mem, e + 1 + i))
    for i in range(nu):
        own, slot = layout.torquer + i * arrays.TORQUER, layout.metrics + n + 3 + i
        command = load(mem, layout.command + i)
        limit, turning = load(mem, own + arrays.LIMIT), load(mem, layout.velocity + shared.targets[i])
        counter = load(mem, own + arrays.BACK_EMF) * choose(command < 0.0, -turning, turning)
        # What the supply of a motor leaves in this direction; nothing where it turns faster than it idles.
        limit = greater(lesser(limit, load(mem, own + arrays.STALL) - counter), 1e-9 * limit)
        command = choose(command < 0.0, -command, command)
        _keep_largest(mem, slot, going, command / limit)
        slot += nu
        add(mem, slot, choose(command >= limit, alive, 0.0 * alive))
    rates = layout.metrics + 2 * n + 4 + 2 * nu
    for i in range(n):
        _keep_largest(mem, rates + i, going, load(mem, layout.velocity + 3 + i))
    settled = going & (load(mem, layout.settle) <= k)
    sight = shared.sensors.shape[0] - layout.sensors
    if sight > 0 and anywhere(settled):
        count = load(mem, rates + n) + choose(settled, alive, 0.0 * alive)
        store(mem, rates + n, count)
        share = 1.0 / greater(count, 0.0 * alive + 1.0)
        _spread(mem, settled, share, layout.velocity, 3, rates + n + 1, 3 + sight)
        _spread(mem, settled, share, layout.sight, sight, rates + n + 4, 3 + sight)
    end = layout.states + nu + layout.drives + 1
    for j in range(layout.commands):
        slot, sensor = layout.following + j, layout.sensor + shared.first[end + j] * arrays.SENSOR
        # Errors and faults of the sensor are no motion of the loop.
        path = load(mem, layout.sensor + (layout.readings + j) * arrays.SENSOR + arrays.PATH)
        _keep_largest(mem, slot, settled, _without_errors(mem, sensor) - path)


@internal
def _spread(mem: FloatArray, counts: Mask, share: Number, source: int, size: int, mean: int, behind: int) -> None:
    """Add values to their means and, `behind` these, to the sums of squares about them (Welford 1962)."""
    for i in range(size):
        value, slot = load(mem, source + i), mean + i
        old = load(mem, slot)
        new = old + share * (value - old)
        put_where(mem, slot, counts, new)
        put_where(mem, slot + behind, counts, load(mem, slot + behind) + (value - old) * (value - new))


@inlined
def _clear(mem: FloatArray, sound: Mask, zero: Number, first: int, count: int, apart: int) -> None:
    """Put zeros into slots of the scenarios that are not sound."""
    for i in range(count):
        put_where(mem, first + i * apart, ~sound, zero)


@internal
def judge(mem: FloatArray, at: At, layout: Layout, shared: Shared) -> bool:
    """Stop scenarios that diverge: a number that is not finite, or a rate above one radian per substep.

    They start again from t = 0 so as not to compute with such numbers, and count no more. Returns whether any is left.
    """
    n = at.n
    step = greater(load(mem, layout.segments), load(mem, layout.segments + 1))
    sound = step > 0.0
    for i in range(at.size):
        y = load(mem, at.state + i)
        sound = sound & (y - y == 0.0)
    for i in range(n + 3):
        turn = load(mem, layout.velocity + i) * step
        sound = sound & (turn < 1.0) & (turn > -1.0)
    for i in range(shared.targets.shape[0]):
        command = load(mem, layout.command + i)
        sound = sound & (command - command == 0.0)
    alive = load(mem, layout.alive)
    if anywhere(~sound):
        for i in range(at.size):
            put_where(mem, at.state + i, ~sound, load(mem, layout.start + i))
        _clear(mem, sound, 0.0 * step, layout.velocity, n + 3, 1)
        _clear(mem, sound, 0.0 * step, layout.controller, layout.states, 1)
        _clear(mem, sound, 0.0 * step, layout.command, shared.targets.shape[0], 1)
        _clear(mem, sound, 0.0 * step, layout.torquer + arrays.TORQUE, shared.targets.shape[0], arrays.TORQUER)
    alive = choose(sound, alive, 0.0 * alive)
    store(mem, layout.alive, alive)
    add(mem, layout.metrics + 2 * n + 3 + 2 * shared.targets.shape[0], alive)
    return bool(anywhere(alive > 0.5))


@internal
def resolve(shared: Shared, mem: FloatArray, layout: Layout) -> None:
    """Put resolved readings behind those of the sensors."""
    part = layout.states + shared.targets.shape[0] + 2 * layout.drives + 1 + layout.commands
    number, out = shared.signals.shape[0], layout.sensor + layout.sensors * arrays.SENSOR
    for _ in range(layout.resolvers):
        size = shared.first[part]
        after, following = _turn_to_joints(shared, mem, layout, part, number, False)
        for i in range(size):
            store(mem, out + i * arrays.SENSOR + arrays.LAST, load(mem, layout.turned + arrays.TO_TURN + i))
        if layout.commands > 0:  # what sound sensors and encoders would have given decides on errors behind commands
            _turn_to_joints(shared, mem, layout, part, number, True)
            for i in range(size):
                slot = out + i * arrays.SENSOR
                off = load(mem, slot + arrays.LAST) - load(mem, layout.turned + arrays.TO_TURN + i)
                store(mem, slot + arrays.BIAS, off)
        part, number, out = after, following, out + size * arrays.SENSOR


@internal
def _turn_to_joints(
    shared: Shared, mem: FloatArray, layout: Layout, part: int, number: int, sound: bool
) -> tuple[int, int]:
    """Put the resolved readings of one loop into TO_TURN, or those of sound sensors; return where its numbers end."""
    zero = 0.0 * load(mem, layout.start)
    size, base, least = shared.first[part], shared.first[part + 1], zero + shared.weights[number]
    of_base, shown = part + 2, number + 1
    part, number = of_base + base, shown + 3 * base
    for i in range(3):
        # Rows and columns that are not there are those of the unit matrix.
        row = layout.turned + arrays.JACOBIAN + 3 * i
        put(mem, row, (zero, zero, zero))
        store(mem, row + i, zero + (1.0 if i >= size else 0.0))
        store(mem, layout.turned + arrays.TO_TURN + i, zero)
    for i in range(size):
        steps, reading = shared.first[part + 1], _reading(mem, layout, shared.first[part], sound)
        part += 2
        axis = plus((zero, zero, zero), _weights(shared, number))
        number += 3
        for _ in range(steps):
            own, column, encoder = _weights(shared, number), shared.first[part], shared.first[part + 1]
            along = dot(own, axis)
            part, number = part + 2, number + 3
            if column >= 0:
                store(mem, layout.turned + arrays.JACOBIAN + 3 * i + column, along)
            if encoder >= 0:
                cosine, sine = cosine_and_sine(_reading(mem, layout, encoder, sound))
                turning = plus(scaled(cosine, axis), scaled(sine, cross(own, axis)))
                axis = plus(turning, scaled((1.0 - cosine) * along, own))
        for k in range(base):
            share = dot(_weights(shared, shown + 3 * k), axis)
            reading = reading - share * _reading(mem, layout, shared.first[of_base + k], sound)
        store(mem, layout.turned + arrays.TO_TURN + i, reading)
    _solve(mem, layout.turned, least, layout.turned + arrays.TO_TURN)
    return part, number


@inlined
def _weights(shared: Shared, k: int) -> Vector:
    """Return three of the weights."""
    return shared.weights[k], shared.weights[k + 1], shared.weights[k + 2]


@inlined
def _reading(mem: FloatArray, layout: Layout, i: int, sound: bool) -> Number:
    """Return the last reading of sensor i, or what it would have been of a sound one."""
    slot = layout.sensor + i * arrays.SENSOR
    return _without_errors(mem, slot) if sound else load(mem, slot + arrays.LAST)


@inlined
def _without_errors(mem: FloatArray, slot: int) -> Number:
    """Return what a sensor without bias, scale error and faults would have read last."""
    scale = load(mem, slot + arrays.SENSOR_SCALE)
    scale = choose((scale < 0.0) | (scale > 0.0), scale, 0.0 * scale + 1.0)
    return (load(mem, slot + arrays.LAST) - load(mem, slot + arrays.FAILED) - load(mem, slot + arrays.BIAS)) / scale


@internal
def _solve(mem: FloatArray, turned: int, least: Number, at: int) -> None:
    """Put (JᵀJ + damping 1)⁻¹ Jᵀ y in the place of y, the damping such that gains stay within the limit."""
    J, y = turned + arrays.JACOBIAN, vector(mem, at)
    det = dot(vector(mem, J), cross(vector(mem, J + 3), vector(mem, J + 6)))
    damping = greater(least * least - det * det, 0.0 * det)
    u, v, w = _column(mem, J), _column(mem, J + 1), _column(mem, J + 2)
    # Rows of JᵀJ + damping 1, which is symmetric, and of its inverse times its determinant.
    a = dot(u, u) + damping, dot(u, v), dot(u, w)
    b = a[1], dot(v, v) + damping, dot(v, w)
    c = a[2], b[2], dot(w, w) + damping
    right, first = (dot(u, y), dot(v, y), dot(w, y)), cross(b, c)
    solved = dot(first, right), dot(cross(c, a), right), dot(cross(a, b), right)
    put(mem, at, scaled(1.0 / dot(a, first), solved))


@inlined
def _column(mem: FloatArray, slot: int) -> Vector:
    """Return the column of a matrix (3, 3) that begins at a slot."""
    return load(mem, slot), load(mem, slot + 3), load(mem, slot + 6)
