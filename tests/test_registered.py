"""What is registered keeps one contract: names, a place in the documentation, reading, refusals in a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from every_key import HERE, every_job_key, every_plant_key
from platform_ctrl import read_job, read_platform
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.export.exporters import FORMS
from platform_ctrl.job.faults import FAULT_KINDS, FAULT_NUMBERS, Fault
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.requirements import limit_keys
from platform_ctrl.mechanics.linearisation import linearise
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.tables import shape
from platform_ctrl.simulation.packing import skeleton

DOCS = Path(__file__).parents[1] / "docs"
PARTS = {table: key for table, key in shape(Platform).keys.items() if key.array is not None}
LIMITS = sorted(limit_keys())


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def refusal(data: dict[str, Any]) -> str:
    with pytest.raises(InputError) as error:
        read_job(data, folder=HERE)
    return str(error.value)


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
    assert text in page("plant-file.md" if registry is PARTS else "job-file.md")


@pytest.mark.parametrize("name", [one.name for one in FORMS])
def test_every_form_of_export_is_in_the_documentation(name: str) -> None:
    assert f"--{name}" in page("command-line.md") + page("export.md")


@pytest.mark.parametrize("key", LIMITS)
def test_every_limit_has_a_row_and_refuses_a_wrong_number_in_a_sentence(key: str) -> None:
    assert f"`{key}`" in page("job-file.md")
    data = every_job_key()
    loop = next(one for one in data["loop"] if key in one.get("limits", {}))
    loop["limits"][key] = -1.0
    assert f"{key} must be a number > 0, got -1.0" in refusal(data)


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_every_fault_refuses_a_number_that_is_none_in_a_sentence(kind: str) -> None:
    for key in ("at", *FAULT_KINDS[kind].keys):
        assert key in FAULT_NUMBERS
        with pytest.raises(ArgumentError, match=f"Fault: {key} must be a number, got 'x'"):
            Fault(**{"name": "tried", "kind": kind, "at": 0.1} | {key: "x"})


@pytest.mark.parametrize("table", PARTS)
def test_every_part_is_read_and_refuses_what_is_no_table(table: str) -> None:
    data = every_plant_key()
    assert len(getattr(read_platform(data), PARTS[table].field)) == len(data[table])
    with pytest.raises(InputError, match=rf"{table} must be a table, got 3"):
        read_platform(data | {table: [3]})


def test_every_sensor_is_in_linear_models_and_in_simulations() -> None:
    platform = read_platform(every_plant_key())
    free = state_space(linearise(platform), root="free")
    packed = skeleton(platform).sensors
    assert len(packed) == len(platform.sensors) > 0
    every = [sensor.name for sensor in platform.sensors]
    assert observed(free, platform, every).output_labels == every
    assert {sensor.unit for sensor in platform.sensors} <= {"rad", "rad/s"}


def test_names_are_those_of_the_entries() -> None:
    assert all(method.key == key for key, method in METHODS.items())
    assert all(kind.name == key for key, kind in FAULT_KINDS.items())
    assert all(metric.name and metric.meaning for metric in METRICS.values())
