"""Modes of the structure: their rates, their derivatives, and what they have in common with the bodies."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined
from platform_ctrl.common.simd import Number, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import vector
from platform_ctrl.simulation.kernel.arrays import At
from platform_ctrl.simulation.kernel.forces import felt_by_root, missing_torque


@inlined
def mode_rates(mem: FloatArray, at: At, y: int, rates: int) -> None:
    """Rates of the modes of a state whose v begins with Omega, with the joints' rates: their momenta less Γ·u."""
    W0, W1, W2 = vector(mem, y + at.n)
    for j in range(at.modes):
        own = at.mode + j * (at.shape + at.torquers) + arrays.INERTIAL
        g0, g1, g2 = vector(mem, own)
        rate = load(mem, y + at.swings + 2 * j + 1) - (g0 * W0 + g1 * W1 + g2 * W2)
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
    f0, f1, f2 = felt_by_root(mem, at, y, around)
    for j in range(at.modes):
        row, eta = at.mode + j * (at.shape + at.torquers), at.swings + 2 * j
        g0, g1, g2 = vector(mem, row + arrays.BASE_FORCE)
        rate = load(mem, at.swing + j)
        force = load(mem, around + at.block - at.modes + j) - (g0 * f0 + g1 * f1 + g2 * f2)
        for m in range(at.windings):
            shape = load(mem, row + at.shape + at.torquers - at.windings + m)
            force = force + shape * missing_torque(mem, at, y, around, m)
        force = force - load(mem, row + arrays.SQUARE) * load(mem, y + eta)
        store(mem, dy + eta, rate)
        store(mem, dy + eta + 1, force - load(mem, row + arrays.DAMPING) * rate)
