"""A way to design a loop: what it is given, what it returns, and what the app and the documentation show of it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, cast

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import StateSpace, System, block
from platform_ctrl.common.arguments import nearest
from platform_ctrl.common.progress import Progress
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import Design, delivered, measured
from platform_ctrl.design.loop_signals import Channels, loop_channels, loop_signals
from platform_ctrl.design.sections import Section, between, flattened, gain, low_pass
from platform_ctrl.design.tuning import Builder, Tuner, over_decades
from platform_ctrl.errors import DesignError, NotCertifiedError
from platform_ctrl.job import methods
from platform_ctrl.job.drive import CommandShaping
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.mechanics.linearisation import LinearModel

OptionGroup = Literal["gains", "lead", "notch", "lag", "design"]
Family = Literal["speed", "robustness"]
# Of the reference filter: it answers a step without overshoot.
_DAMPING = 1.0
# A tuner's start with a notch at a resonance, and the damping ratio below which a motion is one.
_NOTCH, _SWING = {"notch_depth": 0.1, "notch_width": 0.4}, 0.2


@value
class Option:
    """A number that a method takes, all > 0, and how the app's slider shows it.

    Attributes
    ----------
    label, unit, group, tip
        Texts of the slider; `group` is the heading above it.
    low, high
        Ends of the slider; for frequencies `high` is a share of the sample rate.
    logarithmic, whole
        Whether the slider is logarithmic, and whether the number counts something.
    part
        The optional part of the controller that it belongs to, or an empty text.
    below_nyquist
        Whether the method refuses it from half the sample rate on.
    """

    label: str
    tip: str
    unit: str = ""
    group: OptionGroup = "design"
    low: float = 0.0
    high: float = math.inf
    logarithmic: bool = True
    whole: bool = False
    part: str = ""
    below_nyquist: bool = False


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoopProblem:
    """What a design method is given."""

    # job, spec, design: the job, one of its loops, and one of that loop's designs.
    job: Job
    spec: LoopSpec
    design: DesignSpec
    model: LinearModel  # the platform linearised at rest
    plant_set: PlantSet | None = None  # the plants of the loop, the nominal one first; None for a stabilisation loop
    # `channel`, where it does not follow from the loop alone, as of a loop around another one.
    directions: Channels | None = None
    known: Design | None = None  # the design of an earlier command, not measured, where it is the same
    progress: Progress = lambda line: None  # called with a line during long work

    @cached_property
    def plants(self) -> PlantSet:
        """The plants, the nominal one first; their outputs are the directions of `channel` where it has `sense`."""
        assert self.plant_set is not None, "the loop has plants"
        return self.channel.seen(self.plant_set)

    @cached_property
    def channel(self) -> Channels:
        """Gyroscopic pairs and inertial directions of the loop's gimbals."""
        if self.directions is not None:
            return self.directions
        signals = loop_signals(self.model.platform, self.spec.read_by(self.design))
        any_sensors = METHODS[self.design.method].any_sensors
        return loop_channels(self.model, signals, self.job.period_of(self.spec), any_sensors)

    def with_commands(self, K: System, sense: FloatArray | None = None) -> System:
        """Return a controller with its commands, if the design says what to do with them; else K.

        K reads the outputs of `plants`, or with `sense` (directions, readings) the readings themselves.
        """
        if self.design.command is None:
            return K
        own, plants = K._replace(dt=self.job.period_of(self.spec)), self.plants if sense is None else self.plant_set
        sense, commanded = np.eye(len(K.B.T)) if sense is None else sense, None if plants is None else plants.commanded
        return shaped(own, self.design.command, self.channel, sense, commanded)

    def made(
        self,
        controller: System,
        options: dict[str, float],
        claims: dict[str, float] | None = None,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
    ) -> Design:
        """Return a method's controller as a design that is not measured yet.

        `controller` is u = K y of `plants`, sampled with the loop's period or a static gain; of a loop without plants
        with the signals `inputs` and `outputs`. `options` are the method's numbers as finally used, in the units of the
        job file, `claims` what it claims, by name, in SI units.
        """
        spec, design, plants = self.spec, self.design, self.plant_set
        name = f"{spec.name}, {design.name}"
        if plants is None:
            K = controller._replace(dt=self.job.sampling.period).to_control(inputs, outputs, name=name)
        else:
            own = self.with_commands(self.channel.of_readings(controller), self.channel.sense)
            K = delivered(own._replace(dt=plants.period), plants, name)
        return self.of(K, options, claims or {})

    def of(self, controller: StateSpace, options: dict[str, float], claims: dict[str, float]) -> Design:
        """Return the design with a controller that has its signals by name, not measured yet."""
        return Design(
            loop=self.spec.name,
            name=self.design.name,
            method=self.design.method,
            controller=controller,
            options=options,
            claims=claims,
            plants=self.plant_set,
            directions=None if self.plant_set is None else self.channel,
        )


class Method(methods.JobMethod, ABC):
    """A way to design a loop of a job; `register_method` makes a subclass known.

    Attributes
    ----------
    advice
        What to try where its loop is not stable.
    tunable
        Options that the app and, with ``tune = true``, the method itself may move.
    goals
        Whether it works on the loop's goals: then its claims are the largest ratios of limits and goals.
    instant
        Whether the app builds it while a slider moves; others are designed in the background.
    parts
        Optional parts of the controller that the app switches on and off: label and tip by name.
    libraries
        Modules that take long to load and that it needs beside python-control.
    families
        Options that the app moves together for speed and for robustness: by how many per cent each for one per cent.
        The first of a loop's options in ``"speed"`` is shown as its speed.
    """

    options: ClassVar[Mapping[str, Option]]
    advice: ClassVar[str]
    tunable: ClassVar[tuple[str, ...]] = ()
    goals: ClassVar[bool] = False
    instant: ClassVar[bool] = False
    parts: ClassVar[Mapping[str, tuple[str, str]]] = {}
    libraries: ClassVar[tuple[str, ...]] = ()
    families: ClassVar[Mapping[Family, Mapping[str, float]]] = {}

    @property
    def rates(self) -> tuple[str, ...]:
        """Options that are scaled with the crossover."""
        return tuple(self.families.get("speed", ()))

    @abstractmethod
    def design(self, problem: LoopProblem) -> Design:
        """Return a design of a loop, see `LoopProblem.made`; a `DesignError` says why there is none."""

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options of a design, those that are not given by rules of thumb.

        `nutation` is the reference frequency of the plants' grids, rad/s, `period` that of the loop, s.
        """
        return dict(design.options)

    @classmethod
    def completed(
        cls, given: dict[str, float], defaults: dict[str, float], period: float, name: str | None = None
    ) -> dict[str, float]:
        """Return `defaults` with the `given` numbers in place, all judged; `name` is what messages call the method."""
        name = cls.key if name is None else name
        for key in sorted(set(given) - set(defaults)):
            close = nearest(key, defaults)
            hint = "" if close is None else f"did you mean {close!r}? "
            raise DesignError(
                f"{name}: option {key!r} has no meaning for this loop; {hint}its options are {', '.join(defaults)}"
            )
        out = defaults | given
        for key, x in out.items():
            option = cls.options[key]
            if not x > 0.0:
                raise DesignError(f"{name}: {key} must be > 0, got {x:g}")
            if option.below_nyquist and x * period >= 0.5:
                raise DesignError(f"{name}: {key} must be below half the sample rate, got {x:g}")
            if option.whole and not float(x).is_integer():
                raise DesignError(f"{name}: {key} must be a whole number, got {x:g}")
        return out

    def sections(self, problem: LoopProblem, options: dict[str, float]) -> tuple[Section, ...]:
        """Return the controller of complete options section by section, in their order; none: it is matrices alone."""
        return ()

    def judged(self, problem: LoopProblem, design: Design) -> Design:
        """Return a design that is judged on what the method alone knows too, as measured responses."""
        return design


def hertz(
    label: str, group: OptionGroup, tip: str, high: float = math.inf, part: str = "", below_nyquist: bool = False
) -> Option:
    """Return an option that is a frequency; the end of its slider is a share of the sample rate."""
    return Option(label=label, unit="Hz", group=group, tip=tip, high=high, part=part, below_nyquist=below_nyquist)


def number(label: str, tip: str, low: float, high: float, group: OptionGroup = "design", **more: Any) -> Option:
    """Return an option that is no frequency, with the ends of its slider."""
    return Option(label=label, tip=tip, low=low, high=high, group=group, **more)


# The registry of the job reader: `register_method` is given classes of this kind alone.
METHODS = cast("dict[str, Method]", methods.METHODS)


def designed(problem: LoopProblem) -> Design:
    """Return the design that the problem's method makes, with all its values recomputed; a DesignError says why not."""
    out = evaluated(problem)
    if (error := instability(out, problem.design.tune)) is not None:
        raise error
    return out


def evaluated(problem: LoopProblem) -> Design:
    """Return the design of the problem's method, all values recomputed from the closed loops; they may be unstable."""
    method = METHODS[problem.design.method]
    out = method.design(problem) if problem.known is None else problem.known
    if (plants := out.plants) is not None:
        out = measured(problem.spec, out)
    if method.goals:
        ratios = {"limit_ratio": out.results, "goal_ratio": out.goals}
        largest = {name: max(result.ratio for result in results) for name, results in ratios.items() if results}
        out = replace(out, claims=out.claims | largest)
    # A controller to which commands or feedforward were added has no sections.
    if plants is None or tuple(out.controller.input_labels) == plants.angles:
        out = replace(out, sections=method.sections(problem, out.options))
    return method.judged(problem, out)


def instability(design: Design, tuned: bool) -> NotCertifiedError | None:
    """Return the error that the closed loop with the nominal plant is unstable; None where it is stable."""
    measures = design.measures
    if measures is None or measures.decay[0] > 0.0:
        return None
    advice = METHODS[design.method].advice
    if tuned:
        advice = "a higher rate_hz, a shorter delay or other limits: no start of the tuner leads to a stable loop"
    return NotCertifiedError(
        f"{design.loop}, {design.name}: the closed loop grows at {-measures.decay[0]:.3g} 1/s: it is unstable; try "
        f"{advice}",
        design.plants,
    )


class TunedMethod(Method):
    """A method whose controller follows from its options at once; ``tune = true`` moves them until limits are met."""

    tunes = True
    # Share by which the tuner meets limits.
    reserve: ClassVar[float] = 0.05

    @abstractmethod
    def controller(self, options: dict[str, float], channel: Channels, plants: PlantSet) -> System:
        """Return the sampled controller u = K y of complete options; drifting angles of the plants decay slowly."""

    def upper_bounds(self, period: float) -> dict[str, float]:
        """Return the largest values that the tuner may use: the ends of the options' sliders."""
        ends = {name: self.options[name] for name in self.tunable if self.options[name].high < math.inf}
        return {name: one.high / period if one.unit == "Hz" else one.high for name, one in ends.items()}

    def movable(self, options: dict[str, float], channel: Channels) -> list[str]:
        """Return the options that the tuner moves."""
        return [name for name in self.tunable if name in options]

    def starts(self, problem: LoopProblem, options: dict[str, float]) -> list[dict[str, float]]:
        """Return other starts of the tuner: the options as given and by rules of thumb, at crossovers over decades.

        A notch that moves is besides at each resonance of the nominal plant.
        """
        design, plants, channel = problem.design, problem.plants, problem.channel
        movable = self.movable(options, channel)
        fixed = {name: x for name, x in design.options.items() if name not in movable}
        kept = {name: x for name, x in design.options.items() if name not in self.rates} | fixed
        by_rule = self.defaults(replace(design, options=kept), channel, plants.nutation, plants.period)
        bases = [options, options | {name: by_rule[name] for name in options if name in by_rule and name not in fixed}]
        if "notch_hz" in movable:
            z = np.linalg.eigvals(plants.A[0])
            s = np.log(z[(z.imag > 0.0) & (np.abs(z) > 0.5)]) / plants.period
            swings = np.abs(s[-s.real < _SWING * np.abs(s)]) / (2.0 * np.pi)
            bases += [options | _NOTCH | {"notch_hz": float(hertz)} for hertz in np.sort(swings)]
        together = [name for name in self.rates if name in options and name not in fixed]
        return [one for base in bases for one in over_decades(base, together, plants.period)]

    def design(self, problem: LoopProblem) -> Design:
        """Return the loop of a job, with ``tune = true`` its options moved until the limits are met."""
        channel, plants = problem.channel, problem.plants.regular()

        def build(options: dict[str, float]) -> System:
            return self.controller(options, channel, plants)

        options = self.defaults(problem.design, channel, plants.nutation, plants.period)
        if problem.design.tune:
            options = tuned(
                problem,
                options,
                self.movable(options, channel),
                build,
                upper=self.upper_bounds(plants.period),
                starts=self.starts(problem, options),
                reserve=self.reserve,
            )
        return problem.made(build(options), options)


class SectionedMethod(TunedMethod):
    """A tuned method whose controller is made of sections along the directions of a loop."""

    @abstractmethod
    def along(
        self, options: dict[str, float], channel: Channels, period: float, inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[Section]:
        """Return the sections from `inputs`, measured in the directions, to `outputs`, torques in the directions."""

    def of_directions(self, options: dict[str, float], channel: Channels, period: float) -> System:
        """Return the sampled controller u = K y of complete options."""
        inputs, outputs = _signals(channel)
        system = flattened(self.along(options, channel, period, inputs, outputs), inputs, outputs)
        return between(channel.basis, system, channel.basis.T)

    def controller(self, options: dict[str, float], channel: Channels, plants: PlantSet) -> System:
        """Return the sampled controller of complete options."""
        return self.of_directions(options, channel, plants.period)

    def sections(self, problem: LoopProblem, options: dict[str, float]) -> tuple[Section, ...]:
        """Return the controller section by section, from the readings to the torques of the loop."""
        channel, plants = problem.channel, problem.plant_set
        assert plants is not None, "the loop has plants"
        inputs, outputs = _signals(channel)
        directions = channel.basis if channel.sense is None else channel.sense
        first = Section("directions", "mix", "readings along the directions", gain(directions), plants.angles, inputs)
        if channel.sense is not None:
            # Each torquer has its own direction.
            return (first, *self.along(options, channel, plants.period, inputs, plants.torques))
        last = Section("torques", "mix", "torques back on the gimbals", gain(channel.basis.T), outputs, plants.torques)
        return (first, *self.along(options, channel, plants.period, inputs, outputs), last)


def _signals(channel: Channels) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of what is measured and set in the directions."""
    count = range(1, len(channel.basis) + 1)
    return tuple(f"direction_{k}" for k in count), tuple(f"torque_{k}" for k in count)


def tuned(
    problem: LoopProblem,
    options: dict[str, float],
    movable: Sequence[str],
    build: Builder,
    *,
    upper: dict[str, float] | None = None,
    starts: Sequence[dict[str, float]] = (),
    reserve: float = 0.05,
    evaluations: int = 1500,
) -> dict[str, float]:
    """Return the options of a design, moved until its loop's limits are met: see `Tuner`.

    Options with which there is no design count as no control: no loop is stable then, and the search turns back.
    """
    spec, design, plants = problem.spec, problem.design, problem.plants
    nothing = gain(np.zeros((plants.B.shape[-1], plants.C.shape[-2])))

    def built(numbers: dict[str, float]) -> System:
        try:
            return problem.with_commands(build(numbers))
        except DesignError:
            return nothing

    tuner = Tuner(
        movable=movable,
        build=built,
        plants=plants,
        requirements=spec.requirements,
        upper=upper or {},
        reserve=reserve,
        evaluations=evaluations,
        progress=lambda _, limiting: problem.progress(f"{spec.name}: {design.name}, {limiting}"),
    )
    return tuner.run(options, starts)


def shaped(
    K: System, shaping: CommandShaping, directions: Channels, sense: FloatArray, commanded: FloatArray | None = None
) -> System:
    """Return the controller of readings and commands behind a reference filter, of K from the readings.

    u = K (y − F r) + H F r. F = ω²/(s + ω)² does not overshoot. H is the inverse of the plant along the directions:
    J s² + d s + c of an angle, inertia, viscous friction and spring, and J s + d of a rate. Both are sampled by
    Tustin's rule. `sense` (n, p) leads from the readings to the directions, along which the inertias are known;
    `commanded` as of `PlantSet`.
    """
    from scipy.linalg import block_diag

    E = np.eye(len(K.B.T)) if commanded is None else commanded
    p, w, into, through = E.shape[1], 2.0 * math.pi * shaping.filter_hz, K.B @ E, K.D @ E
    derivatives = [low_pass(w, _DAMPING, K.dt, order) for order in range(directions.order + 1)]
    A, B, C, D = (block_diag(*(part,) * p) for part in derivatives[0][:4])
    fed_C, fed_D = np.zeros((len(K.C), len(A))), np.zeros((len(K.D), p))
    if shaping.acceleration:
        # By the derivative that they go with, the highest first.
        needed = (directions.inertias, directions.damping, directions.stiffness)
        for one, strength in zip(reversed(derivatives), needed, strict=False):
            if strength is not None:
                torque = strength[:, None] * (sense[: len(strength)] @ E)
                fed_C += torque @ block_diag(*(one.C,) * p)
                fed_D += torque @ block_diag(*(one.D,) * p)
    rows = [[K.A, -into @ C, K.B, -into @ D], [0, A, 0, B], [K.C, fed_C - through @ C, K.D, fed_D - through @ D]]
    whole = block(rows)
    return System.split(whole, len(K.A) + len(A), K.dt)
