"""result.json: the result of a job as plain data, written whole or not at all, read again, and compared with a check.

No verdict rests on a file's claims: it may be older than the plant. But claims that are not confirmed are reported.
"""

from __future__ import annotations

import math
import os
import platform as interpreter
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Any

import numpy as np

from platform_ctrl import __version__
from platform_ctrl.analysis.dry_friction import FrictionBalance
from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.common.files import plain_types, write_json
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import Design, LoopOutcome
from platform_ctrl.errors import InputError
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.reading import data_hash, job_hashes
from platform_ctrl.job.resolve import Resolver
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Expected, Unfit, finite_number
from platform_ctrl.plant.mistakes import given, one_line
from platform_ctrl.plant.source import read_json
from platform_ctrl.verification.bounds import loop_bounds
from platform_ctrl.verification.budget_result import LineOfSightBudget, SimulatedBudget
from platform_ctrl.verification.coupled import CoupledCheck
from platform_ctrl.verification.proofs import Proofs
from platform_ctrl.verification.simulated import Run
from platform_ctrl.verification.verdict import JobResult

Record = dict[str, Any]
SCHEMA = 1
# States of a controller: what is checked of it takes time by their number's cube.
MOST_STATES = 1000


def result_record(result: JobResult, bounds: bool = True) -> Record:
    """Return the result of a job in plain types: the content of ``result.json``.

    `bounds`: with what bounds the bandwidth of each loop, which takes a second. Numbers that are not finite (the margin
    of an unstable loop, say) are None, ``null`` in the file.
    """
    job = result.job
    record = {
        "schema": SCHEMA,
        "platform": job.platform.name,
        "added": [part.name for part in job.platform.added],
        "job": job.name,
        "passed": result.passed,
        "assumptions": result.assumptions,
        "seed": job.seed,
        "sha256": job_hashes(job),
        "versions": versions(),
        "subsystems": result.subsystems,
        "controllers": [
            _controller(result, one.closed) | (_bounds(result, one) if bounds else {}) for one in result.loops
        ],
        "alternatives": [_controller(result, design) for outcome in result.loops for design in outcome.alternatives],
        "requirements": [_requirement(one) for one in result.requirements],
        "coupled": {"stable": None} if result.coupled is None else _coupled(result, result.coupled),
        "runs": [run_record(run) for run in result.runs],
    }
    if result.failed:
        record["failed"] = [
            {"name": one.loop, "design": one.name, "method": one.method, "reason": one.sentence}
            for one in result.failed
        ]
    if result.budget is not None:
        record["budget"] = budget_record(job, result.budget, result.simulated_budget)
    out: Record = plain_types(record)
    return out


def budget_record(
    job: Job,
    found: LineOfSightBudget,
    runs: SimulatedBudget | None = None,
    others: Mapping[str, LineOfSightBudget | None] | None = None,
) -> Record:
    """Return the budget of a job's line of sight in plain types, SI units; what ``budget --json`` prints."""
    assert job.budget is not None
    record = {
        "schema": SCHEMA,
        "platform": job.platform.name,
        "job": job.name,
        "passed": found.passed,
        "band_hz": [job.budget.from_hz, job.budget.to_hz],
        "axes": found.axes,
        "sources": [
            {"name": name, "kind": kind, "rms": rms, "share": share}
            for name, kind, rms, share in zip(found.names, found.kinds, found.rms, found.shares, strict=True)
        ],
        "total": {"rms": found.total, "across": found.jitter},
        "windows": [
            _fields(one, "exposure", "displacement", "smear", "jitter", "about_mean")
            | {
                "contrast": [
                    {"spatial_frequency": nu, "contrast": one.contrast[:, k]}
                    for k, nu in enumerate(job.budget.spatial_frequencies)
                ]
            }
            for one in found.windows
        ],
        "friction": _friction(found.friction),
        "requirements": [_requirement(one) for one in found.results],
    }
    if others:
        # Instead of the design that is closed; None where there is no budget.
        record["alternatives"] = [
            {"name": name, "rms": one and one.total, "across": one and one.jitter} for name, one in others.items()
        ]
    if runs is not None:
        numbers = ("runs", "seed", "time", "settle", "rms", "low", "high", "linear", "ratio", "left_out")
        record["simulated"] = _fields(runs, *numbers)
    out: Record = plain_types(record)
    return out


def _fields(item: object, *names: str) -> Record:
    return {name: getattr(item, name) for name in names}


def _friction(balance: FrictionBalance) -> list[Record]:
    columns = {
        "rate_rms": balance.rate,
        "viscous": balance.viscous,
        "fed": balance.fed,
        "remainder": balance.remainder,
        "sticking": balance.sticking,
        "valid": balance.valid > 0.0,
        "says": balance.statement,
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def run_record(run: Run) -> Record:
    """Return how a simulated run went, in plain types."""
    trajectory, manoeuvre = run.trajectory, run.manoeuvre
    record = _fields(manoeuvre, "name", "mode", "axis", "duration") | {
        "ended": trajectory.ended,
        "passed": all(one.passed for one in run.results),
        "largest": {name: {"value": number, "signal": signal} for name, (number, signal) in run.largest.items()},
        "saturated": dict(zip(trajectory.torquer_names, trajectory.saturated, strict=True)),
        "stop_contacts": dict(zip(trajectory.angle_names, trajectory.stop_contacts, strict=True)),
        "seed": trajectory.seed,
        "step": trajectory.step,
        "requirements": [_requirement(one) for one in run.results],
    }
    out: Record = plain_types(record)
    return out


def versions() -> dict[str, str]:
    """Return the versions of everything that the values depend on."""
    own = {"platform_ctrl": __version__, "python": interpreter.python_version()}
    used = ("numpy", "scipy", "control", "cvxpy", "clarabel", "numba")
    return own | {name: metadata.version(name) for name in used}


def write_record(record: Mapping[str, Any], path: str | os.PathLike[str]) -> Record:
    """Write `record` as JSON, whole or not at all: what was at `path` stays until the new file is complete.

    Returns what is written: `record` with the hash of its content under ``sha256``, beside those of plant and job.
    """
    written = {**record, "sha256": {**record.get("sha256", {}), "result": _content_hash(record)}}
    write_json(written, path)
    return written


def with_sections(record: Record, source: str | os.PathLike[str]) -> Record:
    """Return a record in which the controllers of a file that was checked keep the sections that it has of them."""
    data: Any = read_json(source, "a JSON file with controllers")[1]
    same = (*"ABCD", "inputs", "outputs")
    for key in ("controllers", "alternatives"):
        for K in record[key]:
            for one in data.get(key) or ():
                if all(one.get(name) == K[name] for name in same):
                    K["sections"] = one.get("sections", [])
    return record


def read_record(path: str | os.PathLike[str]) -> Record:
    """Return the content of a ``result.json`` as it was written; InputError where it is empty or was altered since."""
    label, data = read_json(path, "a result.json")
    JSONTable(label, data).value("schema", fields.SCHEMA)
    assert isinstance(data, dict)
    written = data.get("sha256")
    if not isinstance(written, dict) or "result" not in written or not data.get("requirements"):
        raise InputError(
            f"{label}: is no result of a job with its requirements; accept a file that design or check wrote"
        )
    if written["result"] != _content_hash(data):
        raise InputError(f"{label}: was altered after it was written; accept a file that design or check wrote")
    return data


def _content_hash(record: Mapping[str, Any]) -> str:
    hashes = {key: item for key, item in record.get("sha256", {}).items() if key != "result"}
    return data_hash({**record, "sha256": hashes})


def controller_record(K: StateSpace, job: Job) -> Record:
    """Return matrices, signals and times of a controller, and what turns its readings to joint axes."""
    *matrices, dt = System.of(K, "controller")
    signals: Record = {"inputs": list(K.input_labels), "outputs": list(K.output_labels)}
    for law in job.resolvers:
        if law.names[0] in K.input_labels:
            signals["resolve"] = resolve_record(law)
    return {"dt": dt, **dict(zip("ABCD", matrices, strict=True)), **signals, "delay": job.sampling.delay}


def _controller(result: JobResult, design: Design) -> Record:
    K, claims = design.controller, dict(design.claims)
    if design.measures is not None:
        claims |= {"disk_margin": design.measures.disk_margin[0], "damping": design.measures.damping[0]}
    return {
        "name": design.loop,
        "design": design.name,
        "method": design.method,
        **controller_record(K, result.job),
        "claims": claims,
        **_proofs(result.proofs.get((design.loop, design.name))),
        "options": design.options,
        "sections": [section.record() for section in design.sections],
        "goals": [_requirement(one) for one in design.goals],
    }


def _bounds(result: JobResult, outcome: LoopOutcome) -> Record:
    """Return what bounds the bandwidth of a loop; nothing where that is not known."""
    found = loop_bounds(result.job, outcome, result.inner(outcome))
    if found is None:
        return {}
    of = [_fields(one, "parameter", "sensitivity") for one in found.bounds]
    return {"bounds": {**_fields(found, "gain", "bandwidth", "requirement"), "of": of}}


def resolve_record(law: Resolver) -> Record:
    """Return what turns the readings of a controller to joint axes; the rest of it follows from the plant file."""
    names = ("sensors", "gimbals", "encoders", *(["base"] if law.base else []))
    return {name: list(getattr(law, name)) for name in names} | {"limit": law.limit}


def _proofs(proofs: Proofs | None) -> Record:
    """Return what is proved, and what is claimed without a proof; nothing where no proofs were asked for."""
    if proofs is None:
        return {}
    claims = [
        {"plant": one.plant, "claim": one.kind, "bound": one.bound, "proved": one.proved} for one in proofs.claims
    ]
    return {"certificates": {"proved": proofs.proved, "of": len(claims), "list": claims}}


def _requirement(result: CheckResult) -> Record:
    names = ("name", "subject", "design", "value", "limit", "unit", "sense", "margin", "passed", "stage")
    return _fields(result, *names, "method", "evidence")


def _coupled(result: JobResult, check: CoupledCheck) -> Record:
    keys = ("channel", "decoupled", "coupled", "cost", "torque_noise")
    values = (check.channels, check.decoupled, check.coupled, check.cost, check.torque_noise)
    simultaneous = check.simultaneous
    return {
        "stable": check.stable,
        "largest_pole_radius": np.abs(check.poles).max(initial=0.0),
        "simultaneous_disk_margin": {
            "lower": simultaneous.guaranteed,
            "upper": simultaneous.upper,
            "frequency": simultaneous.frequency,
        },
        "channels": list(check.channels),
        "loop_by_loop": [dict(zip(keys, row, strict=True)) for row in zip(*values, strict=True)],
        **_proofs(result.proofs.get(("", ""))),
    }


# Values of the same job, on another machine, agree to this.
_AGREE = 1e-6


def unconfirmed(source: str | os.PathLike[str] | Mapping[str, Any], result: JobResult) -> tuple[str, ...]:
    """Return a line for every claim of a ``result.json`` that `result`, made from its controllers, does not confirm.

    Compared are the values under ``claims`` that belong to the closed loop: ``disk_margin`` and ``damping``.
    """
    data: Any = source if isinstance(source, Mapping) else read_json(source, "a JSON file with controllers")[1]
    designs = [design for outcome in result.loops for design in outcome.designs if design.measures is not None]
    out: list[str] = []
    for entry in [*(data.get("controllers") or ()), *(data.get("alternatives") or ())]:
        claims = entry.get("claims")
        design = next((one for one in designs if _is_of(entry, one)), None)
        if design is None or design.measures is None or not isinstance(claims, Mapping):
            continue
        for name in ("disk_margin", "damping"):
            found = float(getattr(design.measures, name)[0])
            written = claims.get(name, found)
            number = math.inf if written is None and not math.isfinite(found) else finite_number(written)
            if number is None or not (number == math.inf or math.isclose(number, found, rel_tol=_AGREE, abs_tol=1e-12)):
                out.append(f"{design.loop}, {design.name}: {name} is written as {given(written)}; it is {found:.6g}")
    return tuple(out)


def _is_of(entry: Mapping[str, Any], design: Design) -> bool:
    """Return whether an entry of a file, which was read as a controller, has a design's matrices and outputs."""
    K = design.controller
    pairs = [(np.asarray(entry.get(name, ())), getattr(K, name)) for name in "ABCD"]
    same = all(np.array_equal(rows, M) or rows.size == M.size == 0 for rows, M in pairs)
    return same and entry.get("outputs") == list(K.output_labels)


def _list(item: object) -> list[Any]:
    if not isinstance(item, list):
        raise Unfit
    return item


_ROWS = Expected("a matrix as a list of rows", _list)
_SIGNALS = Expected(
    "a list of signal names", fields.where(lambda names: bool(names) and all(names), fields.NAMES.judge)
)


class JSONTable:
    """A table of a file, with its place for messages."""

    def __init__(self, where: str, data: object) -> None:
        if not isinstance(data, Mapping):
            raise InputError(f"{where} must be a table, got {given(data)}")
        self.where, self.data = where, data

    def mistake(self, text: str) -> InputError:
        """Return the error with `text` about this table."""
        return InputError(one_line(f"{self.where}: {text}"))

    def value(self, key: str, expected: Expected) -> Any:
        """Return what is under `key`, judged."""
        if key not in self.data:
            raise self.mistake(f'the key "{key}" is missing; it must be {expected.words}')
        try:
            return expected.judge(self.data[key])
        except Unfit as error:
            why = f" ({error})" if str(error) else ""
            raise self.mistake(f"{key} must be {expected.words}, got {given(self.data[key])}{why}") from None

    def names(self, key: str) -> tuple[str, ...]:
        """Return signal names, each once."""
        out: tuple[str, ...] = self.value(key, _SIGNALS)
        return out

    def arrays(self, inputs: int, outputs: int, dt: float) -> System:
        """Return the matrices A to D of a system with so many signals."""
        rows = self.value("A", _ROWS)
        order = 0 if rows == [[]] else len(rows)
        if order > MOST_STATES:
            raise self.mistake(f"A: has {order} rows; at most {MOST_STATES} states are allowed")
        return System(
            A=self._matrix("A", order, order),
            B=self._matrix("B", order, inputs),
            C=self._matrix("C", outputs, order),
            D=self._matrix("D", outputs, inputs),
            dt=dt,
        )

    def _matrix(self, key: str, rows: int, columns: int) -> FloatArray:
        item = self.value(key, _ROWS)
        expected = f"{key} must be {rows} x {columns}" + (" (square)" if key == "A" else " (by inputs, outputs and A)")
        if rows * columns == 0 and all(row == [] for row in item):
            return np.zeros((rows, columns))
        if len(item) != rows:
            raise self.mistake(f"{expected}, has {len(item)} row{'' if len(item) == 1 else 's'}")
        out = np.zeros((rows, columns))
        for i, row in enumerate(item):
            try:
                out[i] = fields.numbers(row, columns, fields.finite)
            except Unfit as error:
                raise self.mistake(f"{expected}, row {i + 1} {str(error) or f'is {given(row)}'}") from None
        return out

    def tables(self, key: str, what: str) -> Iterator[JSONTable]:
        """Yield a list of tables."""
        for number, entry in enumerate(self.value(key, Expected(f"a list of {what}", _list)), 1):
            name = entry.get("name", entry.get("loop")) if isinstance(entry, Mapping) else None
            title = f" {given(name)}" if isinstance(name, str) else ""
            yield JSONTable(f"{self.where}: {key} {number}{title}", entry)
