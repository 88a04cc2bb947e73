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
from platform_ctrl.simulation.kernel.arrays import At, Links, PlacedLinks
from platform_ctrl.simulation.kernel.composites import gather, in_gimbal, in_parent, mass_matrix, solve
from platform_ctrl.simulation.kernel.flexible import drive_torques, mode_derivatives, mode_rates, of_modes
from platform_ctrl.simulation.kernel.forces import (
    erection_torques,
    free_rates,
    joint_torques,
    servo_drives,
    servo_momenta,
)
from platform_ctrl.simulation.kernel.slots import add, add_vector, copy, put, times, vector
from platform_ctrl.simulation.kernel.vectors import Vector, cross, dot, plus, scaled


@internal
def _move(links: Links, mem: FloatArray, at: At, Omega: int, rates: int) -> None:
    """Bodies' rates, and their joints' velocities, against the root's origin or a floating plant's mass centre."""
    copy(mem, at.work + arrays.RATE, Omega, 3)
    speed = scaled(0.0, vector(mem, Omega))
    if at.floating != 0:
        for j in range(3 + at.n):
            u = load(mem, Omega + j if j < 3 else rates + j - 3)
            speed = plus(speed, scaled(-u, vector(mem, at.push + 3 * j)))
        speed = scaled(1.0 / load(mem, at.moving + arrays.WHOLE), speed)
    put(mem, at.moving + arrays.SPEED, speed)
    for m in range(at.n):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        w, arm = vector(mem, at.work + parent * arrays.WORK + arrays.RATE), at.place + b * arrays.PLACE + arrays.ARM
        v = plus(vector(mem, at.moving + parent * arrays.MOVING + arrays.SPEED), cross(w, vector(mem, arm)))
        put(mem, at.moving + b * arrays.MOVING + arrays.SPEED, in_gimbal(links, mem, at, m, v))
        put(mem, at.work + b * arrays.WORK + arrays.RATE, in_gimbal(links, mem, at, m, w))
        add(mem, at.work + b * arrays.WORK + arrays.RATE + 2, load(mem, rates + b - 1))


@internal
def _rotors(links: Links, mem: FloatArray, at: At, y: int, around: int, rates: int) -> None:
    """Momenta of the rotors against their carriers into MOMENT, of geared ones too."""
    for b in range(at.n + 1):
        copy(mem, at.work + b * arrays.WORK + arrays.MOMENT, around + at.n + 9 + 3 * b, 3)
    servo_momenta(links, mem, at, y)
    for m in range(at.n):
        k, parent = links.tree[m, arrays.GIMBAL], links.tree[m, arrays.PARENT]
        h2 = load(mem, at.place + (k + 1) * arrays.PLACE + arrays.GEARED) * load(mem, rates + k)
        h = in_parent(links, mem, at, m, (0.0 * h2, 0.0 * h2, h2))
        add_vector(mem, at.work + parent * arrays.WORK + arrays.MOMENT, h)


@internal
def _inward(links: Links, mem: FloatArray, at: At) -> None:
    """Sums over the subtrees: MOMENT about the joints, and LINEAR."""
    for m in range(at.n - 1, -1, -1):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        N = in_parent(links, mem, at, m, vector(mem, at.work + b * arrays.WORK + arrays.MOMENT))
        F = in_parent(links, mem, at, m, vector(mem, at.moving + b * arrays.MOVING + arrays.LINEAR))
        N = plus(N, cross(vector(mem, at.place + b * arrays.PLACE + arrays.ARM), F))
        add_vector(mem, at.work + parent * arrays.WORK + arrays.MOMENT, N)
        add_vector(mem, at.moving + parent * arrays.MOVING + arrays.LINEAR, F)


@internal
def _momenta(links: Links, mem: FloatArray, at: At, y: int, around: int, rates: int) -> None:
    """Momenta of the subtrees at the rates of `_move`: MOMENT, whose third component is dT/dqdot, and LINEAR."""
    _rotors(links, mem, at, y, around, rates)
    for b in range(at.n + 1):
        work, own, place = at.work + b * arrays.WORK, at.moving + b * arrays.MOVING, at.place + b * arrays.PLACE
        w, v = vector(mem, work + arrays.RATE), vector(mem, own + arrays.SPEED)
        mass, S = load(mem, place + arrays.MASS), vector(mem, place + arrays.FIRST_MOMENT)
        add_vector(mem, work + arrays.MOMENT, plus(times(mem, at.body + b * arrays.BODY, w), cross(S, v)))
        put(mem, own + arrays.LINEAR, plus(scaled(mass, v), cross(w, S)))
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
    w, r = vector(mem, work + arrays.RATE), vector(mem, arm)
    return plus(cross(w, cross(w, r)), cross(vector(mem, work + arrays.ACCELERATION), r))


@internal
def _hold(links: Links, mem: FloatArray, at: At, bare: bool, around: int, rates: int) -> None:
    """Forces and moments of the subtrees, into LINEAR and MOMENT, that the present rates need without accelerations."""
    n = at.n
    zero = scaled(0.0, vector(mem, at.work + arrays.RATE))
    put(mem, at.work + arrays.ACCELERATION, zero)
    put(mem, at.moving + arrays.FELT, zero)
    for m in range(n):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        work, up = at.work + b * arrays.WORK, at.work + parent * arrays.WORK
        a = _at_arm(mem, up, at.place + b * arrays.PLACE + arrays.ARM)
        a = plus(vector(mem, at.moving + parent * arrays.MOVING + arrays.FELT), a)
        put(mem, at.moving + b * arrays.MOVING + arrays.FELT, in_gimbal(links, mem, at, m, a))
        e0, e1, e2 = in_gimbal(links, mem, at, m, vector(mem, up + arrays.ACCELERATION))
        w0, w1, _ = vector(mem, work + arrays.RATE)
        rate = load(mem, rates + b - 1)
        put(mem, work + arrays.ACCELERATION, (e0 + w1 * rate, e1 - w0 * rate, e2))
    for b in range(n + 1):
        work, own, place = at.work + b * arrays.WORK, at.moving + b * arrays.MOVING, at.place + b * arrays.PLACE
        inertia, w = at.body + b * arrays.BODY, vector(mem, work + arrays.RATE)
        N = cross(w, plus(times(mem, inertia, w), vector(mem, work + arrays.MOMENT)))
        if at.course != 0 and not bare:
            N = plus(N, vector(mem, around + n + 9 + 3 * (n + 1 + b)))
        N = plus(N, times(mem, inertia, vector(mem, work + arrays.ACCELERATION)))
        a, mass = vector(mem, own + arrays.FELT), load(mem, place + arrays.MASS)
        put(mem, work + arrays.MOMENT, plus(N, cross(vector(mem, place + arrays.FIRST_MOMENT), a)))
        put(mem, own + arrays.LINEAR, plus(scaled(mass, a), _at_arm(mem, work, place + arrays.FIRST_MOMENT)))


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
    if bare:
        zero = 0.0 * load(mem, y)
        for b in range(n + 1):
            put(mem, at.work + b * arrays.WORK + arrays.MOMENT, (zero, zero, zero))
    _hold(links, mem, at, bare, around, dy)
    if at.servos != 0 and not bare:
        servo_drives(links, mem, at, at.yes, y, dy)
    _inward(links, mem, at)
    if at.floating != 0:
        ease = 1.0 / load(mem, at.moving + arrays.WHOLE)
        F = vector(mem, at.moving + arrays.LINEAR)
        for i in range(n + 3):
            add(mem, u + i, ease * dot(vector(mem, at.push + 3 * i), F))
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
        h = of_modes(mem, at, at.swing, 1, 0), of_modes(mem, at, at.swing, 1, 1), of_modes(mem, at, at.swing, 1, 2)
        add_vector(mem, u, cross(h, vector(mem, y + n)))
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
    if free:
        free_rates(mem, at, locking, y, dy)
    else:
        _rates(links, mem, at, locking, y, around, dy)
    joint_torques(mem, at, bare, y, around, dy)
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
        erection_torques(links, mem, at, dy + n + 3)
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
