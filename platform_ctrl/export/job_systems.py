"""What a job can export: its controllers, its plants as linear systems, and the responses of its loops."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis import gang
from platform_ctrl.analysis.frequency_grids import following_grid
from platform_ctrl.analysis.poles import continuous_poles, poles
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.design.loop import sampled_plant
from platform_ctrl.design.plants import plants_of
from platform_ctrl.export.csv_responses import response_data
from platform_ctrl.export.system_records import SystemRecord, signal_units, system_record
from platform_ctrl.job.job import Faults, Job, Uncertainty
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.verification.controllers import outcomes_from
from platform_ctrl.verification.coupled import coupled_plant, one_controller

if TYPE_CHECKING:
    import control

# Frequencies of a table, and its lowest one as a share of the Nyquist frequency.
_POINTS, _LOWEST = 300, 1e-4


@input_value
class ResponseTable:
    """A frequency response of a job, and what it is."""

    name: str  # "plant caging 9-10", "controller ..." or "loop ..."
    response: control.FRD  # With named signals
    notes: tuple[str, ...]  # What it is, with its units


@check_arguments
def controller_systems(job: Job, controllers: Sequence[control.StateSpace]) -> tuple[SystemRecord, ...]:
    """Return a job's controllers u = K y with units and delay, signals as in ``result.json``."""
    note = "controller, positive feedback u = +K y; u acts the delay after the sample and is held"
    return tuple(system_record(K, platform=job.platform, delay=job.sampling.delay, note=note) for K in controllers)


@check_arguments
def model_systems(job: Job) -> tuple[SystemRecord, ...]:
    """Return the linear models of a job's plant about rest.

    ``plant``: torques and platform rates to angles, continuous; ``plant with free root``: the platform reacts; then
    for each caging loop its sampled plant, dead time, torquer lag and hold included.
    """
    model = linearise(job.platform)
    about = f"{job.platform.name}, linear about rest"
    whole, free = state_space(model), state_space(model, root="free")
    out = [
        system_record(whole, "plant", platform=job.platform, note=f"{about}, Omega prescribed"),
        system_record(free, "plant with free root", platform=job.platform, note=f"{about}, the platform reacts"),
    ]
    for name, plant in _loop_plants(job):
        note = "sampled with hold; dead time and torquer lag are in it"
        out.append(system_record(plant, f"plant {name}", platform=job.platform, note=note))
    return tuple(out)


@check_arguments
def job_responses(job: Job, controllers: Sequence[control.StateSpace]) -> tuple[ResponseTable, ...]:
    """Return the frequency responses of a job: plants, controllers and loops.

    For every caging loop its sampled plant; every controller; for every caging loop L of each torquer, broken there
    with all other torquers of the loop closed: −K P of a loop with one torquer, −1 the critical point. Then the
    same of the coupled plant with all loops closed.
    """
    units = signal_units(job.platform)
    frequency = _frequency(job)
    closed = dict(zip((one.spec.name for one in outcomes_from(_nominal(job), controllers)), controllers, strict=True))
    out = []
    for name, plant in _loop_plants(job):
        notes = (f"{job.name}: sampled plant of {name}, hold, dead time and torquer lag in it", _units(plant, units))
        out.append(ResponseTable(name=f"plant {name}", response=response_data(plant, frequency), notes=notes))
    for name, K in closed.items():
        notes = (f"{job.name}: controller of {name}, u = K y, its delay not in it", _units(K, units))
        out.append(ResponseTable(name=f"controller {name}", response=response_data(K, frequency), notes=notes))
    for name, plant in _loop_plants(job):
        what = f"{job.name}: {name} broken at one torquer, its others closed"
        out += _broken(f"loop {name}", plant, closed[name], frequency, what)
    if len(controllers) > 1:
        plant = coupled_plant(job, linearise(job.platform), controllers)
        K = one_controller(job, controllers, plant)
        what = f"{job.name}: broken at one torquer, everything else closed, on the coupled plant"
        out += _broken("all loops", plant, K, frequency, what)
    return tuple(out)


def _nominal(job: Job) -> Job:
    """Return the job with the nominal plant alone."""
    return dataclasses.replace(job, uncertainty=Uncertainty(), faults=Faults(), Omega=np.zeros(3))


def _loop_plants(job: Job) -> Iterator[tuple[str, control.StateSpace]]:
    """Go through the caging loops with their nominal sampled plants."""
    for spec in job.loops:
        plants = plants_of(_nominal(job), spec)
        if plants is not None:
            yield spec.name, sampled_plant(plants)


def _frequency(job: Job) -> FloatArray:
    """Return frequencies up to the Nyquist frequency, denser where the gimbals resonate."""
    nyquist = np.pi / job.sampling.period
    found = [continuous_poles(poles(plant), job.sampling.period) for _, plant in _loop_plants(job)]
    return following_grid(np.concatenate([[], *found]), _LOWEST * nyquist, 0.999 * nyquist, _POINTS)


def _broken(
    name: str, plant: control.StateSpace, K: control.StateSpace, frequency: FloatArray, what: str
) -> Iterator[ResponseTable]:
    """Go through the torquers: L = 1/S - 1 at each, -K P where it is the only one."""
    S = gang(plant, K, frequency).S_input
    for k, torquer in enumerate(K.output_labels):
        with np.errstate(divide="ignore", invalid="ignore"):
            L = 1.0 / S[k, k] - 1.0
        response = import_module("control").FRD(
            L[None, None], frequency, K.dt, inputs=[torquer], outputs=[f"L({torquer})"]
        )
        notes = (what, f"L = 1/S - 1 at {torquer}, dimensionless, the critical point is -1")
        yield ResponseTable(name=f"{name} at {torquer}", response=response, notes=notes)


def _units(system: control.StateSpace, units: Mapping[str, str]) -> str:
    names = dict.fromkeys([*system.output_labels, *system.input_labels])
    return "units: " + ", ".join(f"{name} in {units.get(name, '?')}" for name in names)
