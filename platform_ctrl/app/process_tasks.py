"""What is worked out in a process of its own: sliders tuned, a design by its method, a manoeuvre flown."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.common.values import value
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.job import Job

if TYPE_CHECKING:
    from platform_ctrl.simulation import Trajectory

Say = Callable[[str], None]


@value
class Tuning:
    """A classical design whose free options are to be moved until the limits are met.

    Attributes
    ----------
    job
        With the settings' plant and sampling.
    loop
        Name.
    options
        All that are used.
    movable
        Names of those that may be moved.
    """

    job: Job
    loop: str
    options: dict[str, float]
    movable: tuple[str, ...]

    def run(self, say: Say) -> dict[str, float]:
        """Return the options, tuned."""
        from platform_ctrl.design.classical.caging import classical_controller, upper_bounds
        from platform_ctrl.design.partition import channels
        from platform_ctrl.design.plants import loop_plants, rows_of
        from platform_ctrl.design.tuning import tune
        from platform_ctrl.job.requirements import loop_requirements
        from platform_ctrl.mechanics.linearisation import linearise

        spec = next(one for one in self.job.loops if one.name == self.loop)
        model = linearise(self.job.platform)
        channel, plants = channels(model, rows_of(model, spec.gimbals)), loop_plants(self.job, spec.gimbals)
        return tune(
            self.options,
            self.movable,
            lambda trial: classical_controller(trial, channel, plants.period),
            plants,
            loop_requirements(spec.limits),
            upper=upper_bounds(plants.period),
            progress=lambda ratio: say(f"worst requirement at {ratio:.0%} of its limit"),
        )


@value
class ServoTuning:
    """A platform servo whose free options are to be moved until the coupled limits are met.

    Attributes
    ----------
    job
        With the settings' plant and sampling.
    loop, design
        Names.
    movable
        Names of the options that may be moved.
    options
        All of them.
    caging
        Controller, inputs, outputs and loop of each caging loop.
    """

    job: Job
    loop: str
    design: str
    movable: tuple[str, ...]
    options: dict[str, float]
    caging: tuple[tuple[StateArrays, tuple[str, ...], tuple[str, ...], str], ...]

    def run(self, say: Say) -> dict[str, float]:
        """Return the options, tuned: a simplex search over their logarithms, as `design.tuning.tune` does it."""
        import numpy as np
        from scipy.optimize import minimize

        worst = self.worst_ratio()
        best = [np.inf]
        start = np.log([self.options[name] for name in self.movable])

        def numbers(x: object) -> dict[str, float]:
            ratios = np.exp(np.asarray(x) - start)
            return self.options | {n: self.options[n] * float(r) for n, r in zip(self.movable, ratios, strict=True)}

        def ratio(x: object) -> float:
            found = worst(numbers(x))
            if found < best[0]:
                best[0] = found
                say(f"worst requirement at {found:.0%} of its limit")
            return found

        def enough(intermediate_result: object) -> None:
            if getattr(intermediate_result, "fun", np.inf) <= 0.95:
                raise StopIteration

        if ratio(start) <= 0.95:
            return dict(self.options)
        found = minimize(
            ratio,
            start,
            method="Nelder-Mead",
            callback=enough,
            options={"maxfev": 60 * len(start), "adaptive": True, "xatol": 2e-3, "fatol": 2e-4},
        )
        return numbers(found.x)

    def worst_ratio(self) -> Callable[[dict[str, float]], float]:
        """Return what gives the largest ratio of the coupled limits for some options; beyond 10 where unstable."""
        from platform_ctrl.analysis.arrays import named_system
        from platform_ctrl.app.free_measures import requirements
        from platform_ctrl.app.free_plants import StabilisedLoop, corners, free_models, free_plants
        from platform_ctrl.design.loop import LoopProblem, designed
        from platform_ctrl.mechanics.linearisation import linearise
        from platform_ctrl.verification.coupled import sensed_rates

        spec = next(one for one in self.job.loops if one.name == self.loop)
        design = next(one for one in spec.designs if one.name == self.design)
        model = linearise(self.job.platform)
        others = [named_system(K, inputs, outputs, name=loop) for K, inputs, outputs, loop in self.caging]
        models = free_models(self.job, corners(self.job)[:1], sensed_rates(self.job, others))
        plants = free_plants(models, self.job.sampling, False)
        known: dict[str, dict[str, float]] = {}

        def kept(name: str, make: Callable[[], dict[str, float]]) -> dict[str, float]:
            if name not in known:
                known[name] = make()
            return known[name]

        def worst(options: dict[str, float]) -> float:
            try:
                trial = dataclasses.replace(design, options=options)
                servo = designed(LoopProblem(job=self.job, spec=spec, design=trial, model=model))
            except PlatformCtrlError:
                return 100.0
            loop = StabilisedLoop(
                job=self.job,
                model=model,
                spec=spec,
                controllers=(*others, servo.controller),
                plants=plants,
                shown=plants,
            )
            results = requirements(loop, kept)
            stable = results[0]
            if not stable.value > 0.0:
                return 10.0 + min(-stable.value, 1e6)
            ratios = [one.ratio for one in results]
            # Where one is infinite the others still say which way is better.
            worst_finite = max((x for x in ratios if x < float("inf")), default=0.0)
            return min(max(ratios), 10.0 + min(worst_finite, 1.0))

        return worst


@value
class Made:
    """A controller that a method has made.

    Attributes
    ----------
    controller
        u = K y, in the order of the loop's pick-offs and torquers.
    options, claims
        As the method completes and states them.
    """

    controller: StateArrays
    options: dict[str, float]
    claims: dict[str, float]


@value
class Designing:
    """A design that its method is to make.

    Attributes
    ----------
    job
        With the settings' plant, sampling and options.
    loop, design
        Names.
    """

    job: Job
    loop: str
    design: str

    def run(self, say: Say) -> Made:
        """Return the controller."""
        from platform_ctrl.design.jobs import loops

        spec = next(one for one in self.job.loops if one.name == self.loop)
        design = next(one for one in spec.designs if one.name == self.design)
        alone = dataclasses.replace(spec, designs=(design,), use=design.name)
        [outcome] = loops(dataclasses.replace(self.job, loops=(alone,)), say)
        made = outcome.closed
        return Made(
            controller=state_arrays(made.controller, made.name), options=dict(made.options), claims=dict(made.claims)
        )


@value
class Simulating:
    """A manoeuvre that is to be flown on the non-linear plant.

    Attributes
    ----------
    job
        With the settings' plant and sampling.
    manoeuvre
        Name.
    controllers
        Controller, inputs, outputs and name of every loop, in the job's order.
    """

    job: Job
    manoeuvre: str
    controllers: tuple[tuple[StateArrays, tuple[str, ...], tuple[str, ...], str], ...]

    def run(self, say: Say) -> Trajectory:
        """Return the run."""
        from platform_ctrl.analysis.arrays import named_system
        from platform_ctrl.verification.simulated import fly

        controllers = [named_system(K, inputs, outputs, name=name) for K, inputs, outputs, name in self.controllers]
        manoeuvre = next(one for one in self.job.manoeuvres if one.name == self.manoeuvre)
        return fly(self.job, manoeuvre, controllers).trajectory
