"""The kernel as CUDA runs it: on a GPU where there is one, and thread by thread in the simulator of numba."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, replace
from importlib.util import find_spec
from pathlib import Path
from textwrap import dedent

import control
import numpy as np
import pytest

from platform_ctrl import read_platform
from platform_ctrl.errors import ArgumentError, SimulationError
from platform_ctrl.job.faults import Fault
from platform_ctrl.job.scenario import HalfCosine, Scenario, Vibration
from platform_ctrl.plant.sensors import AttitudeSensor, LineOfSight, RateSensor
from platform_ctrl.simulation import rollout, simulate_batch
from platform_ctrl.simulation.batch import BatchResult

# Rounding alone differs: where products and sums are fused, which multiplies by what a run makes of small differences.
ROUNDING = 1e-11


def missing_gpu() -> str:
    """Why the tests that need a GPU cannot run; empty if they can."""
    if find_spec("numba_cuda") is None:
        return "numba-cuda is not installed"
    from numba import cuda

    return "" if cuda.is_available() else "there is no CUDA GPU here"


needs_gpu = pytest.mark.skipif(bool(missing_gpu()), reason=missing_gpu() or "there is a GPU")


def simulated(tmp_path: Path, program: str) -> dict[str, np.ndarray]:
    """What a program that saves to `out` comes to in numba's CUDA simulator, with nothing compiled."""
    out = tmp_path / "out.npz"
    setting = {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(Path.cwd())}
    subprocess.run(
        [sys.executable, "-c", f"out = {str(out)!r}\n" + dedent(program)],
        env={**os.environ, **setting},
        check=True,
        timeout=300,
    )
    with np.load(out) as file:
        return dict(file)


def close(ours: np.ndarray, theirs: np.ndarray) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=ROUNDING, atol=ROUNDING * np.abs(theirs).max(initial=1e-300))


def some_runs(name: str, runs: int, steps: int, **more: object) -> dict[str, object]:
    """Arguments of a rollout."""
    platform = read_platform(name)
    n, rng = len(platform.gimbals), np.random.default_rng(7)
    return {
        "platform": platform,
        "q": 0.1 * rng.standard_normal((runs, n)),
        "velocity": rng.standard_normal((runs, n + 3)),
        "force": 1e-3 * rng.standard_normal((runs, n + 3)),
        "step": 1e-4,
        "steps": steps,
        "every": max(steps // 3, 1),
        **more,
    }


def some_scenarios(mode: str, runs: int, duration: float) -> dict[str, object]:
    """Arguments of a flight: noise, vibration, faults, and a gimbal that is thrown against its stop."""
    platform = read_platform("three_gyro_platform")
    inner = platform.gimbal_names[-1]
    lags = {"bandwidth_hz": 100.0, "delay": 1e-3, "bias": 1e-3, "noise_rms": 1e-4}
    platform = replace(
        platform,
        rate_sensors=(RateSensor(name="gyro", body=inner, axis=np.array([0.6, 0.0, 0.8]), **lags),),
        attitude_sensors=(AttitudeSensor(name="star", body=inner, axis=np.array([0.0, 1.0, 0.0]), rate_hz=1000.0),),
        line_of_sight=LineOfSight(body=inner, direction=np.array([0.0, 0.6, 0.8])),
    )
    n, rng = len(platform.gimbals), np.random.default_rng(11)
    caged = mode == "caged"
    begin = 1e-3 * rng.standard_normal((runs, n))
    begin[:, 0] = platform.gimbals[0].stops[1] - 1e-6
    faults = (
        Fault(name="blow", kind="stop contact", part=platform.gimbal_names[0], at=1e-3, impulse=1e-4),
        Fault(name="deaf", kind="pick-off dropout", part=platform.pickoffs[1].name, at=0.0, probability=0.5),
        Fault(name="slows", kind="rotor run-down", part=platform.rotors[0].name, at=1e-3, time_constant=0.1),
    )
    scenarios = [
        Scenario(
            platform=platform,
            mode=mode,
            duration=duration,
            delay=3e-4,
            profile=HalfCosine(axis=1, rate=0.2, rise=1e-3, hold=1e-3) if caged else None,
            torque=np.zeros(3) if caged else np.array([0.0, 0.1, 0.0]),
            vibrations=(
                Vibration(
                    kind="rate" if caged else "force",
                    axis=2,
                    frequencies_hz=np.array([10.0, 100.0]),
                    densities=np.array([1e-6, 1e-6]),
                    lines=3,
                ),
            ),
            faults=faults,
            q=begin[run],
            seed=5,
            run=run,
        )
        for run in range(runs)
    ]
    pairs = [(t, s) for t in platform.torquers for s in platform.pickoffs if t.gimbal == s.gimbal]
    damped = control.ss(
        0.5 * np.eye(len(pairs)),
        np.eye(len(pairs)),
        -0.5 * np.eye(len(pairs)),
        -2.0 * np.eye(len(pairs)),
        5e-4,
        inputs=[s.name for _, s in pairs],
        outputs=[t.name for t, _ in pairs],
        name="K",
    )
    return {"scenarios": scenarios, "controllers": [damped], "period": 5e-4, "step": 2e-4}


def agree(ours: BatchResult, theirs: BatchResult) -> None:
    """BatchResult equal to rounding, and the same counts."""
    for name in (field.name for field in fields(theirs)):
        mine, their = np.asarray(getattr(ours, name)), np.asarray(getattr(theirs, name))
        if their.dtype.kind == "i":
            np.testing.assert_array_equal(mine, their)
        else:
            close(mine, their)


def test_a_thread_of_the_simulator_moves_its_run_as_the_processor_does(tmp_path):
    there = simulated(
        tmp_path,
        """
        import sys

        import numpy as np

        sys.path.insert(0, "tests")
        from simulation.test_cuda import some_runs
        from platform_ctrl.simulation import rollout

        run = rollout(**some_runs("three_gyro_platform", 3, 12), device="cuda")
        np.savez(out, q=run.q_history, velocity=run.velocity_history, attitude=run.attitude_history, t=run.t)
        """,
    )
    here = rollout(**some_runs("three_gyro_platform", 3, 12))
    np.testing.assert_array_equal(there["t"], here.t)
    close(there["q"], here.q_history)
    close(there["velocity"], here.velocity_history)
    close(there["attitude"], here.attitude_history)


@pytest.mark.parametrize("mode", ["caged", "stabilised"])
def test_a_thread_of_the_simulator_flies_its_scenario_as_the_processor_does(tmp_path, mode):
    there = simulated(
        tmp_path,
        f"""
        import sys
        from dataclasses import fields

        import numpy as np

        sys.path.insert(0, "tests")
        from simulation.test_cuda import some_scenarios
        from platform_ctrl.simulation import simulate_batch

        figures = simulate_batch(**some_scenarios({mode!r}, 2, 3e-3), device="cuda")
        np.savez(out, **{{field.name: getattr(figures, field.name) for field in fields(figures)}})
        """,
    )
    here = simulate_batch(**some_scenarios(mode, 2, 3e-3))
    assert here.stop_contacts.any()
    agree(BatchResult(**there), here)


@pytest.mark.skipif(find_spec("numba_cuda") is None, reason="numba-cuda is not installed")
def test_the_device_code_compiles_without_a_gpu_and_keeps_what_it_knows_of_the_plant(monkeypatch):
    from types import SimpleNamespace

    from numba import cuda, float64, int64
    from numba.cuda.cudadrv import nvvm

    from platform_ctrl.simulation.kernel.cuda import advance_kernel
    from platform_ctrl.simulation.packing import pack

    if not nvvm.is_available():
        pytest.skip("libNVVM is not installed")
    hopper = SimpleNamespace(compute_capability=(9, 0))
    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: hopper)
    plant, other = pack(read_platform("three_gyro_platform")), pack(read_platform("suspended_platform"))
    kernel = advance_kernel(plant.links, plant.at)
    assert advance_kernel(plant.links, plant.at) is kernel
    assert advance_kernel(other.links, other.at) is not kernel
    arguments = (float64[::1], float64[::1], float64[:, ::1], float64[:, ::1], float64, int64)
    code, returned = cuda.compile_ptx(kernel.py_func, arguments, cc=(9, 0))
    assert ".entry" in code
    assert str(returned) == "none"


@needs_gpu
@pytest.mark.parametrize("mode", ["caged", "stabilised"])
def test_the_gpu_flies_scenarios_as_the_processor_does(mode):
    there, here = (simulate_batch(**some_scenarios(mode, 40, 0.05), device=device) for device in ("cuda", "cpu"))
    agree(there, here)


@needs_gpu
@pytest.mark.parametrize("name", ["three_gyro_platform", "suspended_platform", "vscmg_pyramid"])
def test_the_gpu_moves_runs_as_the_processor_does(name):
    there, here = (rollout(**some_runs(name, 300, 200), device=device) for device in ("cuda", "cpu"))
    close(there.q_history, here.q_history)
    close(there.velocity_history, here.velocity_history)
    close(there.attitude_history, here.attitude_history)


@needs_gpu
def test_a_run_on_the_gpu_does_not_depend_on_those_beside_it():
    runs = some_runs("three_gyro_platform", 300, 50)
    alone = {**runs, **{key: runs[key][137:138] for key in ("q", "velocity", "force")}}
    np.testing.assert_array_equal(rollout(**alone, device="cuda").q[0], rollout(**runs, device="cuda").q[137])


def test_an_unknown_device_is_refused_with_those_that_exist():
    with pytest.raises(ArgumentError, match=r"device must be 'cpu' or 'cuda', got 'gpu'"):
        rollout(**some_runs("three_gyro_platform", 1, 1), device="gpu")


def test_without_numba_cuda_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr("platform_ctrl.simulation.device.find_spec", lambda name: None)
    with pytest.raises(SimulationError, match=r"pip install 'platform_ctrl\[cuda\]'") as told:
        rollout(**some_runs("three_gyro_platform", 1, 1), device="cuda")
    assert "\n" not in str(told.value)


@pytest.mark.skipif(find_spec("numba_cuda") is None or not missing_gpu(), reason="needs numba-cuda and no GPU")
def test_without_a_gpu_one_line_says_so():
    with pytest.raises(SimulationError, match="no CUDA GPU") as told:
        rollout(**some_runs("three_gyro_platform", 1, 1), device="cuda")
    assert "\n" not in str(told.value)
