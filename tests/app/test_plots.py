"""The page's plots hold the numbers of the picture, in both themes, and never grow."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="Bokeh is not installed")

import json
from types import SimpleNamespace

from bokeh.document import Document
from bokeh.models import Label, Model, Plot, Range1d
from scipy.spatial.transform import Rotation

from designer_pictures import broken, picture
from platform_ctrl.app.fragments import fragment
from platform_ctrl.app.pictures import run_data, tree_data
from platform_ctrl.app.plots import Plots
from platform_ctrl.app.plots.painter import Panel
from platform_ctrl.common.palette import PALETTE
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import shipped_models

HZ = 1.0 / (2.0 * np.pi)


@pytest.fixture(scope="module")
def document(plots: Plots) -> Iterator[Document]:
    out = Document()
    for root in plots.layout.values():
        out.add_root(root)
    yield out
    out.clear()


@pytest.fixture(scope="module")
def plots() -> Plots:
    """The plots of one page, with everything that the tests before have done to it."""
    return Plots()


@pytest.fixture
def fresh() -> Plots:
    return Plots()


def named(plots: Plots, kind: type[Model]) -> list[Any]:
    return [one for root in plots.layout.values() for one in root.select({"type": kind})]


def figure(plots: Plots, panel: str, k: int = 0) -> Any:
    return plots.layout[panel].select_one({"name": f"{panel}-figure-{k}"})


def panel_of(plots: Plots, name: str) -> Panel:
    return next(one for one in plots.panels if one.name == name)


def colours(dark: bool) -> Any:
    return PALETTE["dark" if dark else "light"]


def drawn(plots: Plots, panel: str, k: int, name: str) -> dict[str, Any]:
    """Return the columns of what is drawn in a figure of a panel."""
    sources = panel_of(plots, panel).figures[k].sources
    return sources[name].data if name in sources else {}


def keys(plots: Plots, panel: str, dark: bool) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Return colour and dashes of each key of a panel, by its words."""
    found = panel_of(plots, panel).keys
    return {words: (colours(dark)[role], tuple(dashes)) for words, role, dashes, _ in found}


def looks(plots: Plots, panel: str) -> set[tuple[str, tuple[int, ...]]]:
    """Return colour and dashes of everything that is drawn as a line or a mark in the visible figures of a panel."""
    out = set()
    for one in panel_of(plots, panel).figures:
        if not one.plot.visible:
            continue
        for data in (source.data for source in one.sources.values() if "line_color" in source.data):
            dashes = data.get("line_dash", [[]] * len(data["line_color"]))
            out |= {(colour, tuple(dash)) for colour, dash in zip(data["line_color"], dashes, strict=True)}
        if one.sources.get("traced") is not None:
            [trace] = [each for each in one.plot.renderers if each.data_source is one.sources["traced"]]
            out.add((trace.glyph.line_color, ()))
    return out


def messages(plots: Plots) -> dict[str, str]:
    """Return what the figures say is the matter."""
    out = {}
    for name, root in plots.layout.items():
        said = [one.text for one in root.select({"type": Label}) if one.visible]
        out[name] = said[0] if said else ""
    return out


def test_the_loop_is_drawn_in_hertz_decibels_and_degrees(plots: Plots) -> None:
    shown = picture()
    plots.show(shown)
    gain, phase = (drawn(plots, "bode", k, "lines") for k in (0, 1))
    assert gain["xs"][-1] == pytest.approx(shown.bode.frequency * HZ, rel=1e-6)
    assert gain["ys"][-1] == pytest.approx(20.0 * np.log10(np.abs(shown.bode.response)), abs=1e-4)
    assert phase["ys"][-1] == pytest.approx(shown.bode.phase, abs=1e-4)
    assert all(gain[name][-1].dtype == np.float32 for name in ("xs", "ys"))
    nichols = drawn(plots, "nichols", 0, "traced")
    assert nichols["x"][:-1] == pytest.approx(shown.bode.phase, abs=1e-4)
    assert nichols["at"][:-1] == pytest.approx(shown.bode.frequency * HZ, rel=1e-6)


def test_the_required_disk_margin_is_a_region_of_the_nichols_plot(plots: Plots) -> None:
    plots.show(picture())
    data = drawn(plots, "nichols", 0, "bands")
    for x, y in zip(data["xs"], data["ys"], strict=True):
        L = 10.0 ** (np.asarray(y) / 20.0) * np.exp(1j * np.radians(np.asarray(x)))
        assert np.abs(1.0 / (1.0 + L) - 0.5) == pytest.approx(np.full(len(L), 1.0 / 0.5), rel=1e-4)


@pytest.mark.parametrize("gain", [4000.0, 0.5])
def test_the_critical_point_is_in_the_nichols_plot_however_small_the_loop_is(fresh: Plots, gain: float) -> None:
    fresh.show(picture(gain, stable=False))
    view = figure(fresh, "nichols").y_range
    assert view.start < 0.0 < view.end


def test_limits_are_shaded_where_the_job_has_one(plots: Plots) -> None:
    shown = picture()
    plots.show(shown)
    assert sorted(drawn(plots, "Omega", 0, "strips")["y0"]) == pytest.approx([-1.0, 1.0])
    assert figure(plots, "Omega").yaxis[0].axis_label == "µrad"
    none = dataclasses.replace(shown.Omega_time, limit=None)
    plots.show(dataclasses.replace(shown, Omega_time=none))
    assert not drawn(plots, "Omega", 0, "strips")["y0"]


@pytest.mark.parametrize("dark", [False, True])
def test_every_key_has_colour_and_dashes_of_a_curve_that_is_drawn(fresh: Plots, dark: bool) -> None:
    fresh.dark(dark)
    shown = picture(overlays=("one", "two"))
    shown = dataclasses.replace(
        shown,
        limits={**shown.limits, "bandwidth": 5.0},
        Omega_gain=lambda shown=shown: dataclasses.replace(shown.Omega_frequency, limit=1e-3),
        Omega_time=dataclasses.replace(shown.Omega_time, limit=1e-3),
    )
    fresh.show(shown)
    panel_of(fresh, "Omega").turn()
    over_frequency = keys(fresh, "Omega", dark), looks(fresh, "Omega")
    panel_of(fresh, "Omega").turn()
    for named, drawn in (
        over_frequency,
        *((keys(fresh, panel, dark), looks(fresh, panel)) for panel in ("bode", "nichols", "locus", "step", "Omega")),
    ):
        assert named
        for words, (colour, dashes) in named.items():
            if colour == colours(dark)["muted"]:
                # Another design has the colours of its signals: its key shows the dashes.
                assert dashes in {dash for _, dash in drawn}, words
            else:
                assert (colour, dashes) in drawn, words


def test_names_from_a_job_file_are_text_and_no_markup(plots: Plots) -> None:
    plots.show(picture(overlays=("<img src=x onerror=alert(1)>",)))
    written = fragment("heading", panel=panel_of(plots, "bode"))
    assert "<img" not in written
    assert "&lt;img" in written


def test_the_closed_loop_takes_the_place_of_the_open_one(fresh: Plots) -> None:
    plots, shown = fresh, picture(overlays=("other",))
    plots.show(shown)
    visible = lambda: [one.plot.visible for one in panel_of(plots, "bode").figures]  # noqa: E731
    assert visible() == [True, True]
    panel_of(plots, "bode").turn()
    assert visible() == [False, False, True, True, True]
    S = 1.0 / (1.0 + shown.bode.response)
    *others, T_drawn, S_drawn = drawn(plots, "bode", 2, "lines")["ys"]
    np.testing.assert_allclose(S_drawn, 20.0 * np.log10(np.abs(S)), atol=1e-4)
    np.testing.assert_allclose(T_drawn, 20.0 * np.log10(np.abs(1.0 - S)), atol=1e-4)
    np.testing.assert_allclose(drawn(plots, "bode", 3, "lines")["ys"][0], shown.closed.KS, rtol=1e-6)
    assert len(others) == 3, "|S| and |T| of the other design, and the required bandwidth"
    panel_of(plots, "Omega").turn()
    assert {figure(plots, "bode", k).x_range for k in range(5)} == {figure(plots, "Omega", 2).x_range}
    band = drawn(plots, "bode", 2, "bands")
    assert min(map(min, band["ys"])) <= np.min(S_drawn) + 1e-3
    panel_of(plots, "bode").turn()
    assert visible() == [True, True, False, False, False]
    assert "others closed" in panel_of(plots, "bode").detail


def test_the_theme_changes_in_place(plots: Plots, document: Document) -> None:
    plots.dark(False)
    plots.show(picture(overlays=("other",)))
    before = {one.id for one in document.models}
    plots.dark(True)
    assert {one.id for one in document.models} == before
    # Whatever fills a figure leaves a rim of the theme before.
    assert {(one.background_fill_color, one.border_fill_color) for one in named(plots, Plot)} == {(None, None)}
    assert drawn(plots, "bode", 0, "lines")["line_color"][-2] == colours(True)["series-2"]
    plots.dark(False)
    assert drawn(plots, "bode", 0, "lines")["line_color"][-2] == colours(False)["series-2"]


@pytest.mark.parametrize("number", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_nothing_grows_however_many_pictures_are_shown(plots: Plots, document: Document, number: int) -> None:
    several = [picture(3000.0 + 500.0 * k, overlays=("a", "b")[: k % 3], plants=(0, 3, 9)[k % 3]) for k in range(6)]
    for one in several:
        plots.show(one)
    models, callbacks = len(document.models), len(document.session_callbacks)
    for k in range(number):
        plots.show(several[k % 6])
    assert (len(document.models), len(document.session_callbacks)) == (models, callbacks)
    assert document.callbacks.hold_value is None


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e300])
def test_numbers_that_are_not_finite_are_gaps_and_the_plots_say_so(plots: Plots, number: float) -> None:
    plots.show(picture())
    plots.show(broken(number))
    for source in (one for panel in plots.panels for each in panel.figures for one in each.sources.values()):
        for name, column in source.data.items():
            if len(column) and isinstance(column[0], np.ndarray | float):
                assert not any(np.isinf(one).any() for one in column), (source.name, name, column)
    shown = messages(plots)
    assert shown["step"] == "no finite response"
    assert shown["locus"] == "no finite pole"
    assert "no finite" in shown["nichols"]
    ranges = named(plots, Range1d)
    assert all(np.isfinite([one.start, one.end]).all() for one in ranges)
    plots.show(picture())
    assert not any(messages(plots).values())


def test_where_the_user_has_zoomed_the_view_stays_until_it_is_reset(fresh: Plots) -> None:
    plots = fresh
    plots.show(picture())
    y = figure(plots, "nichols").y_range
    y.update(start=-5.0, end=5.0)
    other = picture(4e5)
    plots.show(other)
    assert (y.start, y.end) == (-5.0, 5.0)
    panel_of(plots, "nichols").reset()
    assert y.end > 20.0


@pytest.mark.parametrize("model", shipped_models())
def test_every_body_is_drawn_and_turns_about_its_own_axis(model: str) -> None:
    platform = read_platform(model)
    data = tree_data(platform)
    assert json.loads(json.dumps(data)) == data
    bodies = data["bodies"]
    assert len(bodies) == len(data["labels"]) == len(platform.gimbals) + len(platform.rotors)
    names = [platform.root_name, *platform.gimbal_names]
    for body, gimbal in zip(bodies, platform.gimbals, strict=False):
        assert names[body["parent"] + 1] == gimbal.parent
        np.testing.assert_allclose(body["axis"], gimbal.axis, atol=1e-4)
    for k, body in enumerate(bodies):
        # Arrows lie on the axis that the body turns about.
        (arrow,) = (one["points"] for one in data["shapes"] if one["body"] == k and one["kind"] in ("axis", "spin"))
        away = np.subtract(arrow, body["pivot"])
        assert np.abs(np.cross(away, body["axis"])).max() < 1e-3
    assert np.isfinite([point for one in data["shapes"] for point in one["points"]]).all()


def test_a_run_is_thinned_and_turns_from_its_first_attitude() -> None:
    t = np.linspace(0.0, 2.0, 1001)
    first = Rotation.from_euler("xyz", [0.3, -0.2, 0.1])
    attitude = np.roll((first * Rotation.from_rotvec(np.outer(t, [0.0, 0.5, 0.0]))).as_quat(), 1, axis=1)
    run: Any = SimpleNamespace(t=t, q=np.column_stack([np.sin(t), t]), attitude=attitude)
    data = run_data(run)
    shown = np.array(data["t"])
    assert len(shown) <= 400
    np.testing.assert_allclose(data["angles"], np.column_stack([np.sin(shown), shown]), atol=1e-8)
    np.testing.assert_allclose(data["turns"], np.outer(shown, [0.0, 0.5, 0.0]), atol=1e-8)
