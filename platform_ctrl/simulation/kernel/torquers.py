"""The torquers between samples: limited rates, first-order lags, and what fails of their torque."""

from __future__ import annotations

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import Number, apart, choose, greater, inlined, internal, lesser, load, store
from platform_ctrl.simulation.kernel.body import At
from platform_ctrl.simulation.kernel.faults import acts
from platform_ctrl.simulation.kernel.flight import (
    AT_ONCE,
    BEHIND,
    DECAY,
    FAULT,
    FIRST,
    HELD,
    SECOND,
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
from platform_ctrl.simulation.kernel.functions import logarithm


@internal
def ready_torquers(shared: Shared, mem: FloatArray, lane: int, flight: Flight) -> None:
    """Find how far the lags stay behind a torque that slews."""
    for i in range(shared.targets.shape[0]):
        for segment in range(2):
            slot = flight.torquer + i * TORQUER + segment
            decay = load(mem, slot + DECAY, lane)
            zero = 0.0 * decay
            lagging = (decay > 0.0) & (decay < 1.0)
            behind = (decay - 1.0) / logarithm(choose(lagging, decay, zero + 0.5))
            store(mem, slot + BEHIND, lane, choose(lagging, behind, choose(decay > 0.0, zero + 1.0, zero)))


@inlined
def torquers_fail(shared: Shared) -> bool:
    """Whether any torquer of any scenario fails."""
    failing = False
    for f in range(shared.faults.shape[0]):
        failing = failing or TORQUER_DEAD <= shared.faults[f, 0] <= TORQUER_WEAK
    return failing


@inlined
def _toward(wanted: Number, here: Number, reach: Number) -> Number:
    return greater(lesser(wanted, here + reach), here - reach)


@internal
def new_torque(
    shared: Shared, mem: FloatArray, lane: int, flight: Flight, segment: int, source: int, t: Number
) -> None:
    """What the torquers work towards from t on: the limited command of sample `source`, and what fails of it."""
    apart()
    nu = shared.targets.shape[0]
    for i in range(nu):
        slot = flight.torquer + i * TORQUER
        held = 0.0 * t
        fixed, level = held, held
        if source >= 0:
            held = load(mem, flight.ring + source % (flight.whole + 2) * nu + i, lane)
        torque = load(mem, slot + TORQUE, lane)
        for f in range(shared.faults.shape[0]):
            kind = shared.faults[f, 0]
            if kind < TORQUER_DEAD or kind > TORQUER_WEAK or shared.faults[f, 1] != i:
                continue
            fault = flight.fault + f * FAULT
            on = acts(mem, lane, fault, t)
            if kind == TORQUER_WEAK:
                held = choose(on, load(mem, fault + FIRST, lane) * held, held)
                continue
            fixed = choose(on, 0.0 * t + 1.0, fixed)
            if kind == TORQUER_DEAD:
                level = choose(on, 0.0 * t, level)
            else:
                # SECOND: whether it is stuck already.
                fresh = on & (load(mem, fault + SECOND, lane) < 0.5)
                stuck = choose(fresh, torque, load(mem, fault + STUCK, lane))
                store(mem, fault + STUCK, lane, stuck)
                store(mem, fault + SECOND, lane, choose(fresh, 0.0 * t + 1.0, load(mem, fault + SECOND, lane)))
                level = choose(on, stuck, level)
        sound = fixed < 0.5
        held = choose(sound, held, level)
        store(mem, slot + HELD, lane, held)
        slewed = _toward(held, load(mem, slot + SLEWED, lane), load(mem, slot + AT_ONCE, lane))
        slewed = choose(sound, slewed, level)
        store(mem, slot + SLEWED, lane, slewed)
        lagging = sound & (load(mem, slot + DECAY + segment, lane) > 0.0)
        store(mem, slot + TORQUE, lane, choose(lagging, torque, slewed))


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
    """Let the torquers go on by half a substep of the segment: a lag follows a torque that slews evenly exactly."""
    for i in range(shared.targets.shape[0]):
        slot = flight.torquer + i * TORQUER
        before = load(mem, slot + SLEWED, lane)
        decay, behind = load(mem, slot + DECAY + segment, lane), load(mem, slot + BEHIND + segment, lane)
        after = _toward(load(mem, slot + HELD, lane), before, load(mem, slot + SLEW + segment, lane))
        store(mem, slot + SLEWED, lane, after)
        torque = after + (load(mem, slot + TORQUE, lane) - before) * decay - (after - before) * behind
        store(mem, slot + TORQUE, lane, torque)
