"""Limits that nothing in the job puts to the test: they would be met whatever the loops do, which is a mistake."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.job.faults import FAULT_KINDS, Fault
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.manoeuvre import Manoeuvre
from platform_ctrl.job.requirements import limit_keys
from platform_ctrl.job.scenario import TimeTable
from platform_ctrl.plant.fields import ROUNDING
from platform_ctrl.plant.flexible import MODE_NUMBERS
from platform_ctrl.plant.mistakes import Misfit, Mistake, Path, at, strange, useless, within
from platform_ctrl.plant.platform import OMEGA_NAMES

# Samples behind `settle` at least.
_FEWEST_SAMPLES = 20
# What is not larger counts as zero: rad, rad/s, m/s², N m; noise and torques of small instruments are larger still.
_NOTHING, _SILENT = 1e-9, 1e-15
# Limits of runs that are means over the time behind `settle`.
_MEANS = ("los_angle_rms", "los_rate_rms", "attenuation_db")


def unexercised(job: Job) -> Iterator[Mistake]:
    """Yield the limits of a job that nothing in the job tests."""
    yield from at(("uncertainty",), _of_modes(job))
    for i, spec in enumerate(job.loops):
        for table, limits in (("limits", spec.limits), ("soft", spec.soft)):
            yield from at(("loop", i, table), _of_loop(job, spec, limits))
    for k, manoeuvre in enumerate(job.manoeuvres):
        yield from at(("manoeuvre", k), _of_run(job, manoeuvre))


def _of_modes(job: Job) -> Iterator[Misfit]:
    """Yield uncertain numbers of modes that the plant does not have."""
    modes, drives = [m.name for m in job.platform.modes], [one.gimbal for one in job.platform.compliances]
    for what in MODE_NUMBERS:
        key, known = f"mode_{what}", modes if what == "participation" else [*modes, *drives]
        width, none = (
            getattr(job.uncertainty, key),
            "[[mode]]" if what == "participation" else "[[mode]] or [[compliance]]",
        )
        if isinstance(width, Mapping):
            yield from strange(key, width, "mode of the plant, nor a gimbal with a drive that gives way", known)
        elif width > 0.0 and not known:
            yield useless(job.uncertainty, key, f"without a {none} in the plant")


def _of_loop(job: Job, spec: LoopSpec, limits: dict[str, float]) -> Iterator[Misfit]:
    known = limit_keys()
    for key in limits:
        kind, scope = known.get(key, ("", ""))
        if not kind or scope in ("hz", "from_hz"):
            continue
        if "Omega" in METRICS[kind].disturbed_by and spec.moves_root(job.platform):
            words = f"{key} is about a prescribed rate of {job.platform.root_name!r}, which this loop moves"
            yield key, f"{words}; use torque_rejection, or a manoeuvre with a torque on it"
        elif "Omega" in METRICS[kind].disturbed_by and not np.any(job.Omega > _NOTHING):
            words = f"{key} is about the platform's rate, and Omega = [0, 0, 0]: the platform never turns"
            yield key, f"{words}; state how fast it turns in [operation], or leave the limit out"
        if kind == "torque limit":
            endless = {one.name for one in job.platform.torquers if one.limit is None}
            yield from _without_limit([name for name in job.channels_of(spec) if name in endless], key)
        if kind == "torque noise" and not _noisy(job, spec):
            words = f"{key} cannot be missed: no sensor of this loop has noise"
            yield key, f"{words}; state noise_rms or noise_density in the plant, or leave the limit out"
        if scope == "worst_case" and METRICS[kind].of != "controller" and not _varied(job, spec):
            words = f"{key} needs plants that differ"
            yield key, f"{words}; state [uncertainty], or angles in [operation], or use {METRICS[kind].key}"


def _without_limit(names: list[str], key: str) -> Iterator[Misfit]:
    if names:
        words = f"{key} does not count torquer {', '.join(names)}, which the plant gives no limit"
        yield key, f"{words}; state its limit in the plant, or leave this one out"


def _noisy(job: Job, spec: LoopSpec) -> bool:
    """Return whether a sensor that a loop reads has noise."""
    if spec.kind == "stabilisation":
        return any(one.noise_rms > _SILENT for one in job.platform.sensors)
    read = {
        *spec.sensors,
        *spec.resolve_base,
        *job.readings_of(spec),
        *(name for one in spec.designs for name in job.read_in(spec, one)),
    }
    return any(one.noise_rms > _SILENT for one in job.platform.sensors if one.name in read)


def _varied(job: Job, spec: LoopSpec) -> bool:
    """Return whether a loop has other plants than the nominal one in which nothing has failed."""
    gimbals = spec.gimbals
    if spec.kind == "tracking":
        gimbals = next((one.gimbals for one in job.loops if one.name == spec.around), ())
    spun = job.uncertainty.spin > _NOTHING and any(one.carrier in gimbals for one in job.platform.rotors)
    turned = np.any(job.Omega > _NOTHING) and (
        spec.kind == "caging"
        or (spec.moves_root(job.platform) and not job.platform.root_attitudes.isdisjoint(spec.sensors))
        or job.platform.dry_frictions
    )
    tilted = any(np.abs(q).max(initial=0.0) > _NOTHING for q in job.trims)
    widths = [getattr(job.uncertainty, f"mode_{what}") for what in MODE_NUMBERS]
    swings = any(max(one.values()) if isinstance(one, Mapping) else one for one in widths)
    return bool(job.uncertainty.inertia > _NOTHING or spun or swings or turned or tilted)


def _of_run(job: Job, manoeuvre: Manoeuvre) -> Iterator[Misfit]:
    yield from _after_the_end(job, manoeuvre)
    yield from _window(job, manoeuvre)
    limits = manoeuvre.limits
    if manoeuvre.initial and not any(abs(one) > _NOTHING for one in manoeuvre.initial.values()):
        words = "initial: all of it is zero, where a run starts anyway; give other numbers, or leave it out"
        yield "initial", words
    if "torque_share" in limits:
        used = {name for spec in job.loops for name in job.channels_of(spec)}
        free = manoeuvre.mode == "stabilised"
        lacking = [
            one.name
            for one in job.platform.torquers
            if one.name in used and one.limit is None and (free or one.gimbal is not None)
        ]
        yield from within(("limits",), _without_limit(lacking, "torque_share"))
    if "attenuation_db" in limits and not _turns(manoeuvre):
        words = "attenuation_db: the base does not turn in this manoeuvre"
        yield ("limits", "attenuation_db"), f"{words}; give rate, Omega_table, or a sine or vibration of it"
    if "attitude" in limits and manoeuvre.mode == "caged":
        words = "attitude: how a caged platform turns is prescribed, no loop has a part in it"
        yield ("limits", "attitude"), f'{words}; leave the limit out, or use mode = "stabilised"'


def _turns(manoeuvre: Manoeuvre) -> bool:
    """Return whether the platform of a caged manoeuvre turns before its end."""
    shaken = "rate" in {*(one.kind for one in manoeuvre.vibrations), *(one.kind for one in manoeuvre.sines)}
    table = manoeuvre.Omega_table
    return abs(manoeuvre.rate) > _NOTHING or shaken or (table is not None and _acts(table, manoeuvre.duration))


def _acts(table: TimeTable, duration: float, least: float = 0.0) -> bool:
    """Return whether a table is not zero all the time until the end of a run, or but for less than `least` s."""
    knots = np.unique(np.concatenate([[0.0], np.clip(table.t, 0.0, duration), [duration * (1.0 - ROUNDING)]]))
    large = np.abs(table.at(knots)).max(axis=1) > _NOTHING
    return bool(np.sum(np.diff(knots)[large[1:] | large[:-1]]) > least)


def _after_the_end(job: Job, manoeuvre: Manoeuvre) -> Iterator[Misfit]:
    """Yield what would happen after the end of a run, or does nothing before it."""
    duration, sample = manoeuvre.duration, job.sampling.period * (1.0 - ROUNDING)
    end = f"before the run ends, at {duration:.6g} s"
    sizes: dict[Path, float] = {("sine", k): one.amplitude for k, one in enumerate(manoeuvre.sines)}
    sizes |= {("vibration", k): one.amplitudes[1].max() for k, one in enumerate(manoeuvre.vibrations)}
    sizes |= {("rate",): manoeuvre.rate or 1.0, ("torque",): manoeuvre.torque or 1.0}
    for keys, size in sizes.items():
        if abs(size) <= _NOTHING:
            yield keys, f"{keys[0]}: {size:.3g} is next to nothing; give a larger one, or leave it out"
    for key, table, columns in (
        ("Omega_table", manoeuvre.Omega_table, OMEGA_NAMES),
        ("torque_table", manoeuvre.torque_table, ("M1", "M2", "M3")),
    ):
        if table is not None and not _acts(table, duration, sample):
            words = f"{key}: {', '.join(columns)} stay zero {end}"
            yield key, f"{words}; give times in s within the run, or a longer duration"
    for k, command in enumerate(manoeuvre.commands):
        later = command.at < duration - sample and (abs(command.step) > _NOTHING or abs(command.ramp) > _NOTHING)
        moved = later or abs(command.amplitude) > _NOTHING
        if not (moved or command.t):
            words = f"command of {command.reading} stays zero {end}; give a larger or an earlier one, or leave it out"
            yield ("command", k), words
        if command.t:
            values = np.array([command.value, command.value, command.value]).T
            table = TimeTable(t=np.array(command.t), values=values, smooth=command.smooth)
            if not (moved or _acts(table, duration, sample)):
                words = f"value stays zero {end}; give times in s within the run, or a longer duration"
                yield ("command", k, "value"), words
    events = {one.name: one for one in job.fault_events}
    for name in manoeuvre.faults:
        if name not in events:
            continue
        event, last = events[name], min(events[name].until, duration)
        if event.at >= duration - sample:
            words = f"faults: {name!r} happens at {event.at:.6g} s, and not {end}"
            yield "faults", f"{words}; choose an earlier time, or a longer duration"
        elif event.until - event.at < sample:
            words = f"faults: {name!r} lasts {event.until - event.at:.3g} s, less than a sample"
            yield "faults", f"{words}; choose a later until, or leave it out"
        elif _harmless(event, last - event.at, job.sampling.period):
            words = f"faults: {name!r} changes nothing with its numbers"
            yield "faults", f"{words}; give others, or leave it out"


def _harmless(fault: Fault, lasting: float, period: float) -> bool:
    """Return whether a fault that lasts so long, s, changes next to nothing."""
    keys = FAULT_KINDS[fault.kind].keys
    return (
        ("share" in keys and abs(fault.share - 1.0) <= _NOTHING)
        or ("amplitude" in keys and fault.amplitude <= _NOTHING)
        or ("rate" in keys and abs(fault.rate) * lasting <= _NOTHING)
        or ("impulse" in keys and abs(fault.impulse) <= _NOTHING)
        or ("probability" in keys and fault.probability * lasting < period)
    )


def _window(job: Job, manoeuvre: Manoeuvre) -> Iterator[Misfit]:
    """Yield means over too short a time, and sines that samples see at one phase alone."""
    if not set(manoeuvre.limits) & {*_MEANS, "angle_following_error", "rate_following_error"}:
        return
    rate, left = 1.0 / job.sampling.period, manoeuvre.duration - manoeuvre.settle
    if left * rate < _FEWEST_SAMPLES * (1.0 - ROUNDING):
        words = f"settle leaves {max(left, 0.0):.3g} s of the run, less than {_FEWEST_SAMPLES} samples"
        yield "settle", f"{words}; choose an earlier time, or a longer duration"
        return
    for k, sine in enumerate(manoeuvre.sines):
        f, own = sine.frequency_hz, ("sine", k, "frequency_hz")
        half = round(2.0 * f / rate)
        beat = abs(f - 0.5 * rate * half)
        if beat * left >= 1.0 - ROUNDING:
            continue
        if half:
            words = f"frequency_hz = {f:g}: samples at {rate:g} Hz see it at one and the same phase"
            yield own, f"{words}, so that the run does not show it; choose another frequency"
        else:
            words = f"frequency_hz = {f:g}: behind settle there are {left:.3g} s, less than a period of it"
            yield own, f"{words}; choose a longer duration"
