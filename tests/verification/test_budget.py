"""The budget of a job's line of sight, against a model of one gimbal written down by hand."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

import platform_ctrl as pc
from platform_ctrl.analysis.hybrid_plant import Density, HybridPlant, RandomDisturbance, SampleNoise
from platform_ctrl.analysis.jitter_budget import JitterBudget
from platform_ctrl.analysis.system import System
from platform_ctrl.cli import main
from platform_ctrl.design import loops
from platform_ctrl.design.plants import plants_of
from platform_ctrl.design.sections import gain
from platform_ctrl.errors import ArgumentError, NotFoundError
from platform_ctrl.job.quantities import assumed_words
from platform_ctrl.job.reading import job_data
from platform_ctrl.job.requirements import requirement
from platform_ctrl.simulation import Scenario, TimeTable, simulate
from platform_ctrl.verification import check_job
from platform_ctrl.verification.budget import line_of_sight_budget
from platform_ctrl.verification.budget_result import (
    assumption,
    unstable_results,
    waterfalls,
)
from platform_ctrl.verification.result_file import result_record
from platform_ctrl.verification.simulated import simulated_budget
from report_jobs import page_html
from simulation import test_gimbal_torques as wind

PERIOD, DELAY, LAG = 0.001, 0.0007, 0.0003
INERTIA, DAMPING, UNBALANCE, FIELD = 0.01, 0.02, 2e-3, 98.1
HZ = [1.0, 10.0, 200.0]
DENSITIES = {"pitch rate": [1e-3, 1e-3, 1e-6], "vibration": [0.5, 2.0, 0.1], "bearing": [1e-7, 1e-7, 1e-8]}
FILE = """
schema = 2
name = "camera"
sampling = {{ rate_hz = 1000, delay = 0.0007 }}
operation = {{ Omega = [0.1, 0.1, 0.1] }}

[plant]
schema = 1
name = "one-axis camera"
source = "assumed"
root = {{ name = "base", inertia = [9.0, 9.0, 9.0] }}
gimbal = [{{ name = "pitch", parent = "base", axis = [0, 1, 0], inertia = [0.01, 0.01, 0.01] }}]
torquer = [{{ gimbal = "pitch", lag = 0.0003 }}]
pickoff = [{{ gimbal = "pitch" }}]
friction = [{{ gimbal = "pitch", viscous = 0.02{friction} }}]
unbalance = [{{ body = "pitch", moment = [2e-3, 0.0, 0.0] }}]
line_of_sight = {{ body = "pitch", direction = [1, 0, 0] }}

[[plant.rate_sensor]]
name = "gyro"
body = "pitch"
axis = [0, 1, 0]
noise_rms = 1e-4
quantisation = 2e-5
delay = 0.001

[[loop]]
name = "pitch"
kind = "caging"
gimbals = ["pitch"]
use = "lead"
design = [{{ name = "lead", method = "classical" }}]

[budget]
from_hz = 0.5
to_hz = 150.0
exposure = [0.02]
spatial_frequencies = [1e-3, 2000.0]
{more}
"""
SOURCE = """
[[budget.source]]
name = "{name}"
{place}
frequencies_hz = [1.0, 10.0, 200.0]
densities = {densities}
"""
PLACES = {
    "pitch rate": 'kind = "base-rate"\naxis = 2',
    "vibration": 'kind = "specific-force"\naxis = 3',
    "bearing": 'kind = "torque"\ngimbal = "pitch"',
}
ALL = "".join(SOURCE.format(name=name, place=PLACES[name], densities=DENSITIES[name]) for name in PLACES)


def job(tmp_path: Path, more: str = "", friction: str = "") -> Any:
    file = tmp_path / "camera.toml"
    file.write_text(FILE.format(more=more + ALL, friction=friction), encoding="utf-8")
    return pc.read_job(file)


def controllers(gain: float = 0.5) -> list[control.StateSpace]:
    system = ([[1.0]], [[1.0]], [[-gain * 0.02]], [[-gain]], PERIOD)
    return [control.ss(*system, inputs=["gyro"], outputs=["Qpitch"], name="pitch")]


def by_hand(damping: float = DAMPING, coherence: np.ndarray | None = None, weight: float = 0.0) -> Any:
    """J ω' = u + d (Ω − ω) − k φ + m f + Q of the payload's inertial rate ω = φ'."""
    A = np.array([[-damping / INERTIA, -weight / INERTIA], [1.0, 0.0]])
    B = np.array([[1.0, damping, UNBALANCE, 1.0], [0.0] * 4]) / INERTIA
    C, D = np.array([[1.0, 0.0]] * 3), np.zeros((3, 4))
    D[2, 1] = -1.0
    plant = HybridPlant(
        plant=System(A, B, C, D),
        controls=1,
        measured=1,
        period=PERIOD,
        delay=DELAY,
        lag=np.array([LAG]),
        reading_delay=(1,),
        integrated=(True, False),
    )
    # The tables end at 150 Hz, on their straight lines.
    spectra = []
    for densities in DENSITIES.values():
        turns = 2.0 * math.pi * np.array(HZ)
        law = partial(np.interp, xp=np.log(turns), fp=np.log(densities))
        spectra.append(
            Density(knots=np.append(turns[:2], 300.0 * math.pi), density=lambda w, law=law: np.exp(law(np.log(w))))
        )
    sources: list[Any] = [
        RandomDisturbance(name=name, inputs=(k,), spectra=(one,))
        for k, (name, one) in enumerate(zip(DENSITIES, spectra, strict=True))
    ]
    if coherence is not None:
        sources = [RandomDisturbance(name="all", inputs=(0, 1, 2), spectra=tuple(spectra), coherence=coherence)]
    # Noise in 1000 Hz behind a filter at the Nyquist frequency, 500 Hz.
    sources += [
        SampleNoise(name="noise", measured=0, rms=1e-4 * math.sqrt(0.5)),
        SampleNoise(name="steps", measured=0, rms=2e-5 / math.sqrt(12.0)),
    ]
    K = controllers()[0]
    arrays = System(K.A, K.B, K.C, K.D, PERIOD)
    return JitterBudget(plant, sources, (0.02,), 2.0 * math.pi * 0.5).of(arrays, 1e-8)


def test_the_budget_of_one_gimbal_is_that_of_its_equation(tmp_path: Path) -> None:
    found = line_of_sight_budget(job(tmp_path), controllers())
    expected = by_hand()
    assert found.names == ("pitch rate", "vibration", "bearing", "noise of gyro", "quantisation of gyro")
    # Looking along 1, the first axis across is 2: elevation.
    assert found.rms[:, 0] == pytest.approx(expected.rms[:, 0], rel=1e-4)
    assert found.total[0] == pytest.approx(expected.total[0], rel=1e-4)
    assert found.rms[:, 1:] == pytest.approx(0.0, abs=1e-15)
    assert found.shares[:, 0].sum() == pytest.approx(1.0, rel=1e-9)
    assert found.cumulative[..., -1] == pytest.approx(found.rms**2, rel=1e-6)
    window, own = found.windows[0], expected.windows[0]
    assert window.displacement[0] == pytest.approx(own.displacement[0], rel=1e-4)
    assert window.smear[0] == pytest.approx(math.sqrt(12.0) * own.smear[0], rel=1e-4)
    assert window.jitter[0] == pytest.approx(own.jitter[0], rel=1e-4)
    assert window.contrast[:, 0] == pytest.approx(1.0)
    assert 0.0 < window.contrast[0, 1] < 1.0
    assert not found.friction.frictions


def hanging(tmp_path: Path) -> Any:
    """Return the job with gravity along axis 1: it holds the payload in space, however the base turns."""
    read = job(tmp_path)
    return dataclasses.replace(
        read, platform=dataclasses.replace(read.platform, mode="held", gravity=[FIELD, 0.0, 0.0])
    )


def test_gravity_does_not_turn_with_a_held_base(tmp_path: Path) -> None:
    found, expected = line_of_sight_budget(hanging(tmp_path), controllers()), by_hand(weight=FIELD * UNBALANCE)
    assert found.rms[:, 0] == pytest.approx(expected.rms[:, 0], rel=1e-4)
    assert abs(by_hand().rms[0, 0] / expected.rms[0, 0] - 1.0) > 5e-3


def test_a_loop_sees_the_tilt_of_its_base_up_to_one_radian(tmp_path: Path) -> None:
    read = hanging(tmp_path)
    spec = dataclasses.replace(read.loops[0], kind="rate", sensors=("gyro",))
    plants = plants_of(dataclasses.replace(read, loops=(spec,)), spec)
    w = np.array([0.01, 0.02, 0.1, 0.5, 3.0, 60.0])
    found = plants.disturbances.at(w).read[0, :, 0, -2] * np.exp(1j * w * PERIOD)  # a sample late
    s, k = 1j * w, UNBALANCE * FIELD
    tilt = -1j / np.maximum(w, 0.1)  # rates are at most 0.1 rad/s
    moved = INERTIA * s**2 + DAMPING * s + k
    np.testing.assert_allclose(found, 1.0 - s * (INERTIA * s + k * tilt) / moved, rtol=1e-9)
    np.testing.assert_allclose(found[2:], (DAMPING * s / moved)[2:], rtol=1e-9)
    result = requirement("Omega rejection", 1e9).check(plants, gain(np.zeros((1, 1)))._replace(dt=PERIOD))
    assert "gravity fixed in space, tilts of at most 1 rad" in result.evidence


def test_correlated_sources_count_together_in_the_total_alone(tmp_path: Path) -> None:
    between = '[[budget.correlation]]\nbetween = ["pitch rate", "vibration"]\ncoherence = 0.64\nphase = 0.5\n'
    found = line_of_sight_budget(job(tmp_path, between), controllers())
    coherence = np.eye(3, dtype=complex)
    # A base that accelerates along 3 leaves mass that lies ahead along 1 behind: a torque of +m f about axis 2.
    coherence[0, 1] = 0.8 * np.exp(-0.5j)
    coherence[1, 0] = coherence[0, 1].conjugate()
    assert found.total[0] == pytest.approx(by_hand(coherence=coherence).total[0], rel=1e-4)
    assert found.rms[:, 0] == pytest.approx(by_hand().rms[:, 0], rel=1e-4)
    assert found.total[0] != pytest.approx(by_hand().total[0], rel=1e-3)


def test_a_budget_says_whose_cogging_it_leaves_out(tmp_path: Path) -> None:
    """The motor's in the plant, which runs have; a source of its harmonics stands for it."""
    motor = '[[plant.motor]]\ngimbal = "pitch"\nrotor_inertia = 1e-6\ncogging = [[6.0, 0.02, 0.0]]\n'
    turns = 'kind = "torque"\ngimbal = "pitch"\nharmonics = [[6, 0.02]]\nturning_rate = 1.0\n'
    words = "without cogging and ripple of pitch, which runs show"
    for source in ("", f'[[budget.source]]\nname = "motor"\n{turns}'):
        of = job(tmp_path, f"limits = {{ jitter = 1.0 }}\n{motor}{source}")
        [found] = line_of_sight_budget(of, controllers()).results
        assert found.evidence.endswith(words) == (not source)
        assert (f"that the budget of the line of sight is {words}" in assumed_words(of)) == (not source)


def test_sines_are_lines_and_those_outside_of_the_band_do_not_count(tmp_path: Path) -> None:
    sines = '[[budget.source]]\nname = "{}"\nkind = "torque"\ngimbal = "pitch"\nsines = {}\n'
    lines = sines.format("motor", "[[20.0, 1e-3, 0.0], [160.0, 1.0, 0.0]]") + sines.format(
        "other", "[[20.0, 1e-3, 3.141592653589793]]"
    )
    found = line_of_sight_budget(job(tmp_path, "limits = { contrast = 0.01 }\n" + lines), controllers())
    [contrast] = found.results
    assert contrast.evidence.endswith("sines count as Gaussian")
    assert found.rms[0, 0] == pytest.approx(found.rms[1, 0], rel=1e-9)
    assert found.rms[0, 0] > 0.0
    # In opposite phase they cancel.
    assert found.total[0] == pytest.approx(by_hand().total[0], rel=1e-4)


def multisine(rms: float) -> np.ndarray:
    """Rows of frequency, amplitude and phase: 40 lines from 0.5 to 20 Hz, less with frequency."""
    f = 0.5 * np.arange(1, 41)
    a = np.minimum(1.0, 2.0 / f)
    phase = np.random.default_rng(3).uniform(0.0, 2.0 * math.pi, len(f))
    return np.column_stack([f, rms * math.sqrt(2.0) * a / np.linalg.norm(a), phase])


def simulated(of: Any, rows: np.ndarray, closed: list[control.StateSpace] | None = None) -> float:
    """The rms of the simulated elevation over a period of the base's rate, from the third second on."""
    t = np.arange(0.0, 5.0005, 1e-3)
    rate = np.sum(rows[:, 1] * np.cos(2.0 * math.pi * np.outer(t, rows[:, 0]) + rows[:, 2]), axis=1)
    table = TimeTable(t=t, values=np.outer(np.minimum(1.0, t) * rate, [0.0, 1.0, 0.0]), smooth=True)
    period = of.sampling.period
    run = Scenario(
        platform=of.platform,
        mode="caged",
        duration=5.0 - period,
        delay=of.sampling.delay,
        Omega_table=table,
        drives=of.drive_laws,
        resolvers=of.resolvers,
    )
    found = simulate(run, closed or controllers(), period=period, step=1e-4, noise=False)
    return float(found.line_of_sight[found.t > 3.0 - 1e-9][: round(2.0 / period), 3].std())


def shaken(tmp_path: Path, rows: np.ndarray, friction: str = "", more: str = "") -> Any:
    """The camera on a base that turns by `rows`, with a gyro that neither steps nor is noisy."""
    source = f'[[budget.source]]\nname = "base"\nkind = "base-rate"\naxis = 2\nsines = {rows.tolist()}\n'
    text = FILE.format(more=source + more, friction=friction).replace("noise_rms = 1e-4\nquantisation = 2e-5\n", "")
    (tmp_path / "shaken.toml").write_text(text.replace("from_hz = 0.5", "from_hz = 0.4"), encoding="utf-8")
    return pc.read_job(tmp_path / "shaken.toml")


def test_the_budget_is_the_rms_of_the_non_linear_simulation(tmp_path: Path) -> None:
    rows = multisine(0.01)
    of = shaken(tmp_path, rows)
    assert line_of_sight_budget(of, controllers()).total[0] == pytest.approx(simulated(of, rows), rel=1e-4)


def test_dry_friction_shakes_as_in_the_non_linear_simulation(tmp_path: Path) -> None:
    rows = multisine(0.01)
    of = shaken(tmp_path, rows, ", coulomb = 4e-4, coulomb_rate = 3e-4")
    found, expected = line_of_sight_budget(of, controllers()), simulated(of, rows)
    assert found.total[0] == pytest.approx(expected, rel=0.04)
    # Its equivalent damping alone is less than what shakes.
    assert found.rms[0, 0] < 0.96 * expected
    assert assumption(found.friction, "", of.budget.has_sines).endswith("dry friction; sines count as Gaussian")


@pytest.mark.parametrize("law", ["false", "true"])
def test_bristles_shake_as_in_the_simulation_where_they_bend_give_way_and_slide(tmp_path: Path, law: str) -> None:
    """The base turns by 1.6 mrad rms; the bristles break away at 60, 0.8 and 0.06 mrad."""
    rows, without = multisine(0.01), line_of_sight_budget(shaken(tmp_path, multisine(0.01)), controllers()).total[0]
    bent = []
    for coulomb in (0.3, 4e-3, 3e-4):
        bristles = f", coulomb = {coulomb}, bristle_stiffness = 5.0, bristle_damping = 0.01, elastoplastic = {law}"
        of = shaken(tmp_path, rows, bristles)
        found = line_of_sight_budget(of, controllers())
        assert found.total[0] == pytest.approx(simulated(of, rows), rel=0.15)
        assert found.friction.valid[0]
        assert ("runs show up to a quarter more" in assumption(found.friction, "")) == (coulomb < 0.3)
        assert abs(found.total[0] / without - 1.0) > 0.05
        bent.append(float(found.friction.bristles[3, 0]))
    assert bent[0] < 0.05 < 0.3 < bent[1] < 0.75 < bent[2] < 0.85


DRIVE = """
[[plant.rate_sensor]]
name = "base_rate"
body = "base"
axis = [0, 1, 0]
delay = {late}

[[plant.rate_sensor]]
name = "tacho"
gimbal = "pitch"

[[drive]]
torquer = "Qpitch"
friction = {friction}
friction_rate = 3e-4
sensors = ["{sensor}"]
"""


@pytest.mark.parametrize(
    ("sensor", "friction", "late", "error"),
    [
        ("base_rate", 3.2e-4, 0.002, 0.01),
        ("tacho", 3.2e-4, 0.002, 0.01),
        # What is left is small, and less of a Gaussian.
        ("base_rate", 4e-4, 0.002, 0.05),
    ],
)
def test_friction_that_is_fed_forward_shakes_by_what_is_left_as_in_the_simulation(
    tmp_path: Path, sensor: str, friction: float, late: float, error: float
) -> None:
    rows = multisine(0.01)
    drive = DRIVE.format(sensor=sensor, friction=friction, late=late)
    of = shaken(tmp_path, rows, ", coulomb = 4e-4, coulomb_rate = 3e-4", drive)
    found, expected = line_of_sight_budget(of, controllers()), simulated(of, rows)
    assert found.total[0] == pytest.approx(expected, rel=error)
    # Without the drive: 47 urad.
    assert found.total[0] < 30e-6
    assert f"less the {friction:.3g} N m that are fed forward" in found.friction.statement[0]
    assert assumption(found.friction, "") == "linear budget, with dry friction less what is fed forward"


LIMITS = "limits = { jitter = 1e-3, jitter_per_axis = 1e-9, windowed_jitter = 1.0, smear = 1e-9 }\n"


def test_limits_are_judged(tmp_path: Path) -> None:
    limited = job(tmp_path, LIMITS)
    found = line_of_sight_budget(limited, controllers())
    assert [one.passed for one in found.results] == [True, False, True, False]
    assert not found.passed
    assert [one.value for one in found.results][:2] == pytest.approx([found.jitter, found.total[0]])
    # A source may have any name.
    file = tmp_path / "camera.toml"
    file.write_text(file.read_text(encoding="utf-8").replace('"bearing"', '"jitter"'), encoding="utf-8")
    named = line_of_sight_budget(pc.read_job(file), controllers())
    assert named.results[0].value == pytest.approx(found.jitter, rel=1e-12)
    assert not unstable_results(job(tmp_path))
    unstable = unstable_results(limited)
    assert [one.name for one in unstable] == [one.name for one in found.results]
    assert not any(one.passed for one in unstable)
    with pytest.raises(ArgumentError, match="must be stable"):
        line_of_sight_budget(limited, controllers(50.0))


def test_a_limit_is_judged_at_the_gimbal_angles_where_it_is_worst(tmp_path: Path) -> None:
    # A force along 1 has no lever on mass that lies ahead along 1, until the payload looks up.
    text = FILE.format(more=LIMITS + ALL, friction="").replace("axis = 3", "axis = 1\nlimit = 1.0")
    angles = "operation = { Omega = [0.1, 0.1, 0.1], angles = { q_pitch = [-0.3, 0.5] } }"
    (tmp_path / "up.toml").write_text(text.replace("operation = { Omega = [0.1, 0.1, 0.1] }", angles), encoding="utf-8")
    found = line_of_sight_budget(pc.read_job(tmp_path / "up.toml"), controllers())
    assert found.rms[1] == pytest.approx(0.0, abs=1e-15)
    worst = next(one for one in found.results if one.name.endswith("from vibration"))
    assert worst.value == pytest.approx(math.sin(0.5) * by_hand().rms[1, 0], rel=1e-4)
    assert "q_pitch = 0.5 rad" in worst.evidence


def test_the_verdict_of_a_job_counts_the_limits_and_its_report_has_a_section(tmp_path: Path) -> None:
    loop = '[[loop]]\nname = "rate"\nkind = "rate"\nsensors = ["gyro"]\ngimbals = ["pitch"]\nuse = "PI"\n'
    loop += 'design = [{ name = "PI", method = "pi" }]\n\n[budget]'
    head, _, rest = FILE.format(more="runs = 4\n" + LIMITS + ALL, friction=", coulomb = 2e-4").partition("[[loop]]")
    (tmp_path / "rate.toml").write_text(head + loop + rest.partition("[budget]")[2], encoding="utf-8")
    limited = pc.read_job(tmp_path / "rate.toml")
    result = check_job(limited, loops(limited))
    assert result.budget is not None
    assert set(result.budget.results) <= set(result.requirements)
    assert not result.passed
    assert result_record(result)["budget"]["total"]["across"] == pytest.approx(result.budget.jitter)
    # Its runs stand beside it; a job that is written has them.
    shown = result.simulated_budget
    assert shown is not None
    assert result_record(result)["budget"]["simulated"]["rms"] == pytest.approx(list(shown.rms))
    again = pc.read_job(job_data(limited)).budget
    assert again is not None
    assert again.runs == shown.runs == 4
    page = page_html(result)
    assert all(words in page for words in ("4 runs of the non-linear plant", "vibration", "Dry friction", "rms up to"))


def test_a_budget_that_dry_friction_leaves_none_of_is_not_met_and_the_rest_has_its_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stuck(*_: object) -> None:
        raise NotFoundError("budget: bearings stick and slip")

    monkeypatch.setattr("platform_ctrl.verification.verdict.line_of_sight_budget", stuck)
    limited = job(tmp_path, LIMITS)
    result = check_job(limited, loops(limited))
    missed = [one for one in result.requirements if one.subject == "line of sight"]
    assert len(missed) == len(unstable_results(limited))
    assert not any(one.passed for one in missed)
    assert {one.reason for one in missed} == {"budget: bearings stick and slip"}
    assert result.budget is None
    assert result.coupled is not None
    assert "bearings stick and slip" in page_html(result)


def test_the_command_prints_a_table_of_80_columns_or_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    found = line_of_sight_budget(job(tmp_path, LIMITS), controllers())
    K = controllers()[0]
    record: dict[str, Any] = {"name": "pitch", "inputs": ["gyro"], "outputs": ["Qpitch"], "dt": PERIOD, "delay": DELAY}
    record |= {name: getattr(K, name).tolist() for name in "ABCD"}
    Path("k.json").write_text(json.dumps({"schema": 1, "controllers": [record]}), encoding="utf-8")
    assert main(["budget", "camera.toml", "--controllers", "k.json"]) == 1
    out = capsys.readouterr().out
    table = out.splitlines()
    assert max(map(len, table)) <= 80
    assert any(line.startswith("vibration") and line.split()[2] == f"{1e6 * found.rms[1, 0]:.4g}" for line in table)
    assert any(line.startswith("NOT MET  line-of-sight jitter of one axis") for line in out.splitlines())
    assert main(["budget", "camera.toml", "--controllers", "k.json", "--json"]) == 1
    data = json.loads(capsys.readouterr().out)
    assert data["sources"][0]["rms"] == pytest.approx(found.rms[0].tolist(), rel=1e-12)
    assert data["total"]["across"] == pytest.approx(found.jitter, rel=1e-12)
    assert data["windows"][0]["exposure"] == 0.02
    assert [one["passed"] for one in data["requirements"]] == [one.passed for one in found.results]
    assert main(["budget", "camera.toml", "--controllers", "k.json", "--simulate", "4", "--seed", "3", "--json"]) == 1
    data = json.loads(capsys.readouterr().out)["simulated"]
    assert (data["runs"], data["seed"]) == (4, 3)
    assert data["ratio"] == pytest.approx(np.hypot(*data["rms"][:2]) / np.hypot(*data["linear"][:2]), rel=1e-12)
    Path("still.toml").write_text(FILE.format(more="", friction="").partition("[budget]")[0], encoding="utf-8")
    assert main(["budget", "still.toml", "--controllers", "k.json"]) == 2
    assert "there is no [budget]" in capsys.readouterr().err


def test_the_steps_of_a_waterfall_end_at_the_total_the_largest_first(tmp_path: Path) -> None:
    correlated = job(tmp_path, '[[budget.correlation]]\nbetween = ["pitch rate", "bearing"]\ncoherence = 0.7\n')
    budget = correlated.budget
    assert budget is not None
    found = line_of_sight_budget(correlated, controllers())
    one, other, both = waterfalls(budget, found)
    assert [fall.axis for fall in (one, other, both)] == [*found.axes[:2], "both axes"]
    assert one.high[-1] == pytest.approx(found.total[0] ** 2, rel=1e-9)
    assert both.high[-1] == pytest.approx(found.jitter**2, rel=1e-9)
    assert one.low[0] == 0.0
    np.testing.assert_array_equal(one.low[1:], one.high[:-1])
    # Correlated sources come last: what they do together is not a sum of mean squares.
    assert one.names[-1] == "correlation"
    assert np.all(np.diff(one.rms[:-1]) <= 0.0)
    assert one.rms[0] == found.rms[:, 0].max()
    assert float(one.shares.sum()) == pytest.approx(1.0, rel=1e-9)
    # The camera turns about its pitch axis alone.
    assert other.total == 0.0
    assert not other.names


def spread(found: Any) -> float:
    """Return half of the 95 % interval over the rms of the first axis."""
    return float((found.high[0] - found.low[0]) / (2.0 * found.rms[0]))


def test_where_all_is_linear_runs_have_the_rms_of_the_budget(tmp_path: Path) -> None:
    found = simulated_budget(job(tmp_path), controllers(), 192, time=0.5)
    # Four standard errors; the interval has two.
    assert found.rms[0] == pytest.approx(found.linear[0], rel=2.0 * spread(found))
    assert spread(found) < 0.1
    assert found.low[0] < found.rms[0] < found.high[0]
    # A camera that turns about its pitch axis alone looks nowhere else.
    assert found.rms[1] == pytest.approx(0.0, abs=1e-12)
    assert found.left_out == ()


def test_the_motion_rises_from_rest_so_that_no_step_saturates_a_motor(tmp_path: Path) -> None:
    free = job(tmp_path)
    assert free.budget is not None
    free = dataclasses.replace(free, budget=dataclasses.replace(free.budget, sources=free.budget.sources[:1]))
    # A step of the base's rate, 0.1 rad/s, would ask of the controller for 0.05 N m.
    (torquer,) = free.platform.torquers
    weak = dataclasses.replace(torquer, limit=0.02)
    limited = dataclasses.replace(free, platform=dataclasses.replace(free.platform, torquers=(weak,)))
    found, expected = (simulated_budget(one, controllers(), 32, time=0.5) for one in (limited, free))
    np.testing.assert_array_equal(found.rms, expected.rms)


def test_a_bearing_that_hardly_slides_is_simulated_where_the_budget_does_not_hold(tmp_path: Path) -> None:
    limits = "limits = { jitter = 1.0, windowed_jitter = 1.0, contrast = 0.01 }\n"
    stuck = job(tmp_path, more=limits, friction=", coulomb = 0.05, coulomb_rate = 0.05")
    budget = line_of_sight_budget(stuck, controllers())
    assert not budget.friction.valid[0]
    assert "simulate" in budget.friction.statement[0]
    assert ["state runs in [budget]" in one.reason for one in budget.results] == [True, False, False]
    assert not any(one.passed for one in budget.results)
    few, again = (simulated_budget(stuck, controllers(), 8, time=0.25) for _ in range(2))
    assert math.isfinite(few.ratio)
    np.testing.assert_array_equal(few.rms, again.rms)
    assert np.any(simulated_budget(stuck, controllers(), 8, seed=1, time=0.25).rms != few.rms)


def test_the_budget_has_the_mode_that_wind_excites_as_runs_have_it() -> None:
    """Of both axes across only the second turns with the gimbal; there the mode doubles the rms."""
    of_sight = wind.MODE | {"participation": {"Qpan": wind.PHI, "los_angle2": wind.SEEN}}
    gusts = {
        "name": "wind",
        "kind": "torque",
        "gimbal": "pan",
        "frequencies_hz": [5.0, 20.0],
        "densities": [1e-2, 1e-2],
    }

    def rms(modes: dict[str, Any]) -> Any:
        budget = {"from_hz": 2.0, "to_hz": 40.0, "source": [gusts]}
        read = pc.read_job(wind.DATA | {"plant": wind.PLANT | modes, "budget": budget})
        found = simulated_budget(read, [loops(read)[0].closed.controller], 6, seed=2, time=5.0)
        return found.rms[1], found.linear[1]

    simulated, linear = rms({"mode": [of_sight]})
    assert simulated == pytest.approx(linear, rel=0.1)
    assert linear > 1.5 * rms({})[1]
