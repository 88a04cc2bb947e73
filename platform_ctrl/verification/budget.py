"""The line of sight's budget of a job: what each of its sources does to it with all loops closed.

The coupled linear model, sampled exactly, follows `analysis.jitter_budget`. The sources are those of ``[budget]`` and
the noise and quantisation of the sensors that the controllers read; dry friction is replaced by its describing function
at the rates that the budget itself finds, and by the noise of what is not in proportion to the rate.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, selected, state_arrays
from platform_ctrl.analysis.budget_result import Budget as Found
from platform_ctrl.analysis.disturbances import Disturbance, RandomDisturbance, SampleNoise, SineDisturbance, Spectrum
from platform_ctrl.analysis.dry_friction import FrictionBalance, friction_balance
from platform_ctrl.analysis.friction_noise import friction_noise
from platform_ctrl.analysis.hybrid_plant import HybridPlant
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.pointing_windows import motion_transfer
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.design.cases import at_angles, secant_gains
from platform_ctrl.design.plants import forgetting
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.budget import Budget, Source
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import FORCE_NAMES, OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import LOS_ANGLES, LOS_RATES
from platform_ctrl.verification.budget_limits import assumption, judged
from platform_ctrl.verification.budget_result import LineOfSightBudget, WindowBudget
from platform_ctrl.verification.coupled import acts_on_root, coupled_plant, drifting_angles, one_controller

if TYPE_CHECKING:
    import control

# Relative errors of variances, and of the rates that friction is balanced with.
_TOLERANCE, _FRICTION_TOLERANCE = 1e-5, 1e-4
# The same for one controller after the other.
_QUICK = 1e-4
# Rate at which free angles decay, 1/s: far below all sources, so that springs and their feedforward count in full.
_FORGETTING = 2e-3
# A recorded spectrum has at most so many points to an octave; below, its own.
_PER_OCTAVE = 24
# The fitted line's extent from end to end over its root mean square.
_EXTENT = math.sqrt(12.0)


def expect_budget(job: Job) -> Budget:
    """Return the budget of a job whose plant has a line of sight."""
    if job.budget is None:
        raise ArgumentError(
            f"job {job.name!r}: there is no [budget]; add one, with a [[budget.source]] for each thing that shakes the "
            "line of sight (platform-ctrl new NAME --kind camera-gimbal writes an example)"
        )
    if job.platform.line_of_sight is None:
        raise ArgumentError(
            f"platform {job.platform.name!r}: there is no [line_of_sight]; state what looks out in the plant"
        )
    return job.budget


@check_arguments
def line_of_sight_budget(job: Job, controllers: Sequence[control.StateSpace]) -> LineOfSightBudget:
    """Return the budget of the line of sight with `controllers` closed around the coupled sampled model at rest.

    Parameters
    ----------
    job
        With a budget, and a plant with a line of sight.
    controllers
        u = K y in the order in which they are computed, with the job's sample period.

    Returns
    -------
    LineOfSightBudget
        By source and axis at zero gimbal angles, rad; limits are judged at the job's gimbal angles where it is worst.

    Raises
    ------
    ArgumentError
        The job has no budget or the plant no line of sight, a base rate acts on a platform that is free, the
        controllers do not fit the plant, or the loop is not stable.
    NotFoundError
        No rates were found that agree with the damping by dry friction at them.
    """
    return PreparedBudget(job, controllers).first


class _Balanced(NamedTuple):
    """Gimbal angles (n,), and what stands for dry friction there: damping, and the noise of the rest."""

    q: FloatArray
    friction: FrictionBalance | None
    rest: tuple[RandomDisturbance, ...]


class PreparedBudget:
    """A job's budget, prepared for one controller after the other: some milliseconds each.

    Parameters
    ----------
    job
        With a budget, and a plant with a line of sight.
    controllers
        For which dry friction is balanced; u = K y in the order in which they are computed.
    like
        Of a plant that differs little: friction is taken from there instead, and only the gimbal angles count at which
        limits were decided there.

    Attributes
    ----------
    first
        The budget with `controllers`.

    Raises
    ------
    ArgumentError, NotFoundError
        As `line_of_sight_budget`.
    """

    def __init__(self, job: Job, controllers: Sequence[control.StateSpace], like: PreparedBudget | None = None) -> None:
        self._loop = loop = _Loop(job, expect_budget(job), controllers)
        if like is None:
            nominal = _balanced(loop, job.trims[0])
            self._balanced = [nominal, *(_balanced(loop, q, nominal.friction) for q in job.trims[1:])]
            tolerance = _TOLERANCE
        else:
            self._balanced, tolerance = like.deciding, _QUICK
        self._prepared = [_prepared(loop, one) for one in self._balanced]
        self.first, decided = self._found(loop.controller, range(len(self._balanced)), tolerance)
        self._decided = sorted({0, *decided})

    @property
    def deciding(self) -> list[_Balanced]:
        """Zero gimbal angles, and those at which limits were worst."""
        return [self._balanced[k] for k in self._decided]

    def of(self, controllers: Sequence[control.StateSpace]) -> LineOfSightBudget:
        """Return the budget with other controllers of the same signals.

        Parameters
        ----------
        controllers
            u = K y in the order in which they are computed, with the job's sample period.

        Returns
        -------
        LineOfSightBudget
            With the friction of `first`, and limits at the gimbal angles that decided there.

        Raises
        ------
        ArgumentError
            The loop is not stable.
        """
        return self._found(self._loop.controller_of(controllers), self._decided, _QUICK)[0]

    def _found(
        self, controller: StateArrays, places: Sequence[int], tolerance: float
    ) -> tuple[LineOfSightBudget, list[int]]:
        """Return the budget at the first of some angles, and the place of those at which each limit is worst."""
        found: list[LineOfSightBudget] = []
        for k in places:
            apart, together = self._prepared[k]
            # Only the first is shown over frequency.
            of_all = together.of(controller, tolerance, over_frequency=not found)
            alone = of_all if apart is together else apart.of(controller, tolerance, over_frequency=not found)
            found.append(_result(self._loop, self._balanced[k], alone, of_all))
        worst = [max(range(len(found)), key=lambda k: found[k].results[j].ratio) for j in range(len(found[0].results))]
        results = tuple(found[k].results[j] for j, k in enumerate(worst))
        return replaced(found[0], {"results": results}), [places[k] for k in worst]


def _balanced(loop: _Loop, q: FloatArray, near: FrictionBalance | None = None) -> _Balanced:
    """Return what stands for dry friction at gimbal angles (n,); `near` is the balance at others."""
    dry = loop.dry
    if not dry:
        return _Balanced(q, None, ())
    places = [len(LOS_RATES) + loop.job.platform.gimbal(one.gimbal) for one in dry]

    def found(viscous: FloatArray, over_frequency: bool) -> Found:
        prepared = loop.prepared(loop.damped(viscous, q), loop.together, ())
        return prepared.of(loop.controller, _TOLERANCE, over_frequency=over_frequency)

    def rates(viscous: FloatArray) -> FloatArray:
        return np.asarray(found(viscous, False).total[places])

    balance = friction_balance(dry, rates, None if near is None else near.rate, _FRICTION_TOLERANCE)
    moved = found(balance.viscous, True)
    lowest = 2.0 * math.pi * loop.budget.from_hz
    rest = []
    for one, at, rms in zip(dry, places, balance.rate, strict=True):
        spectrum = friction_noise(one, float(rms), moved.edges, moved.total_cumulative[at], lowest)
        if spectrum is not None:
            name = f"dry friction of {one.gimbal}"
            rest.append(RandomDisturbance(name=name, inputs=(loop.torque_on(one.gimbal),), spectra=(spectrum,)))
    return _Balanced(q, balance, tuple(rest))


def _prepared(loop: _Loop, at: _Balanced) -> tuple[JitterBudget, JitterBudget]:
    """Return the budgets of the sources as if independent and as they are, one where that is the same."""
    plant = loop.damped(at.friction.viscous if at.friction is not None else np.zeros(0), at.q)
    together = loop.prepared(plant, [*loop.together, *at.rest], loop.budget.exposure)
    if loop.together is loop.apart:
        return together, together
    return loop.prepared(plant, [*loop.apart, *at.rest], loop.budget.exposure), together


class _Loop:
    """The loop of a job, for one damping of its bearings after the other."""

    def __init__(self, job: Job, budget: Budget, controllers: Sequence[control.StateSpace]) -> None:
        self.job, self.budget = job, budget
        self.free = acts_on_root(job, controllers)
        self.dry = [one for one in job.platform.frictions if max(*one.coulomb, *one.breakaway) > 0.0]
        self._seen_by = coupled_plant(job, linearise(job.platform), controllers)
        K = one_controller(job, controllers, self._seen_by)
        read = {name for one in controllers for name in one.input_labels}
        # An angle that no controller reads may drift.
        self.torquers, self.sensors = list(K.output_labels), [name for name in K.input_labels if name in read]
        self.controller = self.controller_of(controllers)
        self.inputs: list[str] = []
        columns = [self._input(source) for source in budget.sources]
        for friction in job.platform.frictions:
            self.torque_on(friction.gimbal)
        self.sources, self.rows = self._sources(columns)
        self.noise = self._noise()
        # As if all were independent, for what each does; and as they are.
        self.apart: list[Disturbance] = [*self.sources, *self.noise]
        self.together = self._joined()
        self.names = [*(one.name for one in budget.sources), *(one.name for one in self.noise)]
        self.kinds = [*(one.kind for one in budget.sources), *("sensor" for _ in self.noise)]

    def controller_of(self, controllers: Sequence[control.StateSpace]) -> StateArrays:
        """Return controllers as one, from the loop's sensors to its torquers."""
        K = one_controller(self.job, controllers, self._seen_by)
        return state_arrays(selected(K, self.torquers, self.sensors), "controllers")

    def prepared(self, plant: HybridPlant, sources: Sequence[Disturbance], exposures: Sequence[float]) -> JitterBudget:
        """Return what sources do to a plant, for any controller."""
        return JitterBudget(plant, sources, exposures, 2.0 * math.pi * self.budget.from_hz)

    def damped(self, viscous: FloatArray, q: FloatArray) -> HybridPlant:
        """Return the model about gimbal angles with damping (J,) in the place of dry friction."""
        added = dict(zip((one.gimbal for one in self.dry), map(float, viscous), strict=True))
        return self.plant(_damped(self.job.platform, added), q)

    def plant(self, platform: Platform, q: FloatArray) -> HybridPlant:
        """Return the model of a platform about gimbal angles, with the loop's torquers, sensors and sources."""
        model = linearise(platform, q=q)
        system = state_space(model, root="free" if self.free else "prescribed", specific_force=True)
        system = _with_torques(system, model.angle_names)
        shown = observed(system, platform, [*self.sensors, *LOS_RATES], model.q0, model.Omega0)
        torquers = {t.name: t for t in platform.torquers}
        controls = [torquers[name].signal for name in self.torquers]
        columns = [shown.input_labels.index(name) for name in (*controls, *self.inputs)]
        A, B, C, D, _ = state_arrays(shown, "budget")
        gains = np.concatenate([secant_gains(self.job, q, self.torquers), np.ones(len(self.inputs))])
        # The gimbals' rates: the first states are their angles.
        rates = len(model.angle_names)
        C, D = np.vstack([C, A[:rates]]), np.vstack([D, B[:rates]])
        A = forgetting(A, shown.state_labels, drifting_angles(self.job) - set(self.sensors), _FORGETTING)
        late = {sensor.name: sensor.periods_late(self.job.sampling.period) for sensor in platform.sensors}
        return HybridPlant(
            plant=StateArrays(A, gains * B[:, columns], C, gains * D[:, columns]),
            controls=len(controls),
            measured=len(self.sensors),
            period=self.job.sampling.period,
            delay=self.job.sampling.delay,
            lag=np.array([torquers[name].lag for name in self.torquers]),
            reading_delay=tuple(late[name] for name in self.sensors),
            integrated=(True,) * len(LOS_RATES) + (False,) * rates,
        )

    def _input(self, source: Source) -> int:
        """Return the disturbance input on which a source acts."""
        if source.kind == "torque":
            return self.torque_on(source.gimbal or "")
        name = (OMEGA_NAMES if source.kind == "base-rate" else FORCE_NAMES)[(source.axis or 1) - 1]
        if source.kind == "base-rate" and self.free:
            raise ArgumentError(
                f"source {source.name!r}: a base rate moves a platform that is carried, and here a controller turns "
                "the root; state torques"
            )
        return self._index(name)

    def torque_on(self, gimbal: str) -> int:
        """Return the disturbance input that is the torque on a gimbal."""
        return self._index(_torque_on(self.job.platform.gimbals[self.job.platform.gimbal(gimbal)].angle))

    def _index(self, name: str) -> int:
        if name not in self.inputs:
            self.inputs.append(name)
        return self.inputs.index(name)

    def _sources(self, columns: list[int]) -> tuple[list[Disturbance], list[int]]:
        """Return the job's sources within the band, their sines one by one, and the source of each."""
        low, high = self.budget.from_hz, self.budget.to_hz
        out: list[Disturbance] = []
        rows = []
        for k, (source, at) in enumerate(zip(self.budget.sources, columns, strict=True)):
            spectrum = _spectrum(source, low, high)
            if spectrum is not None:
                out.append(RandomDisturbance(name=source.name, inputs=(at,), spectra=(spectrum,)))
                rows.append(k)
            lines = source.lines
            for i, (f, a) in enumerate(zip(lines.frequencies_hz, lines.amplitudes, strict=True)):
                if low <= f <= high:
                    phase = None if lines.phases is None else lines.phases[i : i + 1]
                    line = SineDisturbance(
                        name=f"{source.name}, line {i + 1}",
                        inputs=(at,),
                        frequency=2.0 * math.pi * float(f),
                        amplitude=np.array([a]),
                        phase=phase,
                    )
                    out.append(line)
                    rows.append(k)
        return out, rows

    def _noise(self) -> list[SampleNoise]:
        sensors = {sensor.name: sensor for sensor in self.job.platform.sensors}
        out = []
        for k, name in enumerate(self.sensors):
            sensor = sensors[name]
            if sensor.noise_rms > 0.0:
                rms = sensor.sampled_noise(self.job.sampling.period)
                out.append(SampleNoise(name=f"noise of {name}", measured=k, rms=rms))
            if sensor.quantisation > 0.0:
                out.append(
                    SampleNoise(name=f"quantisation of {name}", measured=k, rms=sensor.quantisation / math.sqrt(12.0))
                )
        return out

    def _joined(self) -> list[Disturbance]:
        """Return the sources with those that are correlated as one."""
        coherence = self.budget.coherences
        random = {self.rows[k]: one for k, one in enumerate(self.sources) if isinstance(one, RandomDisturbance)}
        groups = _connected(coherence, list(random))
        if all(len(group) == 1 for group in groups):
            return self.apart
        out: list[Disturbance] = []
        for group in groups:
            out.append(
                RandomDisturbance(
                    name=", ".join(random[k].name for k in group),
                    inputs=tuple(random[k].inputs[0] for k in group),
                    spectra=tuple(random[k].spectra[0] for k in group),
                    coherence=coherence[np.ix_(group, group)],
                )
            )
        return [*out, *(one for one in self.sources if isinstance(one, SineDisturbance)), *self.noise]


def _connected(coherence: np.ndarray[tuple[int, ...], np.dtype[np.complex128]], of: list[int]) -> list[list[int]]:
    """Return the groups of sources that are correlated with each other, directly or through others."""
    left, out = list(of), []
    while left:
        group = [left.pop(0)]
        for one in group:
            more = [k for k in left if coherence[one, k] != 0.0]
            group += more
            left = [k for k in left if k not in more]
        out.append(sorted(group))
    return out


def _damped(platform: Platform, viscous: dict[str, float]) -> Platform:
    """Return the platform with viscous friction in the place of dry friction."""
    if not viscous:
        return platform
    frictions = [
        dataclasses.replace(one, viscous=one.viscous + viscous[one.gimbal], coulomb=(0.0, 0.0), breakaway=(0.0, 0.0))
        if one.gimbal in viscous
        else one
        for one in platform.frictions
    ]
    return dataclasses.replace(platform, frictions=tuple(frictions))


def _torque_on(angle: str) -> str:
    return f"torque on {angle}"


def _with_torques(system: control.StateSpace, angles: Sequence[str]) -> control.StateSpace:
    """Return a model with the torque on every gimbal as a further input: it changes the gimbal's momentum."""
    import control

    states = list(system.state_labels)
    more = np.zeros((len(states), len(angles)))
    for k, angle in enumerate(angles):
        more[states.index(f"p_{angle}"), k] = 1.0
    return control.StateSpace(
        system.A,
        np.hstack([system.B, more]),
        system.C,
        np.hstack([system.D, np.zeros((system.noutputs, len(angles)))]),
        remove_useless_states=False,
        inputs=[*system.input_labels, *map(_torque_on, angles)],
        outputs=list(system.output_labels),
        states=states,
    )


def _spectrum(source: Source, low: float, high: float) -> Spectrum | None:
    """Return the density of a source within the band, None where there is none."""
    knots = source.knots_hz
    if not knots.size or max(low, knots[0]) >= min(high, knots[-1]):
        return None
    knots = np.unique(np.clip(knots, low, high))
    thin = _thinned(knots)
    if len(thin) == len(knots):
        return Spectrum(knots=2.0 * math.pi * knots, density=lambda w: source.density(w / (2.0 * math.pi)))
    # Of a record: the mean density between two knots, so that each keeps its share of the variance.
    mean = np.array([source.rms(a, b) ** 2 / (b - a) for a, b in pairwise(thin)])
    turns = 2.0 * math.pi * thin
    return Spectrum(
        knots=turns, density=lambda w: mean[np.clip(np.searchsorted(turns, w, side="right") - 1, 0, len(mean) - 1)]
    )


def _thinned(knots: FloatArray) -> FloatArray:
    """Return knots of a long table without those that are nearer than a 24th of an octave to the one before."""
    if len(knots) <= 8 * _PER_OCTAVE:
        return knots
    kept = [float(knots[0])]
    for one in knots[1:]:
        if one >= kept[-1] * 2.0 ** (1.0 / _PER_OCTAVE):
            kept.append(float(one))
    kept[-1] = float(knots[-1])
    return np.array(kept)


def _result(loop: _Loop, at: _Balanced, apart: Found, together: Found) -> LineOfSightBudget:
    """Return the result: sines of one source added up, and the limits judged."""
    budget = loop.budget
    names = [*loop.names, *(one.name for one in at.rest)]
    place = [*loop.rows, *range(len(budget.sources), len(names))]
    sums = np.zeros((len(names), len(apart.names)))
    sums[place, range(len(apart.names))] = 1.0
    rms = np.sqrt(sums @ apart.rms[:, :3] ** 2)
    windows = []
    for one in together.windows:
        smear, jitter = one.total_smear[:3], one.total_jitter[:3]
        windows.append(
            WindowBudget(
                exposure=one.exposure,
                displacement=one.total_displacement[:3],
                smear=_EXTENT * smear,
                jitter=jitter,
                about_mean=np.hypot(smear, jitter),
                contrast=np.array(
                    [motion_transfer(budget.spatial_frequencies, float(jitter[k]), float(smear[k])) for k in range(2)]
                ),
            )
        )
    linear = assumption(
        at.friction, at_angles(loop.job.platform, at.q), any(drive.friction for drive in loop.job.drives)
    )
    return LineOfSightBudget(
        names=tuple(names),
        kinds=(*loop.kinds, *("friction" for _ in at.rest)),
        axes=LOS_ANGLES,
        rms=rms,
        total=together.total[:3],
        windows=tuple(windows),
        frequencies_hz=apart.edges / (2.0 * math.pi),
        cumulative=np.einsum("sg,gik->sik", sums, apart.cumulative[:, :3]),
        total_cumulative=np.array(
            [np.interp(apart.edges, together.edges, of_axis) for of_axis in together.total_cumulative[:3]]
        ),
        friction=at.friction,
        results=judged(budget, rms, together.total[:3], windows, linear),
    )
