"""The tables of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version

import numpy as np

from platform_ctrl.campaign.summary import Summary
from platform_ctrl.common.files import toml
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.job import quantities
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import PROVED, CheckResult
from platform_ctrl.job.reading import job_data
from platform_ctrl.job.requirements import GOAL
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.modes import Mode, modes
from platform_ctrl.plant.drives import Torquer
from platform_ctrl.plant.sensors import PickOff
from platform_ctrl.report.blocks import Cell, Group, Listing, Paragraph, Row, Subsection, Table, cells, columns, table
from platform_ctrl.report.campaign_tables import campaign_words
from platform_ctrl.verification import result_file
from platform_ctrl.verification.bounds import LoopBounds
from platform_ctrl.verification.coupled import CoupledCheck
from platform_ctrl.verification.verdict import JobResult


@value
class RequirementRow:
    """One requirement as the tables show it, in words: the limit with its sense, the margin in per cent."""

    checked: CheckResult
    value: str
    limit: str
    margin: str
    share: float  # The margin as a number between −1 and 1, for a bar; 0 where there is none

    @property
    def words(self) -> str:
        """The requirement in a line."""
        return f"{self.checked.subject}: {self.checked.name} {self.value}, limit {self.limit}"


def requirement_rows(result: JobResult) -> tuple[RequirementRow, ...]:
    """Return all requirements, subjects in the order of the verdict, the worst first within each."""
    return _ordered(result, result.requirements)


def goal_rows(result: JobResult) -> tuple[RequirementRow, ...]:
    """Return the goals of all closed designs, in the same order."""
    return _ordered(result, [goal for outcome in result.loops for goal in outcome.closed.goals])


def _ordered(result: JobResult, results: Sequence[CheckResult]) -> tuple[RequirementRow, ...]:
    # A loop may have the name of something else that is judged, of which no design is named.
    subjects = list(dict.fromkeys(one.title for one in results))

    def place(one: CheckResult) -> tuple[int, bool, float]:
        # The row of complete proofs has no margin: it comes last.
        margin = np.inf if one.passed and one.name == PROVED.name else one.margin
        return subjects.index(one.title), one.passed, margin

    return tuple(requirement_row(one, result) for one in sorted(results, key=place))


def requirement_row(one: CheckResult, result: JobResult | None) -> RequirementRow:
    """Return a requirement as the tables show it; `result` has the proofs of "certified properties"."""
    number, limit = quantities.compared(one)
    limit, margin = f"{quantities.BOUND[one.sense]} {limit}", quantities.percent(one.margin)
    if one.name == PROVED.name and result is not None:
        # All claims have to be proved: there is no margin.
        proofs = result.proofs[one.subject if one.design else "", one.design]
        number, limit, margin = f"{proofs.proved} of {len(proofs.claims)}", "all", ""
    share = one.margin if margin and np.isfinite(one.margin) else 0.0
    share = float(np.clip(share, -1.0, 1.0))
    return RequirementRow(checked=one, value=number, limit=limit, margin=margin, share=share)


def verdict(result: JobResult, campaign: Summary | None) -> tuple[bool, str]:
    """Return whether all is met, by the runs of a campaign too, and that in a few words."""
    # A torquer that a template added belongs beside "met".
    words = f"{quantities.met_words(result.requirements)}{quantities.added_words(result.job.platform)}"
    if campaign is None:
        return result.passed, words
    return result.passed and campaign.passed, f"{words}; {campaign_words(campaign)}"


def _mark(part: Torquer | PickOff) -> str:
    return ", added" if part.added else ""


# Of the plant file: what has a table of its own, and the keys that say where a part is.
_BODY = ("mode", "gravity", "mass", "centre", "origin")
_SHOWN, _PLACES = ("gimbal", "rotor", "torquer", "pickoff"), ("name", "gimbal", "body")


def element_table(result: JobResult) -> Table | None:
    """Return sensors, springs, friction and whatever else the plant file has, with its keys; None without any."""
    platform = result.job.platform
    rows = []
    if np.any(platform.specific_force):
        rows.append(("specific force", platform.root_name, _value(platform.specific_force.tolist())))
    plant = job_data(result.job)["plant"]
    for part in (plant["root"], *plant.get("gimbal", ()), *plant.get("rotor", ())):
        if own := [f"{key.replace('_', ' ')} {_value(part[key])}" for key in _BODY if key in part]:
            rows.append(("body", part["name"], ", ".join(own)))
    for kind, parts in plant.items():
        for part in parts if kind not in _SHOWN and isinstance(parts, list) else ():
            place = next((key for key in _PLACES if key in part), "")
            numbers = ", ".join(f"{key} {_value(one)}" for key, one in part.items() if key != place)
            rows.append((kind.replace("_", " "), str(part.get(place, "")), numbers))
    return table("element|name or place|keys of the plant file, SI units", rows) if rows else None


def _value(one: object) -> str:
    if isinstance(one, list | tuple):
        return f"({', '.join(map(_value, one))})"
    if isinstance(one, dict):
        return f"({', '.join(f'{key} {_value(number)}' for key, number in one.items())})"
    return quantities.plain(float(one)) if isinstance(one, float) else str(one)


_KIND = {
    "rigid body": "rigid-body mode: free rotation, no gyro and no restraint acts",
    "pendulum": "pendulum oscillation",
    "divergence": "divergence",
}


def _mode_cells(mode: Mode) -> tuple[str, str, str, str]:
    if mode.frequency == 0.0:
        frequency = "no oscillation" if mode.kind in ("decay", "divergence") else "at the origin"
    else:
        frequency = f"{quantities.plain(mode.frequency)} rad/s = {quantities.plain(mode.frequency / (2.0 * np.pi))} Hz"
    kind = _KIND.get(mode.kind, mode.kind)
    if mode.growth > 0.0:
        kind += f", unstable, grows at {quantities.plain(mode.growth, 3)} 1/s"
    return "-".join(mode.gimbals), kind, str(mode.poles), frequency


def requirement_table(result: JobResult) -> Table:
    """Return every requirement of a job, loop by loop, and each loop's goals after it."""
    rows, goals, groups = requirement_rows(result), goal_rows(result), []
    named = [(row, row_name(k)) for k, row in enumerate(rows)]
    for title in dict.fromkeys(row.checked.title for row in rows):
        own = tuple(_requirement(row, name) for row, name in named if row.checked.title == title)
        groups.append(Group(title=title, rows=own))
        wished = [row for row in goals if row.checked.title == title]
        if wished:
            words = f"goals of {wished[0].checked.subject}, not part of the verdict"
            groups.append(Group(title=words, rows=tuple(map(_requirement, wished)), quiet=True))
    titles = columns("requirement|value|limit|margin|stage|method|met", numbers="value|limit|margin")
    return Table(columns=titles, groups=tuple(groups), form="requirements")


def row_name(k: int) -> str:
    """Return where links to the k-th of `requirement_rows` lead."""
    return f"requirement-{k + 1}"


def _requirement(row: RequirementRow, place: str = "") -> Row:
    one = row.checked
    if one.hard:
        mark, tone = (f"{quantities.MET} met", "good") if one.passed else (f"{quantities.NOT_MET} not met", "bad")
    else:
        mark, tone = f"{quantities.MET} reached" if one.passed else f"{quantities.DASH} not reached", "quiet"
    bad = "bad" if tone == "bad" else ""
    return Row(
        cells=(
            Cell(text=one.name if one.hard else one.name.removeprefix(GOAL), note=one.evidence),
            Cell(text=row.value, tone=bad),
            Cell(text=row.limit),
            Cell(text=row.margin, tone="" if tone == "good" else tone, bar=abs(row.share) if row.margin else None),
            *cells(one.stage, one.method),
            Cell(text=mark, tone=tone),
        ),
        missed=bool(bad),
        name=place,
    )


def bound_table(found: LoopBounds) -> Table:
    """Return how the largest bandwidth of a loop changes with what bounds it."""
    rows = [(one.parameter, quantities.plain(one.sensitivity, 2)) for one in found.bounds]
    slope = "d ln(bandwidth)/d ln(parameter)"
    return table(f"parameter|{slope}", rows, numbers=slope, form="narrow")


def margin_table(check: CoupledCheck) -> Table:
    """Return the disk margin of each loop; of a free platform beside that in its design model."""
    rows = []
    for name, before, after, cost in zip(check.channels, check.decoupled, check.coupled, check.cost, strict=True):
        alone, margin = quantities.plain(float(before), 3, "down"), quantities.plain(float(after), 3, "down")
        change = quantities.percent(round(-float(cost), 3) + 0.0)
        if not math.isfinite(cost):
            margin = "unstable"
        # A carried platform is what the design models assume: there is nothing to compare.
        rows.append((name, alone, margin, change) if check.free else (name, margin))
    titles = "in its design model|in the coupled system|change" if check.free else "disk margin"
    return table(f"torquer|{titles}", rows, numbers=titles, form="narrow")


def gimbal_table(result: JobResult) -> Table:
    """Return the gimbals, indented by their level."""
    platform = result.job.platform
    torquers = {t.gimbal: t for t in platform.torquers if t.gimbal is not None}
    pickoffs = {s.gimbal: s for s in platform.pickoffs}
    depth: dict[str, int] = {platform.root_name: -1}
    rows: list[tuple[str, ...]] = []
    for k, gimbal in enumerate(platform.gimbals):
        depth[gimbal.name] = depth.get(gimbal.parent, -1) + 1
        stops = (
            "none"
            if gimbal.stops is None
            else " to ".join(quantities.plain(1e3 * x, 3) for x in gimbal.stops) + " mrad"
        )
        torquer, pickoff = torquers.get(gimbal.name), pickoffs.get(gimbal.name)
        limit = "" if torquer is None else _limit(torquer.limit)
        rows.append(
            (
                "\u2003" * depth[gimbal.name] + gimbal.name,
                gimbal.parent,
                quantities.axis_text(gimbal.axis),
                gimbal.angle,
                f"{quantities.plain(float(result.model.M[k, k]))} kg m²",
                stops,
                "none" if torquer is None else f"{torquer.name}, {limit}{_mark(torquer)}",
                "none" if pickoff is None else f"{_noise(pickoff)}{_mark(pickoff)}",
            )
        )
    titles = "gimbal|carried by|axis|angle|J about the axis|stops|torquer|pick-off noise"
    return table(titles, rows, numbers="J about the axis|stops")


def _noise(pickoff: PickOff) -> str:
    step = f", steps of {quantities.plain(1e6 * pickoff.quantisation)} µrad" if pickoff.quantisation else ""
    return f"{quantities.plain(1e6 * pickoff.noise_rms)} µrad rms{step}"


def _limit(limit: float | None) -> str:
    return "no limit" if limit is None else f"\u00b1{quantities.quantity(limit, 'N m')}"


def rotor_table(result: JobResult) -> Table:
    """Return the rotors."""
    rows = [
        (
            rotor.name,
            rotor.carrier,
            quantities.axis_text(rotor.axis),
            f"{quantities.plain(rotor.angular_momentum)} N m s",
            f"{quantities.plain(rotor.axial_inertia)} kg m²",
            f"{quantities.plain(rotor.spin)} rad/s",
            rotor.control,
        )
        for rotor in result.job.platform.rotors
    ]
    return table("rotor|carried by|spin axis|L|C|spin|speed", rows, numbers="L|C|spin")


def modes_at(result: JobResult, Omega: FloatArray) -> tuple[Mode, ...]:
    """Return the modes of all subsystems at a constant platform rate, rad/s."""
    model = linearise(result.job.platform, Omega=Omega)
    return tuple(mode for group in result.subsystems for mode in modes(model, group))


def mode_table(result: JobResult) -> Table:
    """Return the modes of the uncontrolled gimbals at rest and at the job's largest rate; a group is named once."""
    found = [("at rest", *_mode_cells(mode)) for mode in modes_at(result, np.zeros(3))]
    if np.any(result.job.Omega > 0.0):
        rate = f"Ω = ({', '.join(quantities.plain(float(x), 3) for x in result.job.Omega)}) rad/s"
        found += [(rate, *_mode_cells(mode)) for mode in modes_at(result, result.job.Omega)]
    groups: dict[str, list[tuple[str, ...]]] = {}
    for rate, group, *mode in found:
        groups.setdefault(group, []).append((rate, *mode))
    rows = [(group if k == 0 else "", *row) for group, own in groups.items() for k, row in enumerate(own)]
    return table("group|platform rate|motion|poles|frequency", rows, numbers="poles|frequency")


def record_part(job: Job) -> Subsection:
    """Return the job with its plant as a listing to be copied."""
    words = (
        f"All numbers to their last digit, in SI units, with the plant (“{job.plant}” in the job); what is left out "
        "has its default value."
    )
    return Subsection(
        title="Job and plant as read",
        folded=True,
        blocks=(Paragraph(text=words), Listing(text=toml(job_data(job)), file="job.toml")),
    )


def folded_facts(title: str, rows: Mapping[str, object]) -> Subsection:
    """Return names and what goes with them, folded."""
    facts = table("|", [(name, str(words)) for name, words in rows.items()], form="narrow")
    return Subsection(title=title, blocks=(facts,), folded=True)


def report_versions() -> dict[str, str]:
    """Return the versions of Python and of every package that the report depends on."""
    return {**result_file.versions(), "matplotlib": version("matplotlib")}
