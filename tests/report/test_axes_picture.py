"""Pictures of axes: what they show is what the plant says."""

from __future__ import annotations

import dataclasses
import io
import re
import unicodedata
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from platform_ctrl import read_platform, shipped_models
from platform_ctrl.report.figures import axes_picture
from tree_cases import platforms

ROOT = Path(__file__).parents[2]


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


def letters(name):
    """An angle's name with its Greek letters as letters."""
    return re.sub(
        "alpha|beta|gamma|delta|theta|phi|psi", lambda m: unicodedata.lookup(f"GREEK SMALL LETTER {m[0]}"), name
    )


def texts(figure):
    return {line for text in figure.axes[0].texts for line in text.get_text().split("\n")}


def arrows(figure, kind):
    """Return the arrows of a kind by their bodies, from tail to tip."""
    found = [one for one in figure.axes[0].texts if (one.get_gid() or "").startswith(f"{kind} ")]
    return {one.get_gid().partition(" ")[2]: np.subtract(one.xy, one.xyann) for one in found}


def seen(figure):
    """Return how root directions are seen, (2, 3), right and up: read from the root's axes."""
    root = arrows(figure, "root")
    return np.column_stack([root["1"], root["2"], root["3"]])


def angle_between(a, b):
    return abs(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))


def turn_sense(figure):
    """Return +1 where the only gimbal's turn arrow runs anticlockwise on the screen."""
    turns = [line for line in figure.axes[0].lines if (line.get_gid() or "").startswith("turn")]
    x, y = max((line.get_xydata() for line in turns), key=len).T
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    assert abs(area) > 0.005
    return np.sign(area)


@pytest.mark.parametrize("model", shipped_models())
def test_every_angle_and_every_rotor_is_named_and_the_picture_of_the_docs_is_this_one(model):
    platform = read_platform(model)
    names = texts(axes_picture(platform))
    assert {letters(name) for name in platform.angle_names} <= names
    assert {rotor.name for rotor in platform.rotors} <= names
    kept = (ROOT / "docs" / "pictures" / f"{model}.svg").read_text(encoding="utf-8")
    assert names - {""} <= {text for text in ET.fromstring(kept).itertext() if text.strip()}


@settings(max_examples=5, deadline=None)
@given(platforms())
def test_arrows_point_along_the_axes_of_any_platform(platform):
    figure = axes_picture(platform)
    rows = seen(figure)
    toward = np.cross(rows[0], rows[1]) / 0.8**2
    axes, spins = arrows(figure, "axis"), arrows(figure, "spin")
    assert set(axes) == set(platform.gimbal_names)
    assert set(spins) == {rotor.name for rotor in platform.rotors}
    expected = [(axes[g.name], g.axis) for g in platform.gimbals]
    expected += [(spins[r.name], r.axis * np.sign(r.angular_momentum)) for r in platform.rotors]
    for found, axis in expected:
        if abs(axis @ toward) < 0.9:
            assert np.hypot(*found) > 0.02
        assert angle_between(found, rows @ axis) < 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (2, -1, 0.5), (-1, 1, 1)])
def test_the_turn_arrow_is_right_handed_about_the_axis(axis, sign):
    figure = axes_picture(plant([("g", "base", [sign * x for x in axis])]))
    rows = seen(figure)
    toward = np.cross(rows[0], rows[1])
    assert turn_sense(figure) == np.sign(sign * toward @ axis)


@pytest.mark.parametrize("k", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_up_is_where_the_specific_force_points(k, sign):
    force = [0.1, 0.1, 0.1]
    force[k] = 9.81 * sign
    rows = seen(axes_picture(plant(root={"specific_force": force})))
    assert angle_between(sign * rows[:, k], np.array([0.0, 1.0])) < 1.0


@settings(max_examples=5, deadline=None)
@given(st.text(st.characters(codec="latin-1", exclude_categories=["C"]), max_size=12))
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
        file = io.StringIO()
        axes_picture(platform).savefig(file, format="svg")
        ET.fromstring(file.getvalue())
