"""The strip of the whole job: what its chips say is what `check` measures, and every part of the job has one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")

from app.test_page import JOB
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.fragments import job_verdict, loop_verdict
from platform_ctrl.app.job_parts import ChipState
from platform_ctrl.app.settings import Settings
from platform_ctrl.design.methods import read_job
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.verification.coupled import coupled_check


@pytest.fixture(scope="module")
def backend(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Backend]:
    path = tmp_path_factory.mktemp("parts") / "gyros.toml"
    path.write_text(JOB, encoding="utf-8")
    made = Backend(path)
    yield made
    made.close()


def chips(backend: Backend, settings: Settings, measure: bool = True) -> dict[str, ChipState]:
    parts = backend.job_parts.parts(settings)
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
    controllers = backend._loops.controllers(settings)
    whole = coupled_check(read_job(backend.path), linearise(backend.read.platform), controllers)
    assert found["coupled"].worst is not None
    assert found["coupled"].worst.margin == pytest.approx(min(one.margin for one in whole.results), rel=1e-9)


def test_a_job_is_met_only_when_all_of_its_parts_are(backend: Backend) -> None:
    settings = backend.start()
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
