"""The torquers between samples: limited rates, first-order lags, and what fails of their torque."""

from __future__ import annotations

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import Number, choose, greater, inlined, internal, lesser, load, store
from platform_ctrl.simulation.kernel.body import At
from platform_ctrl.simulation.kernel.faults import acts
from platform_ctrl.simulation.kernel.flight import (
    AT_ONCE,
    DECAY,
    FAULT,
    FIRST,
    HELD,
    SLEW,
    SLEWED,
    STUCK,
    TORQUE,
    TORQUER,
    TORQUER_DEAD,
    TORQUER_WEAK,
    Flight,
    Shared,
)


@internal
def new_torque(
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
            on = acts(mem, lane, fault, t)
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
def put_torques(shared: Shared, mem: FloatArray, lane: int, at: At, flight: Flight, row: int) -> None:
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
def work_on(shared: Shared, mem: FloatArray, lane: int, flight: Flight, segment: int) -> None:
    """Let the torquers go on by half a substep of the segment."""
    for i in range(shared.targets.shape[0]):
        slot = flight.torquer + i * TORQUER
        held, slewed = load(mem, slot + HELD, lane), load(mem, slot + SLEWED, lane)
        slew, decay = load(mem, slot + SLEW + segment, lane), load(mem, slot + DECAY + segment, lane)
        slewed = slewed + lesser(greater(held - slewed, -slew), slew)
        store(mem, slot + SLEWED, lane, slewed)
        store(mem, slot + TORQUE, lane, slewed + (load(mem, slot + TORQUE, lane) - slewed) * decay)
