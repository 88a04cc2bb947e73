"""The plants that a loop has to stand: the nominal one, the corners of the parameter spread, the corners of Omega."""

from __future__ import annotations

import dataclasses
from itertools import product

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.plant_set import PlantSet, plant_set
from platform_ctrl.analysis.sampled import sampled_arrays
from platform_ctrl.arguments import known_name
from platform_ctrl.description import Platform
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.frozen import FloatArray
from platform_ctrl.job import Job, LoopSpec
from platform_ctrl.linearisation import LinearModel, linearise
from platform_ctrl.mechanics import matrices
from platform_ctrl.state_space import state_space

# Open-loop motion slower than this share of the Nyquist frequency says nothing about where a loop can act.
_STILL = 1e-3


def changed(platform: Platform, inertia: dict[str, float], spin: dict[str, float]) -> Platform:
    """Return `platform` with other inertias and spins.

    Parameters
    ----------
    platform
        The platform.
    inertia
        Relative change of J about the axis of each named gimbal, alone: the inertia that the gimbal's own body gains
        or loses is a thin disk about its axis, so that no other J about a gimbal axis through the same body changes
        unless the axes are parallel.
    spin
        Relative change of each named rotor's L.
    """
    J = np.diag(matrices(platform).A_star)[3:]
    gimbals = tuple(
        dataclasses.replace(g, inertia=g.inertia + inertia.get(g.name, 0.0) * J[k] * np.outer(g.axis, g.axis))
        for k, g in enumerate(platform.gimbals)
    )
    rotors = tuple(
        dataclasses.replace(r, angular_momentum=r.angular_momentum * (1.0 + spin.get(r.name, 0.0)))
        for r in platform.rotors
    )
    return dataclasses.replace(platform, gimbals=gimbals, rotors=rotors)


def corners(job: Job, gimbals: tuple[str, ...]) -> list[tuple[str, Platform, FloatArray]]:
    """Return (label, platform, Omega): nominal, every corner of the spread, every corner of Omega."""
    platform = job.platform
    carried = [r.name for r in platform.rotors if r.carrier in gimbals]
    out: list[tuple[str, Platform, FloatArray]] = [("nominal", platform, np.zeros(3))]
    named = [("J", g, job.spread.inertia) for g in gimbals] + [("L", r, job.spread.spin) for r in carried]
    named = [entry for entry in named if entry[2] > 0.0]
    if named:
        for signs in product((-1.0, 1.0), repeat=len(named)):
            moved = [(kind, name, sign * width) for (kind, name, width), sign in zip(named, signs, strict=True)]
            label = " ".join(f"{kind}{name}{change:+.0%}" for kind, name, change in moved)
            inertia = {name: change for kind, name, change in moved if kind == "J"}
            spin = {name: change for kind, name, change in moved if kind == "L"}
            out.append((label, changed(platform, inertia, spin), np.zeros(3)))
    if np.any(job.Omega > 0.0):
        axes = [(-rate, rate) if rate > 0.0 else (0.0,) for rate in job.Omega]
        for rates in product(*axes):
            out.append((f"Omega = ({rates[0]:g}, {rates[1]:g}, {rates[2]:g}) rad/s", platform, np.array(rates)))
    return out


def rows_of(model: LinearModel, gimbals: tuple[str, ...]) -> list[int]:
    """Return the row numbers of the named gimbals, in the loop's order."""
    return [known_name("gimbals", name, model.gimbal_names) for name in gimbals]


def plants_of(job: Job, spec: LoopSpec) -> PlantSet | None:
    """Return the plants of a loop of the job; None for a loop that is judged in the coupled system alone.

    Raises
    ------
    InputError
        The loop's gimbals cut through a subsystem.
    """
    if spec.kind != "caging":
        return None
    try:
        return loop_plants(job, spec.gimbals)
    except ArgumentError as error:
        raise InputError(f"loop {spec.name!r}: {error}") from None


def loop_plants(job: Job, gimbals: tuple[str, ...]) -> PlantSet:
    """Return the sampled plants of the loop on `gimbals`: one torquer and one pick-off on each, in the loop's order.

    Raises
    ------
    ArgumentError
        `gimbals` cuts through a subsystem, or one has no torquer or pick-off.
    """
    cases = corners(job, gimbals)
    torquers = [job.platform.torquer_on(name) for name in gimbals]
    pickoffs = [job.platform.pickoff_on(name) for name in gimbals]
    torques, angles = [t.name for t in torquers], [s.name for s in pickoffs]
    systems = [
        state_space(linearise(platform, Omega=Omega), gimbals=gimbals)[angles, torques] for _, platform, Omega in cases
    ]
    A, B, C, D = (np.array([getattr(system, name) for system in systems]) for name in "ABCD")
    sampling = job.sampling
    arrays = sampled_arrays(A, B, C, D, sampling.period, sampling.delay, [t.lag for t in torquers])
    return plant_set(
        StateArrays(*arrays, dt=sampling.period),
        labels=tuple(label for label, _, _ in cases),
        torques=tuple(torques),
        angles=tuple(angles),
        nutation=_reference(A[0], sampling.period),
        noise=np.array([s.sampled_noise(sampling.period) for s in pickoffs]),
    )


def _reference(A: FloatArray, period: float) -> float:
    """Return the frequency that grids and starting values go by: nutation; without any, a tenth of Nyquist's."""
    nyquist = np.pi / period
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    return fastest if fastest > _STILL * nyquist else 0.1 * nyquist
