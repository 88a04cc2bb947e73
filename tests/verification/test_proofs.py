"""Proofs in interval arithmetic, made on demand: what is true is proved, what is false is not, and fails the job."""

from __future__ import annotations

import dataclasses
import json
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.analysis import hinf_norm
from platform_ctrl.analysis.system import System
from platform_ctrl.design import loops
from platform_ctrl.errors import InputError
from platform_ctrl.verification import check_job
from platform_ctrl.verification.proofs import (
    Claim,
    Proofs,
    _balls,
    _decays,
    _decided,
    _norm_below,
    proofs_of,
    with_proofs,
)
from platform_ctrl.verification.result_file import result_record, unconfirmed

JOB = Path("examples/three_gyro_platform.toml")


@pytest.fixture(scope="module")
def small() -> tuple[Any, tuple[Any, ...]]:
    """One loop of the main job, without uncertainty and manoeuvres."""
    data = tomllib.loads(JOB.read_text(encoding="utf-8"))
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


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (3, 2), (8, 2), (16, 1)])
def test_norm_and_decay_are_proved_above_and_refused_below_their_values(n: int, m: int) -> None:
    rng = np.random.default_rng(n)
    A = rng.standard_normal((n, n))
    A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    system = System(A, rng.standard_normal((n, m)), rng.standard_normal((m, n)), rng.standard_normal((m, m)), 1.0)
    norm, _ = hinf_norm(system)

    def proved(factor: float) -> int:
        return _decided(lambda: _norm_below(tuple(map(_balls, system[:4])), _balls(np.array([[factor * norm]]))[0, 0]))

    assert proved(1.0 + 1e-6)
    assert not proved(1.0 - 1e-6)
    assert _decided(lambda: _decays(_balls(A), -0.999 * np.log(0.97)))
    assert not _decided(lambda: _decays(_balls(A), -1.001 * np.log(0.97)))


def test_an_unstable_system_has_no_norm_and_poles_on_the_circle_are_not_stable() -> None:
    one = np.ones((1, 1))
    for pole in (1.0, -1.0, 1.5):
        loop = tuple(map(_balls, (pole * one, one, one, 0.0 * one)))
        assert not _decided(lambda loop=loop: _norm_below(loop, 100))  # type: ignore[misc]


def test_a_job_is_proved_when_that_is_asked_for(small: tuple[Any, tuple[Any, ...]]) -> None:
    job, (outcome,) = small
    plain = check_job(job, [outcome])
    assert plain.proofs == {}
    assert "certificates" not in result_record(plain)["controllers"][0]
    [margin] = [one for one in plain.requirements if one.name == "disk margin"]
    assert margin.method == "exact"
    assert "exact H-infinity norm" in margin.evidence
    result = check_job(job, [outcome], prove=True)
    assert result.passed
    shown = [one for one in result.requirements if one.name == "certified properties"]
    assert [(one.stage, one.value, one.method) for one in shown] == [
        ("decoupled", 1.0, "proved"),
        ("coupled", 1.0, "proved"),
    ]
    record = json.loads(json.dumps(result_record(result)))
    [entry] = record["controllers"]
    assert (entry["certificates"]["proved"], entry["certificates"]["of"]) == (2, 2)
    stable, disk = entry["certificates"]["list"]
    measures = outcome.closed.measures
    assert measures is not None
    assert stable["bound"] == pytest.approx(0.99 * measures.decay[0])
    assert (disk["claim"], disk["bound"]) == ("disk margin", pytest.approx(measures.disk_margin[0], rel=2e-5))
    assert record["coupled"]["certificates"]["proved"] == 1


def test_what_is_not_proved_fails_the_requirement(small: tuple[Any, tuple[Any, ...]]) -> None:
    job, (outcome,) = small
    design = outcome.closed
    measures = design.measures
    boast = dataclasses.replace(design, measures=dataclasses.replace(measures, disk_margin=1.01 * measures.disk_margin))  # type: ignore[union-attr, type-var]
    found = proofs_of(job.loops[0], boast)
    assert [one.proved for one in found.claims] == [True, False]
    *_, judged = with_proofs(design.results, found, design.loop, design.name)
    assert (judged.passed, judged.value) == (False, 0.5)
    assert judged.evidence.startswith("not proved: the loop with nominal has a disk margin above 0.")
    left_out = with_proofs(check_job(job, [outcome]).coupled.results, Proofs(left_out="80 states"), "all loops closed")  # type: ignore[union-attr]
    assert [one.evidence.endswith("no proof in interval arithmetic: 80 states") for one in left_out].count(True) == 1
    assert str(Claim(plant="nominal", kind="stability", bound=2.0, bits=0)) == (
        "the loop with nominal decays at 2 1/s or faster"
    )


def test_what_a_file_claims_beyond_the_truth_is_told(small: tuple[Any, tuple[Any, ...]]) -> None:
    job, outcomes = small
    result = check_job(job, outcomes)
    record = json.loads(json.dumps(result_record(result)))
    assert unconfirmed(record, result) == ()
    record["controllers"][0]["claims"] |= {"disk_margin": 0.9, "damping": "much"}
    first, second = unconfirmed(record, result)
    assert first.startswith("caging 9-10, plain: disk_margin is written as 0.9; it is")
    assert "damping is written as" in second
    assert unconfirmed({"schema": 1, "controllers": [{}]}, result) == ()


def test_without_the_library_one_sentence_says_what_to_install(
    small: tuple[Any, tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(InputError, match=r"pip install 'platform_ctrl\[proofs\]'"):
        check_job(*small, prove=True)
