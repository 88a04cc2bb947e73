"""The loops of a job: every design of every loop, made by its method and certified."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Mapping

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.classical.caging import TUNABLE, classical_controller, starting_values, upper_bounds
from platform_ctrl.design.classical.stabilisation import platform_servo
from platform_ctrl.design.loop import LoopDesign, certified
from platform_ctrl.design.partition import Channels, channels
from platform_ctrl.design.plants import plants_of, rows_of
from platform_ctrl.design.tuning import tune
from platform_ctrl.errors import ArgumentError, DesignError
from platform_ctrl.job.job import DesignSpec, Job, LoopSpec, Spread
from platform_ctrl.job.reading import read_job
from platform_ctrl.job.requirements import hard_and_soft, loop_requirements
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.plant.platform import OMEGA_NAMES


def with_caging_claims(job: Job, design: LoopDesign, *, closed: bool) -> LoopDesign:
    """Return a caging design with its gains in continuous time and, where it is closed, the Omega that it survives.

    The names end in their units. What does not exist for a loop is left out: an unstable loop has no gains, a torquer
    without limit loses no Omega, an axis that loads no torquer has nothing to survive.
    """
    if design.measures is None or not design.measures.decay[0] > 0.0:
        return design
    claims = dict(design.claims) | _between_samples(job, design)
    if closed:
        claims |= _at_the_limits(job, design)
    return dataclasses.replace(design, claims=claims)


def survived_name(axis: int, *, spread: bool = False) -> str:
    """Return the name of the claim of the Omega that a loop survives about a root axis, 1 to 3."""
    return f"survived {OMEGA_NAMES[axis - 1]}{' over the spread' if spread else ''}, rad/s"


def _between_samples(job: Job, design: LoopDesign) -> dict[str, float]:
    from platform_ctrl.design.riccati.intersample_loop import intersample_gains

    try:
        gains = intersample_gains(job, design.controller)
    except ArgumentError:
        return {}
    return {
        "intersample torque rejection, rad/(N m)": gains.torque_rejection,
        "intersample Omega rejection, rad s/rad": gains.Omega_rejection,
    }


def _at_the_limits(job: Job, design: LoopDesign) -> dict[str, float]:
    from platform_ctrl.design.antiwindup.job import caging_survival

    # One plant of the spread may leave the loop unstable: what holds for the plant as it is stays.
    for asked in (job, dataclasses.replace(job, spread=Spread())):
        try:
            found = caging_survival(asked, design.controller)
        except (ArgumentError, DesignError):
            continue
        out = {survived_name(one.axis): one.nominal.Omega for one in found}
        if asked.spread.inertia > 0.0 or asked.spread.spin > 0.0:
            out |= {survived_name(one.axis, spread=True): one.spread for one in found}
        return out
    return {}


Progress = Callable[[str], None]


@value
class LoopOutcome:
    """A loop with all its designs.

    Attributes
    ----------
    spec
        The loop as the job asks for it.
    designs
        In the job's order.
    use
        Name of the design that is closed.
    """

    spec: LoopSpec
    designs: tuple[LoopDesign, ...]
    use: str

    @property
    def closed(self) -> LoopDesign:
        """The design that is closed together with those of the other loops."""
        return next(design for design in self.designs if design.name == self.use)

    @property
    def alternatives(self) -> tuple[LoopDesign, ...]:
        """The other designs."""
        return tuple(design for design in self.designs if design.name != self.use)


@check_arguments
def loops(
    job: Job | str | os.PathLike[str] | Mapping[str, object], progress: Progress | None = None
) -> tuple[LoopOutcome, ...]:
    """Design every loop of `job` by every method that it asks for.

    Parameters
    ----------
    job
        The job, or what `read_job` reads: a path or a dict.
    progress
        Called with a line before and during each design.

    Returns
    -------
    tuple of LoopOutcome
        In the job's order.

    Raises
    ------
    InputError
        The job makes no sense, or a loop's gimbals cut through a subsystem.
    DesignError
        A method found no controller that its certificate accepts.
    MechanicsError
        The mass matrix is singular at rest (gimbal lock).
    """
    job = job if isinstance(job, Job) else read_job(job)
    say = progress or (lambda line: None)
    model = linearise(job.platform)
    # All plants before the first design: what is wrong with the third loop is said before the work on the first.
    plant_sets = [plants_of(job, spec) for spec in job.loops]
    out = []
    for spec, plants in zip(job.loops, plant_sets, strict=True):
        designs = []
        for design in spec.designs:
            say(f"{spec.name}: {design.name}")
            if plants is None:
                designs.append(platform_servo(job, model, spec, design))
            else:
                try:
                    made = _caging(model, spec, design, plants, say)
                except DesignError as error:
                    if str(error).startswith(f"{spec.name}, "):
                        raise
                    raise type(error)(f"{spec.name}, {design.name}: {error}", error.problem) from None
                designs.append(with_caging_claims(job, made, closed=design.name == spec.use))
        out.append(LoopOutcome(spec=spec, designs=tuple(designs), use=spec.use))
    return tuple(out)


def _caging(model: LinearModel, spec: LoopSpec, design: DesignSpec, plants: PlantSet, say: Progress) -> LoopDesign:
    channel = channels(model, rows_of(model, spec.gimbals))
    if design.method == "hinf":
        from platform_ctrl.design.riccati.hinf_loop import hinf_controller

        controller, options, claims = hinf_controller(design.options, channel, plants)
        return certified(spec, design, controller, plants, options, claims)
    if design.method == "lqg":
        from platform_ctrl.design.riccati.lqg_loop import lqg_controller

        controller, options, claims = lqg_controller(design.options, channel, plants)
        return certified(spec, design, controller, plants, options, claims)
    if design.method == "structured":
        return _structured(spec, design, channel, plants, say)
    options = starting_values(design.options, channel, plants.nutation, plants.period)
    if design.tune:
        options = tune(
            options,
            [name for name in TUNABLE if name in options],
            lambda trial: classical_controller(trial, channel, plants.period),
            plants,
            loop_requirements(spec.limits),
            upper=upper_bounds(plants.period),
            progress=lambda ratio: say(f"{spec.name}: {design.name}, worst requirement at {ratio:.0%} of its limit"),
        )
    controller = classical_controller(options, channel, plants.period)
    return certified(spec, design, controller, plants, options, {})


def _structured(spec: LoopSpec, design: DesignSpec, channel: Channels, plants: PlantSet, say: Progress) -> LoopDesign:
    from platform_ctrl.design.riccati.hinf_loop import hinf_controller
    from platform_ctrl.design.structured.caging import default_options, tuned_controller
    from platform_ctrl.design.structured.families import Named

    form = design.structure or "pid"
    options = default_options(design.options, form, channel, plants.nutation, plants.period)
    first = starting_values({"integral_hz": options["integral_hz"]}, channel, plants.nutation, plants.period)
    cross_axis = Named(
        lambda trial: classical_controller(trial, channel, plants.period), first, TUNABLE, upper_bounds(plants.period)
    )
    hard, soft = hard_and_soft(spec.limits, spec.soft)

    def progress(limits: float, goals: float) -> None:
        told = f"limits at {limits:.0%}" + (f", goals at {goals:.0%}" if soft else "")
        say(f"{spec.name}: {design.name}, {told if math.isfinite(limits) else 'not stable with all plants yet'}")

    found = tuned_controller(
        options,
        form,
        cross_axis,
        channel,
        plants,
        (*hard, *soft),
        [lambda: hinf_controller({}, channel, plants, method="riccati")[0]],
        progress,
    )
    out = certified(spec, design, found.controller, plants, found.options, found.claims)
    # What the search took for its ratios is not believed.
    ratios = {"limit_ratio": out.results, "goal_ratio": out.goals}
    largest = {name: max(result.ratio for result in results) for name, results in ratios.items() if results}
    return dataclasses.replace(out, claims=out.claims | largest)
