"""The controllers to be written, in any form, checked against the job."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.common.signatures import short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.classical.caging import Stage
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.export.c99.scheme import Section, row
from platform_ctrl.job.job import Job
from platform_ctrl.verification.controllers import read_controllers
from platform_ctrl.verification.json_tables import SCHEMA

if TYPE_CHECKING:
    import control

# Prefix of the inputs of `design.anti_windup` through which the excess of a torque acts on the states.
_EXCESS = "excess_"


@value
class Entry:
    """A controller of a job."""

    # loop, design, method: As in the job file; empty where nothing is known
    loop: str
    design: str = ""
    method: str = ""
    arrays: StateArrays  # x⁺ = A x + B y, u = C x + D y; dt is the sample period, s
    # inputs, outputs: Names of the signals
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    # The method's numbers as finally used, in the units of the job file
    options: dict[str, float] = field(default_factory=dict)
    excess: FloatArray | None = None  # (n, m): E of the anti-windup of the controller, or None


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
    gimbals = {torquer.name: torquer.gimbal for torquer in job.platform.torquers}
    acted_on = {gimbals.get(name) for name in outputs}
    for spec in job.loops:
        if acted_on == (set(spec.gimbals) if spec.kind == "caging" else {None}):
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
