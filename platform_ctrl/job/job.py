"""A job to be designed and checked: the job file as values. SI units; Hz only where a name says so."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from itertools import product
from typing import Annotated, Any, get_args

import numpy as np

from platform_ctrl.analysis.interconnection import COMMAND
from platform_ctrl.common.values import FloatArray, input_value
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.drive import Drive, DriveLaw, drive_law
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.manoeuvre import Manoeuvre
from platform_ctrl.job.methods import DesignSpec, LoopKind, kind_misfits
from platform_ctrl.job.requirements import LoopRequirement, limit_misfits, loop_goals, loop_requirements, out_of_reach
from platform_ctrl.job.resolve import Resolver, reading_units, resolve_misfits, resolver
from platform_ctrl.job.scenario import HalfCosine, Scenario
from platform_ctrl.job.variation import Campaign, Faults, Uncertainty
from platform_ctrl.plant import fields
from platform_ctrl.plant.mistakes import Misfit, suggestion, useless, within, wrong
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import body_rotations
from platform_ctrl.plant.tables import TABLE, Array, Instead, InTable, Shape

MOST_LOOPS, MOST_DRIVES = 100, 100
_RATE_HZ = Instead("rate_hz", fields.FREQUENCY, lambda rate, _: 1.0 / rate, lambda period: 1.0 / period)
_LOOP_LIMITS = Shape(dict, {}, others=("", fields.POSITIVE))  # which keys there are, METRICS says
_ANGLES = Shape(dict, {}, others=("", fields.NUMBERS))


@input_value
class Sampling:
    """Sample period, and how long the computer takes.

    Attributes
    ----------
    period
        From sample to sample, s.
    delay
        From the sample to the torque, s.
    """

    period: Annotated[float, _RATE_HZ]
    delay: fields.NotNegative


# Kinds of loops that may be computed at every n-th sample.
OWN_RATES = ("rate", "pointing", "tracking")
# Keys that have no effect in a loop, by its kind.
_NO_EFFECT = {
    "caging": {"sensors", "torquers", "around", "resolve"},
    "rate": {"around"},
    "pointing": {"around"},
    "tracking": {"gimbals", "torquers"},
    "stabilisation": {"gimbals", "sensors", "torquers", "around", "soft", "resolve"},
}


@input_value
class LoopSpec:
    """A loop to be designed.

    Attributes
    ----------
    name, kind
        Which loop: ``"caging"`` keeps gimbals at zero against the platform; ``"rate"`` keeps rates that sensors measure
        at zero or at the command of a loop around it, ``"pointing"`` angles; ``"tracking"`` commands a rate loop by the
        angle that a tracker measures; ``"stabilisation"`` keeps the platform at rest.
    gimbals
        That the loop's torquers turn; all others are held in its plants.
    sensors, torquers
        What a rate, pointing or tracking loop reads (see `kept`) and sets; no torquers: the first one on each gimbal.
    resolve, resolve_limit, resolve_base
        Whether what the loop keeps is turned to the axes of gimbals, the largest gain, and the sensors of the root's
        rate whose share is subtracted: `platform_ctrl.job.resolve`.
    around
        The rate loop that a tracking loop commands.
    rate_hz
        How often a rate, pointing or tracking loop is computed, Hz: a whole fraction of the sample rate; between, its
        outputs are held. None: at every sample.
    designs, use
        By which methods, and the name of the design that is closed.
    limits
        What it has to reach, by the keys and in the units of ``[loop.limits]`` (see docs/reference/job-file.md):
        the verdict rests on it.
    soft
        Goals, by the same keys and in the same units: a method that optimises makes their largest ratio small within
        the limits. No part of the verdict.
    requirements, goals
        What limits and goals require of metrics, stability of all plants included.
    """

    name: fields.SystemName
    kind: Annotated[LoopKind, fields.one_of(get_args(LoopKind))]
    gimbals: fields.Names = ()
    sensors: fields.Names = ()
    torquers: fields.Names = ()
    resolve: fields.Truth = False
    resolve_limit: fields.AtLeastOne = 5.0
    resolve_base: fields.Names = ()
    around: fields.Text | None = None
    rate_hz: fields.Positive | None = None
    designs: Annotated[tuple[DesignSpec, ...], Array("design", least=1, most=MOST_LOOPS, unique=("name",))]
    use: fields.Text
    limits: Annotated[dict[str, float], _LOOP_LIMITS] = field(default_factory=dict)
    soft: Annotated[dict[str, float], _LOOP_LIMITS] = field(default_factory=dict)
    requirements: tuple[LoopRequirement, ...] = field(init=False, default=())
    goals: tuple[LoopRequirement, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        """Read the requirements."""
        object.__setattr__(self, "requirements", loop_requirements(self.limits, self.kind))
        object.__setattr__(self, "goals", loop_goals(self.soft, self.kind))

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        kind, designs = table["kind"], table["design"]
        for key in _NO_EFFECT[kind] & table.keys():
            yield useless(table, key, f"in a {kind} loop; leave the key out")
        if "rate_hz" in table and kind not in OWN_RATES:
            slower = f"{', '.join(OWN_RATES)} loops alone may be slower than [sampling]"
            yield useless(table, "rate_hz", f"in a {kind} loop; leave it out: {slower}")
        yield from resolve_misfits(table)
        for k, design in enumerate(designs):
            yield from ((("design", k, key), text) for key, text in kind_misfits(design, kind))
        for key in ("limits", "soft"):
            yield from within((key,), limit_misfits(table.get(key, {})))
        names = [design["name"] for design in designs]
        if table["use"] not in names:
            yield wrong(table, "use", "the name of a design of this loop", f"; {suggestion(table['use'], names)}")

    @property
    def requests(self) -> tuple[LoopRequirement, ...]:
        """Requirements and goals, for `analysis.loop_metrics.measure`."""
        return (*self.requirements, *self.goals)

    @property
    def has_plants(self) -> bool:
        """Whether the loop has plants of its own; else it is checked in the coupled system alone."""
        return self.kind != "stabilisation"

    def moves_root(self, platform: Platform) -> bool:
        """Return whether the loop reads the motion of a root on which nothing acts: its torquers move it then."""
        read = {name for one in platform.sensors if one.name in self.sensors for name in one.signals(platform)}
        weightless = platform.mode == "pivot" and not (platform.gravity.any() or platform.specific_force.any())
        own = {*OMEGA_NAMES, *body_rotations(platform, 0)}
        return (platform.mode == "floating" or weightless) and bool(read & own)

    @property
    def closed(self) -> DesignSpec:
        """The design that is closed."""
        return next(design for design in self.designs if design.name == self.use)

    def kept(self, platform: Platform) -> tuple[str, ...]:
        """Return the sensors that the loop keeps at zero or commands: the first of its unit, one for each torquer."""
        units = {sensor.name: sensor.unit for sensor in platform.sensors}
        own = [name for name in self.sensors if units.get(name) == ("rad/s" if self.kind == "rate" else "rad")]
        return tuple(own if self.kind == "tracking" else own[: len(self.torquers or self.gimbals)])

    def read_by(self, design: DesignSpec) -> LoopSpec:
        """Return the loop as a design reads it: with the design's own sensors, where it has some."""
        return dataclasses.replace(self, sensors=design.sensors) if design.sensors else self


@input_value
class CoupledLimits:
    """What the coupled system has to reach; None: no requirement.

    Attributes
    ----------
    disk_margin
        Simultaneous disk margin in all channels, dimensionless, at least.
    coupling_cost
        Largest relative loss of a loop-by-loop disk margin against the decoupled design.
    limit_cycle
        Largest amplitude of a gimbal's oscillation from the play of drives, rad; None: there may be none.
    """

    disk_margin: fields.Positive | None = None
    coupling_cost: fields.Positive | None = None
    limit_cycle: fields.Positive | None = None

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        yield from out_of_reach(table)


@input_value
class Job:
    """A job file: the plant, its operation and uncertainty, the loops and the checks.

    Attributes
    ----------
    name, plant
        Title; the shipped name or path of the plant.
    platform
        The plant itself.
    Omega : (3,)
        Largest platform rate about each axis, rad/s.
    uncertainty, faults
        How far the parameters may lie from their nominal values, and the faults that the design allows for.
    sampling
        Sample period and delay of the controllers.
    loops, coupled
        The loops with their designs and limits, and what all of them together have to reach.
    drives
        What torquers do besides what the loops command.
    manoeuvres, fault_events
        The simulated runs, and the faults that happen at a time in them.
    seed
        What everything random in design and simulation is drawn from.
    Omega_grid
        Number of points between −Omega and Omega about each axis; 2: the corners alone.
    angles
        Gimbal angles at which the loops have to work, rad, by the names of the angles; angles that are not named stay
        at zero. With several, every combination counts.
    locked
        Names of gimbals that are locked at the angle zero: `platform` does not have them any more.
    campaign
        Many runs, or None.
    budget
        What disturbs the line of sight, or None.
    tolerance
        Share by which a value may be worse than in an accepted result.
    """

    name: fields.Text
    plant: str
    platform: Platform
    Omega: Annotated[fields.Rates, InTable("operation", "Omega")]
    Omega_grid: Annotated[fields.GridPoints, InTable("operation", "Omega_grid")] = 2
    seed: Annotated[fields.Seed, InTable("operation", "seed")] = 0
    angles: Annotated[dict[str, tuple[float, ...]], InTable("operation", "angles"), _ANGLES] = field(
        default_factory=dict
    )
    locked: Annotated[fields.Names, InTable("operation", "locked")] = ()
    uncertainty: Annotated[Uncertainty, TABLE] = field(default_factory=Uncertainty)
    faults: Annotated[Faults, TABLE] = field(default_factory=Faults)
    sampling: Annotated[Sampling, TABLE]
    loops: Annotated[tuple[LoopSpec, ...], Array("loop", least=1, most=MOST_LOOPS, unique=("name",))]
    drives: Annotated[tuple[Drive, ...], Array("drive", most=MOST_DRIVES, unique=("torquer",))] = ()
    coupled: Annotated[CoupledLimits, TABLE] = field(default_factory=CoupledLimits)
    manoeuvres: Annotated[tuple[Manoeuvre, ...], Array("manoeuvre", unique=("name",))] = ()
    fault_events: Annotated[tuple[Fault, ...], Array("fault", unique=("name",))] = ()
    campaign: Annotated[Campaign | None, TABLE] = None
    budget: Annotated[BudgetSpec | None, TABLE] = None
    tolerance: fields.Part = 0.01

    @property
    def trims(self) -> tuple[FloatArray, ...]:
        """Gimbal angles (n,) at which the loops have to work, rad: zero first, then all combinations of `angles`."""
        names = self.platform.angle_names
        lists = [sorted(set(self.angles.get(name, (0.0,)))) for name in names]
        return (np.zeros(len(names)), *(np.array(q) for q in product(*lists) if any(q)))

    def every(self, spec: LoopSpec) -> int:
        """Return at every how many samples a loop is computed.

        Parameters
        ----------
        spec
            One of the loops.

        Returns
        -------
        int
            1 or more.
        """
        return 1 if spec.rate_hz is None else max(round(1.0 / (spec.rate_hz * self.sampling.period)), 1)

    def period_of(self, spec: LoopSpec) -> float:
        """Return the time from one computation of a loop to the next.

        Parameters
        ----------
        spec
            One of the loops.

        Returns
        -------
        float
            s.
        """
        return self.every(spec) * self.sampling.period

    def loop(self, name: str) -> LoopSpec:
        """Return a loop of the job by its name."""
        return next(one for one in self.loops if one.name == name)

    def channels_of(self, spec: LoopSpec) -> tuple[str, ...]:
        """Return the names of the torquers that a loop sets; of a tracking loop those of the commands that it sets."""
        if spec.kind == "tracking":
            inner = self.loop(str(spec.around))
            return tuple(f"{name}{COMMAND}" for name in self.readings_of(inner.read_by(inner.closed), kept=True))
        if not spec.has_plants:
            return self.platform.root_torquers
        return spec.torquers or tuple(self.platform.torquer_on(name).name for name in spec.gimbals)

    def readings_of(self, spec: LoopSpec, kept: bool = False) -> tuple[str, ...]:
        """Return the names of what a loop reads, or keeps; none of a stabilisation loop, which may read all."""
        if spec.kind == "caging":
            return tuple(self.platform.pickoff_on(name).name for name in spec.gimbals)
        names, law = spec.kept(self.platform) if kept else spec.sensors, self.resolver(spec)
        return names if law is None else law.of(names)

    def resolver(self, spec: LoopSpec) -> Resolver | None:
        """Return what turns the readings of a loop to the axes of its gimbals, on the nominal plant; None: nothing."""
        if not spec.resolve:
            return None
        inner = self.loop(str(spec.around)) if spec.kind == "tracking" else spec
        kept = spec.kept(self.platform)
        return resolver(self.platform, inner.gimbals, kept, spec.resolve_limit, spec.resolve_base)

    @property
    def resolvers(self) -> tuple[Resolver, ...]:
        """What turns readings to the axes of gimbals, in the order of the loops that ask for it."""
        return tuple(law for spec in self.loops if (law := self.resolver(spec)) is not None)

    @property
    def units(self) -> dict[str, str]:
        """Units of all that controllers may read, by names: sensors in the plant's order, then resolved readings."""
        return reading_units(self.platform, self.resolvers)

    def read_in(self, spec: LoopSpec, design: DesignSpec) -> tuple[str, ...]:
        """Return the names of what a design of a loop reads, the sensors of its feedforward too."""
        fed = design.feedforward
        return (*self.readings_of(spec.read_by(design)), *(() if fed is None else fed.sensors))

    @property
    def often_read(self) -> dict[str, int]:
        """At every how many samples the sensors of slower loops are read, by their names: the common divisor."""
        # Drives are computed at every sample.
        out = {name: 1 for law in self.drive_laws for name in law.weights}
        for spec in self.loops:
            if not spec.designs:
                continue  # a loop of which no more than what it turns is known
            law = self.resolver(spec)
            for name in (*self.read_in(spec, spec.closed), *(() if law is None else (*law.read, *law.encoders))):
                out[name] = math.gcd(out.get(name, 0), self.every(spec))
        return out

    @property
    def passive_gimbals(self) -> tuple[str, ...]:
        """Names of the gimbals that no loop turns, in the file's order: they move as they are driven."""
        on = {torquer.name: torquer.gimbal for torquer in self.platform.torquers}
        turned = {name for spec in self.loops for name in (*spec.gimbals, *(on.get(t) for t in spec.torquers))}
        return tuple(name for name in self.platform.gimbal_names if name not in turned)

    @property
    def cycle(self) -> int:
        """Number of samples after which the order of computations of all loops repeats."""
        return math.lcm(*(self.every(spec) for spec in self.loops))

    @property
    def drive_laws(self) -> tuple[DriveLaw, ...]:
        """The drives with the weights of their sensors on the nominal plant."""
        return tuple(drive_law(self.platform, one) for one in self.drives)

    @property
    def commanded(self) -> frozenset[str]:
        """Names of the readings that a manoeuvre commands."""
        return frozenset(one.reading for manoeuvre in self.manoeuvres for one in manoeuvre.commands)

    @property
    def campaign_manoeuvres(self) -> tuple[tuple[Manoeuvre, float], ...]:
        """Manoeuvres of the campaign with their weights, relative to one another.

        All alike where it names none or there is no campaign.
        """
        if self.campaign is None or not self.campaign.manoeuvres:
            return tuple((manoeuvre, 1.0) for manoeuvre in self.manoeuvres)
        by_name = {manoeuvre.name: manoeuvre for manoeuvre in self.manoeuvres}
        return tuple((by_name[one.name], one.weight) for one in self.campaign.manoeuvres)

    @property
    def reference_filters(self) -> dict[str, float]:
        """Time constants of the reference filters, as they are sampled, by the names of readings, s."""
        out: dict[str, float] = {}
        for spec in self.loops:
            shaping = spec.closed.command if spec.designs else None
            if shaping is not None:
                period = self.period_of(spec)
                # Tustin's rule, prewarped at the filter's frequency.
                tau = 0.5 * period / math.tan(math.pi * shaping.filter_hz * period)
                out |= dict.fromkeys(self.readings_of(spec.read_by(spec.closed)), tau)
        return out

    def scenario(self, manoeuvre: Manoeuvre) -> Scenario:
        """Return the run of a manoeuvre on the nominal plant: the job's seed, run 0.

        Parameters
        ----------
        manoeuvre
            One of `manoeuvres`.

        Returns
        -------
        Scenario
            For `simulation.simulate`, with controllers.
        """
        caged = manoeuvre.mode == "caged"
        torque = np.zeros(3)
        torque[manoeuvre.axis - 1] = manoeuvre.torque
        q, rate, Omega = (np.zeros(k) for k in (len(self.platform.gimbals), len(self.platform.gimbals), 3))
        angles = self.platform.angle_names
        initial = dict(manoeuvre.initial)
        for load, motor in self.platform.sides:  # a motor side starts with its load
            for end in ("", "_rate"):
                initial.setdefault(angles[motor] + end, initial.get(angles[load] + end, 0.0))
        for name, number in initial.items():
            if name in angles:
                q[angles.index(name)] = number
            elif name in OMEGA_NAMES:
                Omega[OMEGA_NAMES.index(name)] = number
            else:
                rate[angles.index(name.removesuffix("_rate"))] = number
        profile = HalfCosine(axis=manoeuvre.axis, rate=manoeuvre.rate, rise=manoeuvre.rise, hold=manoeuvre.hold)
        return Scenario(
            platform=self.platform,
            mode=manoeuvre.mode,
            duration=manoeuvre.duration,
            delay=self.sampling.delay,
            profile=profile if caged and manoeuvre.rate else None,
            Omega_table=manoeuvre.Omega_table,
            torque=torque,
            torque_table=manoeuvre.torque_table,
            vibrations=(*manoeuvre.vibrations, *(part for one in manoeuvre.gimbal_torques for part in one.random)),
            sines=(*manoeuvre.sines, *(part for one in manoeuvre.gimbal_torques for part in one.sine)),
            gimbal_torques=tuple(part for one in manoeuvre.gimbal_torques for part in one.course),
            commands=manoeuvre.commands,
            filters=self.reference_filters,
            drives=self.drive_laws,
            resolvers=self.resolvers,
            faults=tuple(fault for fault in self.fault_events if fault.name in manoeuvre.faults),
            q=q,
            rate=rate,
            Omega=Omega,
            start=manoeuvre.start,
            seed=self.seed,
            settle=manoeuvre.settle,
            fade=manoeuvre.fade,
            limits=dict(manoeuvre.limits),
        )
