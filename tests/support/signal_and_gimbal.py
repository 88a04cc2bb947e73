"""A plant of two gimbals whose runs are known without an integrator, and how to fly it."""

from __future__ import annotations

from typing import Any

import control
import numpy as np

from plant_parts import PickOff, RateSensor, Torquer
from platform_ctrl import Platform, simulation
from platform_ctrl.simulation import Fault, Scenario
from small_trees import tree

PERIOD = 1e-3
J = 2e-3
RMS = 1e-3


def plant(
    stops: tuple[float, float] | None = None,
    restitution: float = 0.0,
    noise: float = 0.0,
    quantisation: float = 0.0,
    **torquer: float,
) -> Platform:
    """Two gimbals that do not feel each other on a held root: what `signal` reads is a straight line, `g` is turned."""
    sensor = {"noise_rms": noise, "noise_bandwidth_hz": 0.5 / PERIOD, "quantisation": quantisation}
    return tree(
        0.01,
        [("s", "case", 1, 1.0, "signal"), ("g", "case", 3, J, "alpha", {"stops": stops, "restitution": restitution})],
        base="case",
        torquers=(Torquer(name="Qg", gimbal="g", **torquer),),
        pickoffs=(PickOff(name="signal", gimbal="s", **sensor), PickOff(name="alpha", gimbal="g", **sensor)),
        rate_sensors=(
            RateSensor(name="signal_rate", gimbal="s", **sensor),
            RateSensor(name="Omega2", root_axis=2, **sensor),
        ),
    )


def gain(number: float = 1.0, of: str = "signal") -> control.StateSpace:
    return control.ss([], [], [], [[number]], PERIOD, inputs=[of], outputs=["Qg"], name="gain")


def scenario(platform: Platform, level: float = 1.0, slope: float = 0.0, **more: object) -> Scenario:
    given: dict[str, object] = {"mode": "caged", "duration": 0.1, "delay": 0.0, "q": [level, 0.0], "rate": [slope, 0.0]}
    return Scenario(platform=platform, **(given | more))  # type: ignore[arg-type]


def flown(platform: Platform, *faults: Fault, step: float = 1e-4, **more: object) -> Any:
    return simulation.simulate(scenario(platform, faults=faults, **more), [gain()], period=PERIOD, step=step)


def fault(kind: str, part: str | None = "Qg", at: float = 0.03, until: float = 0.07, **numbers: float) -> Fault:
    return Fault(name="f", kind=kind, part=part, at=at, until=until, **numbers)  # type: ignore[arg-type]


def within(t: np.ndarray, begin: float, end: float) -> np.ndarray:
    return (t > begin - 1e-9) & (t < end - 1e-9)
