"""Equations of motion of bodies with masses and joints that lie anywhere, and of geared motors.

Every body counts from its joint: m its mass, S = m c its first moment, J its inertia about the joint, of geared rotors
that it carries J_m a a' included. With the velocity v and the acceleration less gravity a of the joint

    p = m v + w x S                     H = J w + S x v + h              momenta of one carrier, H about its joint
    F = m a + wdot x S + w x (w x S)    N = J wdot + w x (J w + h) + hdot + S x a
    Q_j = z . N_subtree                 dT/dq_j = z . (H_subtree x w_parent + p_subtree x v_j)

A* is the inertia of the subtrees (composite bodies, Featherstone 2008, ch. 6), P u their momentum. A floating root
keeps its linear momentum, 0: A* - P'P/m, v = -P u/m, a = -F/m at the root. A geared rotor turns at N qdot in the
parent.
"""

from __future__ import annotations

from typing import Any

from platform_ctrl.common.compiling import internal, overloading
from platform_ctrl.common.simd import Number, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import Vector, add, copy, put, times, vector
from platform_ctrl.simulation.kernel.arrays import At, Links, PlacedLinks
from platform_ctrl.simulation.kernel.composites import add_vector, gather, in_gimbal, in_parent, mass_matrix, solve
from platform_ctrl.simulation.kernel.flexible import drive_torques, mode_derivatives, mode_rates, of_modes
from platform_ctrl.simulation.kernel.forces import cross, erection_torques, joint_torque, servo_drives, servo_momenta


@internal
def _move(links: Links, mem: FloatArray, at: At, Omega: int, rates: int) -> None:
    """Bodies' rates, and their joints' velocities, against the root's origin or a floating plant's mass centre."""
    w0, w1, w2 = vector(mem, Omega)
    put(mem, at.work + arrays.RATE, w0, w1, w2)
    for i in range(3):
        speed = 0.0 * w0
        if at.floating != 0:
            for j in range(3 + at.n):
                u = load(mem, Omega + j if j < 3 else rates + j - 3)
                speed = speed - load(mem, at.push + 3 * j + i) * u
            speed = speed / load(mem, at.moving + arrays.WHOLE)
        store(mem, at.moving + arrays.SPEED + i, speed)
    for m in range(at.n):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        w0, w1, w2 = vector(mem, at.work + parent * arrays.WORK + arrays.RATE)
        d0, d1, d2 = vector(mem, at.place + b * arrays.PLACE + arrays.ARM)
        x, y, z = cross(w0, w1, w2, d0, d1, d2)
        v0, v1, v2 = vector(mem, at.moving + parent * arrays.MOVING + arrays.SPEED)
        v0, v1, v2 = in_gimbal(links, mem, at, m, v0 + x, v1 + y, v2 + z)
        put(mem, at.moving + b * arrays.MOVING + arrays.SPEED, v0, v1, v2)
        w0, w1, w2 = in_gimbal(links, mem, at, m, w0, w1, w2)
        put(mem, at.work + b * arrays.WORK + arrays.RATE, w0, w1, w2 + load(mem, rates + b - 1))


@internal
def _rotors(links: Links, mem: FloatArray, at: At, y: int, around: int, rates: int) -> None:
    """Momenta of the rotors against their carriers into MOMENT, of geared ones too."""
    for b in range(at.n + 1):
        copy(mem, at.work + b * arrays.WORK + arrays.MOMENT, around + at.n + 9 + 3 * b, 3)
    servo_momenta(links, mem, at, y, arrays.MOMENT)
    for m in range(at.n):
        k, parent = links.tree[m, arrays.GIMBAL], links.tree[m, arrays.PARENT]
        h2 = load(mem, at.place + (k + 1) * arrays.PLACE + arrays.GEARED) * load(mem, rates + k)
        h0, h1, h2 = in_parent(links, mem, at, m, 0.0 * h2, 0.0 * h2, h2)
        add_vector(mem, at.work + parent * arrays.WORK + arrays.MOMENT, h0, h1, h2)


@internal
def _inward(links: Links, mem: FloatArray, at: At) -> None:
    """Sums over the subtrees: MOMENT about the joints, and LINEAR."""
    for m in range(at.n - 1, -1, -1):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        N0, N1, N2 = vector(mem, at.work + b * arrays.WORK + arrays.MOMENT)
        F0, F1, F2 = vector(mem, at.moving + b * arrays.MOVING + arrays.LINEAR)
        N0, N1, N2 = in_parent(links, mem, at, m, N0, N1, N2)
        F0, F1, F2 = in_parent(links, mem, at, m, F0, F1, F2)
        d0, d1, d2 = vector(mem, at.place + b * arrays.PLACE + arrays.ARM)
        x, y, z = cross(d0, d1, d2, F0, F1, F2)
        add_vector(mem, at.work + parent * arrays.WORK + arrays.MOMENT, N0 + x, N1 + y, N2 + z)
        add_vector(mem, at.moving + parent * arrays.MOVING + arrays.LINEAR, F0, F1, F2)


@internal
def _momenta(links: Links, mem: FloatArray, at: At, y: int, around: int, rates: int) -> None:
    """Momenta of the subtrees at the rates of `_move`: MOMENT, whose third component is dT/dqdot, and LINEAR."""
    _rotors(links, mem, at, y, around, rates)
    for b in range(at.n + 1):
        work, own, place = at.work + b * arrays.WORK, at.moving + b * arrays.MOVING, at.place + b * arrays.PLACE
        w0, w1, w2 = vector(mem, work + arrays.RATE)
        v0, v1, v2 = vector(mem, own + arrays.SPEED)
        S0, S1, S2 = vector(mem, place + arrays.FIRST_MOMENT)
        mass = load(mem, place + arrays.MASS)
        H0, H1, H2 = times(mem, at.body + b * arrays.BODY, w0, w1, w2)
        x, z, s = cross(S0, S1, S2, v0, v1, v2)
        add_vector(mem, work + arrays.MOMENT, H0 + x, H1 + z, H2 + s)
        x, z, s = cross(w0, w1, w2, S0, S1, S2)
        put(mem, own + arrays.LINEAR, mass * v0 + x, mass * v1 + z, mass * v2 + s)
    _inward(links, mem, at)
    for k in range(at.n):
        work, place = at.work + (k + 1) * arrays.WORK, at.place + (k + 1) * arrays.PLACE + arrays.GEARED
        rate = load(mem, rates + k)
        carried = load(mem, work + arrays.RATE + 2) - rate
        add(mem, work + arrays.MOMENT + 2, load(mem, place) * carried + load(mem, place + 1) * rate)


@internal
def _weight(mem: FloatArray, at: At, b: int, i: int) -> Number:
    """Component i of S x f, what holds the subtree of a body in the field: of its masses and unbalance."""
    own = at.moving + b * arrays.MOVING
    j, k = (i + 1) % 3, (i + 2) % 3
    S1, S2 = load(mem, own + arrays.LOPSIDED + j), load(mem, own + arrays.LOPSIDED + k)
    if at.floating == 0:
        S1, S2 = S1 + load(mem, own + arrays.SUM + j), S2 + load(mem, own + arrays.SUM + k)
    force = at.work + b * arrays.WORK + arrays.FORCE
    return S1 * load(mem, force + k) - S2 * load(mem, force + j)


@internal
def _rates(links: Links, mem: FloatArray, at: At, locking: bool, y: int, around: int, dy: int) -> None:
    """Qdot of a prescribed Omega into dy[:n], and dT/dq less the weight into the torques' slots: all but Q of pdot."""
    n = at.n
    gather(links, mem, at, y, around)
    mass_matrix(links, mem, at, locking)
    for k in range(n):
        store(mem, dy + k, 0.0 * load(mem, y + k))
    # What the joints have of dT/dqdot at rest in the root is that of Omega, the rotors and the modes.
    mode_rates(mem, at, y, dy)
    _move(links, mem, at, y + n, dy)
    _momenta(links, mem, at, y, around, dy)
    for k in range(n):
        work = at.work + (k + 1) * arrays.WORK
        own = load(mem, y + n + 3 + k) - load(mem, work + arrays.MOMENT + 2)
        own = own - of_modes(mem, at, at.swing, 1, 3 + k)
        if locking:
            own = own * (1.0 - load(mem, work + arrays.LOCKED))
        store(mem, dy + k, own)
    solve(mem, at, 3, dy - 3)
    _move(links, mem, at, y + n, dy)
    _momenta(links, mem, at, y, around, dy)
    for k in range(n):
        work, own = at.work + (k + 1) * arrays.WORK, at.moving + (k + 1) * arrays.MOVING
        H0, H1, _ = vector(mem, work + arrays.MOMENT)
        w0, w1, _ = vector(mem, work + arrays.RATE)
        p0, p1, _ = vector(mem, own + arrays.LINEAR)
        v0, v1, _ = vector(mem, own + arrays.SPEED)
        change = H0 * w1 - H1 * w0 + p0 * v1 - p1 * v0
        store(mem, dy + n + 3 + k, change - _weight(mem, at, k + 1, 2))


@internal
def _at_arm(mem: FloatArray, work: int, arm: int) -> Vector:
    """Acceleration wdot x r + w x (w x r) of a point of a body, r away from its joint."""
    w0, w1, w2 = vector(mem, work + arrays.RATE)
    e0, e1, e2 = vector(mem, work + arrays.ACCELERATION)
    r0, r1, r2 = vector(mem, arm)
    x, y, z = cross(w0, w1, w2, r0, r1, r2)
    x, y, z = cross(w0, w1, w2, x, y, z)
    r0, r1, r2 = cross(e0, e1, e2, r0, r1, r2)
    return x + r0, y + r1, z + r2


@internal
def _hold(links: Links, mem: FloatArray, at: At, bare: bool, around: int, rates: int) -> None:
    """Forces and moments of the subtrees, into LINEAR and MOMENT, that the present rates need without accelerations."""
    n = at.n
    zero = 0.0 * load(mem, at.work + arrays.RATE)
    put(mem, at.work + arrays.ACCELERATION, zero, zero, zero)
    put(mem, at.moving + arrays.FELT, zero, zero, zero)
    for m in range(n):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        work, up = at.work + b * arrays.WORK, at.work + parent * arrays.WORK
        x, y, z = _at_arm(mem, up, at.place + b * arrays.PLACE + arrays.ARM)
        a0, a1, a2 = vector(mem, at.moving + parent * arrays.MOVING + arrays.FELT)
        a0, a1, a2 = in_gimbal(links, mem, at, m, a0 + x, a1 + y, a2 + z)
        put(mem, at.moving + b * arrays.MOVING + arrays.FELT, a0, a1, a2)
        e0, e1, e2 = vector(mem, up + arrays.ACCELERATION)
        e0, e1, e2 = in_gimbal(links, mem, at, m, e0, e1, e2)
        w0, w1, _ = vector(mem, work + arrays.RATE)
        rate = load(mem, rates + b - 1)
        put(mem, work + arrays.ACCELERATION, e0 + w1 * rate, e1 - w0 * rate, e2)
    for b in range(n + 1):
        work, own, place = at.work + b * arrays.WORK, at.moving + b * arrays.MOVING, at.place + b * arrays.PLACE
        w0, w1, w2 = vector(mem, work + arrays.RATE)
        H0, H1, H2 = times(mem, at.body + b * arrays.BODY, w0, w1, w2)
        h0, h1, h2 = vector(mem, work + arrays.MOMENT)
        x, y, z = cross(w0, w1, w2, H0 + h0, H1 + h1, H2 + h2)
        if at.course != 0 and not bare:
            h0, h1, h2 = vector(mem, around + n + 9 + 3 * (n + 1 + b))
            x, y, z = x + h0, y + h1, z + h2
        e0, e1, e2 = vector(mem, work + arrays.ACCELERATION)
        e0, e1, e2 = times(mem, at.body + b * arrays.BODY, e0, e1, e2)
        x, y, z = x + e0, y + e1, z + e2
        S0, S1, S2 = vector(mem, place + arrays.FIRST_MOMENT)
        a0, a1, a2 = vector(mem, own + arrays.FELT)
        h0, h1, h2 = cross(S0, S1, S2, a0, a1, a2)
        put(mem, work + arrays.MOMENT, x + h0, y + h1, z + h2)
        mass = load(mem, place + arrays.MASS)
        x, y, z = _at_arm(mem, work, place + arrays.FIRST_MOMENT)
        put(mem, own + arrays.LINEAR, mass * a0 + x, mass * a1 + y, mass * a2 + z)


@internal
def _accelerations(
    links: Links, mem: FloatArray, at: At, locking: bool, bare: bool, y: int, around: int, dy: int
) -> None:
    """Accelerations of a free root into dy[n:], which holds [M, Q] before; dy[:n] are the joints' rates."""
    n, u = at.n, dy + at.n
    gather(links, mem, at, y, around)
    mass_matrix(links, mem, at, locking)
    if not bare:
        erection_torques(links, mem, at, u + 3)
    _move(links, mem, at, y + n, dy)
    _rotors(links, mem, at, y, around, dy)
    zero = 0.0 * load(mem, y)
    if bare:
        for b in range(n + 1):
            put(mem, at.work + b * arrays.WORK + arrays.MOMENT, zero, zero, zero)
    _hold(links, mem, at, bare, around, dy)
    if at.servos != 0 and not bare:
        servo_drives(links, mem, at, at.yes, y, dy)
    _inward(links, mem, at)
    if at.floating != 0:
        ease = 1.0 / load(mem, at.moving + arrays.WHOLE)
        F0, F1, F2 = vector(mem, at.moving + arrays.LINEAR)
        for i in range(n + 3):
            p0, p1, p2 = vector(mem, at.push + 3 * i)
            add(mem, u + i, ease * (p0 * F0 + p1 * F1 + p2 * F2))
    for i in range(3):
        add(mem, u + i, -load(mem, at.work + arrays.MOMENT + i))
        if not bare:
            add(mem, u + i, -_weight(mem, at, 0, i))
    for k in range(n):
        work = at.work + (k + 1) * arrays.WORK
        geared = load(mem, at.place + (k + 1) * arrays.PLACE + arrays.GEARED)
        held = load(mem, work + arrays.MOMENT + 2) + geared * load(mem, work + arrays.ACCELERATION + 2)
        if not bare:
            held = held + _weight(mem, at, k + 1, 2)
        total = load(mem, u + 3 + k) - held
        if locking:
            total = total * (1.0 - load(mem, work + arrays.LOCKED))
        store(mem, u + 3 + k, total)
    if at.modes != 0 and not bare:
        # A* u' = Q - Γ η'' with η'' = f - Γ'u': A* - ΓΓ' has taken the place of A*.
        mode_derivatives(mem, at, y, around, dy)
        h0, h1 = of_modes(mem, at, at.swing, 1, 0), of_modes(mem, at, at.swing, 1, 1)
        w0, w1, w2 = vector(mem, y + n)
        h0, h1, h2 = cross(w0, w1, w2, h0, h1, of_modes(mem, at, at.swing, 1, 2))
        add_vector(mem, u, -h0, -h1, -h2)
        for i in range(n + 3):
            pushed = of_modes(mem, at, dy + at.swings + 1, 2, i)
            if locking and i >= 3:
                pushed = pushed * (1.0 - load(mem, at.work + (i - 2) * arrays.WORK + arrays.LOCKED))
            add(mem, u + i, -pushed)
    solve(mem, at, 0, u)


@internal
def _derivative(
    links: Links, mem: FloatArray, at: At, free: bool, locking: bool, bare: bool, y: int, around: int, dy: int
) -> None:
    """Derivative of a state without its attitude: see `dynamics.derivative`."""
    n = at.n
    torque = dy + n + 3
    if not free:
        _rates(links, mem, at, locking, y, around, dy)
    for k in range(n):
        if free:
            rate = load(mem, y + n + 3 + k)
            if locking:
                rate = rate * (1.0 - load(mem, at.work + (k + 1) * arrays.WORK + arrays.LOCKED))
            store(mem, dy + k, rate)
            store(mem, torque + k, 0.0 * rate)
        Q = load(mem, around + 3 + k)
        if at.joints != 0 and not bare:
            Q = Q + joint_torque(mem, at, y, k, load(mem, dy + k))
        add(mem, torque + k, Q)
    if not bare:
        drive_torques(links, mem, at, y, around, dy)
    if free:
        copy(mem, dy + n, around, 3)
        _accelerations(links, mem, at, locking, bare, y, around, dy)
    else:
        for i in range(3):
            store(mem, dy + n + i, 0.0 * load(mem, y + n + i))
        if at.servos != 0:
            servo_drives(links, mem, at, at.no, y, dy)
        erection_torques(links, mem, at, torque)
        mode_derivatives(mem, at, y, around, dy)


@internal
def _joint_momenta(links: Links, mem: FloatArray, at: At, y: int, around: int) -> None:
    """Momenta of the subtrees of a state whose v holds the rates: see `dynamics.joint_momenta`."""
    gather(links, mem, at, y, around)
    if at.floating != 0:
        mass_matrix(links, mem, at, at.no)
    _move(links, mem, at, y + at.n, y + at.n + 3)
    _momenta(links, mem, at, y, around, y + at.n + 3)
    mode_rates(mem, at, y, y + at.n + 3)
    for k in range(at.n):
        add(mem, at.work + (k + 1) * arrays.WORK + arrays.MOMENT + 2, of_modes(mem, at, at.swing, 1, 3 + k))


def _of_placed(function: Any) -> Any:
    """Return what calls a function and returns True if masses and joints lie anywhere, and returns False otherwise.

    Code for centred plants, whose links are of another type, does not contain the function, and is compiled sooner.
    """

    def called(links: Any, *rest: Any) -> bool:
        if isinstance(links, PlacedLinks):
            function(links, *rest)
            return True
        return False

    @overloading(called)
    def _choice(links: Any, *rest: Any) -> Any:
        if links.instance_class is not PlacedLinks:
            return lambda links, *rest: False

        def there(links: Any, *rest: Any) -> bool:
            function(links, *rest)
            return True

        return there

    return called


# As `dynamics.derivative`, but for the attitude; and the subtrees' momenta into MOMENT.
placed_derivative, placed_momenta = _of_placed(_derivative), _of_placed(_joint_momenta)
