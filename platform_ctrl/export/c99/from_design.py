"""The schemes of a job's controllers: blocks of the design where they give the same matrices, otherwise modes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.classical.caging import Stage, classical_diagram
from platform_ctrl.design.classical.stabilisation import rate_estimate, servo_diagram
from platform_ctrl.design.loop_signals import loop_signals
from platform_ctrl.design.partition import channels
from platform_ctrl.errors import ArgumentError, InputError, NotCertifiedError, PlatformCtrlError
from platform_ctrl.export.c99.modes import modal_sections, pid_sections, plain_sections
from platform_ctrl.export.c99.scheme import Entry, Provenance, Scheme, Section, arrays, row
from platform_ctrl.export.systems import signal_units
from platform_ctrl.job.job import Job
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.plant.platform import Platform
from platform_ctrl.verification.controllers import read_controllers
from platform_ctrl.verification.json_tables import SCHEMA

if TYPE_CHECKING:
    import control

# How far a scheme's matrices and response may be from those of the controller: rounding of a few operations.
_SAME_MATRICES = 1e-11
_SAME_RESPONSE = 1e-8
_FREQUENCIES = 240
# Largest number of states of a controller that is split into modes: the time grows with the fourth power.
_MOST = 400
# Prefix of the inputs of `design.anti_windup` through which the excess of a torque acts on the states.
_EXCESS = "excess_"


def scheme_of(job: Job, entry: Entry, **origin: Any) -> Scheme:
    """Return a controller written out in sections; `origin` are further fields of its provenance."""
    units = signal_units(job.platform)
    limits = {t.name: np.inf if t.limit is None else float(t.limit) for t in job.platform.torquers}
    provenance = Provenance(
        job=job.name, plant=job.platform.name, loop=entry.loop, design=entry.design, method=entry.method, **origin
    )

    def scheme(sections: tuple[Section, ...]) -> Scheme:
        return Scheme(
            name=entry.loop,
            inputs=entry.inputs,
            input_units=tuple(units[name] for name in entry.inputs),
            outputs=entry.outputs,
            output_units=tuple(units[name] for name in entry.outputs),
            sections=sections,
            # What commands another loop has no limit.
            torque_limits=tuple(limits.get(name, np.inf) for name in entry.outputs),
            period=entry.arrays.dt,
            delay=job.sampling.delay,
            provenance=provenance,
        )

    for blocks in (_classical, _servo, _pid):
        try:
            with np.errstate(all="ignore"):
                sections = blocks(job, entry, linearise(job.platform))
                made = None if sections is None else scheme(sections)
                if made is not None and _is_controller(arrays(made), entry.arrays):
                    return made if entry.excess is None else with_excess(made, entry.excess)
        except (PlatformCtrlError, KeyError, ArithmeticError, ValueError):
            # Options of another plant, of another version, or nonsense: the modes describe the controller as well.
            continue
    for form in (modal_sections, plain_sections) if len(entry.arrays.A) <= _MOST else (plain_sections,):
        written, T = form(entry)
        made = scheme(written)
        if same_response(arrays(made), entry.arrays):
            return (
                made
                if entry.excess is None
                else with_excess(made, np.asarray(np.linalg.solve(T, entry.excess), np.float64))
            )
    raise NotCertifiedError(
        f"controller {entry.loop!r}: rounding changes its response when it is written in sections; give it in "
        "balanced states",
        entry,
    )


def with_excess(scheme: Scheme, gain: FloatArray) -> Scheme:
    """Return the scheme with the anti-windup gain E (states, outputs) of x⁺ = A x + B y + E (limited u − u)."""
    rows = (row(state, weights, scheme.outputs) for state, weights in zip(scheme.states, gain, strict=True))
    return dataclasses.replace(scheme, excess=tuple(one for one in rows if one.terms))


def _is_controller(made: StateArrays, given: StateArrays) -> bool:
    """Return whether matrices are those of the controller up to rounding, and so the response; NaN is not."""
    return same_response(made, given) and all(
        a.shape == b.shape and np.all(np.abs(a - b) <= _SAME_MATRICES * np.abs(b).max(initial=0.0))
        for a, b in zip(made[:4], given[:4], strict=True)
    )


def same_response(one: StateArrays, other: StateArrays) -> bool:
    """Return whether two controllers have the same frequency response up to rounding."""
    T = other.dt
    angles = np.abs(np.angle(np.linalg.eigvals(other.A)))
    # Finer near each pole, so that no resonance is missed.
    near = np.concatenate([angles * (1.0 + 10.0**-k) for k in range(2, 7)]) if len(angles) else angles
    grid = np.concatenate([np.geomspace(1e-6, np.pi, _FREQUENCIES), np.linspace(0.01, np.pi, _FREQUENCIES), near])
    frequency = np.unique(grid[(grid >= 1e-6) & (grid <= np.pi)]) / T
    a, b = (frequency_response(StateArrays(*item[:4], T), frequency, -3) for item in (one, other))
    # Squares of large or small numbers would overflow or vanish.
    largest = np.abs(b).max(initial=0.0)
    if largest > 0.0:
        a, b = a / largest, b / largest
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        return False
    size = np.linalg.norm(b, axis=(1, 2))
    return bool(
        np.all(np.linalg.norm(a - b, axis=(1, 2)) <= _SAME_RESPONSE * np.maximum(size, 1e-12 * size.max(initial=0.0)))
    )


def _classical(job: Job, entry: Entry, model: LinearModel) -> tuple[Section, ...] | None:
    found = _gimbals(job, entry)
    if found is None or not {"lead_hz", "inertial_lead_hz"} & set(entry.options):
        return None
    gimbals, angles = found
    channel = channels(model, rows_of(model, gimbals))
    return sections_of(classical_diagram(entry.options, channel, entry.arrays.dt, angles, entry.outputs))


def _servo(job: Job, entry: Entry, model: LinearModel) -> tuple[Section, ...] | None:
    if not {"filter_hz", "filter_damping", "crossover_hz", "position_hz"} <= set(entry.options):
        return None
    _, used = rate_estimate(model)
    torquers = {t.gimbal: t.name for t in job.platform.torquers if t.gimbal is not None}
    roots = {t.root_axis: t.name for t in job.platform.torquers if t.root_axis is not None}
    torques = [torquers[model.gimbal_names[k]] for k in used]
    return sections_of(
        servo_diagram(entry.options, model, entry.arrays.dt, torques, [roots[axis] for axis in (1, 2, 3)])
    )


def _pid(job: Job, entry: Entry, model: LinearModel) -> tuple[Section, ...] | None:
    found = _gimbals(job, entry)
    if found is None:
        return None
    gimbals, angles = found
    return pid_sections(entry, channels(model, rows_of(model, gimbals)), angles)


def _gimbals(job: Job, entry: Entry) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Return the gimbals that the outputs act on and the angles that belong to them, if the inputs are just these."""
    platform: Platform = job.platform
    on = {t.name: t.gimbal for t in platform.torquers}
    gimbals = tuple(str(on.get(name)) for name in entry.outputs)
    sensed = {p.gimbal: p.name for p in platform.pickoffs}
    angles = tuple(sensed.get(gimbal, "") for gimbal in gimbals)
    return (gimbals, angles) if set(angles) == set(entry.inputs) and len(angles) == len(entry.inputs) else None


def entries_of(job: Job, given: Sequence[Mapping[str, Any] | control.StateSpace]) -> tuple[Entry, ...]:
    """Return the controllers of a job, checked against it.

    Each is an entry of ``controllers`` in ``result.json``, or a `control.StateSpace` with ``dt`` and signal names
    (also one of `design.anti_windup`, with its inputs ``excess_``), in order of evaluation.
    """
    if isinstance(given, Mapping | str) or not isinstance(given, Sequence):
        raise ArgumentError(f"entries: must be a list of controllers, got {short(given)}")
    records = [one if isinstance(one, Mapping) else _record(one, job) for one in given]
    plain, excess = zip(*(_without_excess(one) for one in records), strict=True) if records else ((), ())
    checked = read_controllers({"schema": SCHEMA, "controllers": list(plain)}, job)
    return tuple(
        Entry(
            loop=str(record["name"]),
            design=_text(record, "design"),
            method=_text(record, "method"),
            arrays=state_arrays(K, "controller"),
            inputs=tuple(K.input_labels),
            outputs=tuple(K.output_labels),
            options=_numbers(record.get("options")),
            excess=E,
        )
        for record, K, E in zip(plain, checked, excess, strict=True)
    )


def _record(K: control.StateSpace, job: Job) -> dict[str, Any]:
    arrays = state_arrays(K, "controller")
    loop, _, design = str(K.name).partition(", ")
    if loop not in {spec.name for spec in job.loops}:
        # A name from python-control or the user: the loop follows from the torques.
        loop, design = _closed_by(job, tuple(K.output_labels)) or str(K.name), ""
    return {
        "name": loop,
        "design": design,
        "dt": arrays.dt,
        **{name: item.tolist() for name, item in zip("ABCD", arrays[:4], strict=True)},
        "inputs": list(K.input_labels),
        "outputs": list(K.output_labels),
        "delay": job.sampling.delay,
    }


def _closed_by(job: Job, outputs: tuple[str, ...]) -> str | None:
    """Return the name of the loop whose torques these are."""
    roots = {torquer.name for torquer in job.platform.torquers if torquer.gimbal is None}
    for spec in job.loops:
        own = {one.name for one in loop_signals(job.platform, spec).torquers} if spec.has_plants else roots
        if set(outputs) == own:
            return spec.name
    return None


def _without_excess(record: Mapping[str, Any]) -> tuple[Mapping[str, Any], FloatArray | None]:
    """Split a controller from the inputs through which anti-windup acts."""
    inputs, outputs = record.get("inputs"), record.get("outputs")
    if not isinstance(inputs, list) or not isinstance(outputs, list):
        return record, None
    added = [f"{_EXCESS}{name}" for name in outputs]
    count = len(inputs) - len(added)
    if count <= 0 or inputs[count:] != added:
        return record, None
    try:
        B, D = (np.array(record[name], dtype=np.float64) for name in "BD")
        into, through = B[:, count:], D[:, count:]
    except (KeyError, TypeError, ValueError, IndexError):
        return record, None
    if through.any():
        raise InputError(
            f"controller {record.get('name')!r}: the excess of a torque acts on an output of the same step; it may act "
            "on states only"
        )
    plain = {"inputs": inputs[:count], "B": B[:, :count].tolist(), "D": D[:, :count].tolist()}
    return {**record, **plain}, into


def _text(record: Mapping[str, Any], key: str) -> str:
    item = record.get(key)
    return item if isinstance(item, str) else ""


def _numbers(item: object) -> dict[str, float]:
    if not isinstance(item, Mapping):
        return {}
    return {str(name): float(x) for name, x in item.items() if isinstance(x, int | float) and not isinstance(x, bool)}


# Names of the coefficients of a block with one or two states.
_POLES = {1: (("pole",),), 2: (("a1", "a2"), ("shift", "none"))}
_SHOWN = {1: ("c",), 2: ("c1", "c2")}


def sections_of(stages: Iterable[Stage]) -> tuple[Section, ...]:
    """Return the sections of a block diagram; stages with states have one input and one output."""
    return tuple(_section(stage) for stage in stages)


def _section(stage: Stage) -> Section:
    A, B, C, D, _ = stage.block
    n = len(A)
    states = [f"{stage.name}_x{k + 1}" if n > 1 else f"{stage.name}_x" for k in range(n)]
    sources = [*stage.inputs, *states]
    through = ("direct",) if n else [""] * len(stage.inputs)
    return Section(
        name=stage.name,
        kind=stage.kind,
        note=stage.note,
        signals=tuple(
            row(target, np.concatenate([D[k], C[k]]), sources, [*through, *_SHOWN.get(n, ())])
            for k, target in enumerate(stage.outputs)
        ),
        states=tuple(
            row(target, np.concatenate([B[k], A[k]]), sources, ["drive", *_POLES[n][k]])
            for k, target in enumerate(states)
        ),
    )
