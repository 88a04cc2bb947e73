"""The certificates of a job: what is not proved fails it."""

from __future__ import annotations

import copy
import dataclasses
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.closed_loop import closed
from platform_ctrl.analysis.certificates.plant_set import sensitivity_plants
from platform_ctrl.design import loops
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.errors import NotCertifiedError
from platform_ctrl.verification import check_job
from platform_ctrl.verification.records import result_record, unconfirmed
from platform_ctrl.verification.verdict import coupled_proofs


@pytest.fixture(scope="module")
def small() -> tuple[Any, tuple[LoopOutcome, ...]]:
    """One loop of the main job, without uncertainty and manoeuvres."""
    data = tomllib.loads(Path("examples/three_gyro_platform.toml").read_text(encoding="utf-8"))
    for name in ("uncertainty", "operation", "coupled", "manoeuvre", "fault", "campaign"):
        data.pop(name, None)
    [loop] = [loop for loop in data["loop"] if loop["name"] == "caging 9-10"]
    loop |= {
        "use": "plain",
        "limits": {"disk_margin": 0.3},
        "design": [{"name": "plain", "method": "classical", "crossover_hz": 40, "integral_hz": 2}],
    }
    job = pc.read_job(data | {"loop": [loop], "operation": {"Omega": [0.0, 0.0, 0.0]}})
    return job, loops(job)


def with_certificates(outcome: LoopOutcome, **change: Any) -> LoopOutcome:
    return dataclasses.replace(outcome, designs=(dataclasses.replace(outcome.designs[0], **change),))


def test_a_forged_certificate_of_a_closed_design_fails_the_job(small: tuple[Any, tuple[LoopOutcome, ...]]) -> None:
    job, (outcome,) = small
    honest = check_job(job, [outcome])
    assert honest.passed
    first, *others = outcome.closed.certificates
    forged = dataclasses.replace(first, X=first.X - 2 * first.X.min() * np.eye(len(first.X)) - first.X.max())
    boast = dataclasses.replace(others[-1], bound=0.9 * others[-1].bound)
    for bad in ([forged, *others], [first, *others[:-1], boast]):
        result = check_job(job, [with_certificates(outcome, certificates=tuple(bad))])
        assert not result.passed
        [missed] = [one for one in result.requirements if not one.passed]
        assert (missed.name, missed.subject) == ("certified properties", "caging 9-10")
        assert missed.value == pytest.approx(1 - 1 / len(bad))
        assert "is not positive definite" in missed.evidence
    silent = check_job(job, [with_certificates(outcome, unproved=("no proof that it is fast",))])
    assert not silent.passed
    assert "no proof that it is fast" in [one.evidence for one in silent.requirements if not one.passed]


def test_certificates_of_another_controller_prove_nothing_of_a_design(
    small: tuple[Any, tuple[LoopOutcome, ...]],
) -> None:
    job, (outcome,) = small
    K = outcome.closed.controller
    other = control.StateSpace(
        K.A, K.B, 1.001 * K.C, K.D, K.dt, inputs=K.input_labels, outputs=K.output_labels, remove_useless_states=False
    )
    result = check_job(job, [with_certificates(outcome, controller=other)])
    [missed] = [one for one in result.requirements if not one.passed]
    assert (missed.name, missed.value) == ("certified properties", 0.0)
    assert "of another loop" in missed.evidence


def test_what_a_file_claims_beyond_the_truth_is_told(small: tuple[Any, tuple[LoopOutcome, ...]]) -> None:
    job, outcomes = small
    result = check_job(job, outcomes)
    record = json.loads(json.dumps(result_record(result)))
    assert unconfirmed(record, result) == ()

    def told(change: Callable[[Any], None]) -> str:
        edited = copy.deepcopy(record)
        change(edited["controllers"][0])
        [line] = unconfirmed(edited, result)
        assert line.startswith("caging 9-10, plain: ")
        return line

    def proof(number: int, **change: Any) -> Callable[[Any], None]:
        return lambda entry: entry["certificates"]["list"][number].update(change)

    def bent(entry: Any) -> None:
        entry["certificates"]["list"][1]["X"][0][0] *= 0.5

    assert "disk_margin is written as 0.9; it is" in told(lambda entry: entry["claims"].update(disk_margin=0.9))
    assert "damping is written as" in told(lambda entry: entry["claims"].update(damping="much"))
    assert "is not positive definite" in told(bent)
    assert "X is not symmetric" in told(lambda entry: entry["certificates"]["list"][0]["X"][0].reverse())
    assert "it is no matrix of numbers" in told(proof(2, X="none"))
    assert "is not positive definite" in told(proof(0, bound=1e3))
    assert "its bound is written as None" in told(proof(0, bound=None))
    assert "no such claim is proved" in told(proof(0, label="every plant"))
    assert "another plant" in told(lambda entry: entry["certificates"]["plant"]["A"][0].reverse())
    assert unconfirmed({"schema": 1, "controllers": [{}]}, result) == ()
    false = copy.deepcopy(record)
    false["controllers"][0]["certificates"]["list"] *= 3
    for one in false["controllers"][0]["certificates"]["list"]:
        one["bound"] = None
    *shown, last = unconfirmed(false, result)
    assert len(shown) == 4
    assert last == "caging 9-10, plain: and 5 more of its claims"


def test_the_record_is_enough_to_prove_the_nominal_claims(small: tuple[Any, tuple[LoopOutcome, ...]]) -> None:
    """Through JSON and back, with nothing but the record."""
    job, outcomes = small
    record = json.loads(json.dumps(result_record(check_job(job, outcomes))))
    [entry] = record["controllers"]
    shown = entry["certificates"]
    assert shown["proved"] == shown["of"] == len(shown["list"]) == 3
    K = StateArrays(*(np.array(entry[name], dtype=float) for name in "ABCD"), dt=entry["dt"])
    A, B, C, D = (np.array(shown["plant"][name], dtype=float) for name in "ABCD")
    (p, m), n = D.shape, len(A)
    plants = {
        "nominal": (A, B, C, D),
        "nominal, (S − T)/2 at the torques": (
            A,
            np.hstack([B, B]),
            np.vstack([np.zeros((m, n)), C]),
            np.block([[np.eye(m) / 2, np.eye(m)], [D, D]]),
        ),
        "nominal, (S − T)/2 at the pick-offs": (
            A,
            np.hstack([np.zeros((n, p)), B]),
            np.vstack([C, C]),
            np.block([[-np.eye(p) / 2 + np.eye(p), D], [np.eye(p), D]]),
        ),
    }
    for claim in shown["list"]:
        loop = closed(StateArrays(*plants[claim["label"]], dt=entry["dt"]), K)
        T = claim.get("coordinates")
        again = Certificate(
            claim=claim["claim"],
            bound=claim["bound"],
            loops=(loop,),
            X=np.array(claim["X"]),
            coordinates=None if T is None else np.array(T),
        ).verify()
        assert again.proved
        assert again.margin == claim["margin"]
    together = record["coupled"]["certificates"]
    assert (together["proved"], together["of"]) == (1, 1)


def test_sensitivity_plants_close_to_s_minus_half(small: tuple[Any, tuple[LoopOutcome, ...]]) -> None:
    design = small[1][0].closed
    assert design.plants is not None
    K = StateArrays(*(getattr(design.controller, name) for name in "ABCD"), dt=design.plants.period)
    P = pc.analysis.frequency_response(
        pc.analysis.arrays.named_system(
            StateArrays(*(getattr(design.plants, name)[0] for name in "ABCD"), dt=K.dt), ["a", "b"], ["c", "d"]
        ),
        [100.0],
    )[..., 0]
    k = pc.analysis.frequency_response(design.controller, [100.0])[..., 0]
    eye = np.eye(2)
    S = np.linalg.inv(eye - k @ P), np.linalg.inv(eye - P @ k)
    for system, expected in zip(sensitivity_plants(design.plants.arrays.at(0)), S, strict=True):
        A, B, C, D, dt = closed(system, K).rounded()
        z = np.exp(100.0j * dt)
        found = C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D
        np.testing.assert_allclose(found, expected - eye / 2, rtol=1e-9, atol=1e-9)


def test_an_unstable_coupled_system_claims_nothing(small: tuple[Any, tuple[LoopOutcome, ...]]) -> None:
    job, outcomes = small
    result = check_job(job, outcomes)
    K = outcomes[0].closed.controller
    unstable = dataclasses.replace(
        result.coupled, poles=2.0 * result.coupled.poles / np.abs(result.coupled.poles).max()
    )
    assert coupled_proofs(unstable, [K]).of == 0
    assert coupled_proofs(result.coupled, [K]).proved == 1


def test_an_unstable_loop_is_not_certified() -> None:
    data = tomllib.loads(Path("examples/three_gyro_platform.toml").read_text(encoding="utf-8"))
    for name in ("uncertainty", "coupled", "manoeuvre", "fault", "campaign"):
        data.pop(name, None)
    [loop] = [loop for loop in data["loop"] if loop["name"] == "caging 9-10"]
    loop |= {
        "use": "classical",
        "design": [{"name": "classical", "method": "classical", "crossover_hz": 400, "damping_hz": 1}],
        "limits": {"bandwidth_hz": 20},
        "soft": {},
    }
    job = pc.read_job(data | {"loop": [loop], "operation": {"Omega": [0.0, 0.0, 0.0]}})
    with pytest.raises(NotCertifiedError, match="the closed loop grows at"):
        loops(job)
