"""Systems of a job for export: its controllers, its plants as linear systems, and frequency responses, also as CSV."""

from __future__ import annotations

import csv
import dataclasses
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis import frequency_response
from platform_ctrl.analysis.feedback import channel_transfers
from platform_ctrl.analysis.poles import continuous_poles, following_grid, poles
from platform_ctrl.common.arguments import one_of, short
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import sampled_plant, with_resolvers
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import ArgumentError
from platform_ctrl.export.systems import ExportedSystem, signal_units
from platform_ctrl.job.job import Job
from platform_ctrl.job.variation import Faults, Uncertainty
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.verification.controllers import outcomes_from
from platform_ctrl.verification.coupled import one_controller
from platform_ctrl.verification.coupled_plant import coupled_plant

if TYPE_CHECKING:
    import control

# Frequencies of a table, and its lowest one as a share of the Nyquist frequency.
_POINTS, _LOWEST = 300, 1e-4
Form = Literal["complex", "polar"]
_HZ = 2.0 * np.pi
# The fewest frequencies that are read back.
_FEWEST = 3


@value
class ResponseTable:
    """A frequency response of a job, and what it is."""

    name: str  # "plant caging 9-10", "controller ..." or "loop ..."
    response: control.FRD  # With named signals
    notes: tuple[str, ...]  # What it is, with its units


def model_systems(job: Job) -> Iterator[ExportedSystem]:
    """Go through the linear models of a job's plant about rest.

    ``plant``: torques and platform rates to angles, continuous; ``plant with free root``: the platform reacts; then
    for each caging loop its sampled plant, dead time, torquer lag and hold included.
    """
    model = linearise(job.platform)
    about = f"{job.platform.name}, linear about rest"
    free = state_space(model, root="free").copy("plant with free root")
    yield ExportedSystem(state_space(model).copy("plant"), note=f"{about}, Omega prescribed")
    yield ExportedSystem(free, note=f"{about}, the platform reacts")
    for name, plant in _loop_plants(job):
        note = "sampled with hold; dead time and torquer lag are in it"
        yield ExportedSystem(plant.copy(f"plant {name}".replace(".", "_")), note=note)


def job_responses(job: Job, controllers: Sequence[control.StateSpace]) -> tuple[ResponseTable, ...]:
    """Return the frequency responses of a job: plants, controllers and loops.

    For every caging loop its sampled plant; every controller; for every caging loop L of each torquer, broken there
    with all other torquers of the loop closed: −K P of a loop with one torquer, −1 the critical point. Then the
    same of the coupled plant with all loops closed; not where some are computed at rates of their own, so that together
    they are periodic and have no frequency response.
    """
    units = signal_units(job.platform, job.units)
    outcomes = outcomes_from(_nominal(job), controllers)
    closed = dict(zip((one.spec.name for one in outcomes), controllers, strict=True))
    # Of the loop itself: without feedforward, which is a part of its plants.
    own = {one.spec.name: one.closed.own_controller for one in outcomes}
    plants = dict(_loop_plants(job))
    systems = {
        f"plant {name}": (plant, f"sampled plant of {name}, hold, dead time and torquer lag in it")
        for name, plant in plants.items()
    }
    systems |= {
        f"controller {name}": (K, f"controller of {name}, u = K y, its delay not in it") for name, K in closed.items()
    }
    out = []
    for title, (system, what) in systems.items():
        response = response_data(system, _frequency(plants.values(), system.dt))
        named = dict.fromkeys([*system.output_labels, *system.input_labels])
        notes = (f"{job.name}: {what}", "units: " + ", ".join(f"{name} in {units.get(name, '?')}" for name in named))
        out.append(ResponseTable(name=title, response=response, notes=notes))
    for name, plant in plants.items():
        what = f"{job.name}: {name} broken at one torquer, its others closed"
        out += _broken(f"loop {name}", plant, own[name], _frequency(plants.values(), plant.dt), what)
    if len(controllers) > 1 and job.cycle == 1:
        controllers = with_resolvers(job, controllers, job.trims[0])
        plant = coupled_plant(job, linearise(job.platform), controllers).system
        K = one_controller(job, controllers, plant)
        what = f"{job.name}: broken at one torquer, everything else closed, on the coupled plant"
        out += _broken("all loops", plant, K, _frequency(plants.values(), plant.dt), what)
    return tuple(out)


def _nominal(job: Job) -> Job:
    """Return the job with the nominal plant alone."""
    return dataclasses.replace(job, uncertainty=Uncertainty(), faults=Faults(), Omega=np.zeros(3))


def _loop_plants(job: Job) -> Iterator[tuple[str, control.StateSpace]]:
    """Go through the caging loops with their nominal sampled plants."""
    for spec in job.loops:
        plants = plants_of(_nominal(job), spec.read_by(spec.closed))
        if plants is not None:
            yield spec.name, sampled_plant(plants)


def _frequency(plants: Iterable[control.StateSpace], period: float) -> FloatArray:
    """Return frequencies up to the Nyquist frequency, denser where the gimbals resonate."""
    nyquist = np.pi / period
    found = [continuous_poles(poles(plant), plant.dt) for plant in plants]
    return following_grid(np.concatenate([[], *found]), _LOWEST * nyquist, 0.999 * nyquist, _POINTS)


def _broken(
    name: str, plant: control.StateSpace, K: control.StateSpace, frequency: FloatArray, what: str
) -> Iterator[ResponseTable]:
    """Go through the torquers: L = 1/S - 1 at each, -K P where it is the only one."""
    for L, torquer in zip(channel_transfers(plant, K, frequency), K.output_labels, strict=True):
        response = import_module("control").FRD(
            L[None, None], frequency, K.dt, inputs=[torquer], outputs=[f"L({torquer})"]
        )
        notes = (what, f"L = 1/S - 1 at {torquer}, dimensionless, the critical point is -1")
        yield ResponseTable(name=f"{name} at {torquer}", response=response, notes=notes)


def response_data(system: control.StateSpace, frequency: ArrayLike) -> control.FRD:
    """Return the frequency response of a system, with the names of its signals; frequency in rad/s."""
    response = frequency_response(system, frequency)
    control = import_module("control")
    names = {"inputs": list(system.input_labels), "outputs": list(system.output_labels), "name": str(system.name)}
    return control.FRD(response, np.atleast_1d(np.asarray(frequency, dtype=np.float64)), system.dt or 0.0, **names)


def write_responses(
    response: control.FRD, path: str | os.PathLike[str], *, form: Form = "complex", notes: Sequence[str] = ()
) -> Path:
    """Write a frequency response as CSV, whole or not at all.

    The header is ``frequency_hz``, then for every pair of signals ``alpha9/Q9 re`` and ``alpha9/Q9 im``, or
    ``alpha9/Q9 magnitude`` and ``alpha9/Q9 phase_deg``. Numbers keep all their digits. ``read_measurement`` of
    `platform_ctrl.design` reads it back; so does ``pandas.read_csv(path, comment="#")``.

    Parameters
    ----------
    response
        As from `response_data`, measured, or made by python-control; frequencies above zero, in rad/s.
    path
        Of the file; its folder is there.
    form
        ``"complex"``: real and imaginary parts; ``"polar"``: magnitude and phase, the phase without jumps, degrees.
    notes
        Lines of comment at the head: what it is, and its units.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ArgumentError
        It is no frequency response, is not finite, has fewer than 3 frequencies above zero, or names that the header
        cannot hold.
    InputError
        The file cannot be written there.
    """
    where = "write_responses"
    one_of("write_responses: form", form, get_args(Form))
    try:
        values, w = np.asarray(response.frdata), np.asarray(response.omega, dtype=np.float64)
        outputs, inputs = list(response.output_labels), list(response.input_labels)
    except AttributeError:
        raise ArgumentError(f"{where}: response must be a control.FRD, got {short(type(response).__name__)}") from None
    if len(w) < _FEWEST or not (w[0] > 0.0 and np.all(np.diff(w) > 0.0) and np.isfinite(w[-1])):
        raise ArgumentError(f"{where}: the response needs {_FEWEST} finite frequencies > 0 that increase, rad/s")
    if not np.isfinite(values).all():
        k = int(np.argwhere(~np.isfinite(values))[0][-1])
        raise ArgumentError(f"{where}: the response at {w[k]:g} rad/s is not finite; leave the frequency out")
    for name in (*outputs, *inputs):
        # The first slash parts output and input, and the reader takes the blanks around names away.
        if not name.isprintable() or name != name.strip() or not name or (name in outputs and "/" in name):
            raise ArgumentError(
                f"{where}: {short(name)}: cannot be in the header; use one printable line, in outputs without /"
            )
    for note in notes:
        if not isinstance(note, str) or not note.isprintable():
            raise ArgumentError(f"{where}: notes must be lines of text, got {short(note)}")
    header, columns = ["frequency_hz"], [w / _HZ]
    for i, output in enumerate(outputs):
        for j, name in enumerate(inputs):
            h = values[i, j]
            parts = {"re": h.real, "im": h.imag}
            if form == "polar":
                parts = {"magnitude": np.abs(h), "phase_deg": np.degrees(np.unwrap(np.angle(h)))}
            header += [f"{output}/{name} {part}" for part in parts]
            columns += parts.values()
    out = io.StringIO()
    out.writelines(f"# {note}\n" for note in notes)
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([repr(float(number)) for number in row] for row in zip(*columns, strict=True))
    return write_whole(path, out.getvalue())
