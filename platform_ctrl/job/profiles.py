"""Profiles of base motion that a source of a budget may name, each with where its numbers come from.

A profile is a table of profiles.toml, or a formula here. Breakpoints of standards are in g²/Hz there and in SI here;
tests integrate the tables and compare with the overall rms that the standards state.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Literal

import numpy as np

from platform_ctrl.analysis.logs import G
from platform_ctrl.common.values import FloatArray, value

_PER_DECADE = 40  # points of a formula's table: between them it is off by less than 0.05 %


@value
class Profile:
    """A one-sided power spectral density, straight lines on logarithmic scales, zero outside of its points.

    Attributes
    ----------
    name
        What job files call it.
    kind
        What it is a density of: ``"base-rate"``, rad/s, or ``"specific-force"``, m/s².
    title
        What moves, in words.
    source
        Where the numbers are from, and whether they are published or assumed.
    points : (k, 2)
        Frequencies, increasing, Hz, and densities, (rad/s)²/Hz or (m/s²)²/Hz.
    """

    name: str
    kind: Literal["base-rate", "specific-force"]
    title: str
    source: str
    points: FloatArray


def _profiles() -> dict[str, Profile]:
    f = np.geomspace(0.01, 500.0, round(_PER_DECADE * np.log10(500.0 / 0.01)) + 1)
    olympus = Profile(
        name="olympus-satellite",
        kind="base-rate",
        title="angular micro-vibration of a large satellite: angle 160/(1 + f²) µrad²/Hz, 16 µrad rms",
        source="published: ESA, fitted to accelerations of Olympus: M. Wittig et al., Proc. SPIE 1218, 1990",
        points=np.array([f, (2.0 * np.pi * f) ** 2 * 160e-12 / (1.0 + f**2)]).T,
    )
    tables = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["profile"]
    unit = {"base-rate": 1.0, "specific-force": G**2}
    return {olympus.name: olympus} | {
        one["name"]: Profile(**one | {"points": np.array(one["points"]) * (1.0, unit[one["kind"]])}) for one in tables
    }


PROFILES = _profiles()
