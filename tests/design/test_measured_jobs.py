"""The measured PID as a method of jobs: on the responses of the plants, and on those of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from given_controllers import outcomes
from platform_ctrl import analysis, design, read_job

MARGIN = 0.4
OfFile = tuple[Path, Any, Any]


def job(**own: object) -> dict[str, object]:
    return {
        "schema": 2,
        "name": "one gimbal",
        "plant": {
            "schema": 1,
            "name": "gimbal with friction",
            "source": "assumed",
            "root": {"name": "case", "inertia": [1.0, 1.0, 1.0]},
            "gimbal": [{"name": "pitch", "parent": "case", "axis": [0, 1, 0], "inertia": [0.1, 0.1, 0.1]}],
            "torquer": [{"gimbal": "pitch"}],
            "pickoff": [{"gimbal": "pitch"}],
            "friction": [{"gimbal": "pitch", "viscous": 1.0}],
        },
        "operation": {"Omega": [0.1, 0.1, 0.1]},
        "sampling": {"rate_hz": 1000, "delay": 0.001},
        "loop": [
            {
                "name": "pitch",
                "kind": "caging",
                "gimbals": ["pitch"],
                "use": "measured",
                "limits": {"disk_margin": MARGIN},
                "design": [{"name": "measured", "method": "measured", "steps": 12, **own}],
            }
        ],
    }


def write(path: Path, plants: Any, factor: float = 1.0, rows: int = 120) -> str:
    """Write the responses of the nominal plant times a factor, as a measurement would have them."""
    w = np.geomspace(0.1, 0.99 * np.pi / plants.period, rows)
    P = factor * plants.on(w).response[0]
    signals = f"{plants.angles[0]}/{plants.torques[0]}"
    lines = [f"frequency_rad_s,{signals} re,{signals} im"]
    lines += [f"{f!r},{x.real!r},{x.imag!r}" for f, x in zip(w.tolist(), P[:, 0, 0].tolist(), strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return path.name


@pytest.fixture(scope="module")
def exact() -> Any:
    [outcome] = design.loops(job())
    return outcome.closed


def test_a_design_on_the_responses_of_the_plants_keeps_its_margin_and_integrates(exact: Any) -> None:
    assert exact.passed
    assert exact.measures is not None
    assert MARGIN <= exact.measures.disk_margin[0] < 1.2 * MARGIN  # the limit is what bounds the integral gain
    assert np.abs(exact.controller.poles() - 1.0).min() < 1e-9


def test_limits_that_no_frequency_decides_alone_are_met_by_smaller_peaks() -> None:
    noisy = job()
    noisy["plant"]["pickoff"][0]["noise_rms"] = 1e-6  # type: ignore[index]
    [loop] = noisy["loop"]  # type: ignore[misc]
    reached = []
    for limits in ({"torque_noise": 1e3, "overshoot": 10.0}, {"torque_noise": 0.5, "overshoot": 0.8}):
        least = {key: x * (reached[0][key] if reached else 1.0) for key, x in limits.items()}
        loop["limits"] = {"disk_margin": MARGIN, **least}
        [outcome] = design.loops(noisy)
        found = {one.name: one.value for one in outcome.closed.results}
        assert outcome.closed.passed
        reached.append({"torque_noise": found["torque noise, rms"], "overshoot": found["overshoot"]})
    assert all(0.3 * free < reached[1][key] < free for key, free in reached[0].items())


@pytest.fixture(scope="module")
def of_file(exact: Any, tmp_path_factory: pytest.TempPathFactory) -> OfFile:
    """Return a file with the responses of the model, its job, and the design on it."""
    folder = tmp_path_factory.mktemp("responses")
    name = write(folder / "pitch.csv", exact.plants)
    found = read_job(job(responses=name), folder=folder)
    [outcome] = design.loops(found)
    return folder / name, found, outcome.closed


def test_a_file_with_the_responses_of_the_model_is_no_distance_from_it(of_file: OfFile) -> None:
    _, found, closed = of_file
    on_data = {one.name: one for one in closed.results if "measured responses" in one.name}
    assert set(on_data) == {"disk margin, measured responses"}
    assert closed.passed
    assert closed.claims["responses from model, relative"] < 1e-9
    # The margin on the data by the formula of one channel, |1/(S − 1/2)| at its least.
    assert closed.plants is not None
    w = np.geomspace(0.1, 0.99 * np.pi / found.sampling.period, 120)
    L = closed.plants.on(w).response[0, :, 0, 0] * analysis.frequency_response(closed.controller, w)[0, 0]
    expected = np.abs(1.0 / (1.0 / (1.0 - L) - 0.5)).min()
    assert on_data["disk margin, measured responses"].value == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("factor", "unstable"), [(1.6, False), (40.0, True)])
def test_a_limit_that_is_met_on_the_model_and_missed_on_the_data_fails_the_loop(
    exact: Any, tmp_path: Path, factor: float, unstable: bool
) -> None:
    name = write(tmp_path / "pitch.csv", exact.plants, factor)
    [outcome] = outcomes(read_job(job(responses=name), folder=tmp_path), [exact.controller])
    judged = outcome.closed
    results = {one.name: one for one in judged.results}
    assert results["disk margin"].passed
    assert not results["disk margin, measured responses"].passed
    assert ("unstable poles, measured responses" in results) is unstable
    assert judged.claims["responses from model, relative"] == pytest.approx(factor - 1.0, rel=1e-9)
    assert not judged.passed


def test_signals_of_a_file_are_read_in_the_units_of_their_names(exact: Any, tmp_path: Path) -> None:
    write(tmp_path / "pitch.csv", exact.plants)
    lines = (tmp_path / "pitch.csv").read_text().splitlines()
    rows = [[float(x) for x in line.split(",")] for line in lines[1:]]
    scale = 180.0 / np.pi * 1e-3  # degrees per mN m
    header = "frequency_rad_s,q_pitch_deg/Qpitch_mNm re,q_pitch_deg/Qpitch_mNm im,q_pitch_deg/Qpitch_mNm coherence"
    text = "\n".join([header, *(f"{f!r},{scale * x!r},{scale * y!r},0.99" for f, x, y in rows)])
    (tmp_path / "other.csv").write_text(text)
    read = read_job(job(responses="other.csv"), folder=tmp_path)
    assert read.loops[0].designs[0].responses == text
    assert outcomes(read, [exact.controller])[0].closed.claims["responses from model, relative"] < 1e-9


def test_a_check_of_a_given_controller_is_judged_on_the_file_of_its_design_too(of_file: OfFile) -> None:
    _, found, closed = of_file
    [outcome] = outcomes(found, [closed.controller])
    wanted = next(one for one in closed.results if "measured responses" in one.name)
    got = next(one for one in outcome.closed.results if "measured responses" in one.name)
    assert got.value == pytest.approx(wanted.value, rel=1e-9)
