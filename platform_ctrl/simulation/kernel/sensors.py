"""What the sensors say at a sample: noise, drift, quantisation, and what fails of it."""

from __future__ import annotations

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import anywhere, choose, internal, load, store, whole
from platform_ctrl.simulation.kernel.body import At
from platform_ctrl.simulation.kernel.faults import acts
from platform_ctrl.simulation.kernel.flight import (
    ANGLE,
    BEGIN,
    FAULT,
    FIRST,
    GIMBAL_RATE,
    LAST,
    PICKOFF_DEAD,
    PICKOFF_DRIFT,
    PICKOFF_DROPOUT,
    PICKOFF_STUCK,
    QUANTISATION,
    RMS,
    SENSOR,
    Flight,
    Shared,
)
from platform_ctrl.simulation.kernel.noise import LOSS, PICKOFF, Keys, normals, uniforms


@internal
def read(shared: Shared, keys: Keys, mem: FloatArray, lane: int, at: At, flight: Flight, k: int, t: float) -> None:
    """Put what every sensor says at sample k into its LAST."""
    for i in range(shared.sensors.shape[0]):
        slot, kind, index = flight.sensor + i * SENSOR, shared.sensors[i, 0], shared.sensors[i, 1]
        if kind == ANGLE:
            value = load(mem, at.state + index, lane)
        elif kind == GIMBAL_RATE:
            value = load(mem, flight.velocity + 3 + index, lane)
        else:
            value = load(mem, flight.velocity + index, lane)
        rms = load(mem, slot + RMS, lane)
        if anywhere(rms > 0.0):
            if i % 2 == 0 or not anywhere(load(mem, slot - SENSOR + RMS, lane) > 0.0):
                normals(keys, mem, lane, k, PICKOFF + i // 2, flight.random)
            value = value + rms * load(mem, flight.random + i % 2, lane)
        for f in range(shared.faults.shape[0]):
            if shared.faults[f, 0] == PICKOFF_DRIFT and shared.faults[f, 1] == i:
                fault = flight.fault + f * FAULT
                drift = load(mem, fault + FIRST, lane) * (t - load(mem, fault + BEGIN, lane))
                value = choose(acts(mem, lane, fault, t), value + drift, value)
        step = load(mem, slot + QUANTISATION, lane)
        fine = step > 0.0
        unit = choose(fine, step, 0.0 * step + 1.0)
        value = choose(fine, unit * whole(value / unit + 0.5), value)
        for f in range(shared.faults.shape[0]):
            failing = shared.faults[f, 0]
            if failing < PICKOFF_DEAD or failing > PICKOFF_DROPOUT or shared.faults[f, 1] != i:
                continue
            fault = flight.fault + f * FAULT
            on = acts(mem, lane, fault, t)
            if failing == PICKOFF_DEAD:
                value = choose(on, 0.0 * value, value)
            elif failing == PICKOFF_STUCK:
                value = choose(on, load(mem, slot + LAST, lane), value)
            elif failing == PICKOFF_DROPOUT:
                uniforms(keys, mem, lane, k, LOSS + shared.faults[f, 2], flight.random + 2)
                lost = on & (load(mem, flight.random + 2, lane) < load(mem, fault + FIRST, lane))
                value = choose(lost, load(mem, slot + LAST, lane), value)
        store(mem, slot + LAST, lane, value)
