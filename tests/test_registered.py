"""What is registered keeps one contract: names, a place in the documentation, reading, refusals in a sentence."""

from __future__ import annotations

from every_key import every_plant_key
from platform_ctrl import linearise, read_platform, state_space
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.simulation.packing import skeleton


def test_every_sensor_is_in_linear_models_and_in_simulations() -> None:
    platform = read_platform(every_plant_key())
    free = state_space(linearise(platform), root="free")
    packed = skeleton(platform).sensors
    assert len(packed) == len(platform.sensors) > 0
    every = [sensor.name for sensor in platform.sensors]
    assert observed(free, platform, every).output_labels == every
    assert {sensor.unit for sensor in platform.sensors} <= {"rad", "rad/s"}
