"""The metrics of a run, sample by sample, and whether it goes on."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Mask, Number, anywhere, choose, greater, load, root, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import At, Layout, Shared


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
def update_metrics(shared: Shared, mem: FloatArray, lane: int, at: At, layout: Layout, k: int) -> None:
    """The metrics up to sample k, of the scenarios that are still going."""
    n, nu = at.n, shared.targets.shape[0]
    alive = load(mem, layout.alive, lane)
    going = alive > 0.5
    for i in range(n):
        q, slot = load(mem, at.state + i, lane), layout.metrics + i
        q = choose(q < 0.0, -q, q)
        store(mem, slot, lane, choose(going, greater(load(mem, slot, lane), q), load(mem, slot, lane)))
    e = at.state + 2 * n + 3
    e0, e1 = load(mem, e, lane), load(mem, e + 1, lane)
    e2, e3 = load(mem, e + 2, lane), load(mem, e + 3, lane)
    _, per_sine = _half_turn(root(e1 * e1 + e2 * e2 + e3 * e3), choose(e0 < 0.0, -e0, e0))
    for i in range(3):
        part, slot = 2.0 * per_sine * load(mem, e + 1 + i, lane), layout.metrics + n + i
        part = choose(part < 0.0, -part, part)
        store(mem, slot, lane, choose(going, greater(load(mem, slot, lane), part), load(mem, slot, lane)))
    for i in range(nu):
        limit = load(mem, layout.torquer + i * arrays.TORQUER + arrays.LIMIT, lane)
        command, slot = load(mem, layout.command + i, lane), layout.metrics + n + 3 + i
        command = choose(command < 0.0, -command, command)
        share = command / limit
        store(mem, slot, lane, choose(going, greater(load(mem, slot, lane), share), load(mem, slot, lane)))
        slot += nu
        store(mem, slot, lane, load(mem, slot, lane) + choose(command >= limit, alive, 0.0 * alive))
    rates = layout.metrics + 2 * n + 4 + 2 * nu
    for i in range(n):
        rate, slot = load(mem, layout.velocity + 3 + i, lane), rates + i
        rate = choose(rate < 0.0, -rate, rate)
        store(mem, slot, lane, choose(going, greater(load(mem, slot, lane), rate), load(mem, slot, lane)))
    settled = going & (load(mem, layout.settle, lane) <= k)
    sight = shared.sensors.shape[0] - layout.sensors
    if sight > 0 and anywhere(settled):
        count = load(mem, rates + n, lane) + choose(settled, alive, 0.0 * alive)
        store(mem, rates + n, lane, count)
        share = 1.0 / greater(count, 0.0 * alive + 1.0)
        _spread(mem, lane, settled, share, layout.velocity, 3, rates + n + 1, 3 + sight)
        _spread(mem, lane, settled, share, layout.sight, sight, rates + n + 4, 3 + sight)
    end = layout.states + nu + layout.drives + 1
    for j in range(layout.commands):
        slot, sensor = layout.following + j, layout.sensor + shared.first[end + j] * arrays.SENSOR
        # What the sensor shows wrongly is no part of what the loop does.
        scale = load(mem, sensor + arrays.SENSOR_SCALE, lane)
        scale = choose((scale < 0.0) | (scale > 0.0), scale, 0.0 * scale + 1.0)
        error = (load(mem, sensor + arrays.LAST, lane) - load(mem, sensor + arrays.BIAS, lane)) / scale
        error = error - load(mem, layout.sensor + (layout.sensors + j) * arrays.SENSOR + arrays.PATH, lane)
        error = choose(error < 0.0, -error, error)
        store(mem, slot, lane, choose(settled, greater(load(mem, slot, lane), error), load(mem, slot, lane)))


@internal
def _spread(
    mem: FloatArray, lane: int, counts: Mask, share: Number, source: int, size: int, mean: int, behind: int
) -> None:
    """Add values to their means and, `behind` these, to the sums of squares about them (Welford 1962)."""
    for i in range(size):
        value, slot = load(mem, source + i, lane), mean + i
        old = load(mem, slot, lane)
        new = old + share * (value - old)
        square = load(mem, slot + behind, lane)
        store(mem, slot, lane, choose(counts, new, old))
        store(mem, slot + behind, lane, choose(counts, square + (value - old) * (value - new), square))


@internal
def judge(mem: FloatArray, lane: int, at: At, layout: Layout, shared: Shared) -> bool:
    """Let go of scenarios that diverge: a number that is not finite, or a rate above one radian per substep.

    They start again from t = 0 so as not to compute with such numbers, and count no more. Returns whether any is left.
    """
    n = at.n
    step = greater(load(mem, layout.segments, lane), load(mem, layout.segments + 1, lane))
    sound = step > 0.0
    for i in range(at.size):
        y = load(mem, at.state + i, lane)
        sound = sound & (y - y == 0.0)
    for i in range(n + 3):
        turn = load(mem, layout.velocity + i, lane) * step
        sound = sound & (turn < 1.0) & (turn > -1.0)
    for i in range(shared.targets.shape[0]):
        command = load(mem, layout.command + i, lane)
        sound = sound & (command - command == 0.0)
    alive = load(mem, layout.alive, lane)
    if anywhere(~sound):
        for i in range(at.size):
            y = at.state + i
            store(mem, y, lane, choose(sound, load(mem, y, lane), load(mem, layout.start + i, lane)))
        for i in range(n + 3):
            slot = layout.velocity + i
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
        for i in range(layout.states):
            slot = layout.controller + i
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
        for i in range(shared.targets.shape[0]):
            slot = layout.command + i
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
            slot = layout.torquer + i * arrays.TORQUER + arrays.TORQUE
            store(mem, slot, lane, choose(sound, load(mem, slot, lane), 0.0 * step))
    alive = choose(sound, alive, 0.0 * alive)
    store(mem, layout.alive, lane, alive)
    done = layout.metrics + 2 * n + 3 + 2 * shared.targets.shape[0]
    store(mem, done, lane, load(mem, done, lane) + alive)
    return bool(anywhere(alive > 0.5))
