"""What the page shows and saves of loops that are shaped: commanded, made by methods, disturbed, over one another."""

from __future__ import annotations

import math
import threading
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.test_saving import LOOP, TWO
from camera_job import camera_job, tracking_loop
from commanded_gimbal import RATE_HZ, commanded_job
from platform_ctrl import design, read_job, verification
from platform_ctrl.analysis.system import System
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.background import DesignPending
from platform_ctrl.app.fragments import job_verdict, loop_verdict
from platform_ctrl.app.job_parts import ChipState
from platform_ctrl.app.pictures import Drawing, Picture
from platform_ctrl.app.settings import Settings, with_options
from platform_ctrl.app.tasks import decode_state, encode_state
from platform_ctrl.cli import main
from platform_ctrl.common.files import toml
from platform_ctrl.design.methods import METHODS
from platform_ctrl.job.quantities import HZ
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.verification.controllers import outcomes_from, read_controllers
from platform_ctrl.verification.coupled import coupled_check

RATE_LIMITS = {"overshoot": 0.5, "settling_time": 9.0}
TRACKING = tracking_loop({"disk_margin": 0.5, "settling_time": 9.0}, "loop", "heading", name="own")


def job_of(*loops: dict[str, Any], reading: str = "gyro", **rate_design: Any) -> dict[str, Any]:
    job = commanded_job([{"reading": reading, "step": 0.01}], **rate_design)
    job["loop"][0]["limits"] = RATE_LIMITS
    job["plant"]["attitude_sensor"][0]["delay"] = 0.005
    job["loop"] += loops
    job["manoeuvre"][0] |= {"duration": 0.01}
    return job


def test_a_design_with_a_filter_is_measured_as_a_whole_and_delivered_with_it() -> None:
    job = read_job(job_of(command={"filter_hz": 4.0, "acceleration": True}))
    (outcome,) = design.loops(job)
    page = Backend(job)
    shown = {one.name: one.value for one in page.picture(page.start()).requirements}
    for one in outcome.closed.results:
        assert shown[one.name] == pytest.approx(one.value, rel=1e-6)
    (closed,) = page.loops.controllers(page.start())
    assert closed.input_labels == outcome.closed.controller.input_labels
    np.testing.assert_allclose(closed.A, outcome.closed.controller.A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(closed.D, outcome.closed.controller.D, rtol=1e-9)
    page.close()


def test_a_tracking_loop_at_every_20th_sample_is_shaped_checked_simulated_and_saved(tmp_path: Path) -> None:
    data = job_of(TRACKING | {"rate_hz": RATE_HZ / 20}, reading="heading")
    path, saved = tmp_path / "job.toml", tmp_path / "saved.toml"
    path.write_text(toml(data), encoding="utf-8")
    page, job = Backend(path), read_job(path)
    found = verification.check_job(job, design.loops(job))
    start = page.start()
    assert [one.name for one in page.read.loops] == ["loop", "track"]
    parts = list(page.job_parts.parts(start))
    for one in page.job_parts.open(parts):
        page.job_parts.measure(one)
    states = {one.chip.label: one for one in page.job_parts.states(parts)}
    assert list(states) == ["loop", "track", "coupled", "runs"]
    for outcome in found.loops:
        at = page.chosen(start, loop=outcome.spec.name)
        shown = {one.name: one.value for one in page.picture(at).requirements}
        for one in outcome.closed.results:
            assert shown[one.name] == pytest.approx(one.value, rel=1e-6, abs=1e-12)
    at = page.chosen(start, loop="track")
    whole = page.loops.coupled(start)
    np.testing.assert_allclose(whole.simultaneous.alpha, found.coupled.simultaneous.alpha, rtol=1e-6)
    run = page.simulate(start, "slew")
    np.testing.assert_allclose(run.q, found.runs[0].trajectory.q, rtol=1e-6, atol=1e-12)
    faster = page.moved(at, "crossover_hz", 1.2 * at.options["track"]["own"]["crossover_hz"])
    page.save(faster, saved)
    again = outcomes_from(read_job(saved), read_controllers(tmp_path / "saved.controllers.json", read_job(saved)))
    assert [one.spec.name for one in again] == ["track", "loop"]
    reopened = Backend(saved)
    assert reopened.start().loop == "loop"
    crossover = [one.options["track"]["own"]["crossover_hz"] for one in (reopened.start(), faster)]
    assert crossover[0] == pytest.approx(crossover[1], rel=1e-3)
    page.close()


def test_a_tracking_loop_around_indirect_stabilisation_behind_a_filter_is_measured_as_designed() -> None:
    """Commands stand behind what the rate loop reads, the base's rates behind these."""
    shaped = {"filter_hz": 10.0, "acceleration": True}
    data = job_of(TRACKING | {"limits": {"disk_margin": 0.3}}, reading="heading", command=shaped)
    data["plant"]["rate_sensor"] += [{"name": "own", "body": "yaw", "axis": [0, 0, 1], "frame": "parent"}]
    data["plant"]["rate_sensor"] += [{"root_axis": 3}]
    fed = {"sensors": ["Omega3"], "into": "reading"}
    data["loop"][0]["design"][0] |= {"sensors": ["own"], "feedforward": fed}
    job = read_job(data)
    tracking, inner = design.loops(job)
    page = Backend(job)
    for one, name in ((inner, "loop"), (tracking, "track")):
        at = page.chosen(page.start(), loop=name)
        shown = {result.name: result.value for result in page.picture(at).requirements}
        for result in one.closed.results:
            assert shown[result.name] == pytest.approx(result.value, rel=1e-6, abs=1e-12), (name, result.name)
    for made, own in zip(page.loops.controllers(page.start()), (tracking, inner), strict=True):
        assert made.input_labels == own.closed.controller.input_labels
        assert made.output_labels == own.closed.controller.output_labels
        np.testing.assert_allclose(made.D, own.closed.controller.D, rtol=1e-9, atol=1e-12)
    page.close()


@pytest.fixture
def bench(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """The job, whose designs are made in this process: starting others takes longer than the designs."""
    path = tmp_path_factory.mktemp("designs") / "gyro.toml"
    path.write_text(TWO)
    run = "platform_ctrl.app.background.Background.run"
    monkeypatch.setattr(run, lambda _, task, **more: task(lambda line: None))
    return Backend(path)


def values(bench: Backend, settings: Settings) -> list[float]:
    """Return the requirements of the settings once the selected design has been made for them."""
    there = threading.Event()
    end = bench.loops.listen(there.set)
    try:
        picture = bench.picture(settings)
    except DesignPending:
        assert there.wait(60.0)
        picture = bench.picture(settings)
    end()
    return [one.value for one in picture.requirements]


def test_a_design_is_that_of_its_numbers_whatever_was_designed_meanwhile(bench: Backend) -> None:
    start = bench.chosen(bench.start(), design="lqg")
    first = values(bench, start)
    faster = bench.moved(start, "largest_torque", 1.3 * start.options[LOOP]["lqg"]["largest_torque"])
    assert values(bench, faster) != first
    assert values(bench, start) == first
    back = bench.moved(faster, "largest_torque", start.options[LOOP]["lqg"]["largest_torque"])
    assert back.data() == start.data()
    # A link has its numbers: where it is not there it is made again.
    again = decode_state(bench, encode_state(bench, faster))
    other = Backend(bench.path)  # type: ignore[arg-type]
    np.testing.assert_allclose(values(other, again), values(bench, faster), rtol=1e-6)
    other.close()


AMPLITUDE, SINE_HZ = 0.1, 5.0


def test_a_sine_ends_in_the_amplitude_that_the_gain_from_the_base_has_at_its_frequency() -> None:
    sine = {"kind": "rate", "axis": 2, "frequency_hz": SINE_HZ, "amplitude": AMPLITUDE}
    run = {"name": "shaken", "mode": "caged", "duration": 2.0, "sine": [sine]}
    backend = Backend(read_job(camera_job(manoeuvre=[run])))
    start = backend.start()
    shown = backend.picture(start)
    backend.close()
    assert start.axis == 2
    over_time, gain = shown.Omega_time, shown.Omega_frequency
    assert (over_time.title, over_time.units[:2]) == ("shaken", ("rad/s", "rad/s"))
    assert over_time.signals[:2] == ("los_rate1", "los_rate2")
    last = over_time.t > 1.2
    wave = np.exp(-2j * math.pi * SINE_HZ * over_time.t[last])
    design = np.stack([wave.real, -wave.imag], axis=1)
    found = [np.hypot(*np.linalg.lstsq(design, one[last], rcond=None)[0]) for one in over_time.values[:2]]
    expected = AMPLITUDE * np.interp(SINE_HZ, gain.frequency * HZ, gain.gain)
    assert np.hypot(*found) == pytest.approx(expected, rel=2e-2)


@pytest.mark.parametrize("kind", ["rate", "pointing"])
def test_a_commanded_reading_ends_at_its_command(kind: str) -> None:
    reading = "gyro" if kind == "rate" else "heading"
    job = commanded_job([{"reading": reading, "step": 0.02, "at": 0.1}], kind=kind)
    job["manoeuvre"][0]["duration"] = 4.0
    backend = Backend(read_job(job))
    shown = backend.picture(backend.start()).Omega_time
    backend.close()
    assert shown.title == "slew"
    assert not shown.values[:, shown.t < 0.1].any()
    assert shown.values[0, -1] == pytest.approx(0.02, rel=1e-2)
    assert shown.drive[-1] == 1.0


def test_a_page_starts_at_the_axis_that_the_job_is_about() -> None:
    turned = {"name": "turn", "mode": "caged", "axis": 3, "rate": 0.1, "rise": 0.1, "hold": 0.1, "duration": 1.0}
    without = camera_job(operation={"Omega": [0.0, 0.2, 0.1]})
    for job, axis in ((camera_job(manoeuvre=[turned]), 3), (without, 2)):
        backend = Backend(read_job(job))
        assert backend.start().axis == axis
        backend.close()


SHIPPED = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
SERVO = "stabilisation"


@pytest.fixture(scope="module")
def servo_bench() -> Backend:
    """The shipped job with a second, slower servo, and nothing that has to be designed first."""
    job = tomllib.loads(SHIPPED.read_text())
    for loop in job["loop"]:
        loop["design"] = [one for one in loop["design"] if one["method"] in ("classical", "platform-servo")]
        loop["use"] = loop["design"][0]["name"]
    job["loop"][-1]["design"].append({"name": "slow", "method": "platform-servo", "crossover_hz": 2.0})
    return Backend(read_job(job, folder=SHIPPED.parent))


@pytest.fixture(scope="module")
def settings(servo_bench: Backend) -> Settings:
    """Not as the job has it: another caging loop inside, another plant, and another axis."""
    inner = servo_bench.moved(servo_bench.start("caging 9-10"), "crossover_hz", 61.0)
    return servo_bench.moved(servo_bench.chosen(inner, loop=SERVO), "position_hz", 0.8).but(
        axis=2, channel="M2", overlays=("slow",)
    )


@pytest.fixture(scope="module")
def picture(servo_bench: Backend, settings: Settings) -> Picture:
    return servo_bench.picture(settings)


def _expect_the_loop_of(over: Drawing, own: Picture) -> None:
    """Compare a drawing over another one with the picture of its design, at the frequencies that both have."""
    _, ours, theirs = np.intersect1d(over.bode.frequency, own.bode.frequency, return_indices=True)
    assert len(ours) > 20
    np.testing.assert_allclose(over.bode.response[ours], own.bode.response[theirs], rtol=1e-9)
    np.testing.assert_allclose(over.bode.phase[ours], own.bode.phase[theirs], atol=1e-6)
    np.testing.assert_allclose(over.Omega_frequency.gain[ours], own.Omega_frequency.gain[theirs], rtol=1e-9)
    np.testing.assert_allclose(np.sort_complex(over.poles), np.sort_complex(own.poles), rtol=1e-9)
    for one, other in ((over.step, own.step), (over.Omega_time, own.Omega_time)):
        assert (one.title, one.signals, one.units) == (other.title, other.signals, other.units)
        np.testing.assert_array_equal(one.t, other.t)
        np.testing.assert_array_equal(one.values, other.values)
        assert not one.low.size


def test_another_servo_over_the_picture_is_what_its_own_picture_draws(
    servo_bench: Backend, settings: Settings, picture: Picture
) -> None:
    [over] = picture.overlays
    assert over.settings.design == "slow"
    own = servo_bench.picture(servo_bench.chosen(settings, design="slow"))
    _expect_the_loop_of(over, own)
    assert np.abs(over.poles).max() > 0.0
    assert not np.allclose(np.sort_complex(over.poles), np.sort_complex(picture.poles), rtol=1e-3)


CLASSICAL = METHODS["classical"]


@pytest.fixture(scope="module")
def shipped() -> Backend:
    return Backend(SHIPPED)


def _controller(bench: Backend, settings: Settings) -> System:
    return bench.loops.caged(settings)[0].controller


def _differ(one: System, other: System) -> bool:
    return any(a.shape != b.shape or not np.array_equal(a, b) for a, b in zip(one[:4], other[:4], strict=True))


def _every_part(bench: Backend, settings: Settings) -> Settings:
    for part in bench.parts(settings):
        settings = bench.with_part(settings, part.name, True)
    return settings


def _expect_that_sliders_are_what_acts(bench: Backend, settings: Settings) -> None:
    settings = _every_part(bench, settings)
    before = _controller(bench, settings)
    own = {slider.name: slider for slider in bench.sliders(settings) if slider.name in CLASSICAL.options}
    assert own
    for name, slider in own.items():
        assert _differ(_controller(bench, bench.moved(settings, name, 0.97 * slider.value)), before), name
    # With every part that there is, even those that are not offered, what has no slider moves nothing.
    all_on = {settings.loop: {settings.design: tuple(CLASSICAL.parts)}}
    loaded = settings.but(optional={**settings.optional, **all_on})
    off = {name for name, kind in CLASSICAL.options.items() if name not in own and kind.part != "spin_notch"}
    for name in off:
        assert not _differ(_controller(bench, with_options(loaded, {name: 3.0})), _controller(bench, loaded)), name


@pytest.mark.parametrize("kind", ["caged-gyro", "control-moment-gyro"])
def test_the_sliders_of_a_classical_loop_are_those_that_make_its_controller(kind: str, tmp_path: Path) -> None:
    assert main(["new", "mine", "--kind", kind, "-o", str(tmp_path)]) == 0
    bench = Backend(tmp_path / "mine.toml")
    for spec in bench.read.loops:
        for one in spec.designs:
            if one.method == "classical":
                _expect_that_sliders_are_what_acts(bench, bench.chosen(bench.start(spec.name), design=one.name))


def test_a_slider_that_is_fixed_and_hidden_again_stays_in_the_link(shipped: Backend) -> None:
    settings = shipped.start("caging 9-10").but(fixed=frozenset({"notch_hz", "damping_hz"}))
    hidden = shipped.with_part(settings, "notch", False)
    servo = shipped.chosen(hidden, loop="stabilisation")
    for one in (hidden, servo):
        assert decode_state(shipped, encode_state(shipped, one)).data() == one.data()


def chips(backend: Backend, settings: Settings, measure: bool = True) -> dict[str, ChipState]:
    parts = list(backend.job_parts.parts(settings))
    for one in backend.job_parts.open(parts) if measure else ():
        backend.job_parts.measure(one)
    return {one.chip.key: one for one in backend.job_parts.states(parts)}


def test_each_chip_has_the_least_margin_of_its_part(backend: Backend) -> None:
    settings = backend.start()
    found = chips(backend, settings)
    assert list(found) == ["loop caging 9-10", "coupled", "runs"]
    picture = backend.picture(settings)
    loop = found["loop caging 9-10"]
    assert loop.worst is not None
    assert loop.worst.margin == min(one.margin for one in picture.requirements)
    assert (loop.checked, loop.missed) == (
        len(picture.requirements),
        sum(not one.passed for one in picture.requirements),
    )
    # The coupled check of the controllers as `save` writes them.
    controllers = backend.loops.controllers(settings)
    whole = coupled_check(read_job(backend.path), linearise(backend.read.platform), controllers)
    assert found["coupled"].worst is not None
    assert found["coupled"].worst.margin == pytest.approx(min(one.margin for one in whole.results), rel=1e-9)


def test_a_job_is_met_only_when_all_of_its_parts_are(backend: Backend) -> None:
    settings = backend.moved(backend.start(), "crossover_hz", 40.5)  # for which no test has flown a run
    states = chips(backend, settings)
    verdict, line = job_verdict(list(states.values()))
    every = sum(one.count for one in states.values())
    assert every == 3 + 2 + 1 + 2  # limits and stability of the loop, coupled, runs
    assert states["runs"].checked == 0
    assert verdict == "open"
    assert line == f"{every - 2} of {every} met, 2 not checked"
    # One loop alone never claims all of a job's requirements.
    words = loop_verdict(backend.picture(settings))[1]
    assert "all" not in words.lower().split()
    assert "loop" in words


def test_a_run_counts_for_the_settings_that_it_was_simulated_with(backend: Backend) -> None:
    settings = backend.start()
    backend.simulate(settings, "0.5 rad/s about axis 1")
    state = chips(backend, settings)["runs"]
    assert (state.checked, state.count) == (1, 2)
    assert state.worst is not None
    assert state.worst.subject == "0.5 rad/s about axis 1"
    moved = backend.moved(settings, "crossover_hz", 41.0)
    after = chips(backend, moved, measure=False)
    assert all(one.checked == 0 for one in after.values())
    # Returning to the settings returns to the results.
    assert chips(backend, settings, measure=False)["runs"].checked == 1
