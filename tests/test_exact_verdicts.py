"""What decides a verdict is exact over all frequencies: a resonance that every grid misses is in the figures."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag

import dense_peak
from platform_ctrl.analysis import PlantSet, StateArrays, measure
from platform_ctrl.analysis.loop_figures import LoopFigures
from platform_ctrl.cli import main
from platform_ctrl.design.blocks import first_order, notch
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.design.structured.descent import Search
from platform_ctrl.design.structured.families import Named
from platform_ctrl.design.structured.loops import ClosedLoops
from platform_ctrl.design.tuning import tune, worst_ratio
from platform_ctrl.reading import read_job
from platform_ctrl.requirements import SPREAD, requirement
from test_cli import undrawn  # noqa: F401

PERIOD = 5e-4
L, J9, J10 = 0.15, 5e-4, 2e-4
JOB = """
schema = 1
name = "gyro 9-10, no delay"
plant = "three_gyro_platform"
operation = { Omega = [0.0, 0.0, 0.0] }
spread = { inertia = 0.1, spin = 0.1 }
sampling = { rate_hz = 2000, delay = 0.0 }

[[loop]]
name = "caging 9-10"
kind = "caging"
gimbals = ["9", "10"]
use = "classical"
limits = { sensitivity_peak_spread = 3.0 }
design = [{ name = "classical", method = "classical" }]
"""
# The plant with which the loop below all but oscillates.
WORST = "J9-10% J10+10% L11-10%"


def narrow_loop(depth: float = 0.20796, width: float = 0.0061867) -> StateArrays:
    """A PD in either axis and cross gain, behind a notch of 0.6 % width at 75 Hz."""
    leads = [
        tuple(
            -J * rate * part if k >= 2 else part
            for k, part in enumerate(first_order(1.0, zero, 1.0 / TOP, 1.0, PERIOD))
        )
        for J, zero, rate in ((J9, 28.549, 285.48), (J10, 26.282, 305.64))
    ]
    A, B, C, D = (block_diag(*parts) for parts in zip(*leads, strict=True))
    D = D + L * 235.28 * np.array([[0.0, -1.0], [1.0, 0.0]])
    one = notch(2.0 * np.pi * 75.46, depth, width, PERIOD)
    a, b, c, d = (block_diag(part, part) for part in one)
    both = np.block([[a, np.zeros((len(a), len(A)))], [B @ c, A]])
    return StateArrays(both, np.vstack([b, B @ d]), np.hstack([D @ c, C]), D @ d, PERIOD)


TOP = 2.0 * np.pi * 800.0


@pytest.fixture(scope="module")
def plants(tmp_path_factory: pytest.TempPathFactory) -> PlantSet:
    path = tmp_path_factory.mktemp("job") / "job.toml"
    path.write_text(JOB, encoding="utf-8")
    return loop_plants(read_job(path), ("9", "10"))


@pytest.mark.usefixtures("undrawn")
def test_check_fails_a_loop_whose_sensitivity_peaks_between_all_grid_points(
    plants: PlantSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    K = narrow_loop()
    true = max(dense_peak.figure("sensitivity peak", plants, k, K) for k in range(len(plants.labels)))
    assert true > 60.0
    # With the grid's points alone the loop would look as if it had room to spare.
    on_grid = np.linalg.norm(_sensitivities(plants, K), 2, axis=(-2, -1)).max()
    assert on_grid < 2.5
    entry = {name: getattr(K, name).tolist() for name in "ABCD"}
    entry |= {"name": "narrow", "dt": PERIOD, "delay": 0.0, "inputs": ["alpha9", "beta10"], "outputs": ["Q9", "Q10"]}
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    (tmp_path / "K.json").write_text(json.dumps({"schema": 1, "controllers": [entry]}), encoding="utf-8")
    arguments = ["check", str(tmp_path / "job.toml"), "--controllers", str(tmp_path / "K.json"), "-o", str(tmp_path)]
    assert main([*arguments, "--quiet"]) == 1
    assert "FAILED" in capsys.readouterr().out
    record = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    (missed,) = [one for one in record["requirements"] if not one["passed"]]
    assert missed["name"] == "sensitivity peak over the spread"
    assert missed["value"] == pytest.approx(true, rel=1e-8)
    assert missed["value"] >= true * (1.0 - 1e-12)
    assert missed["method"] == "exact"
    assert missed["evidence"].startswith(f"{WORST}; 9 plants")


def _sensitivities(plants: PlantSet, K: StateArrays) -> np.ndarray:
    """Sensitivities at the pick-offs on the set's grid, (N, F, p, p)."""
    every = [dense_peak.response(dense_peak.closed(plants, k, K), "y", "n", plants.frequency) for k in range(9)]
    return np.eye(2) + np.array(every)


def test_a_search_sees_the_resonance_that_its_grid_misses(plants: PlantSet) -> None:
    asked = requirement("sensitivity peak", 3.0, over=SPREAD)
    rough = measure(plants, narrow_loop(), [asked])
    assert not rough.exact
    assert asked.figures(rough).max() > 50.0
    assert asked.result(plants, rough).method == "sampled"


@pytest.mark.parametrize(
    "kind",
    ["sensitivity peak", "complementary peak", "disk margin", "torque rejection", "Omega rejection", "bandwidth"],
)
def test_the_worst_plant_of_a_set_is_found_exactly(kind: str, plants: PlantSet) -> None:
    K = narrow_loop()
    one = requirement(kind, 1.0, over=SPREAD)
    true = [dense_peak.figure(kind, plants, k, K) for k in range(len(plants.labels))]
    worst = min(true) if one.sense == "at least" else max(true)
    result = one.check(plants, K)
    assert result.method == "exact"
    assert result.value == pytest.approx(worst, rel=1e-7)
    assert dataclasses.replace(one, over=("nominal",)).check(plants, K).value == pytest.approx(true[0], rel=1e-7)


def test_the_tuner_goes_on_where_a_limit_is_missed_between_the_points_of_its_grid(
    plants: PlantSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without the poles' frequencies the search starts blind: its grid sees nothing wrong with the narrow loop.
    monkeypatch.setattr(LoopFigures, "_narrow", {})
    asked = [requirement("stability", 0.05, over=SPREAD), requirement("sensitivity peak", 3.0, over=SPREAD)]
    start = {"depth": 0.20796, "width": 0.0061867}

    def build(options: dict[str, float]) -> tuple[np.ndarray, ...]:
        return narrow_loop(**options)[:4]

    assert worst_ratio(build(start), plants, asked) < 0.95
    found = tune(start, list(start), build, plants, asked, upper={"depth": 1.0, "width": 1.0})
    K = narrow_loop(**found)
    true = max(dense_peak.figure("sensitivity peak", plants, k, K) for k in range(len(plants.labels)))
    assert true <= 3.0
    # Where the limits cannot be met, what is told is not better than what is there.
    told: list[float] = []
    tune(start, ["width"], build, plants, asked, upper={"width": 0.00619}, evaluations=60, progress=told.append)
    assert min(told) > 1.0


def test_the_structured_search_goes_on_where_a_limit_is_missed_between_the_points_of_its_grid(
    plants: PlantSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LoopFigures, "_narrow", {})
    monkeypatch.setattr(ClosedLoops, "_hidden", lambda self, *_: self.none())
    asked = [requirement("stability", 0.05, over=SPREAD), requirement("sensitivity peak", 3.0, over=SPREAD)]
    start = {"depth": 0.3, "width": 0.003}
    family = Named(lambda options: narrow_loop(**options)[:4], start, list(start), {"depth": 1.0, "width": 1.0})
    told: list[float] = []
    found = Search(plants, asked, 0.02, 200, lambda hard, soft: told.append(hard)).run(family)
    assert told[0] < 0.9  # what it sees at first
    K = StateArrays(*family.block(found.x), PERIOD)
    true = max(dense_peak.figure("sensitivity peak", plants, k, K) for k in range(len(plants.labels)))
    assert true <= 3.0
