"""What is not rigid: shafts and gears that give way, currents of motors, cogging, and modes of the structure."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined
from platform_ctrl.common.simd import Number, choose, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine, within
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.forces import contact, felt_by_root, missing_torque
from platform_ctrl.simulation.kernel.slots import add, put, vector
from platform_ctrl.simulation.kernel.vectors import dot


@inlined
def mode_rates(mem: FloatArray, at: At, y: int, rates: int) -> None:
    """Rates of the modes of a state whose v begins with Omega, with the joints' rates: their momenta less Γ·u."""
    for j in range(at.modes):
        own = at.mode + j * (at.shape + at.torquers) + arrays.INERTIAL
        rate = load(mem, y + at.swings + 2 * j + 1) - dot(vector(mem, own), vector(mem, y + at.n))
        if at.placed != 0:
            for k in range(at.n):
                rate = rate - load(mem, own + 3 + k) * load(mem, rates + k)
        store(mem, at.swing + j, rate)


@inlined
def of_modes(mem: FloatArray, at: At, values: int, apart: int, i: int) -> Number:
    """Sum over the modes of Γ of coordinate i of u times a value of each, `apart` slots from one another."""
    total = 0.0 * load(mem, at.state)
    for j in range(at.modes):
        share = load(mem, at.mode + j * (at.shape + at.torquers) + arrays.INERTIAL + i)
        total = total + share * load(mem, values + apart * j)
    return total


@inlined
def mode_derivatives(mem: FloatArray, at: At, y: int, around: int, dy: int) -> None:
    """Derivatives of the modes' states; the first slots of `dy` have the joints' rates."""
    mode_rates(mem, at, y, dy)
    f = felt_by_root(mem, at, y, around)
    for j in range(at.modes):
        row, eta = at.mode + j * (at.shape + at.torquers), at.swings + 2 * j
        rate = load(mem, at.swing + j)
        force = load(mem, around + at.block - at.modes + j) - dot(vector(mem, row + arrays.BASE_FORCE), f)
        for m in range(at.windings):
            shape = load(mem, row + at.shape + at.torquers - at.windings + m)
            force = force + shape * missing_torque(mem, at, y, around, m)
        force = force - load(mem, row + arrays.SQUARE) * load(mem, y + eta)
        store(mem, dy + eta, rate)
        store(mem, dy + eta + 1, force - load(mem, row + arrays.DAMPING) * rate)


@inlined
def drive_torques(links: Links, mem: FloatArray, at: At, y: int, around: int, dy: int) -> None:
    """Add the torques of drives to the joints' in `dy`, behind the joints' rates there; derivatives of currents."""
    n, zero = at.n, 0.0 * load(mem, y)
    torque, first = dy + n + 3, links.drive.shape[0] - at.windings - at.teeth - at.ripples
    for d in range(first):
        k, motor = links.drive[d, 0], links.drive[d, 1]
        apart = load(mem, y + motor) - load(mem, y + k)
        turning = load(mem, dy + motor) - load(mem, dy + k)
        twist = contact(mem, at.drive + 3 * d, apart, turning)
        add(mem, torque + k, twist)
        add(mem, torque + motor, -twist)
    for m in range(at.windings):
        k, slot, state = links.drive[first + m, 0], at.winding + m * arrays.WINDING, at.currents + 3 * m
        add(mem, torque + k, missing_torque(mem, at, y, around, m))
        current, integral, delayed = vector(mem, y + state)
        error = load(mem, around + at.wanted + m) / load(mem, slot) - current
        asked = load(mem, slot + arrays.LOOP_GAIN) * error + integral
        supply = load(mem, slot + arrays.SUPPLY)
        given = within(asked, supply)
        v = within(2.0 * delayed - given, supply) - load(mem, slot + arrays.RESISTANCE) * current
        v = v - load(mem, slot + arrays.EMF) * load(mem, dy + k)
        further = (asked - given) * error > 0.0
        rise = choose(further, zero, load(mem, slot + arrays.LOOP_INTEGRAL) * error)
        pace = load(mem, slot + arrays.PACE)
        put(mem, dy + state, (v / load(mem, slot + arrays.INDUCTANCE), rise, pace * (given - delayed)))
    for t in range(at.teeth + at.ripples):
        row, slot = first + at.windings + t, at.winding + at.windings * arrays.WINDING + 3 * t
        k, m = links.drive[row, 0], links.drive[row, 1]
        _, s = cosine_and_sine(load(mem, slot) * load(mem, y + k) + load(mem, slot + 2))
        size = load(mem, slot + 1)
        if t >= at.teeth:  # a share of what the current does
            size = size * load(mem, at.winding + m * arrays.WINDING) * load(mem, y + at.currents + 3 * m)
        add(mem, torque + k, size * s)
