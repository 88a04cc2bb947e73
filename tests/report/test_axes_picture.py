"""Pictures of axes: what they show is what the plant says."""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import read_platform
from platform_ctrl.common.text import greek
from platform_ctrl.plant.source import shipped_models
from platform_ctrl.report.figures.axes_picture import axes_picture
from tree_cases import platforms

ROOT = Path(__file__).parents[2]
SVG = "{http://www.w3.org/2000/svg}"
MODEL = pytest.mark.parametrize("model", shipped_models())
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def plant(gimbals=(), rotors=(), **tables):
    """Return a platform of (name, parent, axis) and (name, carrier, axis, L)."""
    return read_platform(
        {
            "schema": 1,
            "name": tables.pop("name", "made up"),
            "root": {"name": "base", "inertia": [9.0, 9.0, 9.0]} | tables.pop("root", {}),
            "gimbal": [
                {"name": name, "parent": parent, "axis": axis, "inertia": [1.0, 1.0, 1.0]}
                for name, parent, axis in gimbals
            ],
            "rotor": [
                {
                    "name": name,
                    "carrier": carrier,
                    "axis": axis,
                    "axial_inertia": 0.1,
                    "transverse_inertia": 0.06,
                    "angular_momentum": L,
                }
                for name, carrier, axis, L in rotors
            ],
        }
        | tables
    )


def drawn(platform):
    return ET.fromstring(axes_picture(platform))


def classed(element, name):
    return [e for e in element.iter() if name in (e.get("class") or "").split()]


def texts(element):
    return [e.text for e in element.iter(f"{SVG}text")]


def points(element):
    """Points of a path of straight lines, (k, 2)."""
    return np.array([float(x) for x in NUMBER.findall(element.get("d"))]).reshape(-1, 2)


def arrow(group):
    """Return tail and tip of a drawn arrow: its line starts at the tail, its head at the tip."""
    shaft, head = group.findall(f"{SVG}path")[:2]
    return points(shaft)[0], points(head)[0]


def arrows(svg, kind):
    found = {group.get("data-body"): arrow(group) for group in classed(svg, kind)}
    return {name: tip - tail for name, (tail, tip) in found.items()}


def seen(svg):
    """Return how root directions are seen, (2, 3), right and down: read from the triad."""
    triad = arrows(svg, "root-axis")
    return np.column_stack([triad["1"], triad["2"], triad["3"]])


def angle_between(a, b):
    return abs(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))


def turn_sense(svg):
    """Return +1 where the only gimbal's turn arrow runs anticlockwise on the screen."""
    stretch = max((points(e) for e in classed(svg, "turn")), key=len)
    x, y = stretch.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    assert abs(area) > 20.0
    return -np.sign(area)


@MODEL
def test_every_angle_and_every_rotor_is_named_in_both_halves(model):
    platform = read_platform(model)
    svg = drawn(platform)
    [view], [scheme] = classed(svg, "view"), classed(svg, "scheme")
    for half in (view, scheme):
        assert {greek(name) for name in platform.angle_names} <= set(texts(half))
        assert {rotor.name for rotor in platform.rotors} <= set(texts(half))
    assert {*platform.gimbal_names, platform.root_name} <= set(texts(scheme))


@settings(max_examples=20, deadline=None)
@given(platforms())
def test_arrows_point_along_the_axes_of_any_platform(platform):
    svg = drawn(platform)
    rows = seen(svg)
    toward = np.cross(rows[0], -rows[1]) / 46.0**2
    axes, spins = arrows(svg, "axis-arrow"), arrows(svg, "spin-arrow")
    assert set(axes) == set(platform.gimbal_names)
    assert set(spins) == {rotor.name for rotor in platform.rotors}
    expected = [(axes[g.name], g.axis) for g in platform.gimbals]
    expected += [(spins[r.name], r.axis * np.sign(r.angular_momentum)) for r in platform.rotors]
    for found, axis in expected:
        length = np.hypot(*found)
        if abs(axis @ toward) < 0.9:
            assert length > 1.0
        # Coordinates are written to a tenth of a pixel.
        assert angle_between(found, rows @ axis) < 1.0 + np.degrees(0.2 / length)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (2, -1, 0.5), (-1, 1, 1)])
def test_the_turn_arrow_is_right_handed_about_the_axis(axis, sign):
    svg = drawn(plant([("g", "base", [sign * x for x in axis])]))
    rows = seen(svg)
    toward = np.cross(rows[0], -rows[1])
    assert turn_sense(svg) == np.sign(sign * toward @ axis)


@pytest.mark.parametrize("k", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_up_is_where_the_specific_force_points(k, sign):
    force = [0.1, 0.1, 0.1]
    force[k] = 9.81 * sign
    rows = seen(drawn(plant(root={"specific_force": force})))
    assert angle_between(sign * rows[:, k], np.array([0.0, -1.0])) < 1.0


@settings(max_examples=25, deadline=None)
@given(st.text(max_size=12))
def test_any_name_is_well_formed(name):
    plain = plant([("g", "base", [0, 0, 1])], [("r", "g", [1, 0, 0], 1.0)])
    [gimbal], [rotor] = plain.gimbals, plain.rotors
    platform = dataclasses.replace(
        plain,
        name=name,
        gimbals=(dataclasses.replace(gimbal, name=name, angle=name),),
        rotors=(dataclasses.replace(rotor, name=name, carrier=name),),
    )
    if name != "base":
        drawn(platform)


@MODEL
def test_the_picture_in_docs_is_the_one_that_is_drawn(model):
    kept = (ROOT / "docs" / "pictures" / f"{model}.svg").read_text(encoding="utf-8")
    new = axes_picture(read_platform(model))
    assert axes_picture(read_platform(model)) == new
    assert NUMBER.sub("#", kept) == NUMBER.sub("#", new)
    # Another processor may round the last digit of a coordinate another way.
    np.testing.assert_allclose(*([float(x) for x in NUMBER.findall(text)] for text in (kept, new)), atol=0.11)
