"""All loops closed on the coupled sampled model: poles, margins, and what the coupling costs.

Every gimbal takes part, those too that no loop turns. A motion that no controller sees, and that does not act on what
they see, cannot be stabilised: it must not grow by itself.

The design models are decoupled: for the caging loops Omega is given; in rate and pointing loops gimbals of other loops
are held, and the root whose motion they do not read; for the platform servo the platform turns under the torques M
alone and the gyros, caged, only measure. In the coupled model all react on the platform.
In a job without a loop on the root the vehicle carries the platform: a sensor of its rate measures the given Omega, to
which no loop is closed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import cached_property
from math import inf

import numpy as np

from platform_ctrl.analysis.feedback import loop_of_sensitivity
from platform_ctrl.analysis.interconnection import interconnected, interconnected_by_sample
from platform_ctrl.analysis.margins import DiskMargin, disk_margin
from platform_ctrl.analysis.metrics import COUPLED_METRICS, METRICS
from platform_ctrl.analysis.norms import drifting_rms, hinf_norm
from platform_ctrl.analysis.periodic import PeriodicLoop
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa, unseen_equilibria, without_drift
from platform_ctrl.analysis.system import ComplexArray, StateSpace, System
from platform_ctrl.common.text import at_most
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.design.cases import at_angles, near_keyhole, swung
from platform_ctrl.design.loop import moves_freely, with_resolvers
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import STABLE, CheckResult, Method, Requirement, drifting
from platform_ctrl.job.resolve import KEYHOLE
from platform_ctrl.mechanics.forces import resting_forces, specific_force_at, twisted
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.plant.locking import with_cogging, with_stuck_bristles
from platform_ctrl.plant.platform import Platform
from platform_ctrl.verification import coupled_plant as models
from platform_ctrl.verification.backlash import limit_cycle_results

ALL_LOOPS = "all loops closed"  # subject of what is required of the coupled system


@value
class CoupledCheck:
    """Poles, margins and noise of the coupled system.

    Attributes
    ----------
    plant, controller
        The sampled model that all loops work in (see `coupled_plant`); all controllers as one, from pick-offs
        and rate sensors to torquers; None where some are computed at every n-th sample: they are periodic then.
    poles : complex (n,)
        Of the closed loop, in z (dimensionless), over `period`; 0 for equilibria that no sensor sees.
    free_angles
        Names of the angles that nothing holds: all loops are in balance wherever they are.
    uncontrolled
        Names of gimbals that no loop turns and on which nothing depends that a loop reads.
    growing
        Whether these move away by themselves.
    period
        The sample period, or the time after which the order of computations of all controllers repeats, s.
    free
        Whether the platform is free: a controller acts on the root. Otherwise it is carried.
    channels
        Torquer names: one channel each.
    decoupled, coupled : (channels,)
        Loop-by-loop disk margins (one channel broken, all others closed) in the design models and in the coupled one,
        dimensionless. Of periodic loops they hold against perturbations that change with time too.
    cost : (channels,)
        Relative loss of margin against the decoupled design.
    simultaneous
        Disk margin in all channels at once.
    torque_noise : (channels,)
        Rms torque from the noise of the sensors, N m.
    results
        The job's limits compared with these.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.

    See docs/reference/job-file.md.
    """

    plant: StateSpace
    controller: StateSpace | None
    poles: ComplexArray
    period: float
    free: bool
    free_angles: tuple[str, ...]
    uncontrolled: tuple[str, ...]
    growing: bool
    channels: tuple[str, ...]
    decoupled: FloatArray
    coupled: FloatArray
    cost: FloatArray
    simultaneous: DiskMargin
    torque_noise: FloatArray
    results: tuple[CheckResult, ...]

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle, and nothing that no loop acts on moves away by itself."""
        return bool(np.abs(self.poles).max(initial=0.0) < 1.0) and not self.growing

    @property
    def stable_at_all_angles(self) -> bool:
        """Whether it is stable at zero angles, as `stable`, and at the other gimbal angles of the job too."""
        return self.stable and all(one.value > 0.0 for one in self.results if one.name == STABLE.name)


def coupled_check(job: Job, model: LinearModel, controllers: Sequence[StateSpace]) -> CoupledCheck:
    """Close `controllers` around the coupled sampled model and compare it with the job's limits.

    Parameters
    ----------
    job
        Limits, sampling and torquers.
    model
        From `linearise`, at rest.
    controllers
        u = K y in the order in which they are computed, with the job's sample period or whole numbers of them.

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

    See docs/reference/job-file.md.
    """
    made, controllers = controllers, with_resolvers(job, controllers, model.q0)
    plant = models.coupled_plant(job, model, controllers)
    together = _Together(job, controllers, plant)
    channels, coupled = together.channels, together.loop_margins
    decoupled = _decoupled_margins(job, model, controllers, together)
    # A decoupled loop without a margin has nothing to lose: that is no pass.
    cost = np.where(decoupled > 0.0, 1.0 - coupled / np.maximum(decoupled, np.finfo(float).tiny), np.inf)
    torque_noise = together.torque_noise

    def around(platform: Platform, q: FloatArray) -> _Together:
        of, there = replaced(job, {"platform": platform}), with_resolvers(job, made, q)
        return _Together(of, there, models.coupled_plant(of, linearise(platform, q=q), there))

    trims, at = [together], [""]
    held = _torques_at_rest(job).max(axis=0)
    platforms, stuck = [*swung(job), *with_cogging(job.platform, held)], with_stuck_bristles(job.platform)
    for label, platform in platforms if stuck is job.platform else [*platforms, ("bristles of bearings stick", stuck)]:
        for q in job.trims if label else job.trims[1:]:
            at.append("".join(f", {words}" for words in (label, at_angles(platform, q)) if words))
            trims.append(around(platform, q))
    margins = [one.simultaneous for one in trims]
    slowest = min(range(len(trims)), key=lambda k: trims[k].decay)
    least = min(range(len(trims)), key=lambda k: margins[k].guaranteed)
    margin, costliest = margins[least], int(np.argmax(cost))
    over = "" if together.controller is not None else f", over {job.cycle} samples"
    where = f"{at[slowest]}{over}{_conditions(job, together, trims[slowest].growing)}"
    bound = f"{len(channels)} torquers, guaranteed by diagonal scaling; at most {at_most(margin.upper, 4)}"
    measured: dict[str, tuple[float, str, Method]] = {
        STABLE.name: (trims[slowest].decay, f"poles of the coupled sampled closed loop{where}", "exact"),
        COUPLED_METRICS["simultaneous disk margin"].name: (
            margin.guaranteed,
            f"{bound}{at[least]}{_dry(job)}",
            "bound",
        ),
        COUPLED_METRICS["coupling cost"].name: (
            float(cost[costliest]),
            f"channel {channels[costliest]}, loop by loop",
            "exact",
        ),
    }
    roots = [k for k, name in enumerate(channels) if name in job.platform.root_torquers]
    if roots:
        noisiest = max(roots, key=lambda k: float(torque_noise[k]))
        coarse = [one.name for one in job.platform.sensors if one.quantisation and one.name in together.seen]
        evidence = f"torquer {channels[noisiest]}" + (
            f"; quantisation of {', '.join(coarse)} not counted" if coarse else ""
        )
        measured[METRICS["torque noise"].name] = (float(torque_noise[noisiest]), evidence, "exact")
    results = [
        one.judge(found, subject=subject, stage="coupled", evidence=evidence, method=method)
        for subject, one in coupled_requirements(job)
        if one.name in measured
        for found, evidence, method in [measured[one.name]]
    ]
    results += holding_results(job, channels, ALL_LOOPS)
    results += limit_cycle_results(job, lambda platform, q: around(platform, q).slowest, ALL_LOOPS)
    return CoupledCheck(
        plant=plant.system,
        controller=together.controller,
        poles=together.poles,
        period=together.period,
        free=moves_freely(job, controllers),
        free_angles=together.free_angles,
        uncontrolled=together.uncontrolled,
        growing=bool(together.growing),
        channels=channels,
        decoupled=decoupled,
        coupled=coupled,
        cost=cost,
        simultaneous=margins[0],
        torque_noise=torque_noise,
        results=tuple(results),
    )


def _conditions(job: Job, together: _Together, growing: str) -> str:
    """Return what the stability of all loops rests on, in words."""
    words = [f"no loop acts on {growing}: it moves away by itself"] if growing else []
    words += drifting(together.free_angles)
    if together.conserved:
        words.append(f"no loop changes the platform's momentum {', '.join(together.conserved)}: it counts as zero")
    if together.uncontrolled and not growing:
        words.append(f"no loop acts on {', '.join(together.uncontrolled)}, which no loop depends on")
    if near := near_keyhole(job, job.resolvers):
        words.append(f"{KEYHOLE} at {'; '.join(near)}")
    return "".join(f"; {one}" for one in words) + _dry(job)


def _dry(job: Job) -> str:
    play = "; gears closed, without play" if any(one.play for one in job.platform.compliances) else ""
    return play + ("; without dry friction" if job.platform.dry_frictions else "")


class _Together:
    """All controllers closed around a sampled plant, at every sample or each at its own rate."""

    def __init__(self, job: Job, controllers: Sequence[StateSpace], whole: models.CoupledPlant) -> None:
        self._job, self._whole = job, whole
        plant = self._plant = whole.system
        self.seen, torquers = models.used_signals(job, controllers, plant)
        self.channels, self.uncontrolled, self.conserved = tuple(torquers), whole.uncontrolled, whole.conserved
        self.controller: StateSpace | None = None
        self._periodic: PeriodicLoop | None = None
        by_sample = interconnected_by_sample(controllers, self.seen, torquers, job.sampling.period)
        at, seen = (
            [labels.index(name) for name in names]
            for labels, names in ((list(plant.input_labels), torquers), (list(plant.output_labels), self.seen))
        )
        read = [k for k, name in enumerate(self.seen) if any(name in K.input_labels for K in controllers)]
        arrays = System.of(plant, "coupled plant")
        if len(by_sample) == 1:
            self.controller = one_controller(job, controllers, plant)
            own = arrays.part(seen, at).feedback(by_sample[0])
            outputs = [len(at) + k for k in read]
            drift = unseen_equilibria(own.part(outputs, slice(None)))
            self._own = own
            self.poles, self.period = poles(drift.system.A), job.sampling.period
        else:
            self._periodic = PeriodicLoop(arrays, by_sample, at, seen)
            drift = self._periodic.drift
            self.poles, self.period = self._periodic.poles, self._periodic.period
        names, moved = list(plant.state_labels), np.abs(drift.equilibria).max(axis=1, initial=0.0)
        angles = set(job.platform.angle_names)
        drifting = [name for name, one in zip(names, moved, strict=False) if one > 0.0 and name in angles]
        self._drift = drift
        self.free_angles = tuple(n for n in job.platform.angle_names if n in (*whole.left_out, *drifting))

    @property
    def growing(self) -> str:
        """Names of gimbals that no loop acts on and that move away by themselves."""
        return ", ".join(self.uncontrolled) if self._whole.growth > 0.0 else ""

    @property
    def decay(self) -> float:
        """The minimum decay rate, 1/s."""
        own = -float(spectral_abscissa(continuous_poles(self.poles, self.period)))
        return own if self._whole.growth <= 0.0 else min(own, -self._whole.growth)

    @property
    def slowest(self) -> tuple[complex, ComplexArray]:
        """The pole that decays most slowly, 1/s, and its part of the gimbals' angles (n,)."""
        z, modes = np.linalg.eig(self._drift.system.A)
        s, names = continuous_poles(z, self.period), list(self._whole.system.state_labels)
        k = int(np.argmax(s.real))
        mode = self._drift.motion(z[k], modes[:, k])
        return complex(s[k]), np.array(
            [mode[names.index(n)] if n in names else 0.0 for n in self._job.platform.angle_names]
        )

    @cached_property
    def loop_margins(self) -> FloatArray:
        """Disk margin of each channel, all others closed."""
        if self._periodic is not None:
            return self._periodic.loop_margins()
        if not self.decay > 0.0:
            return np.zeros(len(self.channels))
        # S − 1/2 of each channel, with the others closed.
        alone = [without_drift(self._own.part([k], [k], 0.5)) for k in range(len(self.channels))]
        norms = [hinf_norm(one, allow_unstable=True)[0] for one in alone]
        return np.array([1.0 / norm if norm > 0.0 else np.inf for norm in norms])

    @property
    def simultaneous(self) -> DiskMargin:
        """Disk margin in all channels at once."""
        if self._periodic is not None:
            return self._periodic.disk_margin
        m = len(self.channels)
        S = without_drift(self._own.part(slice(m), slice(m)))
        return disk_margin(loop_of_sensitivity(S._replace(D=S.D + np.eye(m))))

    @property
    def torque_noise(self) -> FloatArray:
        """Rms of each torque, N m; of periodic loops over the samples of a period."""
        sensors = {s.name: s for s in self._job.platform.sensors}
        period, often = self._job.sampling.period, self._job.often_read
        rms = np.array([sensors[name].sampled_noise(period, often.get(name, 1)) for name in self.seen], np.float64)
        m = len(self.channels)
        if self._periodic is None:
            return drifting_rms(self._own.part(slice(m), slice(m, None)), rms)
        parts = self._periodic.noise_to_torque(rms)
        return np.array([np.linalg.norm(drifting_rms(one, np.ones(one.B.shape[1]))) for one in parts])


def one_controller(job: Job, controllers: Sequence[StateSpace], plant: StateSpace) -> StateSpace:
    """Return all controllers as one, from the sensors that `plant` shows to the torquers that are used."""
    seen, torquers = models.used_signals(job, controllers, plant)
    names = [name for K in controllers for name in K.state_labels]
    whole = interconnected(controllers, seen, torquers, job.sampling.period)
    return whole.to_control(seen, torquers, names, name="all loops")


def _decoupled_margins(job: Job, model: LinearModel, controllers: Sequence[StateSpace], whole: _Together) -> FloatArray:
    """Return the disk margin of each channel in the design models; `whole` are all loops on the coupled one."""
    channels = whole.channels
    gimbal_torquers = [t for t in job.platform.torquers if t.gimbal is not None and t.name in channels]
    own = {t.name for t in gimbal_torquers} | {name for K in controllers for name in K.input_labels}
    caging = [K for K in controllers if set(K.output_labels) <= own]
    loops = [spec for spec in job.loops if spec.kind != "tracking"]
    turning = [spec for spec in loops if spec.kind in ("rate", "pointing")]
    reacts = moves_freely(job, controllers) and not any(spec.moves_root(job.platform) for spec in loops)
    if len(caging) == len(controllers) and (not turning or len(loops) == 1) and not reacts:
        # All loops cage gyros, or one turns gimbals: the design models are the coupled one.
        return whole.loop_margins
    margins: dict[str, float] = {}
    for spec in turning:
        # The gimbals of other loops are held, and the root where the loop does not read its motion.
        group = [spec, *(one for one in job.loops if one.around == spec.name)]
        names = {name for one in group for name in (*job.channels_of(one), *job.readings_of(one))}
        mine = [K for K in caging if set(K.output_labels) <= names]
        caging = [K for K in caging if not set(K.output_labels) <= names]
        gimbals = [name for name in model.gimbal_names if name in (*spec.gimbals, *job.passive_gimbals)]
        plant = models.coupled_plant(job, model, mine, gimbals, spec.moves_root(job.platform))
        together = _Together(job, mine, plant)
        margins |= dict(zip(together.channels, together.loop_margins, strict=True))
    if caging:
        plant = models.coupled_plant(job, model, caging, free=False)
        together = _Together(job, caging, plant)
        margins |= dict(zip(together.channels, together.loop_margins, strict=True))
    if len(margins) < len(channels):
        plant = models.one_way_plant(job, model, models.sensed_rates(job, controllers))
        together = _Together(job, controllers, plant)
        margins = dict(zip(together.channels, together.loop_margins, strict=True)) | margins
    return np.array([margins[name] for name in channels])


def coupled_requirements(job: Job) -> tuple[tuple[str, Requirement], ...]:
    """Return the requirements on the coupled system in the order of the verdict, each with its subject."""
    out = [(ALL_LOOPS, STABLE)]
    for metric in COUPLED_METRICS.values():
        limit = getattr(job.coupled, metric.key)
        if limit is not None:
            out.append((ALL_LOOPS, Requirement.of(metric, limit)))
    for spec in job.loops:
        if spec.kind == "stabilisation":
            out += [(spec.name, one) for one in spec.requirements if one.metric.of_torquers]
    return tuple(out)


def _torques_at_rest(job: Job) -> FloatArray:
    """Return the magnitudes of what turns each gimbal at rest at the job's angles, (angles, n), N m."""
    platform, f = job.platform, specific_force_at(job.platform)
    trims = [twisted(platform, q, f) for q in job.trims]
    return np.abs([resting_forces(platform, q, f) for q in trims])[:, 3:]


HOLDS = Requirement(name="torque at rest over its limit", limit=1.0, unit="", sense="at most")
LASTS = Requirement(name="torque at rest over the continuous one", limit=1.0, unit="", sense="at most")


def holding_results(job: Job, torquers: Collection[str], subject: str) -> Iterator[CheckResult]:
    """Yield a result that is missed for each gimbal that its torquers, of those that loops use, cannot hold or turn.

    At zero angles and at every combination of the job's angles, under springs, unbalance and weight, root at rest;
    breakaway of dry friction and cogging add to them, and ripple takes torque away. Motors also have to bear what is at
    rest for ever.
    """
    platform = job.platform
    limits: dict[str, float] = {}
    lasting: dict[str, float] = {}
    for one in platform.torquers:
        if one.gimbal is not None and one.name in torquers:
            limit = inf if one.limit is None else one.gain * one.limit
            limits[one.gimbal] = limits.get(one.gimbal, 0.0) + one.least_share * limit
            lasting[one.gimbal] = lasting.get(one.gimbal, 0.0) + one.least_share * one.lasting
    forces = _torques_at_rest(job)
    for gimbal, limit in limits.items():
        own = forces[:, platform.gimbal(gimbal)]
        worst = int(np.argmax(own))
        stuck = platform.breakaway(gimbal)
        teeth = sum(abs(float(row[1])) for k, row in platform.cogging if k == platform.gimbal(gimbal))
        where = f", {at_angles(platform, job.trims[worst])}" if worst else ""
        held = f"{own[worst]:.3g} N m hold it"
        if own[worst] + stuck + teeth > limit:
            parts = [held] if own[worst] > 0.0 else []
            parts += [f"{stuck:.3g} N m of dry friction have to be overcome"] if stuck > 0.0 else []
            parts += [f"{teeth:.3g} N m of cogging have to be overcome"] if teeth > 0.0 else []
            yield HOLDS.judge(
                (own[worst] + stuck + teeth) / limit,
                subject=subject,
                stage="coupled",
                evidence=f"gimbal {gimbal}: {' and '.join(parts)}, its torquers have {limit:.3g} N m{where}",
                method="exact",
            )
        if own[worst] > lasting[gimbal]:
            evidence = f"gimbal {gimbal}: {held}, its motors bear {lasting[gimbal]:.3g} N m for ever{where}"
            yield LASTS.judge(
                own[worst] / lasting[gimbal], subject=subject, stage="coupled", evidence=evidence, method="exact"
            )
