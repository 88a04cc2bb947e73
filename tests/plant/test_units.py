"""Keys with a unit are SI values in that unit."""

import math

import pytest

import platform_ctrl as pc
from every_key import every_plant_key


def plant(table, **keys):
    data = every_plant_key()
    for key in keys:
        data[table][0].pop(key.rsplit("_", 1)[0].removesuffix("_deg"), None)
    data[table][0] |= keys
    return data


@pytest.mark.parametrize(
    ("table", "key", "given", "field", "value"),
    [
        ("torquer", "lag_ms", 0.2, "torquers", 2e-4),
        ("torquer", "lag_us", 200.0, "torquers", 2e-4),
        ("cage", "clearance_arcsec", 3600.0, "cages", math.pi / 180),
        ("pickoff", "quantisation_bits", 19, "pickoffs", 2 * math.pi / 2**19),
        ("rate_sensor", "bias_deg_s", 0.5, "rate_sensors", math.radians(0.5)),
        ("friction", "stribeck_rate_deg_s", 2.0, "frictions", math.radians(2.0)),
        ("spring", "rest_deg", -1.0, "springs", -math.radians(1.0)),
    ],
)
def test_a_suffix_is_a_unit(table, key, given, field, value):
    platform = pc.read_platform(plant(table, **{key: given}))
    base = key
    for suffix in ("_ms", "_us", "_arcsec", "_bits", "_deg_s", "_deg"):
        base = base.removesuffix(suffix)
    assert getattr(getattr(platform, field)[0], base) == pytest.approx(value, rel=1e-15)
