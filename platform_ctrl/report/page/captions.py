"""The sentences of the page: what to see in each figure, with the figures that matter in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles, spectral_abscissa
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.requirements import FAULTS, WORST_CASE
from platform_ctrl.plant.platform import Platform
from platform_ctrl.report.loop_responses import LoopResponses, RootLocus
from platform_ctrl.report.page.comparison import plants_in_words
from platform_ctrl.report.page.summary import compared_with_alternatives
from platform_ctrl.report.quantities import count, disk_words, listed, plain, quantity
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult


def nutation(result: JobResult) -> str:
    """Campbell chart."""
    uncertainty = result.job.uncertainty.spin
    shaded = (
        f" The shaded band is the uncertainty of the rotors' speed, ±{plain(100.0 * uncertainty, 3)} %."
        if uncertainty
        else ""
    )
    return (
        "Natural frequencies of the uncontrolled gimbals at rest over the speed of the rotors, all at the same share "
        "of their own; markers are the nominal plant. Dotted lines are the bandwidths of the closed loops: the closer "
        "to nutation, the harder the design. Dashed grey lines are multiples of the rotors' speed, at which an "
        f"unbalance shakes the gimbals.{shaded}"
    )


def loop_summary(outcome: LoopOutcome) -> str:
    """What is closed, and what was compared with it."""
    closed, others = outcome.closed, [design.name for design in outcome.alternatives]
    missed = [one.name for one in closed.results if not one.passed]
    text = f"“{closed.name}” is the design that is closed."
    if others:
        text += f" Compared with {listed([f'“{name}”' for name in others])}."
    if closed.results:
        text += f" It misses: {listed(missed)}." if missed else " It meets every limit of this loop on its own plants."
    if closed.measures is None:
        return f"{text} It has no plants of its own: it is judged in the coupled system."
    if unstable(closed):
        return f"{text} Its closed loop is unstable: its responses below are formulas, not those of a loop that runs."
    return " ".join([text, *compared_with_alternatives(outcome)])


def unstable(design: LoopDesign) -> bool:
    """Whether the closed loop with the nominal plant is unstable; False where a design has no plants of its own."""
    return design.measures is not None and not design.measures.decay[0] > 0.0


def sensitivity(outcome: LoopOutcome, responses: LoopResponses) -> str:
    """Singular values of S, T and (S − T)/2."""
    closed = next(one for one in responses.designs if one.design.name == outcome.closed.name)
    at = responses.frequency[int(np.argmax(closed.balanced))] / (2.0 * np.pi)
    measures = outcome.closed.measures
    if measures is None or unstable(outcome.closed):
        return (
            f"With “{outcome.closed.name}” the loop is unstable: it has no bandwidth and no margin; the other "
            "designs can still be compared."
        )
    bandwidth = measures.bandwidth / (2.0 * np.pi)
    limits, soft = outcome.spec.limits, outcome.spec.soft
    drawn = ("bandwidth_hz", "tracking", "sensitivity_peak", "complementary_sensitivity_peak", "disk_margin")
    goals = [soft.get(key) for key in drawn]
    marks = []
    if limits.get("bandwidth_hz") is not None:
        marks.append("blue band: the bandwidth that is asked for")
    if limits.get("tracking") is not None:
        marks.append("red area: forbidden by the limit on tracking")
    marks.append("thin: the smallest singular value" + (" of the closed design" if len(outcome.designs) > 2 else ""))
    asked = [limits.get("sensitivity_peak"), limits.get("complementary_sensitivity_peak"), limits.get("disk_margin")]
    lines = " Dashed red lines are limits of the nominal plant, whose curves these are." if any(asked) else ""
    return (
        f"Left: the curve stays below 1/√2 up to the bandwidth, {quantity(bandwidth, 'Hz', 3)} for "
        f"“{outcome.closed.name}” (marker); {'; '.join(marks)}. Right: the peak is one over the disk margin; it stands "
        f"at {quantity(float(at), 'Hz', 3)}, where this loop is closest to losing its stability."
        f"{_margins(outcome.closed)}{lines}{_goal_lines(goals)}"
    )


def _margins(design: LoopDesign) -> str:
    """How far the margin falls with other plants."""
    measures = design.measures
    if measures is None:
        return ""
    parts = []
    for groups, where in ((WORST_CASE, "over all uncertain parameters and platform rates"), (FAULTS, "with a fault")):
        chosen = measures.of(groups)
        if chosen.sum() > 1:
            parts.append(f"{plain(float(measures.disk_margin[chosen].min()), 3, 'down')} {where}")
    return f" From {plain(float(measures.disk_margin[0]), 3, 'down')} it falls to {listed(parts)}." if parts else ""


def _goal_lines(goals: Sequence[float | None]) -> str:
    return "" if all(goal is None for goal in goals) else " Grey dash-dotted lines are goals."


def spins(platform: Platform) -> bool:
    """Whether any rotor of a plant has momentum."""
    return any(rotor.angular_momentum != 0.0 for rotor in platform.rotors)


def loop_transfer(outcome: LoopOutcome, spinning: bool) -> str:
    """Loop transfer, controller, channel by channel; `spinning`: of a plant whose rotors spin."""
    which = " (all of them for the closed design, the largest for the others)" if len(outcome.designs) > 2 else ""
    asked = outcome.spec.limits.get("controller_gain")
    gain = f" Red area: forbidden to the controller's gain, {quantity(asked, 'N m/rad')}." if asked is not None else ""
    return (
        f"First column: singular values of the loop transfer at the torquers{which}, and the controller's largest "
        f"gain.{gain} Others: the loop that each torquer closes while all the others stay closed. Stability margins "
        "show where the gain passes 1: the phase there should keep away from −180° and its odd multiples; modes of "
        f"the plant with little damping{', such as nutation,' if spinning else ''} are resonances that the phase has "
        "to pass on the safe side."
    )


def nichols(outcome: LoopOutcome) -> str:
    """Nichols plot of the closed design."""
    asked = outcome.spec.limits.get("disk_margin")
    region = (
        f" In the shaded regions a channel alone would have lost the disk margin of {plain(asked, 3)} that is asked of "
        "all together."
        if asked is not None
        else ""
    )
    return (
        f"The loop that each torquer closes with “{outcome.closed.name}” while all the others stay closed: it "
        f"has to pass the crosses, gain 1 and phase −180°, at a distance.{region} A diamond stands where a "
        "channel comes closest, with its disk margin in the legend."
    )


def disturbance(outcome: LoopOutcome, responses: LoopResponses) -> str:
    """Platform rate and torque disturbance to the angles, and platform rate to the torque."""
    closed = next(one for one in responses.designs if one.design.name == outcome.closed.name)
    text = ""
    if np.isfinite(closed.rejection):
        text += (
            f" With “{outcome.closed.name}” no sinusoidal platform rate, about whatever axis and held from sample to "
            f"sample, moves them by more than {plain(1e3 * closed.rejection, 3, 'up')} mrad per rad/s."
        )
    share = float(np.nanmax(closed.torque_share, initial=0.0))
    if share > 0.0:
        text += (
            f" The torque that a sinusoidal rate of the job's size asks for comes to at most {plain(share, 3, 'up')} "
            "of a torquer's limit (grey line: 1), at any frequency."
        )
    return f"The lower a curve, the better the gimbals are kept at zero. Grey: without a controller.{text}"


def poles(outcome: LoopOutcome, plants: PlantSet) -> str:
    """Pole map."""
    limits, soft = outcome.spec.limits, outcome.spec.soft
    rays = _rays(limits)
    asked = f" Red rays: the damping that is asked of fast poles ({rays})." if rays else ""
    if "fastest_pole" in limits:
        fast = quantity(limits["fastest_pole"], "rad/s")
        asked += f" Red arc: poles may be as fast as {fast} in the w-plane, a circle there."
    faint = "; faint: those with the parameter uncertainty or a platform rate" if len(plants.labels) > 1 else ""
    crosses = "; crosses: those with a fault" if "faults" in plants.groups else ""
    goals = _goal_lines((soft.get("damping"), soft.get("fastest_pole")))
    reach = " How far the clouds reach to the right is what the uncertainty costs." if faint else ""
    return (
        f"Poles as s = ln(z)/T with {plants_in_words(plants)}. Strong: the nominal plant{faint}{crosses}. Stable poles "
        f"lie left of the shaded half plane.{asked}{goals}{reach}"
    )


def _rays(limits: Mapping[str, float]) -> str:
    """Return which ray of the pole map is which."""
    rays = (
        (limits.get("damping"), "dashed", "for the nominal plant"),
        (limits.get("damping_worst_case"), "dotted", "in the worst case"),
        (limits.get("damping_faults"), "dash-dotted", "with a fault"),
    )
    return "; ".join(f"{dashes}, {ratio:g}, {where}" for ratio, dashes, where in rays if ratio is not None)


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
        "The loop through each torquer of the platform, all others closed: gain 1 is crossed at the servo's "
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
        f"With all loops closed the coupled system is stable: {poles}, the slowest decays with "
        f"{plain(decay, 3, 'down')} 1/s."
    )
    proofs = result.proofs["", ""]
    if 0 < proofs.of == proofs.proved:
        text += " That it is stable is proved in interval arithmetic."
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
        else "Red poles lie in the right half plane or on its edge"
    )
    platform = ", the free platform" if result.coupled.free else " on the carried platform"
    return f"Poles as s = ln(z)/T of the gimbals{platform} and all controllers together. {where}."


def margin_bars(result: JobResult) -> str:
    """Loop-by-loop margins."""
    asked = result.job.coupled.coupling_cost
    limit = f" A loss of {plain(100.0 * asked, 3)} % is allowed." if asked is not None else ""
    return (
        "Each pair of bars: the disk margin of one loop before and after the platform feels the gimbals' reactions. "
        f"The design models are good where the pairs are alike.{limit}"
    )


def simultaneous(result: JobResult) -> str:
    """Simultaneous margin."""
    return (
        f"All {len(result.coupled.channels)} loops may change at once and independently, each by "
        f"{disk_words(result.coupled.simultaneous.alpha)}: the system stays stable. The dip shows at which frequency "
        "it is most sensitive."
    )


def platform_disturbance() -> str:
    """Platform compliance."""
    return (
        "Left: how far a torque turns the platform, with all loops closed and (grey) with no controller at all. "
        "Right: how far the gimbals then leave their zero. Low is good; flat towards low frequency means that a "
        "constant torque leaves a constant angle."
    )


def run(one: Run, spinning: bool) -> str:
    """A simulated run; `spinning`: of a plant whose rotors spin."""
    trajectory = one.trajectory
    if not trajectory.completed:
        return (
            f"The run {trajectory.ended} (red line): the loops lost the gimbals. Look for the first trace that "
            "leaves its limits, and for torques at theirs."
        )
    worst = 1e3 * float(np.abs(trajectory.q).max(initial=0.0))
    text = f"No gimbal leaves ±{plain(worst, 3, 'up')} mrad."
    saturated = int(trajectory.saturated.sum())
    if trajectory.mode == "caged" and spinning:
        text += (
            " A caged gyro holds the rate with the torque L Ω: the torques copy the rate; transient and noise are left "
            "in the angles."
        )
    elif trajectory.mode != "caged":
        text += " The platform gives way until the servo holds the torque"
        text += "; the torques of the caged gyros measure its rate." if spinning else "."
    if saturated:
        text += f" Torquers were at their limits in {count(saturated, 'sample')}."
    if int(trajectory.stop_contacts.sum()):
        text += f" Gimbals met their stops {count(int(trajectory.stop_contacts.sum()), 'time')}."
    return text
