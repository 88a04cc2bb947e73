"""What a page shows of designs that a method makes depends on that page alone, not on what was designed elsewhere."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.test_saving import LOOP, TWO
from platform_ctrl.app.backend import Backend
from platform_ctrl.app.designs import DesignPending
from platform_ctrl.app.saving import checked_settings, decode_state, encode_state
from platform_ctrl.app.settings import Settings
from platform_ctrl.design.tuning import OptionEffects
from platform_ctrl.errors import DesignError, InputError


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Backend]:
    """The job, whose designs are made in this process: starting others takes longer than the designs."""
    path = tmp_path_factory.mktemp("designs") / "gyro.toml"
    path.write_text(TWO)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "platform_ctrl.app.designs.TaskRunner.run", lambda _, task, progress, cancelled: task.run(progress)
        )
        yield Backend(path)


@pytest.fixture(scope="module")
def start(bench: Backend) -> Settings:
    """The page at the LQG design of the job as it stands."""
    settings = bench.chosen(bench.start(), design="lqg")
    return designed(bench, settings)


@pytest.fixture(scope="module")
def redesigned(bench: Backend, start: Settings) -> Settings:
    """The page after another torque was allowed, and the design made."""
    settings = bench.moved(start, "largest_torque", 1.3 * start.options[LOOP]["lqg"]["largest_torque"])
    return designed(bench, settings)


def designed(bench: Backend, settings: Settings) -> Settings:
    """Return the settings once the selected design has been made for them."""
    there = threading.Event()
    end = bench.on_designed(there.set)
    try:
        pending = "is being designed" in " ".join(bench.picture(settings).notes)
    except DesignPending:
        pending = True
    assert not pending or there.wait(60.0)
    end()
    return settings


def column(influence: OptionEffects, slider: str) -> Any:
    return influence.change[:, influence.options.index(slider)]


def values(bench: Backend, settings: Settings) -> list[float]:
    return [one.value for one in bench.picture(settings).requirements]


def test_after_a_redesign_and_a_reset_the_page_and_its_arrows_are_those_of_the_start(
    bench: Backend, start: Settings, redesigned: Settings
) -> None:
    first = bench.influence(start)
    assert values(bench, redesigned) != values(bench, start)
    # Whatever was moved on the way, and in whatever order it goes back.
    away = bench.moved(redesigned, "spin 11", 1.1 * start.spins["11"])
    back = bench.moved(away, "spin 11", start.spins["11"])
    back = bench.moved(back, "largest_torque", start.options[LOOP]["lqg"]["largest_torque"])
    assert back.data() == start.data()
    again = bench.influence(back)
    assert again.options == first.options
    np.testing.assert_array_equal(again.change, first.change)
    np.testing.assert_array_equal(again.ratios, first.ratios)


def test_a_rotor_outside_the_loop_does_nothing_to_it(bench: Backend, start: Settings, redesigned: Settings) -> None:
    for settings in (start, redesigned, bench.chosen(start, design="by hand")):
        influence = bench.influence(settings)
        for slider in ("spin 6", "spin 8"):
            np.testing.assert_array_equal(column(influence, slider), 0.0)
        assert np.abs(column(influence, "spin 11")).max() > 1e-3


def test_the_controller_stays_as_it_was_made_while_the_plant_is_moved(bench: Backend, redesigned: Settings) -> None:
    K = bench._loops.caged(redesigned)[0].controller
    moved = bench.moved(redesigned, "spin 11", 1.1 * redesigned.spins["11"])
    loop, [note] = bench._loops.caged(moved)
    assert "was made for other settings" in note
    np.testing.assert_array_equal(loop.controller.A, K.A)
    # The arrow of a rotor says what this controller makes of it.
    after = bench.picture(bench.moved(redesigned, "spin 11", 1.05 * redesigned.spins["11"]))
    ratios = np.array([one.ratio for one in after.requirements])
    influence = bench.influence(redesigned)
    np.testing.assert_allclose(influence.ratios + column(influence, "spin 11"), ratios, rtol=5e-3, atol=5e-3)


def test_what_one_page_designs_changes_nothing_on_another(bench: Backend, start: Settings) -> None:
    mine = bench.moved(start, "spin 11", 1.07 * start.spins["11"])
    before, arrows = values(bench, mine), bench.influence(mine)
    # Another page: other numbers at the same plant, and the same numbers at just this plant.
    other = bench.moved(mine, "recovery", 2.0 * start.options[LOOP]["lqg"]["recovery"])
    for settings in (other, mine.but(designed_for={})):
        theirs = designed(bench, settings)
        assert values(bench, theirs) != before
        assert values(bench, mine) == before
        np.testing.assert_array_equal(bench.influence(mine).change, arrows.change)


def test_a_link_contains_the_conditions_of_a_design(bench: Backend, start: Settings, redesigned: Settings) -> None:
    mine = bench.moved(redesigned, "spin 11", 1.07 * start.spins["11"])
    again = decode_state(bench, encode_state(bench, mine))
    assert again.data() == mine.data()
    assert values(bench, again) == values(bench, mine)
    # Where it is not there it is made again, for what it was made for.
    other = Backend(bench.path)  # type: ignore[arg-type]
    there = threading.Event()
    other.on_designed(there.set)
    with pytest.raises(DesignError, match="is being designed"):
        other.picture(again)
    assert there.wait(60.0)
    np.testing.assert_allclose(values(other, again), values(bench, mine), rtol=1e-6)
    other.close()


@pytest.mark.parametrize(
    "given",
    [
        3,
        {LOOP: 3},
        {LOOP: {"lqr": {}}},
        {LOOP: {"lqg": {"rate_hz": 2000.0}}},
        {LOOP: {"lqg": {"rate": 2000.0}}},
        {LOOP: {"lqg": {"options": {}, "rate_hz": -1, "delay": 0, "spins": {}, "Omega": [0, 0, 0]}}},
        {LOOP: {"lqg": {"options": {"comb": 1}, "rate_hz": 1, "delay": 0, "spins": {}, "Omega": [0, 0, 0]}}},
        {LOOP: {"lqg": {"options": {}, "rate_hz": 1, "delay": 0, "spins": {}, "Omega": [0, 0]}}},
    ],
)
def test_a_damaged_link_says_what_is_wrong_with_it(bench: Backend, given: object) -> None:
    with pytest.raises(InputError, match=r"must|is unknown"):
        checked_settings(bench, {"designed_for": given})
