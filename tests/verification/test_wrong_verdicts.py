"""Jobs that once passed although their loops do not do what is asked: what is wrong is said, and nothing passes.

The jobs in tests/data/wrong_verdicts are of one-axis cameras with assumed numbers.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import platform_ctrl as pc
from continuous_loop import ContinuousLoop
from platform_ctrl import design
from platform_ctrl.errors import InputError
from platform_ctrl.verification import check_job

HERE = Path(__file__).parents[1] / "data" / "wrong_verdicts"


def data(name: str) -> dict[str, Any]:
    return tomllib.loads((HERE / f"{name}.toml").read_text(encoding="utf-8"))


def results(job: Any) -> dict[tuple[str, str], Any]:
    found = check_job(job, design.loops(job))
    return {(one.stage, one.name): one for one in found.requirements}


def test_a_rate_loop_against_a_spring_leaves_what_the_spring_takes() -> None:
    """1 - T(0) = k/(k + K_I), K_I = J w_c w_i; behind a ramp the error grows without bound."""
    read = pc.read_job(data("steady"))
    found = results(read)
    outcome = design.loops(read)[0].closed
    K = outcome.controller
    # A step of the command, by the sampled loop in state space and by its value at zero frequency.
    A = np.array([[0.0, 1.0], [-40.0, -0.1]])
    plant = (A, [[0.0], [100.0]], [[-1.0], [0.1]], [[0.0, 1.0]], [[0.0, 1.0]], [[0.0]], [[0.0]])
    loop = ContinuousLoop(plant, (K.A, K.B, K.C, K.D), 5e-4, delay=1e-4)
    w = np.array([1e-3])
    left = abs(1.0 / (1.0 - loop.sampled_plant(w) @ loop.controller(w)))[0, 0, 0]
    assert left == pytest.approx(0.2025, abs=2e-4)
    assert found["decoupled", "steady-state error"].value == pytest.approx(left, rel=1e-4)
    assert found["decoupled", "ramp error"].value == np.inf
    band = 2.0 * np.pi * np.geomspace(1e-4, 0.02, 200)
    expected = -20.0 * np.log10(loop.gain(band).max())
    assert found["decoupled", "attenuation of base motion"].value == pytest.approx(expected, abs=0.01)
    assert expected == pytest.approx(13.87, abs=0.01)
    assert not any(found["decoupled", name].passed for name in ("steady-state error", "ramp error"))
    stable = found["coupled", "minimum decay rate"]
    assert stable.passed
    assert "nothing holds the angle pitch: it drifts" in stable.evidence


def test_a_pointing_loop_against_a_spring_lags_a_ramp_by_k_over_its_integral_gain() -> None:
    raw = data("steady")
    raw["plant"]["attitude_sensor"] = [{"name": "track", "body": "pitch", "axis": [0, 1, 0]}]
    raw["loop"][0] |= {
        "kind": "pointing",
        "sensors": ["track"],
        "limits": {"ramp_error": 1.0, "steady_error": 0.01},
        "use": "classical",
        "design": [{"name": "classical", "method": "classical", "inertial_crossover_hz": 20, "integral_hz": 0.2}],
    }
    read = pc.read_job(raw)
    found = results(read)
    K = design.loops(read)[0].closed.controller
    z = 1.0 + 1e-7
    integral = 1e-7 / 5e-4 * abs((K.C @ np.linalg.solve(z * np.eye(len(K.A)) - K.A, K.B) + K.D)[0, 0])
    assert found["decoupled", "steady-state error"].value == 0.0
    assert found["decoupled", "ramp error"].value == pytest.approx(0.4 / integral, rel=1e-3)
    assert found["decoupled", "ramp error"].value > 1e-3


def test_a_loop_that_grows_slowly_is_not_stable() -> None:
    read = pc.read_job(data("unstable-loop"))
    with pytest.raises(pc.PlatformCtrlError, match=r"grows at 0\.0896 1/s"):
        design.loops(read)


def test_a_gimbal_without_a_loop_that_falls_over_fails_the_coupled_check() -> None:
    """k = -5 N m/rad, J = 0.03 kg m²: it grows at 12.9 1/s."""
    found = results(pc.read_job(data("free-gimbal")))
    stable = found["coupled", "minimum decay rate"]
    assert stable.value == pytest.approx(-np.sqrt(5.0 / 0.03), rel=1e-6)
    assert not stable.passed
    assert "no loop acts on outer: it moves away by itself" in stable.evidence


@pytest.mark.parametrize("flap", [False, True])
def test_slow_growth_of_a_gimbal_without_a_loop_is_seen_beside_a_light_damped_one(flap: bool) -> None:
    """k = -J 0.0025: it grows at 0.05 1/s; the flap's own pole is at -1e5 1/s."""
    raw = data("free-gimbal")
    plant = raw["plant"]
    plant["spring"][1]["stiffness"] = -0.03 * 0.05**2
    if flap:
        plant["gimbal"].append({"name": "flap", "parent": "outer", "axis": [0, 0, 1], "inertia": [1e-9] * 3})
        plant["spring"].append({"gimbal": "flap", "stiffness": 1e-6})
        plant["friction"] = [{"gimbal": "flap", "viscous": 1e-4}]
    stable = results(pc.read_job(raw))["coupled", "minimum decay rate"]
    assert stable.value == pytest.approx(-0.05, rel=1e-3)
    assert not stable.passed


@pytest.mark.parametrize("kind", ["rate", "pointing"])
def test_a_loop_of_a_low_rate_against_its_spring_is_designed(kind: str) -> None:
    """At a hundredth of 40 Hz the gimbal moves as its spring of 0.5 Hz lets it: against the sign of its inertia."""
    raw = data("steady")
    raw["sampling"] = {"rate_hz": 40, "delay": 0.0}
    raw["plant"]["spring"][0]["stiffness"] = 0.01 * (2.0 * np.pi * 0.5) ** 2
    loop = raw["loop"][0] | {"limits": {"disk_margin": 0.5}}
    loop["design"] = [{"name": "PI", "method": "pi", "crossover_hz": 2, "integral_hz": 0.2}]
    if kind == "pointing":
        raw["plant"]["attitude_sensor"] = [{"name": "track", "body": "pitch", "axis": [0, 1, 0]}]
        own = {"name": "PI", "method": "classical", "inertial_crossover_hz": 2, "integral_hz": 0.2}
        loop |= {"kind": "pointing", "sensors": ["track"], "design": [own]}
    raw["loop"] = [loop]
    read = pc.read_job(raw)
    assert check_job(read, design.loops(read)).passed


def test_a_gimbal_is_locked_where_the_job_says_so_and_the_verdict_says_it_too() -> None:
    raw = data("free-gimbal")
    raw["operation"]["locked"] = ["outer"]
    raw["loop"][0]["limits"].pop("disk_margin_worst_case")
    read = pc.read_job(raw)
    assert read.platform.gimbal_names == ("pitch",)
    np.testing.assert_allclose(read.platform.root_inertia, np.diag([10.02, 10.02, 10.02]))
    found = check_job(read, design.loops(read))
    assert found.passed
    assert "outer is locked" in found.assumptions
    raw["operation"]["locked"] = ["inner"]
    with pytest.raises(InputError, match=r'locked: "inner" is no gimbal of the plant; .*"?outer'):
        pc.read_job(raw)
    raw["operation"]["locked"] = ["pitch"]
    with pytest.raises(InputError, match=r'gimbals: "pitch" is locked in \[operation\]'):
        pc.read_job(raw)


LENS, STIFFNESS = 0.004, (2.0 * np.pi * 85.0) ** 2 * 0.004


def with_a_mode(held: bool) -> dict[str, Any]:
    """A camera whose lens is a passive gimbal about the same axis on a flexure: 85 Hz with the camera held."""
    raw = data("settle")
    plant = raw["plant"]
    plant["friction"] = [{"gimbal": "lens", "viscous": 0.05}, {"gimbal": "pitch", "viscous": 0.001}]
    plant["gimbal"] = [
        {"name": "pitch", "parent": "base", "axis": [0, 1, 0], "inertia": [0.01, 0.01, 0.01]},
        {"name": "lens", "parent": "pitch", "axis": [0, 1, 0], "inertia": [LENS, LENS, LENS]},
    ]
    plant["spring"] = [{"gimbal": "lens", "stiffness": STIFFNESS}]
    plant.pop("unbalance")
    raw.pop("manoeuvre")
    raw["operation"] = {"Omega": [0.3, 0.3, 0.3]} | ({"locked": ["lens"]} if held else {})
    raw["loop"][0]["limits"] = {"disk_margin": 0.3}
    raw["loop"][0]["design"][0]["crossover_hz"] = 10.0
    return raw


def test_a_mode_that_is_a_passive_gimbal_takes_part_in_the_loop() -> None:
    """The disk margin by brute force on the two coupled bodies, and with the lens locked."""
    margins = {}
    for held in (False, True):
        read = pc.read_job(with_a_mode(held))
        outcome = design.loops(read)[0].closed
        K = outcome.controller
        # [pitch, lens] and their rates: M q'' + D q' + k q = [Q, 0]; the gyro sees the first.
        n = 1 if held else 2
        M = np.array([[0.01 + LENS, LENS], [LENS, LENS]])[:n, :n]
        D, k = np.diag([0.001, 0.05])[:n, :n], np.diag([0.0, STIFFNESS])[:n, :n]
        inverse, w = np.linalg.inv(M), 2.0 * np.pi * 262.0
        A = np.zeros((2 * n + 2, 2 * n + 2))
        A[:n, n : 2 * n] = np.eye(n)
        A[n : 2 * n, : 2 * n] = np.hstack([-inverse @ k, -inverse @ D])
        A[-2, -1], A[-1, -2], A[-1, -1] = w, -w, -np.sqrt(2.0) * w
        A[-1, n] = w
        B, none = np.zeros((2 * n + 2, 1)), np.zeros((2 * n + 2, 1))
        B[n : 2 * n, 0] = inverse[:, 0]
        C = np.eye(1, 2 * n + 2, 2 * n)
        plant, law = (A, B, none, C, C, [[0.0]], [[0.0]]), (K.A, K.B, K.C, K.D)
        loop = ContinuousLoop(plant, law, 1e-3, delay=2e-4, lag=[3e-4], late=[1])
        f = np.geomspace(1.0, np.pi / 1e-3, 200_000)
        S = 1.0 / (1.0 - (loop.sampled_plant(f) @ loop.controller(f))[:, 0, 0])
        margins[held] = 1.0 / np.abs(S - 0.5).max()
        assert np.abs(loop.poles()).max() < 1.0 + 1e-9
        assert outcome.measures is not None
        assert outcome.measures.disk_margin[0] == pytest.approx(margins[held], rel=1e-4)
    assert margins[False] < 0.6 * margins[True]


def test_a_mean_over_one_sample_is_a_mistake() -> None:
    with pytest.raises(InputError, match="settle leaves 1e-07 s of the run, less than 20 samples"):
        pc.read_job(data("settle"))


def test_a_sine_faster_than_the_substep_is_followed() -> None:
    """Its own substep follows it, whatever the longest one is."""
    raw = data("after-the-end")
    raw["manoeuvre"] = raw["manoeuvre"][-1:]
    raw["manoeuvre"][0]["sine"][0]["frequency_hz"] = 19_913.0
    read = pc.read_job(raw)
    run = check_job(read, design.loops(read)).runs[0]
    assert run.trajectory.step == pytest.approx(1.0 / (6.0 * 19_913.0))
    assert np.abs(run.trajectory.Omega[:, 1]).max() == pytest.approx(5.0, rel=0.01)


def unexercised_job() -> dict[str, Any]:
    """A job with a run, for the table of wrong inputs."""
    run = {"name": "m", "mode": "caged", "duration": 0.5, "limits": {"angle": 0.1}, "faults": []}
    return data("after-the-end") | {"fault": [], "manoeuvre": [run]}


def settled_job() -> dict[str, Any]:
    """A job without runs, for the table of wrong inputs."""
    return {key: item for key, item in data("settle").items() if key != "manoeuvre"}
