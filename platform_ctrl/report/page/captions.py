"""The values in the sentences of the page: what to see in each plot. The sentences are in templates/sentences.txt."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.common.text import Rounding
from platform_ctrl.design.caging_claims import largest_Omega_name
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.requirements import FAULTS, WORST_CASE
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.figures.limit_lines import damping_rays, limited
from platform_ctrl.report.figures.loop import SENSITIVITIES
from platform_ctrl.report.loop_responses import LoopResponses
from platform_ctrl.report.page import campaign_tables
from platform_ctrl.report.page.comparison import plants_in_words
from platform_ctrl.report.quantities import BOUND, HZ, compared, count, disk_words, listed, percent, plain, quantity
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult

_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def sentences(name: str, /, **values: Any) -> str:
    """Return the sentences `name` of templates/sentences.txt with `values` in them, on one line."""
    return re.sub(r"\s*\n\s*", " ", str(getattr(_templates(), name)(**values)).strip("\n "))


@lru_cache(maxsize=1)
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("platform_ctrl.report"), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    filters: list[Any] = [compared, count, disk_words, listed, number_word, percent, plain, quantity, quoted, share]
    filters += [campaign_tables.chance, campaign_tables.count_words]
    environment.filters |= {function.__name__: function for function in filters}
    environment.globals |= {"METRICS": METRICS, "BOUND": BOUND, "chances": campaign_tables.chances}
    return environment.get_template("sentences.txt").module


def quoted(name: str) -> str:
    """Return a name in quotation marks."""
    return f"“{name}”"


def number_word(number: int) -> str:
    """Return a small number as a word."""
    return _NUMBERS[number] if number < len(_NUMBERS) else str(number)


def share(number: float, rounding: Rounding = "nearest") -> str:
    """Return a share in per cent, without a sign."""
    return f"{plain(100.0 * number, 2, rounding)}\u00a0%"


def unstable(design: LoopDesign) -> bool:
    """Return whether the closed loop with the nominal plant is unstable; False for a design without plants."""
    return design.measures is not None and not design.measures.decay[0] > 0.0


def bandwidth_hz(design: LoopDesign) -> float:
    """Return the bandwidth of the nominal loop in Hz; 0 where the loop is unstable or has no plants of its own."""
    if design.measures is None or unstable(design) or not np.isfinite(design.measures.bandwidth):
        return 0.0
    return design.measures.bandwidth * HZ


def spins(platform: Platform) -> bool:
    """Return whether any rotor of a plant has momentum."""
    return any(rotor.angular_momentum != 0.0 for rotor in platform.rotors)


def sensitivity(outcome: LoopOutcome, responses: LoopResponses) -> str:
    """Singular values of S, T and (S − T)/2."""
    closed, spec = outcome.closed, outcome.spec
    peak = int(np.argmax(responses.closed_design.gains["disk margin"]))
    return sentences(
        "sensitivity",
        outcome=outcome,
        bandwidth=bandwidth_hz(closed),
        closest=None if closed.measures is None or unstable(closed) else float(responses.frequency[peak]) * HZ,
        lines=[METRICS[kind] for curve in SENSITIVITIES for kind in limited(spec.limits, curve)],
        goals=METRICS["bandwidth"].key in spec.soft or any(limited(spec.soft, curve) for curve in SENSITIVITIES),
        margins=_margins(closed),
    )


def _margins(design: LoopDesign) -> list[str]:
    """Return the nominal disk margin and those that it falls to with other plants; nothing without others."""
    measures = design.measures
    if measures is None:
        return []
    parts = [plain(float(measures.disk_margin[0]), 3, "down")]
    for groups, where in ((WORST_CASE, "over all uncertain parameters and platform rates"), (FAULTS, "with a fault")):
        chosen = measures.of(groups)
        if chosen.sum() > 1:
            parts.append(f"{plain(float(measures.disk_margin[chosen].min()), 3, 'down')} {where}")
    return parts if len(parts) > 1 else []


def disturbance(outcome: LoopOutcome, responses: LoopResponses) -> str:
    """Platform rate and torque disturbance to the angles, and platform rate to the torque."""
    closed = responses.closed_design
    rejection = closed.peaks["Omega rejection"]
    of_limit = float(np.nanmax(closed.gains.get("torque limit", 0.0)))
    rejected = rejection if np.isfinite(rejection) else None
    return sentences("disturbance", outcome=outcome, rejection=rejected, share=of_limit)


def further_gains(outcome: LoopOutcome, responses: LoopResponses, kinds: Sequence[str]) -> str:
    """Gains whose peaks have a limit, beside those of the other plots."""
    peaks = responses.closed_design.peaks
    limits, goals = (any(limited(one, kind) for kind in kinds) for one in (outcome.spec.limits, outcome.spec.soft))
    values = [(METRICS[kind], peaks[kind] / METRICS[kind].scale) for kind in kinds]
    return sentences("further_gains", outcome=outcome, values=values, limits=limits, goals=goals)


def poles(outcome: LoopOutcome, plants: PlantSet) -> str:
    """Pole map."""
    limits, soft = outcome.spec.limits, outcome.spec.soft
    rays = [words for _, _, words in damping_rays(limits)]
    goals = bool(damping_rays(soft)) or METRICS["fastest pole"].key in soft
    counted = plants_in_words(plants)
    return sentences("poles", outcome=outcome, plants=plants, plants_in_words=counted, rays=rays, goals=goals)


def coupled(result: JobResult) -> str:
    """State of the coupled system in two sentences."""
    check, proofs = result.coupled, result.proofs["", ""]
    decay = -float(spectral_abscissa(continuous_poles(check.poles, result.job.sampling.period)))
    cost = None
    if check.stable and np.isfinite(check.cost).any():
        k = int(np.nanargmax(check.cost))
        cost = max(float(check.cost[k]), 0.0), check.channels[k]
    return sentences("coupled", check=check, decay=decay, proved=0 < proofs.of == proofs.proved, cost=cost)


def run(one: Run, spinning: bool, loops: Sequence[LoopOutcome]) -> str:
    """A simulated run; `spinning`: of a plant whose rotors spin."""
    trajectory = one.trajectory
    return sentences(
        "run",
        manoeuvre=one.manoeuvre,
        trajectory=trajectory,
        worst=1e3 * float(np.abs(trajectory.q).max(initial=0.0)),
        saturated=int(trajectory.saturated.sum()),
        contacts=int(trajectory.stop_contacts.sum()),
        spinning=spinning,
        proved=_largest_rate(one, loops),
    )


def _largest_rate(run: Run, loops: Sequence[LoopOutcome]) -> tuple[float, float | None] | None:
    """Return the rates about the run's axis up to which the closed loops are proved to keep within their limits."""
    claims = [outcome.closed.claims for outcome in loops]
    nominal, varied = (
        min((own[name] for own in claims if name in own), default=None)
        for name in (largest_Omega_name(run.manoeuvre.axis, worst_case=worst) for worst in (False, True))
    )
    return None if run.manoeuvre.mode != "caged" or nominal is None else (nominal, varied)
