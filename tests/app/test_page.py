from __future__ import annotations

import gc
import math
import time
import weakref
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from browser import Screen, screen, served

pytest.importorskip("bokeh")
pytest.importorskip("tomlkit")


from platform_ctrl.app.backend import Backend
from platform_ctrl.app.session import Pages
from platform_ctrl.app.tasks import parse_request, target
from platform_ctrl.design.methods import read_job
from platform_ctrl.errors import InputError, PlatformCtrlError
from questions import sleeping

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

    from platform_ctrl.app.server import PageServer

JOB = """# A comment that is to stay.
schema = 2
name = "gyros <9 & 10>"
plant = "three_gyro_platform"

[operation]
Omega = [0.0, 0.0, 0.0]

[uncertainty]
inertia = 0.05

[sampling]
rate_hz = 2000
delay = 0.0005

[[loop]]
name = "caging 9-10"
kind = "caging"
gimbals = ["9", "10"]
use = "classical"
limits = { bandwidth_hz = 20, disk_margin = 0.4, disk_margin_worst_case = 0.3 }

[[loop.design]]
name = "classical"
method = "classical"
crossover_hz = 40                      # by hand
integral_hz = 2

[[loop.design]]
name = "slower"
method = "classical"
crossover_hz = 30
integral_hz = 2

[[loop.design]]
name = "H-infinity"
method = "hinf"
bandwidth_hz = 20

[[loop.design]]
name = "out of reach"
method = "hinf"
bandwidth_hz = 20
complementary = 1e12
disturbance = 1e14

[[manoeuvre]]
name = "0.5 rad/s about axis 1"
mode = "caged"
axis = 1
rate = 0.5
rise = 0.01
hold = 0.02
duration = 0.05
limits = { angle = 0.1 }

[[manoeuvre]]
name = "0.5 rad/s about axis 2"
mode = "caged"
axis = 2
rate = 0.5
rise = 0.01
hold = 0.02
duration = 0.05
limits = { angle = 0.1 }
"""
# How often what has to come is looked for, at least 40 ms apart: not a time, which would be short on a busy machine.
LOOKS = 3000
CROSSOVER = '#sliders [data-slider="crossover_hz"]'
LOOP = """() => {
  for (const model of Bokeh.documents[0]._all_models.values()) {
    if (model.name === "bode-figure-0-lines") return Array.from(model.data.ys.at(-1));
  }
}"""
DESIGNS = """() => {
  const out = {};
  for (const { name, data } of Bokeh.documents[0]._all_models.values()) {
    const [, panel] = /^(\\w+)-figure-\\d-(?:lines|points)$/.exec(name ?? "") ?? [];
    if (panel) (out[panel] ??= []).push(...data.name);
  }
  return out;
}"""
BANDS = """() => {
  for (const model of Bokeh.documents[0]._all_models.values()) {
    if (model.name === "bode-figure-0-bands") return model.data.ys.length;
  }
}"""


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gyros") / "gyros.toml"
    path.write_text(JOB, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def backend(job: Path) -> Iterator[Backend]:
    made = Backend(job)
    made.picture(made.start())  # compiled before a browser waits for it
    yield made
    made.close()


@pytest.fixture(scope="module")
def server(backend: Backend) -> Iterator[PageServer]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("platform_ctrl.app.server.LINGER", 2_000)
        with served(Pages(backend).fill) as running:
            yield running


@contextmanager
def opened(browser: Browser, address: str, **how: Any) -> Iterator[Screen]:
    with screen(browser, address, **how) as seen:
        seen.page.wait_for_selector("body:not(.starting)", state="attached")
        yield seen


@pytest.fixture(scope="module")
def only(browser: Browser, server: PageServer) -> Iterator[Screen]:
    with opened(browser, server.address) as one:
        yield one


@pytest.fixture
def page(only: Screen) -> Page:
    """The page, brought back to the job as it stands by all its undo."""
    page = only.page
    if page.locator("dialog[open]").count():
        page.keyboard.press("Escape")
    settled(page)
    while page.locator("#undo").is_enabled():
        page.locator("#undo").click()
        settled(page)
    page.locator("h1").click()
    return page


def settled(page: Page) -> None:
    until(page, lambda: page.evaluate("window.page.settled()"))


def until(page: Page, what: Any) -> Any:
    """Return what `what` returns once it is true; the page's own rules forbid Playwright's way of waiting."""
    for _ in range(LOOKS):
        if found := what():
            return found
        page.wait_for_timeout(40)
    raise AssertionError("it did not come")


def number(page: Page, slider: str) -> Locator:
    return page.locator(f'#sliders [data-slider="{slider}"] input[type="text"]')


def shows(page: Page, slider: str, value: str) -> None:
    until(page, lambda: number(page, slider).input_value() == value)


def typed(page: Page, slider: str, text: str) -> None:
    number(page, slider).fill(text)
    number(page, slider).press("Enter")
    settled(page)


def drawn(page: Page) -> list[float]:
    return [float(one) for one in page.evaluate(LOOP)]


def line(page: Page, part: str) -> str:
    return str(until(page, lambda: part in (text := page.locator("#line").text_content() or "") and text))


def test_a_slider_that_is_dragged_changes_the_plots_and_one_undo_takes_the_drag_back(page: Page) -> None:
    before, pixels = drawn(page), page.locator("#panel-nichols").screenshot()
    thumb = page.locator(f'{CROSSOVER} input[type="range"]').bounding_box()
    assert thumb is not None
    middle = thumb["y"] + thumb["height"] / 2
    page.mouse.move(thumb["x"] + thumb["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(thumb["x"] + 0.56 * thumb["width"], middle, steps=6)
    page.mouse.up()
    until(page, lambda: drawn(page) != before)
    until(page, lambda: page.locator("#panel-nichols").screenshot() != pixels)
    until(page, lambda: number(page, "crossover_hz").input_value() not in ("", "40"))
    page.keyboard.press("Control+z")
    shows(page, "crossover_hz", "40")
    until(page, lambda: drawn(page) == before)
    page.keyboard.press("Control+Shift+z")
    until(page, lambda: drawn(page) != before)


def test_drags_without_a_pause_are_a_step_of_undo_each(page: Page) -> None:
    names = ("crossover_hz", "integral_hz", "lead_hz")
    for name in names:
        box = page.locator(f'#sliders [data-slider="{name}"] input[type="range"]').bounding_box()
        assert box is not None
        middle = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + box["width"] / 2, middle)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.6 * box["width"], middle, steps=8)
        page.mouse.up()
    settled(page)
    moved = [number(page, name).input_value() for name in names]
    page.locator("#undo").click()
    settled(page)
    assert [number(page, name).input_value() for name in names[:2]] == moved[:2]
    assert number(page, "lead_hz").input_value() != moved[2]
    for _ in names[1:]:
        page.locator("#undo").click()
        settled(page)
    assert page.locator("#undo").is_disabled()


def test_everything_works_by_keyboard(page: Page) -> None:
    page.keyboard.press("g")
    speed = page.locator('#sliders [data-slider="speed"] input[type="range"]')
    assert speed.evaluate("one => one === document.activeElement")
    slider = page.locator(f'{CROSSOVER} input[type="range"]')
    slider.focus()
    page.keyboard.press("ArrowRight")
    until(page, lambda: number(page, "crossover_hz").input_value() != "40")
    fine = float(number(page, "crossover_hz").input_value())
    page.keyboard.press("Shift+ArrowRight")
    until(page, lambda: float(number(page, "crossover_hz").input_value()) > fine + 5 * (fine - 40))
    page.keyboard.press("r")
    shows(page, "crossover_hz", "40")
    page.keyboard.press("x")
    pin = page.locator(f"{CROSSOVER} .pin")
    until(page, lambda: pin.get_attribute("aria-pressed") == "true")
    page.keyboard.press("n")
    page.keyboard.type("41\n")
    shows(page, "crossover_hz", "41")
    page.keyboard.press("Escape")
    slider.focus()
    page.keyboard.press("d")
    until(page, lambda: page.locator("#design").input_value() == "slower")
    shows(page, "crossover_hz", "30")
    page.keyboard.press("?")
    assert page.locator("#help-dialog").is_visible()
    assert "tune the rest" in (page.locator("#help-dialog").text_content() or "")
    page.keyboard.press("Escape")
    assert not page.locator("#help-dialog").is_visible()
    page.keyboard.press("Control+s")
    assert page.locator("#save-name").evaluate("one => one === document.activeElement")


def test_a_screen_reader_is_told_the_verdict_and_what_each_plot_shows(page: Page) -> None:
    words = until(page, lambda: page.locator("#spoken").text_content())
    assert words.startswith(page.locator("#verdict .words span").text_content() or "-")
    captions = page.locator(".head [role=img]").evaluate_all("all => all.map(one => one.ariaLabel)")
    assert len(captions) >= 5
    assert all(captions)
    assert captions[0].startswith("L at Q9, others closed; gain, dB over freq")
    page.keyboard.press("Tab")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"


@pytest.mark.parametrize("theme", ["Light", "Dark"])
def test_axe_core_has_nothing_to_object_to(page: Page, theme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page.locator("#theme label", has_text=theme).click()
    until(page, lambda: any(page.locator("#requirements td.cell").all_text_contents()))
    for dialog in ("", "#save", "#help"):
        if dialog:
            page.locator(dialog).click()
        found = axe.run(page)
        assert found.violations_count == 0, found.generate_report()
        page.keyboard.press("Escape")
    page.locator("#theme label", has_text="System").click()


def test_the_rest_is_tuned_saved_and_checked(page: Page, job: Path) -> None:
    typed(page, "crossover_hz", "25")
    shows(page, "crossover_hz", "25")
    until(page, lambda: "bad" in (page.locator("#verdict").get_attribute("class") or ""))
    fixed = {
        slider: number(page, slider).input_value()
        for slider in ("integral_hz", "damping_hz", "damping2_hz", "rolloff_hz")
    }
    for slider in (*fixed, "lead_hz"):
        page.locator(f'#sliders [data-slider="{slider}"] .pin').click()
        settled(page)
    page.keyboard.press("t")
    until(page, lambda: "good" in (page.locator("#verdict").get_attribute("class") or ""))
    assert {slider: number(page, slider).input_value() for slider in fixed} == fixed
    assert number(page, "crossover_hz").input_value() != "25"

    page.locator("#save").click()
    page.locator("#save-name").fill("../outside")
    page.locator("#save-go").click()
    until(page, lambda: "only letters" in (page.locator("#save-line").text_content() or ""))
    page.locator("#save-name").fill("gyros")
    page.locator("#save-go").click()
    until(page, lambda: page.locator("#save-go").text_content() == "Overwrite")
    assert "exists already" in (page.locator("#save-line").text_content() or "")
    assert job.read_text(encoding="utf-8") == JOB
    page.locator("#save-name").fill("by hand")
    page.locator("#save-go").click()
    command = str(until(page, lambda: page.locator("#saved-command").text_content()))
    saved = job.with_name("by hand.toml")
    assert command == f"platform-ctrl check '{saved}'"
    assert "A comment that is to stay." in saved.read_text(encoding="utf-8")
    [loop] = read_job(saved).loops
    assert loop.designs[0].options["crossover_hz"] == pytest.approx(
        float(number(page, "crossover_hz").input_value()), rel=1e-3
    )


def test_requirements_are_tightest_first_and_a_limit_is_edited_where_it_stands(page: Page) -> None:
    until(page, lambda: page.locator("#requirements .stale").count() == 0)
    rows = page.locator("#requirements tbody tr")
    first = rows.first.locator("th").text_content()
    limit = page.get_by_role("textbox", name="Limit of bandwidth")
    assert limit.input_value() == "≥ 20 Hz"
    limit.fill("≥ 500")
    limit.press("Enter")
    until(page, lambda: limit.input_value() == "≥ 500 Hz")
    until(page, lambda: page.locator("#requirements .stale").count() == 0)
    assert first != "bandwidth"
    assert rows.first.locator("th").text_content() == "bandwidth"
    assert "missed" in (rows.first.get_attribute("class") or "")
    assert "bandwidth" in (page.locator("#step").text_content() or "")
    limit.fill("nothing")
    limit.press("Enter")
    assert "must be a positive finite number" in line(page, "bandwidth_hz")
    assert limit.input_value() == "≥ 500 Hz"
    page.locator("h1").click()
    page.keyboard.press("Control+z")
    until(page, lambda: limit.input_value() == "≥ 20 Hz")


def test_a_section_is_added_and_removed_by_a_button_and_undone(page: Page) -> None:
    before = drawn(page)
    page.get_by_role("button", name="Add lag").click()
    page.locator('#sliders [data-slider="lag_hz"]').wait_for()
    until(page, lambda: drawn(page) != before)
    page.get_by_role("button", name="Remove lag").click()
    until(page, lambda: page.locator('#sliders [data-slider="lag_hz"]').count() == 0)
    page.locator("h1").click()
    page.keyboard.press("Control+z")
    page.locator('#sliders [data-slider="lag_hz"]').wait_for()
    page.keyboard.press("Control+z")
    until(page, lambda: drawn(page) == before)
    page.get_by_role("button", name="Add lag").wait_for()


def test_a_design_that_takes_seconds_is_announced_and_drawn_in_every_plot_once_available(page: Page) -> None:
    # Chosen itself, it stays chosen while the one before is shown.
    page.locator("#design").select_option("H-infinity")
    assert "is being designed" in line(page, "H-infinity: is being designed")
    assert page.locator("#line").get_attribute("class") == "quiet"
    assert page.locator("#design").input_value() == "H-infinity"
    page.locator('#sliders [data-slider="bandwidth_hz"]').wait_for(state="attached")
    until(page, lambda: "is being designed" not in (page.locator("#line").text_content() or ""))
    assert page.locator("#design").input_value() == "H-infinity"
    # Its options are folded.
    assert not page.locator('#sliders [data-slider="bandwidth_hz"]').is_visible()
    page.keyboard.press("Control+z")
    shows(page, "crossover_hz", "40")
    page.keyboard.press("c")
    for design in ("slower", "H-infinity", "out of reach"):
        page.locator("#overlays label", has_text=design).get_by_role("checkbox").check()
    assert "is being designed" in line(page, "out of reach: is being designed")
    page.keyboard.press("Escape")
    until(page, lambda: "is being designed" not in (page.locator("#line").text_content() or ""))
    assert "minimising gamma" in line(page, "out of reach: ")
    # What is hidden follows when it is seen.
    page.get_by_role("button", name="frequency").click()
    # The other two designs may still be under way.
    both = {"slower", "H-infinity"}
    until(page, lambda: all(both <= set(names) for names in page.evaluate(DESIGNS).values()))
    assert set(page.evaluate(DESIGNS)) == {"bode", "nichols", "locus", "step", "Omega"}
    # The band of the design that is worked on stays.
    assert page.locator("#band").is_checked()
    assert page.evaluate(BANDS) > 0


def test_a_run_leaves_the_page_alive_can_be_cancelled_and_turns_the_gimbal_tree(
    page: Page, backend: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    manoeuvre = backend.read.manoeuvres[1].name
    page.locator("#manoeuvre").select_option(manoeuvre)
    page.locator("h1").click()
    with monkeypatch.context() as patch:
        patch.setattr("platform_ctrl.app.backend.simulated", sleeping)
        page.keyboard.press("s")
        until(page, lambda: f"{manoeuvre}: the first run" in (page.locator("#busy").text_content() or ""))
        typed(page, "crossover_hz", "41")
        shows(page, "crossover_hz", "41")
        assert page.locator("#busy").is_visible()
        page.locator("h1").click()
        page.keyboard.press("Escape")
        line(page, "was cancelled")
        assert not page.locator("#busy").is_visible()
        assert not backend.has_simulated

    page.locator("#simulate").click()
    slider = page.locator("#panel-tree .controls input")
    until(page, slider.is_visible)
    assert backend.has_simulated
    settings = backend.moved(backend.start(), "crossover_hz", 41.0)
    run = backend.simulate(settings, manoeuvre)
    assert np.ptp(run.q[:, -1]) > 1e-5
    # A turn about axis 1 moves the gimbals as the linear model of the picture says.
    turn, linear = backend.simulate(settings, backend.read.manoeuvres[0].name), backend.picture(settings).Omega_time
    assert np.abs(turn.q[:, -2:]).max() == pytest.approx(np.abs(linear.values[:2]).max(), rel=0.1)
    drawn_at = []
    for time_shown in ("0.011", "0.037"):
        slider.fill(time_shown)
        drawn_at.append(page.locator("#panel-tree path.axis").last.get_attribute("d"))
    assert drawn_at[0] != drawn_at[1]
    assert "angles ×" in (page.locator("#panel-tree .note").text_content() or "")


def test_nothing_is_cut_off_or_scrolls_sideways(only: Screen, page: Page) -> None:
    cut = """selector => [...document.querySelectorAll(selector)]
        .filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.textContent)"""
    for width, height in ((1920, 1080), (1440, 900)):
        page.set_viewport_size({"width": width, "height": height})
        size = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
        assert size == [width, height]
        assert page.evaluate(cut, "button, .slider label, #numbers div, h1, .panel .top, #requirements") == []
    # Smaller windows scroll downwards alone, and a zoomed one is as a smaller one.
    for width, height in ((1280, 720), (1024, 768), (960, 600)):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert page.evaluate(cut, "button, .slider label, #numbers div, #requirements") == []
    page.set_viewport_size({"width": 1440, "height": 900})
    assert only.complaints == []


def test_a_page_refuses_nonsense_over_its_websocket_and_goes_on(page: Page) -> None:
    send = "message => { Bokeh.documents[0].get_model_by_name('state').request = message; }"
    for nonsense in (
        "no request",
        5,
        {"n": 0, "what": "move", "moves": [{"slider": "crossover_hz", "value": math.nan}], "gesture": 1},
        {"n": 0, "what": "move", "moves": [{"slider": "no such", "value": 1}], "gesture": 1},
        {"n": 0, "what": "set", "name": "plant", "value": ["x"]},
    ):
        page.evaluate("() => { document.querySelector('#line').textContent = ''; }")
        page.evaluate(send, nonsense)
        until(page, lambda: "error" in (page.locator("#line").get_attribute("class") or "") and line(page, "e"))
    typed(page, "crossover_hz", "abc")
    assert "must be a finite number" in line(page, "abc")
    shows(page, "crossover_hz", "40")
    typed(page, "crossover_hz", "39")
    shows(page, "crossover_hz", "39")


def test_a_link_opens_the_same_state_and_a_page_that_is_closed_leaves_nothing_behind(
    browser: Browser, server: PageServer, page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    from platform_ctrl.app import session as page_app

    kept: list[weakref.ref[Any]] = []

    class Watched(page_app.Session):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            kept.extend(weakref.ref(one) for one in (self, self.plots, self.history, given[1]))

    monkeypatch.setattr(page_app, "Session", Watched)
    before = page.url
    typed(page, "crossover_hz", "47.5")
    shows(page, "crossover_hz", "47.5")
    until(page, lambda: page.url not in (before, server.address))  # the address follows once nothing moves
    with opened(browser, page.url, dark=True) as other:
        assert number(other.page, "crossover_hz").input_value() == "47.5"
        assert drawn(other.page) == drawn(page)
        assert other.page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 30)"
        typed(other.page, "crossover_hz", "33")
        shows(other.page, "crossover_hz", "33")
        until(other.page, lambda: other.page.url != page.url)
        other.page.locator("#theme label", has_text="Light").click()
        other.page.goto(f"{server.address}&state=nonsense")
        other.page.wait_for_selector("body:not(.starting)", state="attached")
        assert "The state in the link was not used" in line(other.page, "link")
        assert number(other.page, "crossover_hz").input_value() == "40"
        until(other.page, lambda: "state=" not in other.page.url)
        # The theme that was chosen is kept.
        assert other.page.evaluate("document.documentElement.dataset.theme") == "light"
        other.page.goto("about:blank")
    assert number(page, "crossover_hz").input_value() == "47.5"
    assert len(kept) == 8
    for _ in range(LOOKS):
        if all(one() is None for one in kept):
            break
        time.sleep(0.05)
        gc.collect()
    assert [one() for one in kept] == [None] * 8


def test_messages_are_checked() -> None:
    acts = {"move": lambda count, moves, gesture: None, "fix": lambda settings, slider, fixed: None}
    given = {"moves": [{"slider": "a", "value": 2}], "gesture": 0}
    assert parse_request({"n": 3, "what": "move", **given}, acts) == (3, "move", given)
    for message in ("[" * 9000, {"what": []}, {"n": 1, "what": []}, "x" * 30_000, {"n": 1, "what": "fix"}, 5, None):
        with pytest.raises(InputError):
            parse_request(message, acts)


def test_choices_are_checked(backend: Backend) -> None:
    start = backend.start()
    assert backend.with_choice(start, "axis", 3).axis == 3
    assert backend.with_overlay(start, "slower", True).overlays == ("slower",)
    for huge in (10**400, 1e308, "1", True, None):
        with pytest.raises(PlatformCtrlError, match="crossover_hz must be"):
            backend.moved(start, "crossover_hz", huge)
    wrong = [
        ("axis", 4),
        ("axis", "1"),
        ("axis", True),
        ("band", 1),
        ("loop", 3),
        ("plant", "nominal "),
    ]
    for name, given in wrong:
        with pytest.raises(PlatformCtrlError):
            backend.with_choice(start, name, given)
    for design in ("classical", "no such"):
        with pytest.raises(PlatformCtrlError):
            backend.with_overlay(start, design, True)


def test_a_page_whose_server_ends_says_so_and_returns_with_its_state(
    browser: Browser, backend: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ExitStack() as stack:
        with served(Pages(backend).fill) as server:
            port = server.port
            page = stack.enter_context(screen(browser, server.address)).page
            page.wait_for_selector("body:not(.starting)", state="attached")
            other = f"{1.1 * float(number(page, 'crossover_hz').input_value()):.4g}"
            typed(page, "crossover_hz", other)
            until(page, lambda: "state=" in page.url)
        line(page, "connection to the server is lost")
        page.locator("#save").click()
        page.locator("#save-go").click()
        assert "Not saved" in (page.locator("#save-line").text_content() or "")
        page.keyboard.press("Escape")
        # Another server has another link.
        with served(Pages(backend).fill, port=port):
            assert "open that one" in line(page, "has another link")
        monkeypatch.setattr("secrets.token_urlsafe", lambda size: server.token)
        with page.expect_event("load"):
            stack.enter_context(served(Pages(backend).fill, port=port))
        until(page, lambda: page.evaluate("!document.body.matches('.starting, .lost') && window.page.settled()"))
        assert number(page, "crossover_hz").input_value() == other
        page.close()


@pytest.mark.parametrize("name", ["a" * 99, ".hidden", "", ".", "..", "../a", "a/b", "a\\b", "a\0", "a:b", "~", "a*"])
def test_a_job_is_saved_under_a_plain_name_alone(tmp_path: Path, name: str) -> None:
    assert target(tmp_path, "by hand") == target(tmp_path, " by hand.toml ") == tmp_path / "by hand.toml"
    with pytest.raises(InputError, match="only letters"):
        target(tmp_path, name)
