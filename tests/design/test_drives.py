"""Drives in linear plants: a secant gain undoes the cosine of an elevation, friction that is fed back is a slope."""

from __future__ import annotations

import control
import numpy as np
import pytest

from driven_gimbal import FRICTION, INERTIA, RATE_HZ, SECANT, VISCOUS, driven_job
from platform_ctrl import read_job
from platform_ctrl.analysis.arrays import state_arrays
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.design import loops
from platform_ctrl.design.plants import loop_plants
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.verification.coupled import coupled_plant

ANGLES = {"Omega": [0.1, 0.1, 0.1], "angles": {"pitch": [-0.5, 1.0, 1.4]}}
TACHO = FRICTION | {"sensors": ["tacho"], "friction_rate": 0.1}


def test_a_loop_at_any_elevation_is_that_at_zero_where_the_inner_inertia_is_a_sphere() -> None:
    plants = loop_plants(read := read_job(driven_job(SECANT, operation=ANGLES)), read.loops[0])
    labels = ("nominal", "pitch = -0.5 rad", "pitch = 1 rad", "pitch = 1.4 rad")
    zero, low, high, beyond = (plants.response[plants.labels.index(label)] for label in labels)
    for one in (low, high):
        np.testing.assert_allclose(one, zero, rtol=0.0, atol=1e-12 * np.abs(zero).max())
    # Beyond the limit of 5 only a part of the cosine is undone.
    np.testing.assert_allclose(beyond[:, 0, 0], 5.0 * np.cos(1.4) * zero[:, 0, 0], rtol=1e-9)
    without = loop_plants(read := read_job(driven_job(operation=ANGLES)), read.loops[0])
    np.testing.assert_allclose(
        without.response[without.labels.index("pitch = 1 rad")][:, 0, 0], np.cos(1.0) * zero[:, 0, 0], rtol=1e-9
    )


def test_the_coupled_check_has_the_secant_gain() -> None:
    job = read_job(driven_job(SECANT, operation=ANGLES))
    K = control.ss(
        [], [], [], -np.eye(2), 1.0 / RATE_HZ, inputs=["gyro", "pitch_gyro"], outputs=["Qouter", "Qinner"], name="K"
    )
    w = np.array([1.0, 30.0, 300.0])
    zero, moved = (
        frequency_response(
            state_arrays(coupled_plant(job, linearise(job.platform, q=np.array([0.0, q])), [K]), ""), w, -3
        )
        for q in (0.0, 1.0)
    )
    np.testing.assert_allclose(moved, zero, rtol=0.0, atol=1e-9 * np.abs(zero).max())


def test_friction_that_is_fed_back_is_a_slope_of_further_plants() -> None:
    job = read_job(driven_job(TACHO, operation=ANGLES))
    plants = loop_plants(job, job.loops[0])
    fed = [k for k, label in enumerate(plants.labels) if label.startswith("friction that is fed forward at rest")]
    assert len(fed) == 4
    assert {plants.groups[k] for k in fed} == {"friction"}
    # 2 J w' = -d w + u, with u = k w of the sample held: both bodies turn about the axis.
    period, slope = 1.0 / RATE_HZ, TACHO["friction"] / TACHO["friction_rate"]
    decay = np.exp(-VISCOUS / (2.0 * INERTIA) * period)
    for k in fed:
        poles = np.linalg.eigvals(plants.A[k])
        expected = decay + (1.0 - decay) / VISCOUS * slope
        assert np.abs(poles - expected).min() == pytest.approx(0.0, abs=1e-12)
    assert np.abs(np.linalg.eigvals(plants.A[0])).max() <= 1.0 < expected


def test_what_the_base_shows_changes_no_plant() -> None:
    with_drive, without = (
        loop_plants(job := read_job(driven_job(*drives, operation=ANGLES)), job.loops[0])
        for drives in ((FRICTION,), ())
    )
    assert with_drive.labels == without.labels
    np.testing.assert_array_equal(with_drive.A, without.A)


@pytest.mark.parametrize(("friction_rate", "stable"), [(0.01, True), (0.001, False)])
def test_friction_that_is_fed_back_too_steeply_is_judged_unstable(friction_rate: float, stable: bool) -> None:
    (outcome,) = loops(read_job(driven_job(TACHO | {"friction_rate": friction_rate})))
    (decay,) = (one for one in outcome.closed.results if one.name == "minimum decay rate, worst case")
    assert decay.passed is stable
    assert (decay.value > 0.0) is stable
