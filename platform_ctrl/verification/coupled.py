"""All loops closed on the coupled sampled model: poles, margins, and what the coupling costs.

The design models are decoupled: for the caging loops Omega is given; for the platform servo the platform turns under
the torques M alone and the gyros, caged, only measure. In the coupled model the platform feels the gyros' reactions.
In a job without a loop on the root the vehicle carries the platform: a sensor of its rate measures the given Omega, to
which no loop is closed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, seen_states, state_arrays
from platform_ctrl.analysis.feedback import closed_loop, loop_transfer
from platform_ctrl.analysis.interconnection import interconnect_controllers
from platform_ctrl.analysis.margins import DiskMargin, disk_margin, loop_margins
from platform_ctrl.analysis.metrics import COUPLED_METRICS, METRICS
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.sampling import late_outputs, late_states, sampled
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import at_most
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.cases import at_angles, secant_gains
from platform_ctrl.design.plants import forgetting
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import STABLE, CheckResult, Method, Requirement
from platform_ctrl.job.requirements import loop_requirements
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space, subsystems
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control

ALL_LOOPS = "all loops closed"  # subject of what is required of the coupled system


@value
class CoupledCheck:
    """What the coupled system does.

    Attributes
    ----------
    plant, controller
        The sampled model that all loops work in (see `coupled_plant`); all controllers as one, from pick-offs
        and rate sensors to torquers.
    poles : complex (n,)
        Of the closed loop, in z (dimensionless).
    free
        Whether the platform is free: a controller acts on the root. Otherwise it is carried.
    channels
        Torquer names: one channel each.
    decoupled, coupled : (channels,)
        Loop-by-loop disk margins (one channel broken, all others closed) in the design models and in the coupled one,
        dimensionless.
    cost : (channels,)
        Relative loss of margin against the decoupled design.
    simultaneous
        Disk margin in all channels at once.
    of_torquers
        Metrics of the torquers in the coupled system, SI units, (channels,) each, by their keys in `METRICS`.
    results
        The job's limits compared with these.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.

    See docs/job-file.md.
    """

    plant: control.StateSpace
    controller: control.StateSpace
    poles: ComplexArray
    free: bool
    channels: tuple[str, ...]
    decoupled: FloatArray
    coupled: FloatArray
    cost: FloatArray
    simultaneous: DiskMargin
    of_torquers: Mapping[str, FloatArray]
    results: tuple[CheckResult, ...]

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return bool(np.abs(self.poles).max(initial=0.0) < 1.0)

    @property
    def torque_noise(self) -> FloatArray:
        """Rms torque from the noise of the sensors, N m, (channels,)."""
        return self.of_torquers["torque noise"]


@check_arguments
def coupled_check(job: Job, model: LinearModel, controllers: Sequence[control.StateSpace]) -> CoupledCheck:
    """Close `controllers` around the coupled sampled model and compare it with the job's limits.

    Parameters
    ----------
    job
        Limits, sampling and torquers.
    model
        From `linearise`, at rest.
    controllers
        u = K y in the order in which they are computed, with the job's sample period.

    Returns
    -------
    CoupledCheck
        Poles, margins and noise of the whole, and the verdicts.

    Raises
    ------
    ArgumentError
        The controllers do not fit the plant.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.

    See docs/job-file.md.
    """
    plant = coupled_plant(job, model, controllers)
    K = one_controller(job, controllers, plant)
    loop = closed_loop(plant, K)
    z = poles(loop.A)
    channels = tuple(K.output_labels)
    coupled = loop_margins(plant, K, at="input").alpha
    decoupled = _decoupled_margins(job, model, controllers, channels)
    # A decoupled loop without a margin has nothing to lose: that is no pass.
    cost = np.where(decoupled > 0.0, 1.0 - coupled / np.maximum(decoupled, np.finfo(float).tiny), np.inf)
    simultaneous = disk_margin(loop_transfer(plant, K, at="input"))
    of_torquers = _torquer_metrics(job, loop, len(channels))
    decay = -float(spectral_abscissa(continuous_poles(z, job.sampling.period)))
    worst = _worst_trims(job, controllers, decay, simultaneous)
    return CoupledCheck(
        plant=plant,
        controller=K,
        poles=z,
        free=acts_on_root(job, controllers),
        channels=channels,
        decoupled=decoupled,
        coupled=coupled,
        cost=cost,
        simultaneous=simultaneous,
        of_torquers=of_torquers,
        results=coupled_results(
            job,
            worst.decay,
            channels,
            cost,
            (worst.simultaneous.guaranteed, worst.simultaneous.upper),
            of_torquers,
            at=(worst.decay_at, worst.margin_at),
        ),
    )


# Kinds of loops that hold a body in inertial space where they read no angle of a gimbal.
_HOLD_BODIES = ("rate", "pointing")


class _Worst(NamedTuple):
    """The slowest decay and the least simultaneous margin over the job's gimbal angles, and where they are."""

    decay: float
    decay_at: str
    simultaneous: DiskMargin
    margin_at: str


def _worst_trims(job: Job, controllers: Sequence[control.StateSpace], decay: float, simultaneous: DiskMargin) -> _Worst:
    out = _Worst(decay, "", simultaneous, "")
    for q in job.trims[1:]:
        plant = coupled_plant(job, linearise(job.platform, q=q), controllers)
        K, where = one_controller(job, controllers, plant), f", {at_angles(job.platform, q)}"
        own = -float(spectral_abscissa(continuous_poles(poles(closed_loop(plant, K).A), job.sampling.period)))
        margin = disk_margin(loop_transfer(plant, K, at="input"))
        if own < out.decay:
            out = out._replace(decay=own, decay_at=where)
        if margin.guaranteed < out.simultaneous.guaranteed:
            out = out._replace(simultaneous=margin, margin_at=where)
    return out


def coupled_plant(job: Job, model: LinearModel, controllers: Sequence[control.StateSpace]) -> control.StateSpace:
    """Return the sampled model in which all `controllers` work, from torquers (in the file's order) to angles.

    Outputs are besides the angles the rates that the controllers take in and a sensor of the plant measures.
    With a controller that acts on the root the platform is free and reacts. Without one nothing would hold it: it
    counts as carried by the vehicle, Omega given, and only the subsystems that a controller acts on are closed.
    """
    if acts_on_root(job, controllers):
        system = state_space(model, root="free")
        torquers, angles = list(job.platform.torquers), list(model.angle_names)
    else:
        used = {name for K in controllers for name in K.output_labels}
        driven = {t.gimbal for t in job.platform.torquers if t.name in used}
        gimbals = [name for group in subsystems(model) if driven & set(group) for name in group]
        system = state_space(model, gimbals=gimbals)
        torquers = [t for t in job.platform.torquers if t.gimbal in gimbals]
        angles = [g.angle for g in job.platform.gimbals if g.name in gimbals]
    read = {name for K in controllers for name in K.input_labels}
    drifting = drifting_angles(job)
    angles = [name for name in angles if name in read or name not in drifting]
    outputs = [*angles, *sensed_rates(job, controllers)]
    whole = observed(system, job.platform, outputs, model.q0, model.Omega0)
    columns = [whole.input_labels.index(t.signal) for t in torquers]
    kept = seen_states(whole.A[None], whole.C[None]) if drifting else range(whole.nstates)
    A = forgetting(whole.A, whole.state_labels, drifting)
    names = [t.name for t in torquers]
    gains = secant_gains(job, model.q0, names)
    arrays = StateArrays(
        A[np.ix_(kept, kept)],
        gains * whole.B[np.ix_(kept, columns)],
        whole.C[:, kept],
        gains * whole.D[:, columns],
        0.0,
    )
    named = named_system(arrays, names, outputs, [whole.state_labels[k] for k in kept])
    return _read_late(job, sampled(named, job.sampling.period, job.sampling.delay, [t.lag for t in torquers]))


def drifting_angles(job: Job) -> set[str]:
    """Return the angles of gimbals that rate and pointing loops turn, and that no loop reads: they hold a body."""
    turned = {name for spec in job.loops if spec.kind in _HOLD_BODIES for name in spec.gimbals}
    used = {name for spec in job.loops for name in spec.read_by(spec.closed).sensors}
    read = {signal for sensor in job.platform.sensors if sensor.name in used for signal in sensor.signals(job.platform)}
    return {gimbal.angle for gimbal in job.platform.gimbals if gimbal.name in turned} - read


def _drifting_words(job: Job) -> str:
    if not drifting_angles(job):
        return ""
    kinds = dict.fromkeys(spec.kind for spec in job.loops if spec.kind in _HOLD_BODIES)
    return f"; angles that {' and '.join(kinds)} loops leave free do not count"


def _read_late(job: Job, plant: control.StateSpace) -> control.StateSpace:
    """Return a sampled plant whose sensors' readings are as late as they are."""
    late = {sensor.name: sensor.periods_late(job.sampling.period) for sensor in job.platform.sensors}
    outputs = list(plant.output_labels)
    periods = [late.get(name, 0) for name in outputs]
    if not any(periods):
        return plant
    arrays = late_outputs(state_arrays(plant, "coupled plant"), periods)
    states = [*plant.state_labels, *late_states(outputs, periods)]
    return named_system(arrays, list(plant.input_labels), outputs, states)


def sensed_rates(job: Job, controllers: Sequence[control.StateSpace]) -> list[str]:
    """Return what a sensor measures beside the angles, such as rates, and one of the controllers takes in."""
    used = {name for K in controllers for name in K.input_labels} - set(job.platform.angle_names)
    return [s.name for s in job.platform.sensors if s.name in used]


def _root_torquers(job: Job) -> set[str]:
    return {t.name for t in job.platform.torquers if t.root_axis is not None}


def acts_on_root(job: Job, controllers: Sequence[control.StateSpace]) -> bool:
    """Return whether a controller sets a torque on the root: the platform is free then."""
    return any(_root_torquers(job) & set(K.output_labels) for K in controllers)


def one_controller(
    job: Job, controllers: Sequence[control.StateSpace], plant: control.StateSpace
) -> control.StateSpace:
    """Return all controllers as one, from the sensors that `plant` shows to the torquers that are used."""
    used = {name for K in controllers for name in K.output_labels}
    torquers = [name for name in plant.input_labels if name in used]
    seen = [s.name for s in job.platform.sensors if s.name in plant.output_labels]
    return interconnect_controllers(controllers, seen, torquers, job.sampling.period)


def _decoupled_margins(
    job: Job, model: LinearModel, controllers: Sequence[control.StateSpace], channels: Sequence[str]
) -> FloatArray:
    gimbal_torquers = [t for t in job.platform.torquers if t.gimbal is not None and t.name in channels]
    own = {t.name for t in gimbal_torquers} | {name for K in controllers for name in K.input_labels}
    caging = [K for K in controllers if set(K.output_labels) <= own]
    margins: dict[str, float] = {}
    if caging:
        plant = coupled_plant(job, model, caging)
        K = one_controller(job, caging, plant)
        margins |= dict(zip(K.output_labels, loop_margins(plant, K, at="input").alpha, strict=True))
    if len(margins) < len(channels):
        plant = one_way_plant(job, model, sensed_rates(job, controllers))
        K = one_controller(job, controllers, plant)
        one_way = loop_margins(plant, K, at="input").alpha
        margins = dict(zip(K.output_labels, one_way, strict=True)) | margins
    return np.array([margins[name] for name in channels])


def one_way_plant(job: Job, model: LinearModel, rates: Sequence[str]) -> control.StateSpace:
    """The platform turns under M alone, J ω' = M, and the gimbals see its rate: no reaction."""
    system = state_space(model)
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
    arrays = StateArrays(A, B, C, np.zeros((len(C), len(torquers))), 0.0)
    states = [*system.state_labels, *OMEGA_NAMES]
    named = named_system(arrays, [t.name for t in torquers], [*model.angle_names, *OMEGA_NAMES], states)
    named = observed(named, job.platform, [*model.angle_names, *rates], model.q0, model.Omega0)
    return _read_late(job, sampled(named, job.sampling.period, job.sampling.delay, [t.lag for t in torquers]))


def torquer_metrics(noise_to_torque: StateArrays, rms: FloatArray) -> dict[str, FloatArray]:
    """Return the metrics of every torquer from the closed loop between the sensors' noise and the torque commands."""
    return {
        kind: metric.of_torquers(noise_to_torque, rms)
        for kind, metric in METRICS.items()
        if metric.of_torquers is not None
    }


def _torquer_metrics(job: Job, loop: control.StateSpace, channels: int) -> dict[str, FloatArray]:
    arrays = state_arrays(loop, "coupled loop")
    noisy = [k for k, name in enumerate(loop.input_labels) if name.startswith("noise_")]
    names = [loop.input_labels[k].removeprefix("noise_") for k in noisy]
    sensors = {s.name: s for s in job.platform.sensors}
    rms = [sensors[name].sampled_noise(job.sampling.period) for name in names]
    A, B, C, D, dt = arrays
    noise_to_torque = StateArrays(A, B[:, noisy], C[:channels], D[:channels, noisy], dt)
    return torquer_metrics(noise_to_torque, np.array(rms, dtype=np.float64))


def coupled_requirements(job: Job) -> tuple[tuple[str, Requirement], ...]:
    """Return the requirements on the coupled system in the order of the verdict, each with its subject."""
    out = [(ALL_LOOPS, STABLE)]
    for metric in COUPLED_METRICS.values():
        limit = getattr(job.coupled, metric.key)
        if limit is not None:
            required = Requirement(name=metric.name, limit=limit, unit=metric.unit, sense=metric.sense)
            out.append((ALL_LOOPS, required))
    for spec in job.loops:
        if spec.kind == "stabilisation":
            out += [(spec.name, one) for one in loop_requirements(spec.limits) if one.metric.of_torquers]
    return tuple(out)


def coupled_results(
    job: Job,
    decay: float,
    channels: Sequence[str],
    cost: FloatArray,
    simultaneous: tuple[float, float],
    of_torquers: Mapping[str, FloatArray],
    proved: bool = True,
    at: tuple[str, str] = ("", ""),
) -> tuple[CheckResult, ...]:
    """Return the verdicts on the requirements on the coupled system; see `CoupledCheck`.

    `simultaneous` are a guaranteed lower and an upper bound of the simultaneous disk margin; `proved` is whether the
    lower one holds between all frequencies. `of_torquers` is as `torquer_metrics` returns it. `at` are words for the
    gimbal angles at which decay and margin are worst.
    """
    scaling = f"{len(channels)} torquers, guaranteed by diagonal scaling; at most {at_most(simultaneous[1], 4)}{at[1]}"
    costliest = int(np.argmax(cost))
    measured: dict[str, tuple[float, str, Method]] = {
        STABLE.name: (decay, f"poles of the coupled sampled closed loop{at[0]}{_drifting_words(job)}", "exact"),
        COUPLED_METRICS["simultaneous disk margin"].name: (simultaneous[0], scaling, "bound" if proved else "sampled"),
        COUPLED_METRICS["coupling cost"].name: (
            float(cost[costliest]),
            f"channel {channels[costliest]}, loop by loop",
            "exact",
        ),
    }
    roots = [k for k, name in enumerate(channels) if name in _root_torquers(job)]
    for kind, values in of_torquers.items() if roots else ():
        sign = 1.0 if METRICS[kind].sense == "at most" else -1.0
        worst = max(roots, key=lambda k, values=values, sign=sign: sign * values[k])  # type: ignore[misc]
        measured[METRICS[kind].name] = (float(values[worst]), f"torquer {channels[worst]}", "exact")
    results = []
    for subject, one in coupled_requirements(job):
        if one.name in measured:
            found, evidence, method = measured[one.name]
            results.append(one.judge(found, subject=subject, stage="coupled", evidence=evidence, method=method))
    return tuple(results)
