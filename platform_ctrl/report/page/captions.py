"""The sentences of the page: what to see in each plot, with the important values in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.design.jobs import LoopOutcome, largest_Omega_name
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.requirements import FAULTS, WORST_CASE
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.figures.limit_lines import damping_rays, limited
from platform_ctrl.report.figures.loop import SENSITIVITIES
from platform_ctrl.report.loop_responses import LoopResponses, RootLocus
from platform_ctrl.report.page.comparison import plants_in_words
from platform_ctrl.report.page.summary import bandwidth_hz, compared_with_alternatives
from platform_ctrl.report.quantities import BOUND, count, disk_words, listed, plain, quantity
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult


def nutation(result: JobResult) -> str:
    """Campbell diagram."""
    uncertainty = result.job.uncertainty.spin
    band = f" The shaded band is the uncertainty of the rotors' speed, ±{plain(100.0 * uncertainty, 3)} %."
    shaded = band if uncertainty else ""
    return (
        "Natural frequencies of the uncontrolled gimbals at rest over the speed of the rotors, which all run at the "
        "same share of their nominal speed; markers show the nominal plant. Dotted lines are the bandwidths of the "
        "closed loops: the closer to nutation, the harder the design. Dashed grey lines are multiples of the rotors' "
        f"speed, at which an unbalance excites the gimbals.{shaded}"
    )


def loop_summary(outcome: LoopOutcome) -> str:
    """Which design is closed, and how it compares with the others."""
    closed, others = outcome.closed, [design.name for design in outcome.alternatives]
    missed = [one.name for one in closed.results if not one.passed]
    text = f"“{closed.name}” is the design that is closed."
    if others:
        text += f" It is compared with {listed([f'“{name}”' for name in others])}."
    if closed.results:
        text += f" It misses: {listed(missed)}." if missed else " It meets every limit of this loop on its own plants."
    if closed.measures is None:
        return f"{text} It has no plants of its own: it is judged in the coupled system."
    if unstable(closed):
        return f"{text} Its closed loop is unstable: the responses below are computed, but no such loop can run."
    return " ".join([text, *compared_with_alternatives(outcome)])


def unstable(design: LoopDesign) -> bool:
    """Return whether the closed loop with the nominal plant is unstable; False for a design without plants."""
    return design.measures is not None and not design.measures.decay[0] > 0.0


def sensitivity(outcome: LoopOutcome, responses: LoopResponses) -> str:
    """Singular values of S, T and (S − T)/2."""
    closed, spec = outcome.closed, outcome.spec
    if closed.measures is None or unstable(closed):
        return (
            f"With “{closed.name}” the loop is unstable and has neither bandwidth nor margin; the other designs can "
            "still be compared."
        )
    at = responses.frequency[int(np.argmax(responses.closed_design.gains["disk margin"]))]
    marks = []
    if METRICS["bandwidth"].key in spec.limits:
        marks.append("blue band: the required bandwidth")
    lines = [METRICS[kind] for curve in SENSITIVITIES for kind in limited(spec.limits, curve)]
    marks += [f"red area: forbidden by the limit on {one.name}" for one in lines if one.band]
    marks.append("thin: the smallest singular value" + (" of the closed design" if len(outcome.designs) > 2 else ""))
    dashed = " Dashed red lines are limits for the nominal plant, whose curves these are."
    goals = METRICS["bandwidth"].key in spec.soft or any(limited(spec.soft, curve) for curve in SENSITIVITIES)
    return (
        f"Left: the curve stays below 1/√2 up to the bandwidth, {quantity(bandwidth_hz(closed), 'Hz', 3)} for "
        f"“{closed.name}” (marker); {'; '.join(marks)}. Right: the peak is one over the disk margin; it is at "
        f"{quantity(float(at) / (2.0 * np.pi), 'Hz', 3)}, where this loop is closest to instability."
        f"{_margins(closed)}{dashed if any(not one.band for one in lines) else ''}{_goal_lines(goals)}"
    )


def _margins(design: LoopDesign) -> str:
    """Return how far the disk margin falls with other plants."""
    measures = design.measures
    if measures is None:
        return ""
    parts = []
    for groups, where in ((WORST_CASE, "over all uncertain parameters and platform rates"), (FAULTS, "with a fault")):
        chosen = measures.of(groups)
        if chosen.sum() > 1:
            parts.append(f"{plain(float(measures.disk_margin[chosen].min()), 3, 'down')} {where}")
    nominal = plain(float(measures.disk_margin[0]), 3, "down")
    return f" From {nominal} for the nominal plant the disk margin falls to {listed(parts)}." if parts else ""


def _goal_lines(drawn: bool) -> str:
    return " Grey dash-dotted lines are goals." if drawn else ""


def spins(platform: Platform) -> bool:
    """Return whether any rotor of a plant has momentum."""
    return any(rotor.angular_momentum != 0.0 for rotor in platform.rotors)


def loop_transfer(outcome: LoopOutcome, spinning: bool) -> str:
    """Loop transfer and controller, channel by channel; `spinning`: of a plant whose rotors spin."""
    which = " (all of them for the closed design, the largest for the others)" if len(outcome.designs) > 2 else ""
    metric = METRICS["controller gain"]
    limit = outcome.spec.limits.get(metric.key)
    gain = "" if limit is None else f" Red area: forbidden to the {metric.name}, {quantity(limit, metric.unit)}."
    return (
        f"First column: singular values of the loop transfer at the torquers{which}, and the largest gain of the "
        f"controller.{gain} Others: the loop that each torquer closes while all the others stay closed. Stability "
        "margins show where the gain passes 1: the phase there should keep away from −180° and its odd multiples. "
        f"Lightly damped modes of the plant{', such as nutation,' if spinning else ''} are resonances, which the phase "
        "has to pass on the safe side."
    )


def nichols(outcome: LoopOutcome) -> str:
    """Nichols plot of the closed design."""
    metric = METRICS["disk margin"]
    limit = outcome.spec.limits.get(metric.key)
    region = (
        f" A curve that enters a shaded region has, in this channel alone, less than the {metric.name} of "
        f"{plain(limit, 3)} that is required of all channels together."
        if limit is not None
        else ""
    )
    return (
        f"The loop that each torquer closes with “{outcome.closed.name}” while all the others stay closed: it has to "
        f"pass the crosses, gain 1 and phase −180°, at a distance.{region} A diamond marks where a channel comes "
        "closest; its disk margin is in the legend."
    )


def disturbance(outcome: LoopOutcome, responses: LoopResponses) -> str:
    """Platform rate and torque disturbance to the angles, and platform rate to the torque."""
    closed = responses.closed_design
    text, rejection = "", closed.peaks["Omega rejection"]
    if np.isfinite(rejection):
        text += (
            f" With “{outcome.closed.name}” no sinusoidal platform rate, about any axis and constant from sample to "
            f"sample, moves them by more than {plain(1e3 * rejection, 3, 'up')} mrad per rad/s."
        )
    share = float(np.nanmax(closed.gains.get("torque limit", 0.0)))
    if share > 0.0:
        text += (
            f" The torque for a sinusoidal rate of the job's size is at most {plain(share, 3, 'up')} of a torquer's "
            "limit (grey line: 1), at any frequency."
        )
    return f"The lower a curve, the better the gimbals are kept at zero. Grey: without a controller.{text}"


def further_gains(outcome: LoopOutcome, responses: LoopResponses, kinds: Sequence[str]) -> str:
    """Gains whose peaks have a limit, beside those of the other plots."""
    parts = []
    for kind in kinds:
        metric = METRICS[kind]
        found = responses.closed_design.peaks[kind] / metric.scale
        bounds = [
            f"{words} {BOUND[metric.sense]} {quantity(limits[metric.key], metric.unit)}"
            for words, limits in (("limit", outcome.spec.limits), ("goal", outcome.spec.soft))
            if metric.key in limits
        ]
        towards = "up" if metric.sense == "at most" else "down"
        value = quantity(found, metric.unit, 3, rounding="up" if towards == "up" else "down")
        parts.append(
            f"{metric.name[:1].upper()}{metric.name[1:]}: {metric.meaning}; {value} with “{outcome.closed.name}”, "
            f"{' and '.join(bounds)}."
        )
    goals = any(limited(outcome.spec.soft, kind) for kind in kinds)
    lines = " Dashed red lines are limits." if any(limited(outcome.spec.limits, kind) for kind in kinds) else ""
    return f"{' '.join(parts)}{lines}{_goal_lines(goals)}"


def poles(outcome: LoopOutcome, plants: PlantSet) -> str:
    """Pole map."""
    limits, soft = outcome.spec.limits, outcome.spec.soft
    fastest = METRICS["fastest pole"]
    rays = "; ".join(words for _, _, words in damping_rays(limits))
    required = f" Red rays: the required damping of fast poles ({rays})." if rays else ""
    if fastest.key in limits:
        fast = quantity(limits[fastest.key], fastest.unit)
        required += f" Red arc: poles may be as fast as {fast} in the w-plane, where the arc is a circle."
    faint = "; faint: with uncertain parameters or a platform rate" if len(plants.labels) > 1 else ""
    crosses = "; crosses: with a fault" if "faults" in plants.groups else ""
    goals = _goal_lines(bool(damping_rays(soft)) or fastest.key in soft)
    reach = " How far the clouds reach to the right shows what uncertainty costs." if faint else ""
    return (
        f"Poles as s = ln(z)/T with {plants_in_words(plants)}. Strong: the nominal plant{faint}{crosses}. Stable poles "
        f"lie left of the shaded half plane.{required}{goals}{reach}"
    )


def root_locus(outcome: LoopOutcome, locus: RootLocus) -> str:
    """Root locus."""
    found = locus.stable_range
    if found is None:
        words = "the loop is unstable at its design gain"
    else:
        low = "from the smallest gain drawn" if found[0] <= locus.gains[1] else f"from {plain(found[0], 3)}"
        high = (
            f"to beyond {plain(float(locus.gains[-1]), 3)}"
            if found[1] >= locus.gains[-1]
            else f"to {plain(found[1], 3)}"
        )
        words = f"the loop is stable {low} {high} times its gain"
    return (
        f"Poles of “{outcome.closed.name}” on the nominal plant while all its gains grow together from 0 to "
        f"{plain(float(locus.gains[-1]), 3)} times the design. Steps of 0.5 are marked, the design itself large "
        f"and orange, labelled along the least damped branch: {words}."
    )


def servo() -> str:
    """The platform servo's loops."""
    return (
        "The loop through each torquer of the platform, all others closed: the gain crosses 1 at the servo's "
        "crossover; the loops of the gimbals must be fast enough to leave phase there."
    )


def coupled_summary(result: JobResult) -> str:
    """State of the coupled system in two sentences."""
    check = result.coupled
    decay = -float(spectral_abscissa(continuous_poles(check.poles, result.job.sampling.period)))
    if not check.stable:
        return (
            f"The coupled system is unstable: its minimum decay rate, {plain(decay, 3, 'down')} 1/s, must be above 0. "
            "Margins and noise have no meaning until it is stable; try slower loops, or caging loops and servo "
            "further apart in bandwidth."
        )
    poles = count(len(check.poles), "pole")
    text = (
        f"With all loops closed the coupled system is stable: {poles}, minimum decay rate "
        f"{plain(decay, 3, 'down')} 1/s."
    )
    proofs = result.proofs["", ""]
    if 0 < proofs.of == proofs.proved:
        text += " Its stability is proved in interval arithmetic."
    if np.isfinite(check.cost).any():
        k = int(np.nanargmax(check.cost))
        cost = plain(100.0 * max(float(check.cost[k]), 0.0), 2, "up")
        text += f" Coupling costs at most {cost} % of a disk margin (channel {check.channels[k]})."
    return text


def coupled_poles(result: JobResult) -> str:
    """Poles of the coupled system."""
    where = (
        "All lie in the left half plane"
        if result.coupled.stable
        else "Red poles lie in the right half plane or on the imaginary axis"
    )
    platform = ", the free platform" if result.coupled.free else " on the carried platform"
    return f"Poles as s = ln(z)/T of the gimbals{platform} and all controllers together. {where}."


def margin_bars(result: JobResult) -> str:
    """Loop-by-loop margins."""
    allowed = result.job.coupled.coupling_cost
    limit = f" A loss of {plain(100.0 * allowed, 3)} % is allowed." if allowed is not None else ""
    return (
        "Each pair of bars: the disk margin of one loop on a fixed platform and on one that reacts to the gimbals. "
        f"The design models are good where the pairs are alike.{limit}"
    )


def simultaneous(result: JobResult) -> str:
    """Simultaneous margin."""
    return (
        f"All {len(result.coupled.channels)} loops may change at once and independently, each by "
        f"{disk_words(result.coupled.simultaneous.alpha)}: the system stays stable. The dip is at the frequency where "
        "it is most sensitive."
    )


def platform_disturbance() -> str:
    """Platform compliance."""
    return (
        "Left: how far a torque turns the platform, with all loops closed and (grey) with no controller at all. "
        "Right: how far the gimbals then leave zero. Low is good; flat towards low frequency means that a "
        "constant torque leaves a constant angle."
    )


def run(one: Run, spinning: bool, loops: Sequence[LoopOutcome]) -> str:
    """A simulated run; `spinning`: of a plant whose rotors spin."""
    trajectory = one.trajectory
    if not trajectory.completed:
        return (
            f"The run {trajectory.ended} (red line): the loops could not hold the gimbals. Look for the first signal "
            "beyond its limit, and for torques at their limits."
        )
    worst = 1e3 * float(np.abs(trajectory.q).max(initial=0.0))
    text = f"No gimbal leaves ±{plain(worst, 3, 'up')} mrad."
    saturated = int(trajectory.saturated.sum())
    if trajectory.mode == "caged" and spinning:
        text += (
            " A caged gyro balances the rate with the torque L Ω: the torques follow the rate; transients and noise "
            "remain in the angles."
        )
    elif trajectory.mode != "caged":
        text += " The platform yields until the servo balances the torque"
        text += "; the torques of the caged gyros measure its rate." if spinning else "."
    if saturated:
        text += f" Torquers were at their limits in {count(saturated, 'sample')}."
    if int(trajectory.stop_contacts.sum()):
        text += f" Gimbals met their stops {count(int(trajectory.stop_contacts.sum()), 'time')}."
    return text + _largest_rate(one, loops)


def _largest_rate(run: Run, loops: Sequence[LoopOutcome]) -> str:
    """Return up to which rate about the run's axis the closed loops are proved to keep within their limits."""
    claims = [outcome.closed.claims for outcome in loops]
    nominal, varied = (
        min((own[name] for own in claims if name in own), default=None)
        for name in (largest_Omega_name(run.manoeuvre.axis, worst_case=worst) for worst in (False, True))
    )
    if run.manoeuvre.mode != "caged" or nominal is None:
        return ""
    others = "" if varied is None else f", {plain(varied, 3, 'down')} in the worst case"
    return (
        f" Up to {plain(nominal, 3, 'down')} rad/s about this axis{others}, torques and angles of the linear loops are "
        f"proved to keep within their limits, without noise; this run goes to {plain(run.manoeuvre.rate, 3)}."
    )
