"""The plants that a loop must control: the nominal one, uncertain parameters, the range of Omega, parts that fail."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.plant_set import Group, PlantSet, plant_set
from platform_ctrl.analysis.sampling import held_input, sampled, sampled_states
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job.job import Job, LoopSpec, Sampling
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.matrices import matrices
from platform_ctrl.mechanics.state_space import state_space, subsystems_of_all
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform, Torquer
from platform_ctrl.plant.sensors import PickOff

# Open-loop motion slower than this share of the Nyquist frequency is no reference for the loop.
_SLOW_MOTION = 1e-3
# Largest angle of a motion in a sample period, rad: beyond it a sampled plant has lost all digits.
_LARGEST_ANGLE = 1e6


def changed(platform: Platform, inertia: dict[str, float], spin: dict[str, float]) -> Platform:
    """Return `platform` with other inertias and spins, relative changes by name.

    `inertia` changes J about the axis of a gimbal alone: what the gimbal's own body gains or loses is a thin disk about
    its axis, so that no other J about a gimbal axis through the same body changes unless the axes are parallel. `spin`
    changes the L of a rotor.
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


def with_spins(platform: Platform, spins: Mapping[str, float]) -> Platform:
    """Return the platform with other spins of its rotors, rad/s; those that are not named stay."""
    rotors = tuple(
        dataclasses.replace(r, angular_momentum=r.axial_inertia * spins[r.name])
        if r.name in spins and spins[r.name] != r.spin
        else r
        for r in platform.rotors
    )
    return dataclasses.replace(platform, rotors=rotors)


@value
class Case:
    """A plant of the set: what it is and stands for, the rate (3,) at which it is linearised.

    `torque`, (m,), is the share of its torque that each torquer of the loop keeps.
    """

    label: str
    group: Group
    platform: Platform
    Omega: FloatArray
    torque: FloatArray


def cases(job: Job, gimbals: tuple[str, ...]) -> list[Case]:
    """Return the plants that the loop on `gimbals` must control, the nominal one first.

    Then every corner of the parameter uncertainty and the samples inside it, the grid of Omega, and the faults.
    """
    platform, still, whole = job.platform, np.zeros(3), np.ones(len(gimbals))
    out = [Case(label="nominal", group="nominal", platform=platform, Omega=still, torque=whole)]
    for label, parameters in _varied(job, gimbals):
        moved = changed(platform, **parameters)
        out.append(Case(label=label, group="uncertainty", platform=moved, Omega=still, torque=whole))
    for rates in _rates(job.Omega, job.Omega_grid):
        label = f"Omega = ({rates[0]:g}, {rates[1]:g}, {rates[2]:g}) rad/s"
        out.append(Case(label=label, group="Omega", platform=platform, Omega=np.array(rates), torque=whole))
    return [*out, *_faults(job, gimbals)]


def _varied(job: Job, gimbals: tuple[str, ...]) -> Iterator[tuple[str, dict[str, dict[str, float]]]]:
    """Walk the relative changes of J and L at the corners of the uncertainty, then at the samples inside it."""
    named = [("inertia", g, job.uncertainty.inertia) for g in gimbals]
    named += [("spin", name, job.uncertainty.spin) for name in _carried(job.platform, gimbals)]
    named = [entry for entry in named if entry[2] > 0.0]
    if not named:
        return
    for signs in product((-1.0, 1.0), repeat=len(named)):
        yield _moved(named, signs, "+.0%")
    for place in _samples(job, len(named)):
        yield _moved(named, place, "+.1%")


def _moved(
    named: list[tuple[str, str, float]], place: Sequence[float], digits: str
) -> tuple[str, dict[str, dict[str, float]]]:
    out: dict[str, dict[str, float]] = {"inertia": {}, "spin": {}}
    words = []
    for (parameter, name, width), part in zip(named, place, strict=True):
        out[parameter][name] = part * width
        words.append(f"{'J' if parameter == 'inertia' else 'L'}{name}{part * width:{digits}}")
    return " ".join(words), out


def subsystems_over(platform: Platform, Omega: FloatArray, grid: int) -> tuple[tuple[str, ...], ...]:
    """Return the groups of gimbals that are coupled at rest or on a grid of platform rates, in the file's order."""
    return subsystems_of_all([linearise(platform, Omega=rate) for rate in [(0.0, 0.0, 0.0), *_rates(Omega, grid)]])


def _samples(job: Job, dimension: int) -> list[list[float]]:
    """Return points of the box [-1, 1]: a scrambled Sobol sequence (Owen), the same for the same seed."""
    if job.uncertainty.samples == 0:
        return []
    from scipy.stats import qmc

    points = qmc.Sobol(dimension, scramble=True, seed=np.random.default_rng(job.seed))
    # Drawn by powers of two, for which alone the sequence is balanced.
    drawn = points.random_base2(math.ceil(math.log2(job.uncertainty.samples)))[: job.uncertainty.samples]
    return [[float(entry) for entry in row] for row in 2.0 * drawn - 1.0]


def _rates(Omega: FloatArray, grid: int) -> list[tuple[float, ...]]:
    """Return a grid of platform rates up to `Omega` about each axis, without rest."""
    axes = [np.linspace(-rate, rate, grid) if rate > 0.0 else np.zeros(1) for rate in Omega]
    # An odd grid's middle is 0 up to rounding.
    axes = [np.where(np.abs(axis) < 1e-9 * rate, 0.0, axis) for axis, rate in zip(axes, Omega, strict=True)]
    return [tuple(map(float, rates)) for rates in product(*axes) if any(rates)]


def _faults(job: Job, gimbals: tuple[str, ...]) -> Iterator[Case]:
    still, whole = np.zeros(3), np.ones(len(gimbals))
    slow, weak = job.faults.slow_rotor, job.faults.weak_torquer
    if slow is not None:
        for name in _carried(job.platform, gimbals):
            platform = changed(job.platform, {}, {name: slow - 1.0})
            label = f"rotor {name} at {slow:.0%} of its spin"
            yield Case(label=label, group="faults", platform=platform, Omega=still, torque=whole)
    if weak is not None:
        for k, gimbal in enumerate(gimbals):
            label = f"torquer {job.platform.torquer_on(gimbal).name} at {weak:.0%} of its torque"
            torque = np.where(np.arange(len(gimbals)) == k, weak, 1.0)
            yield Case(label=label, group="faults", platform=job.platform, Omega=still, torque=torque)


def _carried(platform: Platform, gimbals: tuple[str, ...]) -> list[str]:
    return [r.name for r in platform.rotors if r.carrier in gimbals]


def rows_of(model: LinearModel, gimbals: tuple[str, ...]) -> list[int]:
    """Return the row numbers of the named gimbals, in the loop's order."""
    return [known_name("gimbals", name, model.gimbal_names) for name in gimbals]


def plants_of(job: Job, spec: LoopSpec) -> PlantSet | None:
    """Return the plants of a loop of the job; None for a loop that is checked in the coupled system alone."""
    if spec.kind != "caging":
        return None
    try:
        return loop_plants(job, spec.gimbals)
    except ArgumentError as error:
        raise InputError(f"loop {spec.name!r}: {error}") from None


@value
class LinearPlants:
    """The plants of a loop before they are sampled: torques and platform rate → angles.

    Attributes
    ----------
    cases
        What each of them is, the nominal plant first.
    torquers, pickoffs
        Of the loop's gimbals, in the loop's order.
    A, B, C, D, B_Omega
        Continuous; shapes (N, n, n), (N, n, m), (N, p, n), (N, p, m), (N, n, 3).
    states
        Names of the n states.
    """

    cases: tuple[Case, ...]
    torquers: tuple[Torquer, ...]
    pickoffs: tuple[PickOff, ...]
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    B_Omega: FloatArray
    states: tuple[str, ...]


def linear_plants(platform: Platform, gimbals: tuple[str, ...], plants: Sequence[Case]) -> LinearPlants:
    """Linearise `plants`: one torquer and one pick-off on each of `gimbals`, in that order."""
    torquers = [platform.torquer_on(name) for name in gimbals]
    pickoffs = [platform.pickoff_on(name) for name in gimbals]
    torques, angles = [t.name for t in torquers], [s.name for s in pickoffs]
    systems = [state_space(linearise(one.platform, Omega=one.Omega), gimbals=gimbals) for one in plants]
    acting = [system[angles, torques] for system in systems]
    A, B, C, D = (np.array([getattr(system, name) for system in acting]) for name in "ABCD")
    return LinearPlants(
        cases=tuple(plants),
        torquers=tuple(torquers),
        pickoffs=tuple(pickoffs),
        A=A,
        B=B * np.array([one.torque for one in plants])[:, None, :],
        C=C,
        D=D,
        B_Omega=np.array([system[angles, list(OMEGA_NAMES)].B for system in systems]),
        states=tuple(systems[0].state_labels),
    )


def sampled_plants(linear: LinearPlants, sampling: Sampling, Omega: FloatArray) -> PlantSet:
    """Sample linear plants; `Omega` is the largest platform rate about each axis, rad/s."""
    torques, angles = (tuple(one.name for one in part) for part in (linear.torquers, linear.pickoffs))
    A, lags = linear.A, np.array([t.lag for t in linear.torquers])
    _expect_slow(A, linear.cases, sampling.period)
    arrays = sampled(StateArrays(A, linear.B, linear.C, linear.D, 0.0), sampling.period, sampling.delay, lags)
    return plant_set(
        arrays,
        labels=tuple(one.label for one in linear.cases),
        torques=torques,
        angles=angles,
        nutation=reference_frequency(A[0], sampling.period),
        noise=np.array([s.sampled_noise(sampling.period) for s in linear.pickoffs]),
        groups=tuple(one.group for one in linear.cases),
        B_Omega=held_rate(A, linear.B_Omega, sampling.period, arrays.A.shape[-1]),
        Omega=Omega,
        torque_limit=np.array([np.inf if t.limit is None else t.limit for t in linear.torquers]),
        states=sampled_states(linear.states, torques, lags, arrays.A.shape[-1]),
    )


def loop_plants(job: Job, gimbals: tuple[str, ...]) -> PlantSet:
    """Return the sampled plants of the loop on `gimbals`: one torquer and one pick-off on each, in the loop's order."""
    return sampled_plants(linear_plants(job.platform, gimbals, cases(job, gimbals)), job.sampling, job.Omega)


def _expect_slow(A: FloatArray, plants: Sequence[Case], period: float) -> None:
    finite = np.array([np.isfinite(one).all() for one in A])
    fastest = np.where(finite, np.abs(np.linalg.eigvals(np.where(finite[:, None, None], A, 0.0))).max(axis=-1), np.inf)
    worst = int(fastest.argmax())
    if fastest[worst] * period > _LARGEST_ANGLE:
        where = f"plant {plants[worst].label}" if plants[worst].label else "the plant"
        raise InputError(
            f"rate_hz = {1.0 / period:.6g}: in a sample period {where} turns by {fastest[worst] * period:.3g} rad or "
            f"grows as fast, more than {_LARGEST_ANGLE:.0e}; choose a higher rate"
        )


def held_rate(A: FloatArray, B: FloatArray, period: float, order: int) -> FloatArray:
    """Return the sampled input of Omega: held like the torques, but neither delayed nor lagging."""
    out = np.zeros((*A.shape[:-2], order, B.shape[-1]))
    # The sampled states begin with the plant's own, on which Omega acts directly.
    out[..., : A.shape[-1], :] = held_input(A, B, period)[1]
    return out


def reference_frequency(A: FloatArray, period: float) -> float:
    """Return the frequency that grids and starting values go by: nutation; without any, a tenth of Nyquist's."""
    nyquist = np.pi / period
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    return fastest if fastest > _SLOW_MOTION * nyquist else 0.1 * nyquist
