"""What a page shows of designs that a method makes depends on that page alone, not on what was designed elsewhere."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from app.test_saving import LOOP, TWO
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.background import DesignPending
from platform_ctrl.app.settings import Settings
from platform_ctrl.app.tasks import decode_state, encode_state


@pytest.fixture
def bench(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """The job, whose designs are made in this process: starting others takes longer than the designs."""
    path = tmp_path_factory.mktemp("designs") / "gyro.toml"
    path.write_text(TWO)
    run = "platform_ctrl.app.background.Background.run"
    monkeypatch.setattr(run, lambda _, task, **more: task.run(lambda line: None))
    return Backend(path)


def values(bench: Backend, settings: Settings) -> list[float]:
    """Return the requirements of the settings once the selected design has been made for them."""
    there = threading.Event()
    end = bench.on_designed(there.set)
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
