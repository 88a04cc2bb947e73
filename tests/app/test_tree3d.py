"""The gimbal tree in 3-D: its bodies stand where the mechanics says, in Python and in a real browser's page."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from jinja2 import Template

from browser import Screen, screen, served
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.mechanics.kinematics import kinematics, topology
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.plant.source import shipped_models

pytest.importorskip("bokeh")

from platform_ctrl.app.gimbal_tree import SAMPLES, TreeView, columns, scene

if TYPE_CHECKING:
    from playwright.sync_api import Browser

TEMPLATE = """{% from macros import embed %}<!doctype html><html lang="en"><head><title>tree</title>
<script type="module" src="/page/tree.js"></script>{{ bokeh_js|safe }}</head>
<body><div style="position: relative; width: 500px; height: 400px">{{ embed(roots.tree)|safe }}</div>
{{ plot_script|safe }}</body></html>"""


def plant(name: str) -> Platform:
    """A shipped plant; the pyramid's wheels with speed loops."""
    platform = read_platform(name)
    if name != "vscmg_pyramid":
        return platform
    rotors = tuple(replaced(rotor, {"control": "servo", "speed_gain": 0.1}) for rotor in platform.rotors)
    return replaced(platform, {"rotors": rotors})


def a_run(platform: Platform, N: int = 101, largest: float = 4e-3) -> Any:
    """A run that nobody simulated: angles, an attitude, and servo rotors that speed up."""
    n, t = len(platform.gimbals), np.linspace(0.0, 2.0, N)
    servo = [rotor for rotor in platform.rotors if rotor.control == "servo"]
    turn = 0.01 * t
    return SimpleNamespace(
        t=t,
        q=largest * np.sin(t[:, None] * np.arange(1.0, n + 1.0) + np.arange(n)),
        attitude=np.stack([np.cos(turn / 2), 0.6 * np.sin(turn / 2), 0.0 * t, 0.8 * np.sin(turn / 2)], axis=1),
        rotor_names=tuple(rotor.name for rotor in servo),
        rotor_spin=np.array([rotor.spin + 10.0 * t for rotor in servo]).reshape(len(servo), N).T,
    )


def rotation(w: float, x: float, y: float, z: float) -> FloatArray:
    """The matrix of a unit quaternion."""
    v = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross)


def about(axis: FloatArray, angle: float) -> FloatArray:
    return rotation(np.cos(angle / 2), *(np.sin(angle / 2) * axis))


@pytest.mark.parametrize("name", shipped_models())
def test_bodies_are_connected_as_in_the_plant(name: str) -> None:
    platform = read_platform(name)
    seen, tree = scene(platform), topology(platform)
    n = len(platform.gimbals)
    names = [platform.root_name, *(one.name for one in platform.gimbals), *(one.name for one in platform.rotors)]
    assert [node.name for node in seen.nodes] == names
    assert [node.parent for node in seen.nodes] == [-1, *(tree.parents + 1), *tree.carriers]
    for node, axis in zip(seen.nodes[1:], [*tree.axes, *tree.spin_axes], strict=True):
        np.testing.assert_allclose(node.axis, axis)
        assert node.pieces
        # A body is held on its axis: its pin or shaft passes through the point about which it turns.
        shafts = [one["points"] for one in node.pieces if one["kind"] == "tube" and one["radius"] < 0.06]
        assert shafts
        for shaft in shafts:
            np.testing.assert_allclose(np.cross(shaft, node.axis), 0.0, atol=1e-12)
    for node, rotor in zip(seen.nodes[1 + n :], platform.rotors, strict=True):
        assert node.spin == rotor.spin
        (disc,) = [one["points"] for one in node.pieces if one["kind"] == "disc"]
        np.testing.assert_allclose(disc[0], -disc[1])
    for one in _points(seen):
        assert np.linalg.norm(one - seen.centre) <= seen.reach + 1e-9
    assert json.loads(json.dumps(seen.data()))["nodes"][0]["kind"] == "root"


@pytest.mark.parametrize("name", shipped_models())
def test_bodies_that_turn_do_not_touch_those_of_another_loop(name: str) -> None:
    """What the root carries stands apart: balls about the bodies, which hold them however they turn."""
    seen = scene(read_platform(name))
    top = [k for k, node in enumerate(seen.nodes) if node.parent == 0]
    middles = np.array([seen.nodes[k].pivot for k in top])
    own = [_reach(seen, k) for k in top]
    for k in range(len(top)):
        for j in range(k):
            assert np.linalg.norm(middles[k] - middles[j]) > own[k] + own[j]


def _points(seen: Any) -> list[FloatArray]:
    places: list[FloatArray] = []
    for node in seen.nodes:
        places.append(node.pivot + (places[node.parent] if node.parent >= 0 else 0.0))
    return [
        place + p for node, place in zip(seen.nodes, places, strict=True) for one in node.pieces for p in one["points"]
    ]


def _reach(seen: Any, body: int) -> float:
    """Radius of the ball about a body's pivot that holds it and all that it carries, names left out."""
    own = [float(np.linalg.norm(p)) for one in seen.nodes[body].pieces for p in one["points"] if one["kind"] != "arrow"]
    carried = [k for k, node in enumerate(seen.nodes) if node.parent == body]
    return max([*own, *(float(np.linalg.norm(seen.nodes[k].pivot)) + _reach(seen, k) for k in carried)])


def test_a_long_run_is_thinned_out_and_servo_rotors_keep_their_turns() -> None:
    platform = plant("vscmg_pyramid")
    run = a_run(platform, N=3 * SAMPLES)
    data = columns(run)
    assert len(data["t"]) == SAMPLES
    assert {len(one) for one in data.values()} == {SAMPLES}
    np.testing.assert_array_equal(data["q 2"], run.q[::3, 2])
    for rotor in platform.rotors:
        t = data["t"]
        np.testing.assert_allclose(data[f"turned {rotor.name}"], rotor.spin * t + 5.0 * t**2, atol=1e-6)


# In the browser.


@pytest.fixture(scope="module")
def views() -> list[TreeView]:
    return []


def page_of(name: str, views: list[TreeView], run: bool = True) -> Callable[[Any, Any], None]:
    def make(backend: object, document: Any) -> None:
        view = TreeView(plant(name))
        if run:
            view.show(a_run(plant(name)))
        document.add_root(view.layout)
        document.template = Template(TEMPLATE)
        views.append(view)

    return make


@pytest.fixture(scope="module")
def pyramid(browser: Browser, views: list[TreeView]) -> Iterator[Screen]:
    with served(make=page_of("vscmg_pyramid", views)) as server, screen(browser, server.address) as shown:
        drawn(shown)
        yield shown


def drawn(shown: Screen) -> None:
    shown.page.wait_for_function("() => document.querySelector('*') && window.Bokeh?.documents.length")
    shown.page.locator("gimbal-tree .names span").first.wait_for(state="attached")


def state(shown: Screen, before: str = "") -> Any:
    return shown.page.locator("gimbal-tree").evaluate(f"tree => {{ {before}; return tree.state(); }}")


@pytest.mark.parametrize("name", ["suspended_platform", "vscmg_pyramid"])
def test_bodies_on_the_page_are_where_the_mechanics_places_them(
    name: str, browser: Browser, views: list[TreeView], pyramid: Screen
) -> None:
    platform = plant(name)
    if name == "vscmg_pyramid":
        _agrees(platform, pyramid)
        return
    with served(make=page_of(name, views)) as server, screen(browser, server.address) as shown:
        drawn(shown)
        _agrees(platform, shown)
        assert shown.complaints == []
        assert shown.hosts() == {f"127.0.0.1:{server.port}"}


def _agrees(platform: Platform, shown: Screen) -> None:
    run, n = a_run(platform), len(platform.gimbals)
    seen = scene(platform)
    for time, factor, together in ((0.62, 50.0, True), (2.0, 1.0, False), (1.234, 100.0, False)):
        found = state(
            shown,
            f"tree.controls.platform.checked = {str(together).lower()}; tree.magnify({factor}); tree.seek({time})",
        )
        assert found["time"] == time
        assert found["factor"] == factor
        q = np.array([np.interp(time, run.t, run.q[:, k]) for k in range(n)])
        there = kinematics(platform, factor * q)
        turn = 0.01 * time * (factor if together else 1.0)
        root = about(np.array([0.6, 0.0, 0.8]), turn)
        np.testing.assert_allclose(rotation(*found["rotations"][platform.root_name]), root, atol=1e-6)
        for k, gimbal in enumerate(platform.gimbals):
            np.testing.assert_allclose(
                rotation(*found["rotations"][gimbal.name]), root @ there.rotations[k + 1], atol=1e-6
            )
        carriers = topology(platform).carriers
        for k, rotor in enumerate(platform.rotors):
            servo = 5.0 * time**2 if rotor.control == "servo" else 0.0
            turned = (rotor.spin * time + servo) / found["slower"]
            assert found["turned"][n + k] == pytest.approx(turned, rel=1e-4, abs=1e-3)
            spun = root @ there.rotations[carriers[k]] @ about(rotor.axis, found["turned"][n + k])
            np.testing.assert_allclose(rotation(*found["rotations"][rotor.name]), spun, atol=1e-6)
            np.testing.assert_allclose(spun @ rotor.axis, root @ there.spin_axes[k], atol=1e-6)
        for node, parent in ((node, seen.nodes[node.parent]) for node in seen.nodes[1:]):
            place = np.array(found["places"][parent.name]) + rotation(*found["rotations"][parent.name]) @ node.pivot
            np.testing.assert_allclose(found["places"][node.name], place, atol=1e-6)


@pytest.mark.parametrize(("largest", "factor", "most"), [(0.3, 1, 100), (7e-5, 5000, 5000), (0.0, 1, 100)])
def test_angles_are_enlarged_until_they_can_be_seen(
    largest: float, factor: float, most: float, pyramid: Screen, views: list[TreeView]
) -> None:
    view, document = views[0], views[0].layout.document
    assert document is not None
    run = a_run(plant("vscmg_pyramid"), largest=largest)
    count = state(pyramid, "window.count = 0; tree.source.properties.data.change.connect(() => { window.count += 1; })")
    document.add_next_tick_callback(lambda: view.show(run))
    pyramid.page.wait_for_function("() => window.count > 0")
    found = state(pyramid)
    assert found["factor"] == factor
    assert pyramid.page.get_by_label("Angles are shown times").get_attribute("max") == str(np.log10(most)).removesuffix(
        ".0"
    )
    assert count["start"] == 0.0


def test_the_page_says_what_is_enlarged_or_slowed(pyramid: Screen) -> None:
    state(pyramid, "tree.controls.platform.checked = true; tree.magnify(20); tree.seek(1)")
    slower = state(pyramid)["slower"]
    spin = "spin as it is" if slower == 1 else f"spin {slower:g} times slower"
    pyramid.page.get_by_text(f"angles × 20 (platform’s × 20), {spin}", exact=True).wait_for()
    pyramid.page.get_by_label("Platform’s angles too").uncheck()
    pyramid.page.get_by_text(f"angles × 20 (platform’s × 1), {spin}", exact=True).wait_for()
    pyramid.page.get_by_label("Angles are shown times").fill("0")
    pyramid.page.get_by_text(f"angles as they are, {spin}", exact=True).wait_for()


def test_mouse_and_keys_go_round_and_play(pyramid: Screen) -> None:
    canvas = pyramid.page.locator("gimbal-tree canvas")
    state(pyramid, "tree.orbit.home()")
    canvas.focus()
    before = state(pyramid)
    for _ in range(3):
        pyramid.page.keyboard.press("ArrowRight")
    pyramid.page.keyboard.press("ArrowUp")
    pyramid.page.keyboard.press("+")
    after = state(pyramid)
    assert after["azimuth"] == pytest.approx(before["azimuth"] + np.radians(15.0))
    assert after["elevation"] == pytest.approx(before["elevation"] + np.radians(5.0))
    assert after["zoom"] == pytest.approx(1.15)
    box = canvas.bounding_box()
    assert box is not None
    pyramid.page.mouse.move(box["x"] + 100, box["y"] + 100)
    pyramid.page.mouse.down()
    pyramid.page.mouse.move(box["x"] + 150, box["y"] + 110, steps=3)
    pyramid.page.mouse.up()
    assert state(pyramid)["azimuth"] == pytest.approx(after["azimuth"] - 0.008 * 50)
    pyramid.page.keyboard.press("Home")
    assert (state(pyramid)["azimuth"], state(pyramid)["zoom"]) == (0.0, 1.0)
    state(pyramid, "tree.seek(0)")
    assert not state(pyramid)["playing"]
    pyramid.page.keyboard.press(" ")
    pyramid.page.wait_for_function("() => window.Bokeh && true")
    assert state(pyramid)["playing"]
    pyramid.page.get_by_role("button", name="Pause").click()
    stopped = state(pyramid)
    assert not stopped["playing"]
    pyramid.page.get_by_label("Time", exact=True).fill("1.5")
    assert state(pyramid)["time"] == 1.5
    pyramid.page.keyboard.press("Tab")


def test_a_new_run_replaces_the_one_before_and_frees_its_memory(pyramid: Screen, views: list[TreeView]) -> None:
    held = state(pyramid)["held"]
    tree = pyramid.page.locator("gimbal-tree")
    again = tree.evaluate(
        """async tree => {
          const text = tree.model.tags[1];
          for (let k = 0; k < 5; k += 1) {
            tree.restage();
            await new Promise(requestAnimationFrame);
          }
          return tree.state().held;
        }"""
    )
    assert again == held
    gone = tree.evaluate(
        """tree => {
          const before = tree.renderer;
          tree.remove();
          const lost = before.getContext().isContextLost();
          return [lost, before.info.memory.geometries, tree.bodies, tree.run, tree.source];
        }"""
    )
    assert gone == [True, 0, None, None, None]
    assert pyramid.complaints == []


def test_without_webgl_there_is_a_line_and_the_page_goes_on(browser: Browser, views: list[TreeView]) -> None:
    with served(make=page_of("rate_gyro", views, run=False)) as server, screen(browser) as shown:
        shown.page.add_init_script(
            "const was = HTMLCanvasElement.prototype.getContext;"
            "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
            " return kind.startsWith('webgl') ? null : was.call(this, kind, ...more); };"
        )
        shown.page.goto(server.address)
        shown.page.get_by_text("This browser has no WebGL here").wait_for()
        assert all("WebGL" in one for one in shown.complaints)


def test_runs_and_plants_come_while_the_page_is_open_and_colours_follow_the_theme(
    browser: Browser, views: list[TreeView]
) -> None:
    make = page_of("rate_gyro", views, run=False)
    with served(make=make) as server, screen(browser, server.address, dark=True) as shown:
        drawn(shown)
        shown.page.get_by_text("Simulate a manoeuvre to see it turn").wait_for()
        assert state(shown)["dark"]
        shown.page.evaluate("document.documentElement.dataset.theme = 'light'")
        assert not state(shown)["dark"]
        view, document = views[-1], views[-1].layout.document
        assert document is not None
        document.add_next_tick_callback(lambda: view.show(a_run(plant("rate_gyro"))))
        shown.page.get_by_role("button", name="Play").wait_for()
        assert state(shown)["end"] == 2.0
        document.add_next_tick_callback(lambda: view.stage(plant("gyro_horizon")))
        shown.page.locator("gimbal-tree").get_by_text("aircraft").wait_for()
        shown.page.get_by_text("Simulate a manoeuvre to see it turn").wait_for()
        shown.page.evaluate("delete document.documentElement.dataset.theme")
        shown.page.emulate_media(color_scheme="light")
        assert not state(shown)["dark"]
