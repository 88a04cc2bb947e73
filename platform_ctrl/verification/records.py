"""result.json: what a job came to as plain data, written whole or not at all."""

from __future__ import annotations

import os
import platform as interpreter
from collections.abc import Mapping
from importlib import metadata
from typing import Any

import numpy as np

from platform_ctrl import __version__
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.certificate import Verification
from platform_ctrl.common.json_text import plain_types, write_json
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.job.job import Job
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.verification.coupled import CoupledCheck
from platform_ctrl.verification.simulated import Run, largest
from platform_ctrl.verification.verdict import JobResult, Proofs

SCHEMA = 1

Record = dict[str, Any]


@check_arguments
def result_record(result: JobResult) -> Record:
    """Return what a job came to in plain types: the content of ``result.json``.

    Numbers that are not finite (the margin of an unstable loop, say) are None, ``null`` in the file.
    """
    job = result.job
    record = {
        "schema": SCHEMA,
        "platform": job.platform.name,
        "added": [part.name for part in job.platform.added],
        "job": job.name,
        "passed": result.passed,
        "seed": job.seed,
        "versions": versions(),
        "subsystems": result.subsystems,
        "controllers": [_controller(result, outcome.closed) for outcome in result.loops],
        "alternatives": [_controller(result, design) for outcome in result.loops for design in outcome.alternatives],
        "requirements": [_requirement(one) for one in result.requirements],
        "coupled": _coupled(result.coupled) | {"certificates": _certificates(result.proofs["", ""])},
        "runs": [run_record(job, run) for run in result.runs],
    }
    out: Record = plain_types(record)
    return out


def run_record(job: Job, run: Run) -> Record:
    """Return how a simulated run went, in plain types."""
    trajectory, manoeuvre = run.trajectory, run.manoeuvre
    record = {
        "name": manoeuvre.name,
        "mode": manoeuvre.mode,
        "axis": manoeuvre.axis,
        "duration": manoeuvre.duration,
        "ended": trajectory.ended,
        "passed": all(one.passed for one in run.results),
        "largest": {
            name: {"value": figure, "signal": signal} for name, (figure, signal) in largest(job, trajectory).items()
        },
        "saturated": dict(zip(trajectory.torquer_names, trajectory.saturated, strict=True)),
        "stop_contacts": dict(zip(trajectory.angle_names, trajectory.stop_contacts, strict=True)),
        "seed": trajectory.seed,
        "step": trajectory.step,
        "requirements": [_requirement(one) for one in run.results],
    }
    out: Record = plain_types(record)
    return out


def versions() -> dict[str, str]:
    """Return the versions of everything that the figures depend on."""
    own = {"platform_ctrl": __version__, "python": interpreter.python_version()}
    used = ("numpy", "scipy", "control", "cvxpy", "clarabel", "numba", "python-flint")
    return own | {name: metadata.version(name) for name in used}


@check_arguments
def write_record(record: Mapping[str, Any], path: str | os.PathLike[str]) -> None:
    """Write `record` as JSON, whole or not at all: what stood at `path` stays until the new file is complete."""
    write_json(record, path)


def _controller(result: JobResult, design: LoopDesign) -> Record:
    K, claims = design.controller, dict(design.claims)
    if design.measures is not None:
        claims |= {"disk_margin": design.measures.disk_margin[0], "damping": design.measures.damping[0]}
    return {
        "name": design.loop,
        "design": design.name,
        "method": design.method,
        "dt": float(K.dt),
        **{name: np.asarray(getattr(K, name), dtype=np.float64) for name in "ABCD"},
        "inputs": list(K.input_labels),
        "outputs": list(K.output_labels),
        "delay": result.job.sampling.delay,
        "claims": claims,
        "certificates": _certificates(result.proofs[design.loop, design.name]),
        "options": design.options,
        "goals": [_requirement(one) for one in design.goals],
    }


def _certificates(proofs: Proofs) -> Record:
    """Return all claims, and of the first plant, the nominal one, what proves them: its matrices and every X."""
    out: Record = {"proved": proofs.proved, "of": proofs.of, "unproved": proofs.unproved}
    if proofs.certificates:
        first = proofs.certificates[0].loops[0]
        out["plant"] = {name: getattr(first, name) for name in "ABCD"}
    out["list"] = []
    for certificate, found in zip(proofs.certificates, proofs.verifications, strict=True):
        label = certificate.loops[0].label
        out["list"].append(_certificate(certificate, found, matrices=label.partition(", ")[0] == first.label))
    return out


def _certificate(certificate: Certificate, found: Verification, matrices: bool) -> Record:
    out: Record = {
        "label": certificate.loops[0].label,
        "claim": certificate.claim,
        "bound": certificate.bound,
        "proved": found.proved,
        "margin": found.margin,
    }
    if matrices:
        out["X"] = certificate.X
        out |= {} if certificate.coordinates is None else {"coordinates": certificate.coordinates}
    return out


def _requirement(result: CheckResult) -> Record:
    names = ("name", "subject", "design", "value", "limit", "unit", "sense", "margin", "passed", "stage")
    return {name: getattr(result, name) for name in (*names, "method", "evidence")}


def _coupled(check: CoupledCheck) -> Record:
    figures = zip(check.channels, check.decoupled, check.coupled, check.cost, check.torque_noise, strict=True)
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
        "loop_by_loop": [
            {"channel": name, "decoupled": alone, "coupled": together, "cost": cost, "torque_noise": noise}
            for name, alone, together, cost, noise in figures
        ],
    }
