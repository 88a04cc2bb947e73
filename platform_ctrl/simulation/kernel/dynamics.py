"""Equations of motion of the exact non-linear plant, by articulated bodies (Featherstone 2008, ch. 7).

Here all bodies turn about one fixed point, so that only rotations remain of that recursion; `placed` has the others.
Bodies are numbered 0 (root) and 1 + k (gimbal k). With the rates w, the carriers' inertias I (rotors included:
A(1 - ss') + C ss' where regulated, A(1 - ss') where free), h = sum L s of the rotors, and a the joint's axis:

    N = I wdot + w x (I w + h) + hdot                     moment of one carrier
    Q_j = a_j . (sum of N over the subtree of j)          joint torque; the root's M is the sum over all bodies
    p_j = a_j . (sum of H = I w + h over the subtree)     joint momentum, eq. (9): dT/dqdot_j
    dT/dq_j = a_j . (H_subtree x w_parent)                only w_parent turns against the frame of j

The root rows are Boltzmann-Hamel's by construction: they are the moment of momentum in turning axes. N and p have the
same form, so that one recursion gives accelerations from torques and rates from momenta.

The state is [q (n), v (3 + n), attitude (4), P (m), x (m)] with v = [Omega, qdot] for a free root and
v = [Omega(t), p] for a prescribed Omega, whose derivative is not needed then; attitude is the unit quaternion w, x, y,
z that takes root axes to inertial axes. P and x belong to the m servo rotors: axial momentum C (phidot + s . w) and
integral of the speed error.

A servo rotor is a free rotor, P s in place of L s, whose momentum the motor changes: Pdot = tau. N of its carrier then
has hdot = tau s besides, in other words the motor's reaction -tau s acts on the carrier. With dT/dqdot as momenta there
is no reaction: the motor's torque does virtual work along phi alone, and dT/dq at constant phidot is that above. The
same holds for regulated rotors whose L follows a course in time.

The force elements add to [M, Q]: springs, friction, cages and erections at their gimbals; an unbalance as the moment
-(m r) x f on its carrier.

Non-positive pivots give NaN, which the callers take as divergence.
"""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Number, choose, load, root, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays, forces
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.axes import from_parent, to_parent, whole_inertia_to_parent
from platform_ctrl.simulation.kernel.flexible import drive_torques, mode_derivatives
from platform_ctrl.simulation.kernel.placed import placed_derivative, placed_momenta
from platform_ctrl.simulation.kernel.slots import add, copy, put, times, vector
from platform_ctrl.simulation.kernel.vectors import Vector, cross, dot, minus, plus, scaled, turned


@inlined
def _outward(links: Links, mem: FloatArray, at: At, free: bool, bare: bool, y: int, around: int) -> None:
    """From the root to the tips: joints' cosines and sines; rates and moments at zero acceleration (free root)."""
    n = at.n
    momenta = around + n + 9
    for b in range(n + 1):
        slot = at.work + b * arrays.WORK
        copy(mem, slot + arrays.INERTIA, at.body + b * arrays.BODY, 6)
    copy(mem, at.work + arrays.RATE, y + n, 3)
    if at.weight != 0:
        put(mem, at.work + arrays.FORCE, forces.felt_by_root(mem, at, y, around))
    for m in range(n):
        k, up = links.tree[m, arrays.GIMBAL], at.work + links.tree[m, arrays.PARENT] * arrays.WORK
        slot = at.work + (k + 1) * arrays.WORK
        c, s = cosine_and_sine(load(mem, y + k))
        store(mem, slot + arrays.COS, c)
        store(mem, slot + arrays.SIN, s)
        if free:
            x, v, z = turned(c, s, from_parent(links, mem, m, up + arrays.RATE))
            rate = load(mem, y + n + 3 + k)
            put(mem, slot + arrays.RATE, (x, v, z + rate))
            store(mem, slot + arrays.PRODUCT, v * rate)
            store(mem, slot + arrays.PRODUCT + 1, -x * rate)
        if at.weight != 0:
            put(mem, slot + arrays.FORCE, turned(c, s, from_parent(links, mem, m, up + arrays.FORCE)))
    for b in range(n + 1):
        h = vector(mem, momenta + 3 * b)
        if bare:
            h = scaled(0.0, h)
        put(mem, at.work + b * arrays.WORK + arrays.MOMENT, h)
    if not bare:
        forces.servo_momenta(links, mem, at, y)
    if free:
        for b in range(n + 1):
            slot = at.work + b * arrays.WORK
            w = vector(mem, slot + arrays.RATE)
            N = cross(w, plus(times(mem, at.body + b * arrays.BODY, w), vector(mem, slot + arrays.MOMENT)))
            if at.course != 0 and not bare:
                N = plus(N, vector(mem, momenta + 3 * (n + 1 + b)))
            put(mem, slot + arrays.MOMENT, N)


@inlined
def _inward(links: Links, mem: FloatArray, at: At, moving: bool, locking: bool, torque: int) -> None:
    """From the tips to the root: articulated inertias and moments; `torque` holds the joints' torques (or momenta)."""
    n = at.n
    for m in range(n - 1, -1, -1):
        k, up = links.tree[m, arrays.GIMBAL], at.work + links.tree[m, arrays.PARENT] * arrays.WORK
        slot = at.work + (k + 1) * arrays.WORK
        c, s = load(mem, slot + arrays.COS), load(mem, slot + arrays.SIN)
        xx, yy, D = vector(mem, slot + arrays.INERTIA)
        xy, ux, uy = vector(mem, slot + arrays.INERTIA + 3)
        p0, p1, p2 = vector(mem, slot + arrays.MOMENT)
        tau = load(mem, torque + k)
        ease = choose(D > 0.0, 1.0 / D, float("nan") * D)
        if locking:
            ease = ease * (1.0 - load(mem, slot + arrays.LOCKED))
        gx, gy, drive = ux * ease, uy * ease, (tau - p2) * ease
        store(mem, slot + arrays.GAIN_X, gx)
        store(mem, slot + arrays.GAIN_Y, gy)
        store(mem, slot + arrays.DRIVE, drive)
        xx, xy, yy = xx - ux * gx, xy - ux * gy, yy - uy * gy
        p0, p1, p2 = p0 + ux * drive, p1 + uy * drive, p2 + D * drive
        if moving:
            cx, cy = load(mem, slot + arrays.PRODUCT), load(mem, slot + arrays.PRODUCT + 1)
            p0, p1 = p0 + xx * cx + xy * cy, p1 + xy * cx + yy * cy
        if locking or links.tree[m, arrays.SKEW] != 0:
            kept = 1.0 - D * ease  # 0, or 1 where the joint is locked
            if moving:
                p2 = p2 + kept * (ux * cx + uy * cy)
            put(mem, slot + arrays.INERTIA, (xx, yy, kept * D))
            put(mem, slot + arrays.INERTIA + 3, (xy, kept * ux, kept * uy))
            whole_inertia_to_parent(links, mem, at, m, slot + arrays.INERTIA)
        else:
            a, b = c * xx - s * xy, c * xy - s * yy
            turned = c * a - s * b
            add(mem, up + arrays.INERTIA + links.tree[m, arrays.XX], turned)
            add(mem, up + arrays.INERTIA + links.tree[m, arrays.YY], xx + yy - turned)
            add(mem, up + arrays.INERTIA + links.tree[m, arrays.XY], s * a + c * b)
        to_parent(links, mem, m, up + arrays.MOMENT, c, s, (p0, p1, p2))


@inlined
def _root_acceleration(mem: FloatArray, at: At, around: int) -> Vector:
    """Solve the root's three equations: articulated inertia times acceleration = M − moment."""
    xx, yy, zz = vector(mem, at.work + arrays.INERTIA)
    xy, xz, yz = vector(mem, at.work + arrays.INERTIA + 3)
    b0, b1, b2 = minus(vector(mem, around), vector(mem, at.work + arrays.MOMENT))
    d0 = choose(xx > 0.0, 1.0 / xx, float("nan") * xx)
    l10, l20 = xy * d0, xz * d0
    yy = yy - l10 * xy
    d1 = choose(yy > 0.0, 1.0 / yy, float("nan") * yy)
    yz = yz - l20 * xy
    l21 = yz * d1
    zz = zz - l20 * xz - l21 * yz
    d2 = choose(zz > 0.0, 1.0 / zz, float("nan") * zz)
    b1 = b1 - l10 * b0
    b2 = b2 - l20 * b0 - l21 * b1
    z = b2 * d2
    y = b1 * d1 - l21 * z
    return b0 * d0 - l10 * y - l20 * z, y, z


@inlined
def _accelerate(links: Links, mem: FloatArray, at: At, moving: bool, locking: bool, field: int, result: int) -> None:
    """From the root to the tips: the joints' accelerations (or rates) into `result`, the bodies' into `field`."""
    n = at.n
    for m in range(n):
        k, up = links.tree[m, arrays.GIMBAL], at.work + links.tree[m, arrays.PARENT] * arrays.WORK
        slot = at.work + (k + 1) * arrays.WORK
        c, s = load(mem, slot + arrays.COS), load(mem, slot + arrays.SIN)
        x, y, z = turned(c, s, from_parent(links, mem, m, up + field))
        if moving:
            x, y = x + load(mem, slot + arrays.PRODUCT), y + load(mem, slot + arrays.PRODUCT + 1)
        along = z
        if locking:
            along = z * (1.0 - load(mem, slot + arrays.LOCKED))
        own = load(mem, slot + arrays.DRIVE) - load(mem, slot + arrays.GAIN_X) * x - load(mem, slot + arrays.GAIN_Y) * y
        own = own - along
        store(mem, result + k, own)
        put(mem, slot + field, (x, y, z + own))


@inlined
def _sum_moments(links: Links, mem: FloatArray, at: At) -> None:
    """Sum MOMENT over the subtrees."""
    for m in range(at.n - 1, -1, -1):
        slot = at.work + (links.tree[m, arrays.GIMBAL] + 1) * arrays.WORK
        c, s = load(mem, slot + arrays.COS), load(mem, slot + arrays.SIN)
        up = at.work + links.tree[m, arrays.PARENT] * arrays.WORK + arrays.MOMENT
        to_parent(links, mem, m, up, c, s, vector(mem, slot + arrays.MOMENT))


@inlined
def _momenta(links: Links, mem: FloatArray, at: At, y: int, around: int) -> None:
    """Angular momenta of the subtrees into MOMENT, from the bodies' rates."""
    n = at.n
    for b in range(n + 1):
        slot = at.work + b * arrays.WORK
        H = times(mem, at.body + b * arrays.BODY, vector(mem, slot + arrays.RATE))
        put(mem, slot + arrays.MOMENT, plus(H, vector(mem, around + n + 9 + 3 * b)))
    forces.servo_momenta(links, mem, at, y)
    _sum_moments(links, mem, at)


@inlined
def _turn(mem: FloatArray, at: At, y: int, dy: int) -> None:
    """Derivative of the attitude."""
    W0, W1, W2 = vector(mem, y + at.n)
    e, d = y + 2 * at.n + 3, dy + 2 * at.n + 3
    e0, (e1, e2, e3) = 0.5 * load(mem, e), scaled(0.5, vector(mem, e + 1))
    store(mem, d, -e1 * W0 - e2 * W1 - e3 * W2)
    store(mem, d + 1, e0 * W0 + e2 * W2 - e3 * W1)
    store(mem, d + 2, e0 * W1 + e3 * W0 - e1 * W2)
    store(mem, d + 3, e0 * W2 + e1 * W1 - e2 * W0)


@internal
def derivative(
    links: Links, mem: FloatArray, at: At, free: bool, locking: bool, bare: bool, y: int, around: int, dy: int
) -> None:
    """Derivative of the state at slot `y` in the surroundings at slot `around`, into slot `dy`.

    With a prescribed Omega, v[:3] must hold its value at this instant. With `locking`, gimbals whose LOCKED is 1 do
    not turn: qdot = const (free root) or qdot = 0 (prescribed Omega; its momentum then means nothing). With `bare`
    rotors and force elements are left out.
    """
    n = at.n
    torque = dy + n + 3  # the joints' torques, replaced by their accelerations
    if placed_derivative(links, mem, at, free, locking, bare, y, around, dy):
        _turn(mem, at, y, dy)
        return
    _outward(links, mem, at, free, bare, y, around)
    if free:
        forces.free_rates(mem, at, locking, y, dy)
    else:
        _inward(links, mem, at, at.no, locking, y + n + 3)
        _accelerate(links, mem, at, at.no, locking, arrays.RATE, dy)
        for k in range(n):
            store(mem, torque + k, 0.0 * load(mem, dy + k))
    forces.joint_torques(mem, at, bare, y, around, dy)
    if not bare:
        drive_torques(links, mem, at, y, around, dy)
    if free:
        if at.weight != 0 and not bare:
            forces.unbalance_moments(mem, at)
            forces.erection_torques(links, mem, at, torque)
        if at.servos != 0 and not bare:
            forces.servo_drives(links, mem, at, at.yes, y, dy)
        _inward(links, mem, at, at.yes, locking, torque)
        acceleration = _root_acceleration(mem, at, around)
        put(mem, dy + n, acceleration)
        put(mem, at.work + arrays.ACCELERATION, acceleration)
        _accelerate(links, mem, at, at.yes, locking, arrays.ACCELERATION, torque)
    else:
        if at.weight != 0:
            # Moments that act on the carriers, summed over the subtrees.
            zero = 0.0 * load(mem, y)
            for b in range(n + 1):
                put(mem, at.work + b * arrays.WORK + arrays.MOMENT, (zero, zero, zero))
            forces.unbalance_moments(mem, at)
            _sum_moments(links, mem, at)
            for k in range(n):
                add(mem, torque + k, -load(mem, at.work + (k + 1) * arrays.WORK + arrays.MOMENT + 2))
            forces.erection_torques(links, mem, at, torque)
        _momenta(links, mem, at, y, around)
        for k in range(n):
            slot = at.work + (k + 1) * arrays.WORK
            H0, H1, _ = vector(mem, slot + arrays.MOMENT)
            w0, w1, _ = vector(mem, slot + arrays.RATE)
            add(mem, torque + k, H0 * w1 - H1 * w0)
        if at.servos != 0:
            forces.servo_drives(links, mem, at, at.no, y, dy)
        for i in range(3):
            store(mem, dy + n + i, 0.0 * load(mem, y + n + i))
    if at.modes != 0:
        mode_derivatives(mem, at, y, around, dy)
    _turn(mem, at, y, dy)


@inlined
def at_rest(mem: FloatArray, at: At) -> None:
    """Fill the spare state with the angles of the state, without rates, and the spare block with nothing that acts."""
    n = at.n
    zero = 0.0 * load(mem, at.state)
    copy(mem, at.spare_state, at.state, at.size)
    for i in range(n + 3):
        store(mem, at.spare_state + n + i, zero)
    for i in range(2 * at.modes):
        store(mem, at.spare_state + at.swings + i, zero)
    for i in range(at.block):
        store(mem, at.spare_block + i, zero)


@internal
def response(links: Links, mem: FloatArray, at: At, free: bool, k: int, dy: int) -> None:
    """Response to a unit impulse at joint k: rates of the joints into dy[:n], with a free root all rates behind."""
    n, state, block = at.n, at.spare_state, at.spare_block
    at_rest(mem, at)
    zero = 0.0 * load(mem, at.state)
    if free:
        store(mem, block + 3 + k, zero + 1.0)
    else:
        store(mem, state + n + 3 + k, zero + 1.0)
    derivative(links, mem, at, free, at.no, at.yes, state, block, dy)
    if free:
        copy(mem, dy, dy + n + 3, n)


@inlined
def push(mem: FloatArray, at: At, free: bool, k: int, dy: int, impulse: Number) -> None:
    """Change the state by an impulse at joint k; with a free root `dy` holds the response to it."""
    n = at.n
    if free:
        for i in range(n, 2 * n + 3):
            add(mem, at.state + i, impulse * load(mem, dy + i))
    else:
        add(mem, at.state + n + 3 + k, impulse)


@internal
def joint_momenta(links: Links, mem: FloatArray, at: At, around: int, result: int) -> None:
    """Joint momenta dT/dqdot of the state, whose v holds the rates; all of it stays in the root's MOMENT."""
    if not placed_momenta(links, mem, at, at.state, around):
        _outward(links, mem, at, at.yes, at.no, at.state, around)
        _momenta(links, mem, at, at.state, around)
    for k in range(at.n):
        store(mem, result + k, load(mem, at.work + (k + 1) * arrays.WORK + arrays.MOMENT + 2))


@internal
def start_servos(links: Links, mem: FloatArray, at: At) -> None:
    """Put the servo rotors' momenta in the place of their spins in the state, whose v holds the rates."""
    if at.servos == 0:
        return
    joint_momenta(links, mem, at, at.surroundings, at.stages)
    for r in range(at.servos):
        axis, rate = at.servo + r * arrays.SERVO, at.work + links.servo_carrier[r] * arrays.WORK + arrays.RATE
        p, carried = at.state + 2 * at.n + 7 + r, dot(vector(mem, axis), vector(mem, rate))
        store(mem, p, load(mem, axis + arrays.C) * (load(mem, p) + carried))


@internal
def runge_kutta(links: Links, mem: FloatArray, at: At, free: bool, locking: bool, step: Number) -> None:
    """One step of the classical Runge-Kutta method, of the state; three blocks of surroundings hold what acts."""
    n, size, y = at.n, at.size, at.state
    now, dy, total = at.stages, at.stages + size, at.stages + 2 * size
    block = at.block
    if not free:
        copy(mem, y + n, at.surroundings + n + 3, 3)
    copy(mem, now, y, size)
    for i in range(size):
        store(mem, total + i, 0.0 * step)
    for stage in range(4):
        around = at.surroundings + (stage + 1) // 2 * block
        if at.keeps != 0:
            store(mem, at.during, 0.5 * ((stage + 1) // 2) * step)
        derivative(links, mem, at, free, locking, at.no, now, around, dy)
        if at.keeps != 0:
            forces.stand_still(mem, at, now, dy)
        ahead, weight = step if stage == 2 else 0.5 * step, 2.0 if 0 < stage < 3 else 1.0
        for i in range(size):
            d = load(mem, dy + i)
            add(mem, total + i, weight * d)
            store(mem, now + i, load(mem, y + i) + ahead * d)
        if not free and stage < 3:
            block_ahead = at.surroundings + (stage + 2) // 2 * block
            copy(mem, now + n, block_ahead + n + 3, 3)
    sixth = step / 6.0
    for i in range(size):
        add(mem, y + i, sixth * load(mem, total + i))
    if not free:
        copy(mem, y + n, at.surroundings + 2 * block + n + 3, 3)
    e = y + 2 * n + 3
    w, v = load(mem, e), vector(mem, e + 1)
    scale = 1.0 / root(w * w + dot(v, v))
    store(mem, e, scale * w)
    put(mem, e + 1, scaled(scale, v))
