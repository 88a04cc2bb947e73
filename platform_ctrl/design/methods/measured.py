"""The measured PID as a method of jobs: designed on responses from a file, or on those of the job's own plants."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import following_grid
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.convex_step import CENTRES
from platform_ctrl.design.loop import Design
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.measured_pid import MeasuredDesign, measured_pid
from platform_ctrl.design.method import LoopProblem, Method, Option, hertz, number
from platform_ctrl.design.responses import MeasuredResponses, contour, read_responses, unstable_poles
from platform_ctrl.errors import DesignError, NotCertifiedError
from platform_ctrl.job.judging import CheckResult, Requirement
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.job.requirements import LoopRequirement
from platform_ctrl.plant.mistakes import one_line

# Share by which the limits are kept at the frequencies of the data: between them loops are a little worse.
_RESERVE = 0.02
# Plants that join the nominal one, one at a time, where they are the worst.
_MOST_ADDED = 2
# Limits that are met by bounding a peak: the setting that bounds it, what it cannot come below; how often that is done.
_DEPENDS_ON = {"torque_noise": ("torque_per_noise", 0.0), "overshoot": ("complementary_sensitivity_peak", 1.0)}
_MOST_BOUNDED = 4
_LARGEST_MARGIN = 1.9
# Poles this near to z = 1 are integrators, those this far beyond the unit circle unstable; those between are rounding.
_INTEGRATOR = 1e-5
# Motion slower than this need not be seen, rad/s.
_SLOW = 0.2
# The grid on which plants are described: points beside resonances, and the share of the slowest pole that it begins at.
_POINTS, _BELOW = 100, 0.05
_HZ = 1.0 / (2.0 * np.pi)
_ON_DATA = ", measured responses"


OPTIONS: dict[str, Option] = {
    "rolloff_hz": hertz("roll-off", "design", "where the rate action ends", high=0.45, below_nyquist=True),
    "sensitivity_peak": number("sensitivity peak", "largest gain of S where no limit is lower", 1.05, 20),
    "resonance_damping": number(
        "resonance damping", "damping ratio that unresolved resonances get at least", 1e-3, 0.7
    ),
    "steps": number("steps", "most convex problems", 5, 200, whole=True),
}


class MeasuredPID(Method):
    """The PID with the largest integral gain within the loop's limits, on responses from a file or of plants."""

    key = "measured"
    options = OPTIONS
    advice = "a smaller sensitivity_peak, or responses of the plant as it is"
    responses = True

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options; those that are not given are the same for every loop, but for the roll-off."""
        defaults = {"rolloff_hz": 0.4 / period, "sensitivity_peak": 2.0, "resonance_damping": 0.03, "steps": 40.0}
        return self.completed(design.options, defaults, period)

    def design(self, problem: LoopProblem) -> Design:
        """Return the PID; its claims say what the integral gain is and how many plants and steps it took."""
        plants = problem.plants.regular()
        options = self.defaults(problem.design, problem.channel, plants.nutation, plants.period)
        if len(plants.torques) != len(plants.angles):
            raise DesignError(
                f"measured: a loop must have as many torquers as directions, got {len(plants.torques)} and "
                f"{len(plants.angles)}; choose another method"
            )
        bounds = _bounds(problem.spec.requests)
        bounds["sensitivity_peak"] = min(bounds.get("sensitivity_peak", np.inf), options["sensitivity_peak"])
        bounds["resonance_damping"] = options["resonance_damping"]
        found, view = _searched(problem, options, bounds)
        claims = {"least integral gain": found.objective, "plants": float(len(view)), "steps": float(found.steps)}
        return problem.made(found.controller, options, claims)

    def expect_responses(
        self, text: str, label: str, torques: Sequence[str], readings: Sequence[str], period: float
    ) -> None:
        """Raise an InputError where a file's text holds no responses of a loop's sampled signals."""
        read_responses(text, label, torques, readings, period)

    def judged(self, problem: LoopProblem, design: Design) -> Design:
        """Return a design that is judged on its measured responses too: a plant beside those of the model."""
        data, plants = _of_file(problem), problem.plant_set
        if data is None or plants is None:
            return design
        model = plants.on(data.frequency).response[0]
        apart = largest_singular_values(data.response - model) / largest_singular_values(model)
        k = int(apart.argmax())
        claims = {"responses from model, relative": float(apart[k]), "at, Hz": float(_HZ * data.frequency[k])}
        results = _results(problem, design, data, plants)
        problem.progress(
            f"{problem.spec.name}: {problem.design.name}, the measured responses are up to {apart[k]:.1%} from the "
            f"nominal plant's (at {_HZ * data.frequency[k]:.4g} Hz)"
        )
        return dataclasses.replace(design, claims=design.claims | claims, results=(*design.results, *results))


def _of_file(problem: LoopProblem) -> MeasuredResponses | None:
    """Return the responses of the file that a design names, if it does, in the order of the loop's signals."""
    own, text = problem.plant_set, problem.design.responses
    if own is None or text is None:
        return None
    where = f"responses of {problem.spec.name}, {problem.design.name}"
    return read_responses(text, where, own.torques, own.angles, own.period)


def _strictest(requirements: Sequence[LoopRequirement]) -> dict[str, LoopRequirement]:
    """Return the strictest of the limits that can be kept at every frequency, by their keys."""
    out: dict[str, LoopRequirement] = {}
    for one in requirements:
        key = one.metric.key
        if one.hard and key in CENTRES:
            stricter = max if one.sense == "at least" else min
            out[key] = stricter(out.get(key, one), one, key=lambda each: each.limit)
    return out


def _bounds(requirements: Sequence[LoopRequirement]) -> dict[str, float]:
    """Return these limits with a reserve, by the names of `measured_pid`."""
    limits = {key: one.limit for key, one in _strictest(requirements).items()}
    return {
        key: x * (1.0 + _RESERVE) if key == "disk_margin" else 1.0 + (x - 1.0) * (1.0 - _RESERVE)
        for key, x in limits.items()
    }


def _searched(
    problem: LoopProblem, options: dict[str, float], limits: dict[str, float]
) -> tuple[MeasuredDesign, list[int]]:
    """Return a design on a file's responses or on the nominal plant's, and the numbers of the active plants.

    It is measured with all plants. Those with which it is the worst join, unless there is a file; where a limit is
    missed that no frequency decides alone, the peak that it depends on is bounded, in turn.
    """
    plants = problem.plants.regular()
    requirements = problem.spec.requests
    counts = [_unstable(A) for A in plants.A]
    z = np.linalg.eigvals(plants.A[0])
    s = np.asarray(np.log(z[np.abs(z) > _INTEGRATOR] + 0j) / plants.period, dtype=np.complex128)
    moving = np.abs(s) * plants.period > _INTEGRATOR
    slowest = float(np.abs(s[moving]).min(initial=_SLOW))
    low = min(plants.frequency[0], _BELOW * slowest)
    plants = plants.on(following_grid(s, low, float(plants.frequency[-1]), _POINTS))
    data = [(plants.frequency, P) for P in plants.response]
    if of_file := _of_file(problem):
        sense = problem.channel.sense
        data = [(of_file.frequency, of_file.response if sense is None else np.asarray(sense @ of_file.response))]

    def pid(view: list[int], limits: dict[str, float]) -> MeasuredDesign:
        return measured_pid(
            [data[k] for k in view],
            plants.period,
            limits,
            filter_time=1.0 / (2.0 * np.pi * options["rolloff_hz"]),
            unstable=max(counts[k] for k in view),
            steps=int(options["steps"]),
        )

    view: list[int] = [0]
    found = pid(view, limits)
    for _ in range(_MOST_ADDED + _MOST_BOUNDED):
        measures = measure(plants, found.controller, requirements)
        wider, tighter = _widened(view, measures, requirements, counts), limits
        if of_file or wider == view:
            wider, tighter = view, limits | _bounded(found, measures, requirements, limits)
        if wider == view and tighter == limits:
            break
        added = f"{plants.labels[wider[-1]]} joins the nominal plant"
        bounds = ", ".join(f"{name} {x:.3g}" for name, x in tighter.items() if x != limits.get(name))
        problem.progress(f"{problem.spec.name}: {problem.design.name}, {bounds or added}")
        try:
            found, view, limits = pid(wider, tighter), wider, tighter
        except DesignError:
            break  # what has been found is judged with all plants
    return found, view


def _widened(
    view: list[int], measures: LoopMetrics, requirements: Sequence[LoopRequirement], counts: list[int]
) -> list[int]:
    """Return the active plants with the worst one, where it misses stability or the disk margin."""
    missed = np.where(measures.decay > 0.0, 0.0, 1e6)
    for one in requirements:
        if one.metric.key == "disk_margin" and one.hard:
            chosen = measures.of(one.over)
            missed[chosen] = np.maximum(missed[chosen], one.limit / np.maximum(measures.disk_margin[chosen], 1e-9))
    worst = int(missed.argmax())
    full = len(view) > _MOST_ADDED or missed[worst] <= 1.0 or worst in view or counts[worst] != counts[0]
    return view if full else [*view, worst]


def _bounded(
    found: MeasuredDesign, measures: LoopMetrics, requirements: Sequence[LoopRequirement], settings: dict[str, float]
) -> dict[str, float]:
    """Return stricter settings for the limits that are missed: the disk margin, and peaks of K S and T."""
    out: dict[str, float] = {}
    for one in requirements:
        key = one.metric.key
        if not one.hard or key not in ("disk_margin", *_DEPENDS_ON) or not np.all(measures.decay > 0.0):
            continue
        excess = float(one.ratios(measures).max())
        if not (np.isfinite(excess) and excess > 1.0):
            continue
        if key == "disk_margin":
            out[key] = max(out.get(key, 0.0), min(settings[key] * excess, _LARGEST_MARGIN))
        else:
            name, floor = _DEPENDS_ON[key]
            bound = floor + (found.peaks[name] - floor) * (1.0 - _RESERVE) / excess
            out[name] = min(out.get(name, np.inf), bound)
    return out


def _unstable(A: FloatArray) -> int:
    poles = np.linalg.eigvals(A)
    return int(np.count_nonzero((np.abs(poles) > 1.0 + _INTEGRATOR) & (np.abs(poles - 1.0) > _INTEGRATOR)))


def _results(problem: LoopProblem, design: Design, data: MeasuredResponses, plants: PlantSet) -> list[CheckResult]:
    """Return the limits that responses can be held against, and stability, on a file's responses."""
    K = plants.feedback(plants.joined(design.own_controller))
    responding = K.to_control(plants.angles, plants.torques)

    def controller(s: ComplexArray) -> ComplexArray:
        return np.asarray(np.moveaxis(responding(np.exp(s * K.dt), squeeze=False), -1, 0), dtype=np.complex128)

    sense = np.eye(len(plants.angles)) if problem.channel.sense is None else problem.channel.sense
    back = np.linalg.pinv(sense)
    P_own = np.asarray(sense @ data.response, dtype=np.complex128)
    evidence = f"measured responses at {len(data.frequency)} frequencies"
    try:
        if np.count_nonzero(np.abs(np.linalg.eigvals(K.A) - 1.0) < _INTEGRATOR) < len(P_own[0]):
            raise NotCertifiedError("stability from data: the controller must integrate in every direction")
        count: float = unstable_poles(
            contour(data.frequency, P_own), lambda s: controller(s) @ back, _unstable(plants.A[0])
        )
        why = evidence
    except NotCertifiedError as error:
        count, why = np.inf, one_line(str(error))
    stated = {"subject": problem.spec.name, "design": problem.design.name, "stage": "decoupled"}
    out: list[CheckResult] = []
    if count != 0:
        stable = Requirement(name=f"unstable poles{_ON_DATA}", limit=0.0, unit="", sense="at most")
        out.append(stable.judge(count, evidence=why, **stated))  # type: ignore[arg-type]
    S, S_input = sensitivities_of_plants(data.response, controller(np.asarray(1j * data.frequency)))
    for key, one in _strictest(problem.spec.requests).items():
        c = CENTRES[key]
        peaks = [largest_singular_values(part - c * np.eye(part.shape[-1])) for part in (S, S_input)]
        worst = np.maximum(*peaks)
        k = int(worst.argmax())
        reached = float(worst[k]) if count == 0 else np.inf
        asked = Requirement.of(one.metric, one.limit, one.metric.name + _ON_DATA)
        found = 1.0 / reached if key == "disk_margin" else reached
        out.append(asked.judge(found, evidence=f"{evidence}, at {_HZ * data.frequency[k]:.4g} Hz", **stated))  # type: ignore[arg-type]
    return out
