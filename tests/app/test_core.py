"""The designer's pictures against independent routes: python-control's joining, certified designs, time responses."""

from __future__ import annotations

import math
from pathlib import Path

import control
import numpy as np
import pytest

import platform_ctrl as pc
from camera_job import camera_job, camera_loop
from platform_ctrl import analysis, design
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.system import System
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.closed_loops import ClosedLoops
from platform_ctrl.app.pictures import Picture
from platform_ctrl.app.settings import Settings
from platform_ctrl.app.tasks import decode_state, encode_state
from platform_ctrl.design.loop import closed_loop_poles, given_design, sampled_plant
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.verification.coupled import coupled_check

JOB = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
LOOP = "caging 9-10"


@pytest.fixture(scope="module")
def bench() -> Backend:
    return Backend(JOB)


@pytest.fixture(scope="module")
def settings(bench: Backend) -> Settings:
    """The loop 9-10, moved, the notch off."""
    out = bench.start(LOOP)
    for slider, number in (("crossover_hz", 61.0), ("lead_hz", 6.0)):
        out = bench.moved(out, slider, number)
    return bench.with_part(out, "notch", False)


@pytest.fixture(scope="module")
def picture(bench: Backend, settings: Settings) -> Picture:
    return bench.picture(settings)


def _closed(bench: Backend, settings: Settings) -> tuple[Job, LoopSpec, PlantSet, System]:
    """The loop as the package's own design route builds it from the settings' job."""
    job = bench.loops.job(settings)
    spec = next(one for one in job.loops if one.name == settings.loop)
    loop = ClosedLoops(bench.read, None).caged(settings)[0]
    plants = plants_of(job, spec)
    return job, spec, plants, loop.controller


def test_bode_is_the_loop_broken_at_one_torquer_with_the_others_closed(
    bench: Backend, settings: Settings, picture: Picture
) -> None:
    _, _, plants, K = _closed(bench, settings)
    controller = K.to_control(plants.angles, plants.torques)
    # Q10 is closed first, then the loop transfer of Q9 alone is taken: no sensitivity is inverted.
    j = plants.torques.index(settings.channel)
    other = [k for k in range(len(plants.torques)) if k != j]
    inner = System(K.A, K.B, K.C[other], K.D[other], K.dt).to_control(plants.angles, ["Q10"])
    closed = analysis.closed_loop(sampled_plant(plants), inner)
    single = System(K.A, K.B, K.C[[j]], K.D[[j]], K.dt).to_control(plants.angles, ["Q9"])
    plant = closed[list(plants.angles), ["Q9"]]
    direct = analysis.frequency_response(analysis.loop_transfer(plant, single), picture.bode.frequency)[0, 0]
    np.testing.assert_allclose(picture.bode.response, direct, rtol=1e-6, atol=1e-9)
    both = analysis.loop_transfer(sampled_plant(plants), controller)
    L = np.moveaxis(analysis.frequency_response(both, picture.bode.frequency), -1, 0)
    S = np.linalg.inv(np.eye(2) + L)[:, j, j]
    np.testing.assert_allclose(picture.bode.response, 1.0 / S - 1.0, rtol=1e-6, atol=1e-9)
    assert (
        np.abs(np.exp(1j * np.radians(picture.bode.phase)) * np.abs(picture.bode.response) - direct).max()
        < 1e-6 * np.abs(direct).max()
    )


def test_what_noise_and_loads_come_to_is_what_python_control_closes(
    bench: Backend, settings: Settings, picture: Picture
) -> None:
    _, _, plants, K = _closed(bench, settings)
    P, K = sampled_plant(plants), K.to_control(plants.angles, plants.torques)
    P, K = (control.ss(one.A, one.B, one.C, one.D, plants.period) for one in (P, K))
    # u = K y: positive feedback; a torque beside the controller's, and noise on all readings.
    loads, noise = control.feedback(P, K, sign=1), control.feedback(K, P, sign=1)
    j, w = plants.torques.index(settings.channel), picture.bode.frequency
    PS, KS = (one.frequency_response(w).complex for one in (loads, noise))
    np.testing.assert_allclose(picture.closed.PS, np.linalg.norm(PS[:, j], axis=0), rtol=1e-6)
    np.testing.assert_allclose(picture.closed.KS, np.linalg.norm(KS[j], axis=0), rtol=1e-6)
    assert picture.closed.units == ("N m/rad", "rad/(N m)")


def test_poles_and_requirements_are_those_of_the_certified_design(
    bench: Backend, settings: Settings, picture: Picture
) -> None:
    _, spec, plants, K = _closed(bench, settings)
    design = next(d for d in spec.designs if d.name == settings.design)
    made = given_design(spec, design.name, K, plants, design.method)
    assert [(r.name, r.passed) for r in picture.requirements] == [(r.name, r.passed) for r in made.results]
    np.testing.assert_allclose([r.value for r in picture.requirements], [r.value for r in made.results], rtol=1e-6)
    s = continuous_poles(closed_loop_poles(plants, made.controller), plants.period)
    present = np.sort_complex(np.round(picture.poles[np.isfinite(picture.poles)], 3))
    np.testing.assert_allclose(present, np.sort_complex(np.round(s[0][np.isfinite(s[0])], 3)), rtol=1e-6)
    assert picture.measured.margins.disk == pytest.approx(made.measures.disk_margin[0], rel=1e-6)  # type: ignore[union-attr]
    assert picture.measured.margins.bandwidth == pytest.approx(made.measures.bandwidth, rel=2e-2)  # type: ignore[union-attr]
    at_one = int(np.argmin(np.abs(picture.locus.values - 1.0)))
    assert picture.locus.values[at_one] == 1.0


def test_time_responses_are_those_of_the_closed_loop_sample_by_sample(
    bench: Backend, settings: Settings, picture: Picture
) -> None:
    _, _, plants, K = _closed(bench, settings)
    closed = analysis.closed_loop(sampled_plant(plants), K.to_control(plants.angles, plants.torques))
    step = picture.step
    count = round(step.t[-1] / plants.period) + 1
    size = float(step.title.split()[0]) * 1e-3
    y = analysis.time_response(
        closed[list(plants.angles), ["Q9"]], np.arange(count) * plants.period, np.full((1, count), size)
    )
    every = round(step.t[1] / plants.period)
    np.testing.assert_allclose(step.values[:2], y[:, ::every], rtol=1e-7, atol=1e-9 * np.abs(y).max())
    assert np.all(step.low <= step.values)
    assert np.all(step.values <= step.high)


def test_the_manoeuvre_is_what_the_held_rate_makes_of_the_closed_loop(
    bench: Backend, settings: Settings, picture: Picture
) -> None:
    _, _, plants, K = _closed(bench, settings)
    shown = picture.Omega_time
    every = round(shown.t[1] / plants.period)
    rate = 1.0
    t = np.arange(every * (len(shown.t) - 1) + 1) * plants.period
    assert shown.drive.max() == pytest.approx(1.0)
    A, B, C = plants.A[0], plants.B_Omega[0][:, :1], plants.C[0]
    # One sample after another, the plainest of all routes.
    x, k = np.zeros(len(A)), np.zeros(len(K.A))
    ramp = np.where(t < 0.5, t / 0.5, np.where(t < 1.5, 1.0, np.where(t < 2.0, (2.0 - t) / 0.5, 0.0)))
    u = rate * 0.5 * (1.0 - np.cos(np.pi * ramp))
    y = np.zeros((2, len(t)))
    for n in range(len(t)):
        y[:, n] = C @ x
        torque = K.C @ k + K.D @ y[:, n]
        k = K.A @ k + K.B @ y[:, n]
        x = A @ x + plants.B[0] @ torque + B[:, 0] * u[n]
    np.testing.assert_allclose(shown.values[:2], y[:, ::every], rtol=1e-6, atol=1e-9 * np.abs(y).max())


def test_margins_of_the_channel_put_a_pole_on_the_boundary(
    bench: Backend, settings: Settings, picture: Picture
) -> None:
    _, _, plants, K = _closed(bench, settings)
    j = plants.torques.index(settings.channel)
    for factor in (picture.measured.margins.gain_up, picture.measured.margins.gain_down):
        if 0.0 < factor < math.inf:
            scale = np.ones(len(plants.torques))
            scale[j] = factor
            turned = System(K.A, K.B, scale[:, None] * K.C, scale[:, None] * K.D, K.dt)
            z = closed_loop_poles(plants.only([0]), turned.to_control(plants.angles, plants.torques))[0]
            assert np.abs(z).max() == pytest.approx(1.0, abs=2e-3)
    assert 10.0 < picture.measured.margins.phase < 90.0
    assert picture.measured.margins.delay > 0.0


def test_the_band_holds_every_plant_of_the_set(bench: Backend, settings: Settings, picture: Picture) -> None:
    bode = picture.bode
    assert bode.band.shape == (len(bode.labels), len(bode.band_frequency))
    for label in (bode.labels[1], bode.labels[-1]):
        alone = bench.picture(settings.but(plant=label, band=False)).bode
        row = bode.labels.index(label)
        gain = np.interp(np.log(bode.band_frequency), np.log(alone.frequency), np.log(np.abs(alone.response)))
        np.testing.assert_allclose(np.log(np.abs(bode.band[row])), gain, atol=0.05)
        # The phase of the set lies on the sheet of the curve that is shown.
        row = bode.band_phase[row]
        turn = np.degrees(
            np.angle(
                np.exp(
                    1j
                    * np.radians(
                        row
                        - np.interp(
                            bode.band_frequency, alone.frequency, np.degrees(np.unwrap(np.angle(alone.response)))
                        )
                    )
                )
            )
        )
        assert np.abs(turn).max() < 5.0
    without = bench.picture(settings.but(band=False))
    assert not without.bode.band_frequency.size
    assert [r.value for r in without.requirements] == [r.value for r in picture.requirements]


def test_requirements_of_all_loops_are_those_of_check(bench: Backend) -> None:
    settings = bench.moved(bench.start("stabilisation"), "crossover_hz", 5.0)
    picture = bench.picture(settings)
    job = bench.loops.job(settings)
    controllers = ClosedLoops(bench.read, None).controllers(settings)
    expected = coupled_check(job, linearise(job.platform), controllers)
    assert [(r.name, r.passed) for r in picture.requirements] == [(r.name, r.passed) for r in expected.results]
    np.testing.assert_allclose(
        [r.value for r in picture.requirements], [r.value for r in expected.results], rtol=2e-3, atol=2e-4
    )
    s = continuous_poles(expected.poles, job.sampling.period)
    ours, theirs = (np.sort(np.abs(one[np.isfinite(one) & (np.abs(one) < 5e3)])) for one in (picture.poles, s))
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)
    j = expected.channels.index(settings.channel)
    assert picture.measured.margins.disk == pytest.approx(expected.coupled[j], rel=1e-3)
    L = analysis.loop_transfer(expected.plant, expected.controller)
    response = np.moveaxis(analysis.frequency_response(L, picture.bode.frequency), -1, 0)
    S = np.linalg.inv(np.eye(len(expected.channels)) + response)[:, j, j]
    np.testing.assert_allclose(picture.bode.response, 1.0 / S - 1.0, rtol=1e-5, atol=1e-8)
    # In the end a constant torque turns the platform by no more: the angle loop holds it.
    assert abs(picture.step.values[0, -1] - picture.step.values[0, -2]) < 0.02 * abs(picture.step.values[0, -1])


def test_influence_is_what_the_moved_slider_does(bench: Backend, settings: Settings, picture: Picture) -> None:
    found = bench.influence(settings)
    slider = next(k for k in bench.sliders(settings) if k.name == "crossover_hz")
    after = bench.picture(bench.moved(settings, "crossover_hz", 1.05 * slider.value))
    exact = np.array([a.ratio - b.ratio for a, b in zip(after.requirements, picture.requirements, strict=True)])
    column = found.change[:, found.options.index("crossover_hz")]
    np.testing.assert_allclose(column, exact, atol=0.02)
    assert found.requirements == tuple(r.name for r in picture.requirements)


def test_an_unstable_loop_has_a_picture_that_says_so(bench: Backend, settings: Settings) -> None:
    wild = bench.picture(bench.moved(settings, "crossover_hz", 900.0))
    assert not wild.stable
    assert wild.measured.margins.disk == 0.0
    assert math.isnan(wild.measured.margins.phase)
    assert not all(r.passed for r in wild.requirements)
    for values in (wild.step.values, wild.Omega_time.values, wild.bode.phase, wild.Omega_frequency.gain):
        assert np.isfinite(values).all()


@pytest.mark.parametrize(
    ("slider", "number"),
    [
        ("crossover_hz", math.nan),
        ("crossover", 1.0),
        ("lead_hz", "fast"),
    ],
)
def test_an_impossible_slider_value_is_an_error_of_one_line(
    bench: Backend, settings: Settings, slider: str, number: float
) -> None:
    with pytest.raises(ArgumentError) as error:
        bench.moved(settings, slider, number)
    assert "\n" not in str(error.value)
    assert slider in str(error.value)


def test_a_section_that_is_added_has_sliders_is_in_the_link_and_is_saved(bench: Backend, tmp_path: Path) -> None:
    job = tmp_path / "job.toml"
    start = bench.start(LOOP)
    for section, on in (("lag", True), ("notch", False)):
        changed = bench.with_part(start, section, on)
        own = {slider.name for slider in bench.sliders(changed) if slider.part == section}
        assert bool(own) == on
        changed = bench.moved(changed, "lag_ratio", 2.0) if on else changed
        assert decode_state(bench, encode_state(bench, changed)).data() == changed.data()
        again = Backend(bench.save(changed, job, overwrite=True).job)
        names = {one.name: one.value for one in again.sliders(again.start(LOOP))}
        assert names == {one.name: pytest.approx(one.value) for one in bench.sliders(changed)}
        again.close()
        assert bench.picture(changed).bode.response[0] != bench.picture(start).bode.response[0] or not on
    assert bench.with_part(bench.with_part(start, "notch", False), "notch", True).data() == start.data()
    # No other method has sections to add.
    assert not bench.parts(bench.chosen(start, design="LQG"))


@pytest.mark.parametrize(("kind", "method"), [("rate", "pi"), ("pointing", "classical")])
def test_rate_and_pointing_loops_are_shown_as_they_are_designed(kind, method):
    """The page closes the same controller around the same plants: its numbers are those of the design."""
    angles = {"Omega": [0.2, 0.2, 0.2], "angles": {"q_el": [0.6]}}
    loop = camera_loop(kind, method, use="pi", limits={"disk_margin": 0.3})
    job = pc.read_job(camera_job(operation=angles, loop=loop))
    designed = design.loops(job)[0].closed
    backend = Backend(job)
    try:
        start = backend.start()
        shown = backend.picture(start)
        found = {one.name: one.value for one in shown.requirements}
        for one in designed.results:
            assert found[one.name] == pytest.approx(one.value, rel=1e-9)
        assert shown.step.units == (("rad/s",) if kind == "rate" else ("rad",)) * 2 + ("N m",) * 2
        slider = next(one for one in backend.sliders(start) if one.name.endswith("crossover_hz"))
        slower = backend.picture(backend.moved(start, slider.name, 0.5 * slider.value))
        assert slower.measured.margins.crossover < 0.7 * shown.measured.margins.crossover
        assert ("second" in {part.name for part in backend.parts(start)}) == (kind == "rate")
    finally:
        backend.close()
