"""Profiles of base motion that a source of a budget may name, each with where its numbers come from.

A profile is an entry of `PROFILES`. Breakpoints of standards are in g²/Hz there and in SI here; tests integrate the
tables and compare with the overall rms that the standards state.
"""

from __future__ import annotations

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


def _olympus() -> FloatArray:
    """Return points of the rate of an angle whose density is 160/(1 + f²) µrad²/Hz, f in Hz."""
    f = np.geomspace(0.01, 500.0, round(_PER_DECADE * np.log10(500.0 / 0.01)) + 1)
    return np.array([f, (2.0 * np.pi * f) ** 2 * 160e-12 / (1.0 + f**2)]).T


def _in_g(*points: tuple[float, float]) -> FloatArray:
    return np.array(points) * (1.0, G**2)


# Not compared with the text of the standards: known are the tables' overall rms, to which these points integrate.
_TRUCK = "assumed: points as in MIL-STD-810G, method 514.6, US highway truck; compare with its text"

PROFILES: dict[str, Profile] = {
    profile.name: profile
    for profile in (
        Profile(
            name="olympus-satellite",
            kind="base-rate",
            title="angular micro-vibration of a large satellite: angle 160/(1 + f²) µrad²/Hz, 16 µrad rms",
            source="published: ESA, fitted to accelerations of Olympus: M. Wittig et al., Proc. SPIE 1218, 1990",
            points=_olympus(),
        ),
        Profile(
            name="highway-truck-vertical",
            kind="specific-force",
            title="cargo bed of a truck on a highway, vertical",
            source=_TRUCK,
            points=_in_g((10, 0.015), (40, 0.015), (500, 0.00015)),
        ),
        Profile(
            name="highway-truck-transverse",
            kind="specific-force",
            title="the same, transverse",
            source=_TRUCK,
            points=_in_g((10, 13e-5), (20, 65e-5), (30, 65e-5), (78, 2e-5), (79, 19e-5), (120, 19e-5), (500, 1e-5)),
        ),
        Profile(
            name="highway-truck-longitudinal",
            kind="specific-force",
            title="the same, longitudinal",
            source=_TRUCK,
            points=_in_g(
                *((10, 0.0065), (20, 0.0065), (120, 0.0002), (121, 0.003)),
                *((200, 0.003), (240, 0.0015), (340, 0.00003), (500, 0.00015)),
            ),
        ),
        Profile(
            name="jet-fuselage",
            kind="specific-force",
            title="equipment in the fuselage of a fixed-wing jet",
            source="assumed: points as in RTCA DO-160, section 8, random vibration, curve C; compare with its text",
            points=_in_g((10, 0.012), (40, 0.012), (100, 0.002), (500, 0.002), (2000, 0.00013)),
        ),
        Profile(
            name="multirotor",
            kind="base-rate",
            title="small multirotor in light gusts: attitude control below 10 Hz, rotors at 90 to 150 Hz",
            source="assumed, typical of gyro logs of small multirotors",
            points=np.array(
                [
                    *((0.1, 2e-3), (2.0, 2e-3), (30.0, 1e-5), (70.0, 1e-5)),
                    *((90.0, 5e-5), (150.0, 5e-5), (200.0, 5e-6), (400.0, 1e-6)),
                ]
            ),
        ),
        Profile(
            name="wheeled-vehicle",
            kind="base-rate",
            title="pitch or roll of a wheeled vehicle on a rough road: body at 1 to 2 Hz, wheels at 10 to 14 Hz",
            source="assumed, typical of off-road vehicles with suspension",
            points=np.array(
                [
                    *((0.1, 1e-4), (1.0, 3e-3), (2.0, 3e-3), (5.0, 2e-4)),
                    *((10.0, 1e-4), (14.0, 1e-4), (30.0, 5e-6), (100.0, 1e-7)),
                ]
            ),
        ),
        Profile(
            name="ship-roll",
            kind="base-rate",
            title="roll of a ship of frigate size in a beam sea: natural period 10 s, 2.8° rms",
            source="assumed, typical of sea state 5",
            points=np.array([(0.02, 1e-5), (0.07, 5e-3), (0.1, 2e-2), (0.13, 5e-3), (0.3, 1e-4), (1.0, 1e-6)]),
        ),
    )
}
