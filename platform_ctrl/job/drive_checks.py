"""What must fit together about the drives of a job."""

from __future__ import annotations

from collections.abc import Iterator

from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.drive import Drive, angle_sensors, drive_law
from platform_ctrl.job.job import Job
from platform_ctrl.plant.entry import Entry
from platform_ctrl.plant.mistakes import Mistake, given, one_line, suggestion
from platform_ctrl.plant.platform import Platform

# The keys that belong together: the first, and what has no effect without it.
_WITH = {"friction": ("friction_rate", "sensors"), "secant_of": ("secant_limit",)}
# Friction that is fed forward over the plant's: with more the bearing would be better off without it.
_MOST = 2.0


def drive_mistakes(job: Entry) -> Iterator[Mistake]:
    """Walk what can be said of the plain data."""
    taken: dict[str, int] = {}
    for drive in job.tables("drive"):
        there = [key for key in _WITH if key in drive]
        if not there:
            yield drive.missing("friction", "a drive needs friction with sensors, secant_of, or both")
        for key, others in _WITH.items():
            for other in others:
                if there and key not in drive and other in drive:
                    yield drive.useless(other, f"without {key}; add it, or leave the key out")
        if drive.data.get("friction") and not drive.data.get("sensors"):
            words = "friction is fed forward by the rate that rate sensors of the base or the gimbal show"
            yield drive.missing("sensors", words)
        name = drive.text("torquer")
        if name is not None and name in taken:
            yield drive.says("torquer", f"{given(name)} has [[drive]] {taken[name]} already; write both in one table")
        elif name is not None:
            taken[name] = drive.place


def misplaced_drives(job: Job) -> Iterator[Mistake]:
    """Walk what does not fit the plant and the loops."""
    for k, drive in enumerate(job.drives):
        for key, words in _misfits(job, drive):
            yield Mistake(("drive", k, key), one_line(f"{key}: {words}"))


def _misfits(job: Job, drive: Drive) -> Iterator[tuple[str, str]]:
    platform = job.platform
    gimbals = {one.name: one.gimbal for one in platform.torquers if one.gimbal is not None}
    if drive.torquer not in gimbals:
        words = f"{given(drive.torquer)} is no torquer on a gimbal of the plant"
        yield "torquer", f"{words}; {suggestion(drive.torquer, gimbals)}"
        return
    gimbal = platform.gimbal(gimbals[drive.torquer])
    yield from _secant(platform, gimbal, drive)
    rates = [sensor.name for sensor in platform.rate_sensors]
    unknown = [name for name in drive.sensors if name not in rates]
    if unknown:
        yield "sensors", f"{given(unknown[0])} is no rate sensor of the plant; {suggestion(unknown[0], rates)}"
    elif drive.friction:
        yield from _friction(job, gimbal, drive)


def _secant(platform: Platform, gimbal: int, drive: Drive) -> Iterator[tuple[str, str]]:
    """Judge the angle that a gain follows: of a gimbal that the torquer's own one carries."""
    if drive.secant_of is None:
        return
    fitting = [name for name, of in angle_sensors(platform).items() if gimbal in _above(platform, of)]
    if drive.secant_of not in fitting:
        words = f"{given(drive.secant_of)} is no sensor of the angle of a gimbal that {platform.gimbal_names[gimbal]!r}"
        yield "secant_of", f"{words} carries; {suggestion(drive.secant_of, fitting)}"


def _above(platform: Platform, gimbal: int) -> list[int]:
    """Return the gimbals between the root and a gimbal."""
    out = []
    while (gimbal := int(platform.parents[gimbal])) >= 0:
        out.append(gimbal)
    return out


def _friction(job: Job, gimbal: int, drive: Drive) -> Iterator[tuple[str, str]]:
    """Judge friction that is fed forward: whether there is any, how much, and from which rate."""
    platform, name = job.platform, job.platform.gimbal_names[gimbal]
    there = max((max(*one.coulomb, *one.breakaway) for one in platform.frictions if one.gimbal == name), default=0.0)
    if there == 0.0:
        yield "friction", f"gimbal {name!r} has no dry friction; add coulomb to its [[friction]] in the plant"
    elif drive.friction > _MOST * there:
        words = f"{drive.friction:g} N m is {drive.friction / there:.3g} times the dry friction of gimbal {name!r}"
        yield "friction", f"{words}, {there:g} N m; give at most twice as much"
    try:
        law = drive_law(platform, drive)
    except ArgumentError as error:
        yield "sensors", str(error)
        return
    if not law.feedback and any(loop.kind == "stabilisation" for loop in job.loops):
        words = f"{', '.join(law.weights)} turn with {platform.root_name!r}, which a stabilisation loop moves"
        yield "sensors", f"{words}; use a sensor of the gimbal's rate against its parent"
