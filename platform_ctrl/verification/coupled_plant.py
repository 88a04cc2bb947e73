"""The coupled sampled models that all controllers work in: what they set and read, and what is left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from platform_ctrl.analysis.sampling import late_outputs, late_states, sampled
from platform_ctrl.analysis.system import System, seen_states, state_scaling
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import moves_freely
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import ROOT_MOMENTA, free_system, linear_system
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control

# A gimbal that no loop acts on grows by itself where its pole is this much larger than rounding may make it: that of
# poles that coincide, as those of a body that turns freely, may be anything.
_GROWS = 1e3
# A sum of states changes by no more than this share of what each of them may change by: it is constant.
_CONSTANT = 1e-9


class CoupledPlant(NamedTuple):
    """The sampled model that all controllers work in, and what it leaves out.

    `left_out`: angles on which nothing depends. `uncontrolled`: gimbals on which nothing depends that a controller
    reads; they grow at `growth`, 1/s. `conserved`: momenta of a free root that nothing changes, and that are zero.
    """

    system: control.StateSpace
    left_out: tuple[str, ...]
    uncontrolled: tuple[str, ...]
    growth: float
    conserved: tuple[str, ...] = ()


def coupled_plant(
    job: Job,
    model: LinearModel,
    controllers: Sequence[control.StateSpace],
    gimbals: Sequence[str] | None = None,
    free: bool | None = None,
) -> CoupledPlant:
    """Return the sampled model in which all `controllers` work, from torquers (in the file's order) to what they read.

    With a controller that acts on the root, and where the plant says so, the platform is free and reacts, unless `free`
    says otherwise. Otherwise nothing would hold it: it counts as carried by the vehicle, Omega given. Other gimbals
    than those named are held; default: none.
    """
    platform, turned = job.platform, model.gimbal_names if gimbals is None else gimbals
    free = moves_freely(job, controllers) if free is None else free
    others: Literal["coupled", "held"] = "coupled" if gimbals is None else "held"
    # No loop turns a given root: how gravity turns with it is no part of their stability.
    made = free_system(model, gimbals, currents=True) if free else linear_system(model, gimbals, False, others, True)
    system = made.state_space()
    torquers = [t for t in platform.torquers if (free if t.gimbal is None else t.gimbal in turned)]
    read = {name for K in controllers for name in K.input_labels}
    outputs = [*(name for name in model.angle_names if name in read), *sensed_rates(job, controllers)]
    whole = observed(system, platform, outputs, model.q0, model.Omega0)
    used = {name for K in controllers for name in K.output_labels}
    whole, conserved = _without_conserved(whole, [t.signal for t in torquers if t.name in used], free)
    states, columns = list(whole.state_labels), [whole.input_labels.index(t.signal) for t in torquers]
    seen = seen_states(whole.A[None], whole.C[None])
    kept, growth = list(range(whole.nstates)), 0.0
    uncontrolled: tuple[str, ...] = ()
    if not free and len(seen) < whole.nstates:
        # States that no output sees do not act on those that are seen: they are judged by themselves.
        kept = seen
        rest = [k for k in range(whole.nstates) if k not in seen]
        growth = _growth(whole.A[np.ix_(rest, rest)])
        momenta = {states[k].removeprefix("p_") for k in rest if states[k].startswith("p_")}
        uncontrolled = tuple(g.name for g in platform.gimbals if g.angle in momenta)
    arrays = System(
        whole.A[np.ix_(kept, kept)], whole.B[np.ix_(kept, columns)], whole.C[:, kept], whole.D[:, columns], 0.0
    )
    named = arrays.to_control([t.name for t in torquers], outputs, [states[k] for k in kept])
    at_samples = sampled(named, job.sampling.period, job.sampling.delay, [t.lag for t in torquers])
    left_out = tuple(
        name for k, name in enumerate(states) if name in model.angle_names and k not in kept and not whole.A[:, k].any()
    )
    return CoupledPlant(_read_late(job, at_samples), left_out, uncontrolled, growth, conserved)


def _without_conserved(
    whole: control.StateSpace, used: Sequence[str], free: bool
) -> tuple[control.StateSpace, tuple[str, ...]]:
    """Return a model without the momenta of a free root that no used torquer changes, and their names.

    Sums wᵀx of states with wᵀ[A, B] = 0 keep what they have. They are zero for a platform that was at rest, and no loop
    could bring them there: the largest momentum of the root in each follows from the other states.
    """
    from scipy.linalg import null_space, qr

    names = list(whole.state_labels)
    momenta = [k for k, name in enumerate(names) if name in ROOT_MOMENTA]
    if not free or not momenta:
        return whole, ()
    B = whole.B[:, [whole.input_labels.index(name) for name in used]]
    scale = state_scaling(whole.A, B, whole.C)
    changes = np.hstack([whole.A * scale, B]) / scale[:, None]
    constant = null_space((changes / np.linalg.norm(changes, axis=0).clip(1e-300)).T, rcond=_CONSTANT).T / scale
    constant = constant[np.linalg.norm(constant[:, momenta] * scale[momenta], axis=1) > _CONSTANT]
    if not len(constant):
        return whole, ()
    order = qr(constant[:, momenta], mode="r", pivoting=True)[1][: len(constant)]
    gone = [momenta[k] for k in order]
    kept = [k for k in range(len(names)) if k not in gone]
    T = np.eye(len(names))[:, kept]
    T[gone] = -np.linalg.solve(constant[:, gone], constant[:, kept])
    arrays = System(whole.A[kept] @ T, whole.B[kept], whole.C @ T, whole.D, 0.0)
    labels = list(whole.input_labels), list(whole.output_labels), [names[k] for k in kept]
    return arrays.to_control(*labels), tuple(sorted(names[k] for k in gone))


def _growth(A: FloatArray) -> float:
    """Return the growth of the fastest growing pole of a continuous system, 1/s; 0 where rounding may make it."""
    from scipy.linalg import eig

    scale = state_scaling(A, np.zeros((len(A), 0)), np.zeros((0, len(A))))
    A = A * scale / scale[:, None]
    s, left, right = eig(A, left=True)
    condition = np.abs(np.sum(left.conj() * right, axis=0))
    moved = np.einsum("ik,ij,jk->k", np.abs(left), np.abs(A), np.abs(right)) * np.finfo(float).eps
    return float(s.real[s.real * condition > _GROWS * moved].max(initial=0.0))


def _read_late(job: Job, plant: control.StateSpace) -> control.StateSpace:
    """Return a sampled plant whose sensors' readings are as late as they are."""
    often = job.often_read
    late = {s.name: s.periods_late(job.sampling.period, often.get(s.name, 1)) for s in job.platform.sensors}
    outputs = list(plant.output_labels)
    periods = [late.get(name, 0) for name in outputs]
    if not any(periods):
        return plant
    arrays = late_outputs(System.of(plant, "coupled plant"), periods)
    states = [*plant.state_labels, *late_states(outputs, periods)]
    return arrays.to_control(list(plant.input_labels), outputs, states)


def sensed_rates(job: Job, controllers: Sequence[control.StateSpace]) -> list[str]:
    """Return what a sensor measures beside the angles, such as rates, and one of the controllers takes in."""
    used = {name for K in controllers for name in K.input_labels} - set(job.platform.angle_names)
    return [s.name for s in job.platform.sensors if s.name in used]


def used_signals(
    job: Job, controllers: Sequence[control.StateSpace], plant: control.StateSpace
) -> tuple[list[str], list[str]]:
    """Return the sensors that a plant shows, and its torquers that are used."""
    used = {name for K in controllers for name in K.output_labels}
    torquers = [name for name in plant.input_labels if name in used]
    return [s.name for s in job.platform.sensors if s.name in plant.output_labels], torquers


def one_way_plant(job: Job, model: LinearModel, rates: Sequence[str]) -> CoupledPlant:
    """The platform turns under M alone, J ω' = M, and the gimbals see its rate: no reaction."""
    system = linear_system(model, currents=True).state_space()
    n, torquers = system.nstates, job.platform.torquers
    B_Omega = system.B[:, [system.input_labels.index(name) for name in OMEGA_NAMES]]
    mobility = np.linalg.inv(model.root_inertia)
    A = np.block([[system.A, B_Omega], [np.zeros((3, n + 3))]])
    B = np.zeros((n + 3, len(torquers)))
    for column, torquer in enumerate(torquers):
        if torquer.root_axis is None:
            B[:n, column] = system.B[:, system.input_labels.index(torquer.name)]
        else:
            B[n:, column] = mobility[:, torquer.root_axis - 1]
    C = np.block([[system.C, np.zeros((system.noutputs, 3))], [np.zeros((3, n)), np.eye(3)]])
    arrays = System(A, B, C, np.zeros((len(C), len(torquers))), 0.0)
    states = [*system.state_labels, *OMEGA_NAMES]
    named = arrays.to_control([t.name for t in torquers], [*model.angle_names, *OMEGA_NAMES], states)
    named = observed(named, job.platform, [*model.angle_names, *rates], model.q0, model.Omega0)
    at_samples = sampled(named, job.sampling.period, job.sampling.delay, [t.lag for t in torquers])
    return CoupledPlant(_read_late(job, at_samples), (), (), 0.0)
