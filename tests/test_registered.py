"""What is registered keeps one contract: names, a place in the documentation, reading, refusals in a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from every_key import every_plant_key
from platform_ctrl import read_platform
from platform_ctrl.job.faults import FAULT_KINDS
from platform_ctrl.job.methods import METHODS
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.tables import shape
from platform_ctrl.simulation.packing import skeleton

DOCS = Path(__file__).parents[1] / "docs"
PARTS = {table: key for table, key in shape(Platform).keys.items() if key.array is not None}


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("registry", "name", "text"),
    [
        *((PARTS, name, f"[[{name}]]") for name in PARTS),
        *((FAULT_KINDS, name, name) for name in FAULT_KINDS),
        *((METHODS, name, f'`"{name}"`') for name in METHODS),
    ],
)
def test_every_entry_is_in_the_documentation(registry: dict[str, Any], name: str, text: str) -> None:
    assert name in registry
    assert text in page("reference/plant-file.md" if registry is PARTS else "reference/job-file.md")


def test_every_sensor_is_in_linear_models_and_in_simulations() -> None:
    platform = read_platform(every_plant_key())
    free = state_space(linearise(platform), root="free")
    packed = skeleton(platform).sensors
    assert len(packed) == len(platform.sensors) > 0
    every = [sensor.name for sensor in platform.sensors]
    assert observed(free, platform, every).output_labels == every
    assert {sensor.unit for sensor in platform.sensors} <= {"rad", "rad/s"}
