"""The next step that the page proposes helps as it says, and snapshots keep what was there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")


from app.test_session import Driven
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.page.session import Session

JOB = Path(__file__).parents[2] / "examples" / "three_gyro_platform.toml"
THREE = "caging 4-5-7"


@pytest.fixture(scope="module")
def backend() -> Iterator[Backend]:
    made = Backend(JOB)
    yield made
    made.close()


def test_two_steps_take_a_loop_with_two_violated_limits_within_all_of_them(backend: Backend) -> None:
    settings = backend.start(THREE)
    for left in (2, 1, 0):
        picture = backend.picture(settings)
        assert sum(not one.passed for one in picture.requirements) == left
        step = backend.next_step(settings, backend.influence(settings))
        assert step is not None
        # What it promises is what a picture of its settings shows.
        after = {one.name: one for one in backend.picture(step.settings).requirements}
        tightest = min(picture.requirements, key=lambda one: one.margin)
        assert step.gain.before.name == tightest.name
        assert step.gain.after.margin == after[tightest.name].margin > step.gain.before.margin == tightest.margin
        assert max(one.ratio for one in after.values()) < max(one.ratio for one in picture.requirements)
        losses = {one.name: min(one.margin, 1.0) - min(after[one.name].margin, 1.0) for one in picture.requirements}
        if step.cost is None:
            assert max(losses.values()) <= 1e-3
        else:
            assert step.cost.before.name == max(losses, key=lambda name: losses[name])
        # One slider moves, and by no more than a fifth.
        moved = {
            name: step.settings.options[THREE]["classical"][name] / x
            for name, x in settings.options[THREE]["classical"].items()
            if step.settings.options[THREE]["classical"][name] != x
        }
        assert list(moved) == [step.slider.name]
        assert 0.79 < moved[step.slider.name] < 1.21
        settings = step.settings


def test_no_step_moves_a_fixed_slider(backend: Backend) -> None:
    settings = backend.start(THREE)
    influence = backend.influence(settings)
    step = backend.next_step(settings, influence)
    assert step is not None
    other = backend.next_step(settings.but(fixed=frozenset({step.slider.name})), influence)
    assert other is not None
    assert other.slider.name != step.slider.name


class Told(Driven):
    """A session with its real pictures, and what it said."""

    def __init__(self, backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
        self.said: dict[str, Any] = {}
        super().__init__(backend, monkeypatch)

    def picture(self, settings: Any, on_drawn: Any = None, ghosts: Any = ()) -> Any:
        return self._picture(settings, on_drawn, ghosts)

    def _responded(self, name: str, old: object, new: str) -> None:
        super()._responded(name, old, new)
        self.said |= json.loads(new)


@pytest.fixture
def told(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> Iterator[Told]:
    made = Told(backend, monkeypatch)
    yield made
    made.session.close(None)


def overlays(session: Session) -> list[str]:
    return list(session.plots.sources["overlays"].data["name"])


def test_a_step_is_previewed_over_the_plots_and_applied(told: Told) -> None:
    session, settings = told.session, told.session.settings
    step = told.backend.next_step(settings, told.backend.influence(settings))
    assert step is not None
    session.compared.found(step)
    assert told.said["next"]["slider"] == step.slider.name
    assert "→" in told.said["next"]["gain"]
    told.request("preview", on=True)
    told.settle()
    assert overlays(session) == ["next step"]
    ghost = session.plots.sources["overlays"].data["gains"][0]
    told.request("apply")
    told.settle()
    assert overlays(session) == []
    assert session.settings.options == step.settings.options
    assert told.state["undo"]
    # The ghost was where the loop is now.
    now = session.plots.sources["loop"].data
    then = told.backend.picture(settings, ghosts=[("after", step.settings)]).bode
    np.testing.assert_allclose(
        np.interp(1.0, now["frequency"], now["gain"]),
        np.interp(1.0, then.frequency / (2 * np.pi), ghost),
        atol=0.05,
    )


def test_snapshots_keep_values_are_drawn_and_restored(told: Told) -> None:
    session = told.session
    before = session.settings
    told.request("pin")
    told.settle()
    told.request("move", moves=[{"slider": "crossover_hz", "value": 40.0}], gesture=1)
    told.settle()
    [pinned] = told.said["state"]["pinned"]
    assert pinned["name"] == "A"
    shown = {one.name: one for one in told.backend.picture(before).requirements}
    assert pinned["values"]["bandwidth"][1] == pytest.approx(shown["bandwidth"].margin)
    now = {one["name"]: one["margin"] for one in told.said["requirements"]}
    assert now["bandwidth"] != pytest.approx(shown["bandwidth"].margin)
    told.request("snapshot", name="A", act="draw")
    told.settle()
    assert overlays(session) == ["A"]
    for name in ("B", "C"):
        told.request("pin")
        told.settle()
        assert [one["name"] for one in told.said["state"]["pinned"]][-1] == name
    told.request("pin")
    told.settle()
    assert told.said["line"]["kind"] == "error"
    assert "remove one" in told.said["line"]["text"]
    told.request("snapshot", name="A", act="restore")
    told.settle()
    assert session.settings.data() == before.data()
    told.request("snapshot", name="A", act="remove")
    told.settle()
    assert overlays(session) == []
    assert [one["name"] for one in told.said["state"]["pinned"]] == ["B", "C"]
    # Each is of its own loop.
    told.request("set", name="loop", value="caging 9-10")
    told.settle()
    assert told.said["state"]["pinned"] == []
