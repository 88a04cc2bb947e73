"""The values in the sentences of the report: its first paragraph, and what to see in each plot.

The sentences are in templates/sentences.txt.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.common.files import templates
from platform_ctrl.design.loop import Design, LoopOutcome
from platform_ctrl.job.quantities import BOUND, HZ, count, disk_words, listed, plain, quantity
from platform_ctrl.job.requirements import of_readings
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report import campaign_tables
from platform_ctrl.report.campaign_tables import all_drivers, causes, value_name
from platform_ctrl.report.comparison import plants_in_words
from platform_ctrl.report.curves import SENSITIVITIES, ShownLoop, damping_rays, limited
from platform_ctrl.verification.proofs import Proofs
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult

_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def sentences(name: str, /, **values: Any) -> str:
    """Return the sentences `name` of templates/sentences.txt with `values` in them, on one line."""
    return re.sub(r"\s*\n\s*", " ", str(getattr(_templates(), name)(**values)).strip("\n "))


@lru_cache(maxsize=1)
def _templates() -> Any:
    environment = templates("platform_ctrl.report")
    filters: list[Any] = [count, disk_words, listed, of_readings, plain, quantity, quoted, campaign_tables.chance]
    environment.filters |= {function.__name__: function for function in filters}
    environment.filters["number_word"] = lambda n: _NUMBERS[n] if n < len(_NUMBERS) else str(n)
    environment.globals |= {"METRICS": METRICS, "BOUND": BOUND, "chances": campaign_tables.chances}
    return environment.get_template("sentences.txt").module


def quoted(name: str) -> str:
    """Return a name in quotation marks."""
    return f"“{name}”"


def unstable(design: Design) -> bool:
    """Return whether the closed loop with the nominal plant is unstable; False for a design without plants."""
    return design.measures is not None and not design.measures.decay[0] > 0.0


def bandwidth_hz(design: Design) -> float:
    """Return the bandwidth of the nominal loop in Hz; 0 where the loop is unstable or has no plants of its own."""
    if design.measures is None or unstable(design) or not np.isfinite(design.measures.bandwidth):
        return 0.0
    return design.measures.bandwidth * HZ


def sensitivity(outcome: LoopOutcome, loop: ShownLoop) -> str:
    """Singular values of S, T and (S − T)/2."""
    closed, spec = outcome.closed, outcome.spec
    peak = int(np.argmax(loop.closed.gains["disk margin"]))
    return sentences(
        "sensitivity",
        outcome=outcome,
        bandwidth=bandwidth_hz(closed),
        closest=None if closed.measures is None or unstable(closed) else float(loop.frequency[peak]) * HZ,
        lines=[METRICS[kind] for curve in SENSITIVITIES for kind in limited(spec.limits, curve, spec)],
        goals=METRICS["bandwidth"].key in spec.soft or any(limited(spec.soft, curve, spec) for curve in SENSITIVITIES),
    )


def disturbance(outcome: LoopOutcome, loop: ShownLoop) -> str:
    """Platform rate and torque disturbance to the angles, and platform rate to the torque."""
    closed = loop.closed
    rejection = closed.peaks["Omega rejection"]
    of_limit = float(np.nanmax(closed.gains.get("torque limit", 0.0)))
    rejected = rejection if np.isfinite(rejection) else None
    share = 0.0 if unstable(closed.design) else of_limit
    return sentences("disturbance", outcome=outcome, rejection=rejected, share=share)


def further_gains(outcome: LoopOutcome, kinds: Sequence[str]) -> str:
    """Gains whose peaks have a limit, beside those of the other plots."""
    limits, goals = (
        any(limited(one, kind, outcome.spec) for kind in kinds) for one in (outcome.spec.limits, outcome.spec.soft)
    )
    shown = [METRICS[kind] for kind in kinds]
    return sentences("further_gains", outcome=outcome, metrics=shown, limits=limits, goals=goals)


def poles(outcome: LoopOutcome, plants: PlantSet) -> str:
    """Pole map."""
    limits, soft = outcome.spec.limits, outcome.spec.soft
    rays = [words for _, _, words in damping_rays(limits)]
    goals = bool(damping_rays(soft)) or METRICS["fastest pole"].key in soft
    counted = plants_in_words(plants)
    return sentences("poles", outcome=outcome, plants=plants, plants_in_words=counted, rays=rays, goals=goals)


def coupled(result: JobResult) -> str:
    """State of the coupled system in two sentences."""
    check, proofs = result.coupled, result.proofs.get(("", ""), Proofs())
    assert check is not None, "all loops have controllers"
    decay = -float(spectral_abscissa(continuous_poles(check.poles, check.period)))
    return sentences("coupled", check=check, decay=decay, proved=0 < proofs.proved == len(proofs.claims))


def run(one: Run, platform: Platform) -> str:
    """A simulated run of a plant."""
    trajectory = one.trajectory
    stopped = [k for k, gimbal in enumerate(platform.gimbals) if gimbal.stops is not None]
    some = bool(stopped) and len(stopped) < len(platform.gimbals)  # the others may turn on, as wheels
    angles = trajectory.metrics.angle[0, stopped if some else slice(None)]
    pushed = one.largest["torque_share"]
    return sentences(
        "run",
        trajectory=trajectory,
        lost=one.lost,
        worst=1e3 * float(angles.max(initial=0.0)),
        some=some,
        saturated=int(trajectory.saturated.sum()),
        contacts=int(trajectory.stop_contacts.sum()),
        pushed=pushed if pushed[0] > 0.0 else None,  # torquers without a limit have no share of it
        servo=bool(platform.root_torquers),
        spinning=any(rotor.angular_momentum != 0.0 for rotor in platform.rotors),
    )


def opening(result: JobResult, campaign: Summary | None) -> list[str]:
    """Return one to three sentences: what was designed, and what holds of all loops together."""
    given = all(design.method == "given" for outcome in result.loops for design in outcome.designs)
    rate = float(np.linalg.norm(result.job.Omega, np.inf)) if result.job.Omega.size else 0.0
    found = [sentences("designed", job=result.job, loops=result.loops, given=given, rate=rate)]
    if result.coupled is not None:
        found.append(sentences("together", check=result.coupled, loops=result.loops))
    found.append("" if campaign is None else _campaign(campaign))
    return [one for one in found if one]


def _campaign(summary: Summary) -> str:
    drivers = [quoted(name) for name in all_drivers(summary)[:2]]
    shared = [quoted(value_name(one)) for one in causes(summary) if one.in_every_violation]
    return sentences("campaign", statistics=summary.statistics, drivers=drivers, shared=shared)
