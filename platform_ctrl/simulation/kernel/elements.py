"""What force elements and the motors of servo rotors do: torques at joints, moments on carriers."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Number, choose, greater, lesser, load, root, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import add, exponential, hyperbolic_tangent, vector
from platform_ctrl.simulation.kernel.arrays import At, Links


@internal
def joint_torque(mem: FloatArray, lane: int, at: At, joint: int, q: Number, rate: Number) -> Number:
    """What springs, friction and a cage do at a joint."""
    Q = load(mem, joint + arrays.PRELOAD, lane) - load(mem, joint + arrays.STIFFNESS, lane) * q
    Q = Q - load(mem, joint + arrays.VISCOUS, lane) * rate
    if at.dry != 0:
        back = rate < 0.0
        level = choose(back, load(mem, joint + arrays.COULOMB, lane), load(mem, joint + arrays.COULOMB + 1, lane))
        more = (
            choose(back, load(mem, joint + arrays.BREAKAWAY, lane), load(mem, joint + arrays.BREAKAWAY + 1, lane))
            - level
        )
        sliding = rate * load(mem, joint + arrays.PER_STRIBECK_RATE, lane)
        level = level + more * exponential(-sliding * sliding)
        Q = Q - level * hyperbolic_tangent(rate * load(mem, joint + arrays.PER_COULOMB_RATE, lane))
    if at.cages != 0:
        # No cage is one with infinite clearance.
        stiffness, damping = load(mem, joint + arrays.CAGE, lane), load(mem, joint + arrays.CAGE + 1, lane)
        clearance, out = load(mem, joint + arrays.CAGE + 2, lane), q - load(mem, joint + arrays.CAGE + 3, lane)
        held = stiffness * out + damping * rate
        above = greater(held - stiffness * clearance, 0.0 * rate)
        below = lesser(held + stiffness * clearance, 0.0 * rate)
        push = choose(out > clearance, above, choose(out < -clearance, below, 0.0 * rate))
        Q = Q - choose(clearance > 0.0, push, held)
    return Q


@inlined
def servo_momenta(links: Links, mem: FloatArray, lane: int, at: At, y: int, field: int) -> None:
    """Add P s of the servo rotors to a vector of their carriers."""
    for r in range(at.servos):
        slot = at.work + links.servo_carrier[r] * arrays.WORK + field
        p = load(mem, y + 2 * at.n + 7 + r, lane)
        for i in range(3):
            add(mem, lane, slot + i, p * load(mem, at.servo + r * arrays.SERVO + i, lane))


@inlined
def servo_drives(links: Links, mem: FloatArray, lane: int, at: At, react: bool, y: int, dy: int) -> None:
    """Derivatives of the servo rotors' states; with `react` their motors' torques on the carriers' moments."""
    p, x = 2 * at.n + 7, 2 * at.n + 7 + at.servos
    for r in range(at.servos):
        row, work = at.servo + r * arrays.SERVO, at.work + links.servo_carrier[r] * arrays.WORK
        s0, s1, s2 = vector(mem, lane, row)
        w0, w1, w2 = vector(mem, lane, work + arrays.RATE)
        spin = load(mem, y + p + r, lane) / load(mem, row + arrays.C, lane) - (s0 * w0 + s1 * w1 + s2 * w2)
        error = spin - load(mem, row + arrays.SPIN, lane)
        limit = load(mem, row + arrays.TORQUE_LIMIT, lane)
        wanted = -load(mem, row + arrays.GAIN, lane) * error - load(mem, row + arrays.INTEGRAL, lane) * load(
            mem, y + x + r, lane
        )
        torque = lesser(greater(wanted, -limit), limit)
        further = ((wanted >= limit) & (error < 0.0)) | ((wanted <= -limit) & (error > 0.0))
        store(mem, dy + p + r, lane, torque)
        store(mem, dy + x + r, lane, choose(further, 0.0 * error, error))
        if react:
            add(mem, lane, work + arrays.MOMENT, torque * s0)
            add(mem, lane, work + arrays.MOMENT + 1, torque * s1)
            add(mem, lane, work + arrays.MOMENT + 2, torque * s2)


@inlined
def unbalance_moments(mem: FloatArray, lane: int, at: At) -> None:
    """Add the unbalances' moments on the carriers to MOMENT, with the sign of what has to be held."""
    for b in range(at.n + 1):
        slot = at.work + b * arrays.WORK
        u0, u1, u2 = vector(mem, lane, at.body + b * arrays.BODY + arrays.UNBALANCE)
        f0, f1, f2 = vector(mem, lane, slot + arrays.FORCE)
        add(mem, lane, slot + arrays.MOMENT, u1 * f2 - u2 * f1)
        add(mem, lane, slot + arrays.MOMENT + 1, u2 * f0 - u0 * f2)
        add(mem, lane, slot + arrays.MOMENT + 2, u0 * f1 - u1 * f0)


@inlined
def erection_torques(links: Links, mem: FloatArray, lane: int, at: At, dy: int) -> None:
    """Add the erecting devices' torques to the joints' in `dy`."""
    f0, f1, f2 = vector(mem, lane, at.work + arrays.FORCE)
    size = root(f0 * f0 + f1 * f1 + f2 * f2)
    scale = choose(size > 0.0, 1.0 / size, 0.0 * size)
    for e in range(links.erection.shape[0]):
        row, slot = at.erection + e * arrays.ERECTION, at.work + links.erection[e, 1] * arrays.WORK + arrays.FORCE
        s0, s1, s2 = vector(mem, lane, row)
        f0, f1, f2 = vector(mem, lane, slot)
        Q = load(mem, row + arrays.ERECTION_GAIN, lane) * (s0 * f0 + s1 * f1 + s2 * f2) * scale
        limit = load(mem, row + arrays.ERECTION_LIMIT, lane)
        add(mem, lane, dy + links.erection[e, 0], lesser(greater(Q, -limit), limit))
