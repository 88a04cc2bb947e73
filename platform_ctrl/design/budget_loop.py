"""The loop of a budget: the coupled linear model, its sources and sensors, and its controllers with their drives."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from platform_ctrl.analysis.dry_friction import FrictionGains
from platform_ctrl.analysis.hybrid_plant import (
    Density,
    Disturbance,
    HybridPlant,
    RandomDisturbance,
    SampleNoise,
    SineDisturbance,
)
from platform_ctrl.analysis.interconnection import MultiRate, interconnected_at_rates
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import moves_freely, with_resolvers
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.budget import BudgetSpec, Source
from platform_ctrl.job.drive import DriveLaw
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import connected, linearise
from platform_ctrl.mechanics.outputs import observed_system
from platform_ctrl.mechanics.state_space import free_system, linear_system, tilting
from platform_ctrl.plant.force_elements import Friction
from platform_ctrl.plant.platform import FORCE_NAMES, OMEGA_NAMES
from platform_ctrl.plant.sensors import LOS_RATES

# A recorded spectrum has at most so many points to an octave; below, its own.
_PER_OCTAVE = 24


def _torque_on(angle: str) -> str:
    return f"torque on {angle}"


def _from_outside(angle: str) -> str:
    return f"torque on {angle} from outside"


class BudgetLoop:
    """The loop of a job, for one damping of its bearings after the other."""

    def __init__(self, job: Job, budget: BudgetSpec, controllers: Sequence[StateSpace]) -> None:
        self.job, self.budget = job, budget
        self.free, self.given = moves_freely(job, controllers), controllers
        self.dry = job.platform.dry_frictions
        read = {name for one in with_resolvers(job, controllers, job.trims[0]) for name in one.input_labels}
        used = {name for one in controllers for name in one.output_labels}
        # An angle that no controller reads may drift.
        self.sensors = [one.name for one in job.platform.sensors if one.name in read]
        self.torquers = [one.name for one in job.platform.torquers if one.name in used]
        self.laws = self._drives()
        self.turning = self._turning()
        # Of `dry` those on bristles, which take part in the model while a bearing does not turn.
        self.elastic = [k for k, one in enumerate(self.dry) if one.bristle_stiffness and not self.turning[k]]
        # Of the outputs of `damped` the rates of these bearings, the first deflection, and what comes behind.
        self.bearings = [len(LOS_RATES) + job.platform.gimbal(one.gimbal) for one in self.dry]
        self.bent = len(LOS_RATES) + len(job.platform.gimbals)
        self.behind = self.bent + len(self.elastic)
        self.cycle = self.controllers_of(controllers, job.trims[0]).cycle
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

    def controllers_of(self, controllers: Sequence[StateSpace], q: FloatArray) -> MultiRate:
        """Return controllers as one at gimbal angles (n,), from the loop's sensors to its torquers."""
        turned = with_resolvers(self.job, controllers, q)
        return interconnected_at_rates(turned, self.sensors, self.torquers, self.job.sampling.period)

    def with_drives(self, controller: MultiRate, fed: FloatArray) -> MultiRate:
        """Return a controller with what drives add in proportion to readings, `fed` (J,), N m s."""
        D = np.array(controller.fast.D)
        for law, each in zip(self.laws, fed, strict=True):
            if law is not None:
                D[self.torquers.index(law.torquer), : len(self.sensors)] += each * self.weights(law)
        return controller._replace(fast=controller.fast._replace(D=D))

    def weights(self, law: DriveLaw) -> FloatArray:
        """Return the weights of the sensors (p,) in the rate that a drive finds."""
        return np.array([law.weights.get(name, 0.0) for name in self.sensors])

    def _drives(self) -> list[DriveLaw | None]:
        """Return what is fed forward against each dry friction; its torquer and sensors join those of the loop."""
        gimbals = {one.name: one.gimbal for one in self.job.platform.torquers}
        out: list[DriveLaw | None] = []
        for one in self.dry:
            laws = [law for law in self.job.drive_laws if law.friction and gimbals[law.torquer] == one.gimbal]
            if len(laws) > 1:
                names = " and ".join(law.torquer for law in laws)
                raise ArgumentError(
                    f"budget: {names} both feed friction of gimbal {one.gimbal!r} forward; let one drive do it"
                )
            out += laws or [None]
            for law in laws:
                self.torquers += [law.torquer] if law.torquer not in self.torquers else []
                self.sensors += [name for name in law.weights if name not in self.sensors]
        return out

    def _turning(self) -> FloatArray:
        """Return the mean rates of the bearings with dry friction (J,), rad/s; motor sides turn as their loads."""
        platform, rates = self.job.platform, dict(self.budget.turning)
        angles = dict(zip(platform.gimbal_names, platform.angle_names, strict=True))
        for load, motor in platform.sides:
            rates.setdefault(platform.angle_names[motor], rates.get(platform.angle_names[load], 0.0))
        out = np.array([rates.get(angles[one.gimbal], 0.0) for one in self.dry])
        for one, law, rate in zip(self.dry, self.laws, out, strict=True):
            if law is not None and rate:
                raise ArgumentError(
                    f"budget: turning: {law.torquer} feeds friction of gimbal {one.gimbal!r} forward, of which the "
                    "linear budget knows no mean rate; leave one of the two out, or simulate"
                )
        return out

    def prepared(self, plant: HybridPlant, sources: Sequence[Disturbance], exposures: Sequence[float]) -> JitterBudget:
        """Return what sources do to a plant, for any controller."""
        return JitterBudget(plant, sources, exposures, 2.0 * math.pi * self.budget.from_hz)

    def damped(self, gains: FrictionGains, q: FloatArray) -> HybridPlant:
        """Return the model about gimbal angles with gains in the place of dry friction, but those of drives.

        Outputs behind the readings: rates of the line of sight and of the gimbals, deflections of bristles.
        """
        added = dict(zip((one.gimbal for one in self.dry), map(float, gains.viscous), strict=True))
        own = self.job.platform.frictions
        frictions = tuple(one.linear(added[one.gimbal]) if one.gimbal in added else one for one in own)
        platform = dataclasses.replace(self.job.platform, frictions=frictions)
        model = linearise(platform, q=q)
        system = (free_system if self.free else linear_system)(model, specific_force=True, currents=True)
        shown = observed_system(system, platform, [*self.sensors, *LOS_RATES], model.q0, model.Omega0)
        torquers = {t.name: t for t in platform.torquers}
        controls = [torquers[name].signal for name in self.torquers]
        A, B, C, D = shown[:4]
        # The torque on a gimbal changes its momentum.
        momenta = [shown.state_labels.index(f"p_{angle}") for angle in model.angle_names]
        inside = np.eye(len(A))[:, momenta]
        # From outside, as of wind, it works on modes as the first torquer of the gimbal does.
        outside, first = inside.copy(), {t.gimbal: t.name for t in reversed(platform.torquers)}
        for mode in platform.modes:
            if (swing := f"p_{mode.name}") in shown.state_labels:
                shares = mode.of([first.get(name, "") for name in platform.gimbal_names])
                outside[shown.state_labels.index(swing)] = shares
        B, D = np.hstack([B, inside, outside]), np.pad(D, ((0, 0), (0, 2 * len(momenta))))
        labels = [*shown.input_labels, *map(_torque_on, model.angle_names), *map(_from_outside, model.angle_names)]
        columns = [labels.index(name) for name in (*controls, *self.inputs)]
        # Limits on base motion take a sine at full rate of any frequency, whose tilt ends at 1 rad (`PlantResponses`).
        # Here the density of a source says how far the root tilts, and no rate that would end it.
        tilted = tilting(shown.B, platform) @ np.array([[one == name for one in self.inputs] for name in OMEGA_NAMES])
        # The gimbals' rates: the first states are their angles.
        rates = slice(len(model.angle_names))
        plant = System(A, B[:, columns], np.vstack([C, A[rates]]), np.vstack([D, B[rates]])[:, columns])
        for k in self.elastic:
            at = self.job.platform.gimbal(self.dry[k].gimbal)
            plant = _with_bristles(plant, self.dry[k], (at, momenta[at]), gains.share[k], gains.slip[k])
        period, often = self.job.sampling.period, self.job.often_read
        late = {one.name: one.periods_late(period, often.get(one.name, 1)) for one in platform.sensors}
        return HybridPlant(
            plant=plant,
            controls=len(controls),
            measured=len(self.sensors),
            period=period,
            delay=self.job.sampling.delay,
            lag=np.array([torquers[name].lag for name in self.torquers]),
            reading_delay=tuple(late[name] for name in self.sensors),
            integrated=(True,) * len(LOS_RATES) + (False,) * (self.behind - len(LOS_RATES)),
            cycle=self.cycle,
            of_integral=np.pad(tilted, ((0, len(self.elastic)), (0, 0))) if tilted.any() else None,
        )

    def _input(self, source: Source) -> int:
        """Return the disturbance input on which a source acts."""
        if source.kind == "torque":
            return self.torque_on(source.gimbal or "", _from_outside)
        name = (OMEGA_NAMES if source.kind == "base-rate" else FORCE_NAMES)[(source.axis or 1) - 1]
        if source.kind == "base-rate" and self.free:
            raise ArgumentError(
                f"source {source.name!r}: a base rate moves a platform that is carried, and here a controller turns "
                "the root; state torques"
            )
        return self._index(name)

    def torque_on(self, gimbal: str, name: Callable[[str], str] = _torque_on) -> int:
        """Return the disturbance input that is the torque on a gimbal: of its bearing, or by name from outside."""
        return self._index(name(self.job.platform.gimbals[self.job.platform.gimbal(gimbal)].angle))

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
                rms = sensor.sampled_noise(self.job.sampling.period, self.job.often_read.get(name, 1))
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
        rows = list(random)
        groups = [sorted(rows[k] for k in group) for group in connected(coherence[np.ix_(rows, rows)] != 0.0)]
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


def _with_bristles(plant: System, friction: Friction, states: tuple[int, int], share: float, slip: float) -> System:
    """Return a plant with ż = share q̇ − slip z and −σ0 z − σ1 ż on the momentum; `states`: angle and momentum."""
    A, B, C, D, _ = plant
    angle, momentum = states
    A, C = (np.pad(one, ((0, 1), (0, 1))) for one in (A, C))
    B, D = (np.pad(one, ((0, 1), (0, 0))) for one in (B, D))
    A[-1], B[-1], C[-1, -1] = share * A[angle], share * B[angle], 1.0
    A[-1, -1] -= slip
    A[momentum] -= friction.bristle_damping * A[-1]
    B[momentum] -= friction.bristle_damping * B[-1]
    A[momentum, -1] -= friction.bristle_stiffness
    return System(A, B, C, D)


def _spectrum(source: Source, low: float, high: float) -> Density | None:
    """Return the density of a source within the band, None where there is none."""
    knots = source.spectrum.within(low, high)
    if not knots.size:
        return None
    thin = _thinned(knots)
    if len(thin) == len(knots):
        return Density(knots=2.0 * math.pi * knots, density=lambda w: source.density(w / (2.0 * math.pi)))
    # Of a record: the mean density between two knots, so that each keeps its share of the variance.
    mean = np.array([source.rms(a, b) ** 2 / (b - a) for a, b in pairwise(thin)])
    turns = 2.0 * math.pi * thin
    return Density(
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
