"""The numbers of scenarios that fly side by side, for all of them at a time: rows (N, parts, slots) of `Flight`.

Those of a scenario do not depend on which others there are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.description import Platform
from platform_ctrl.frozen import FloatArray
from platform_ctrl.scenario import Fault, Scenario
from platform_ctrl.simulation.attitude import unit_quaternions
from platform_ctrl.simulation.kernel import flight as layout
from platform_ctrl.simulation.packing import Packed, Skeleton
from platform_ctrl.simulation.servo_rotors import servo_rotors, with_rotor_states

# A fault's kind, its part, and which one of these it is.
FaultKey = tuple[str, str, int]


class Plants(NamedTuple):
    """The plants of N scenarios, each once, and `which` of them each scenario flies on, (N,)."""

    made: list[Platform]
    which: NDArray[np.intp]


def plants_of(scenarios: Sequence[Scenario]) -> Plants:
    """Return the plants that scenarios fly on; of many that fly on the same one it is packed once."""
    places: dict[int, int] = {}
    made: list[Platform] = []
    which = np.empty(len(scenarios), dtype=np.intp)
    for k, scenario in enumerate(scenarios):
        which[k] = places.setdefault(id(scenario.platform), len(made))
        if which[k] == len(made):
            made.append(scenario.platform)
    return Plants(made, which)


def states(scenarios: Sequence[Scenario], packed: Packed) -> FloatArray:
    """States at t = 0, (N, size), v holding the rates."""
    attitudes = unit_quaternions([s.attitude for s in scenarios], (len(scenarios), 4))
    rows = [np.array([getattr(s, name) for s in scenarios]) for name in ("q", "Omega", "rate")]
    states = np.concatenate([*rows, attitudes], axis=1)
    if packed.at.servos == 0:
        return states
    spins = [[r.spin for r in servo_rotors(s.platform)] if s.spin is None else s.spin for s in scenarios]
    inertias = [[r.axial_inertia for r in servo_rotors(s.platform)] for s in scenarios]
    return with_rotor_states(packed, states, np.array(spins), np.array(inertias))


def rate(scenario: Scenario) -> list[float]:
    """The half-cosine's rate vector, its rise and hold; the scale of the time table."""
    row = [0.0] * layout.PROFILE
    if scenario.profile is not None:
        row[scenario.profile.axis - 1] = scenario.profile.rate
        row[layout.RISE], row[layout.HOLD] = scenario.profile.rise, scenario.profile.hold
    table = scenario.torque_table if scenario.mode == "stabilised" else scenario.Omega_table
    row[layout.SCALE] = 1.0 if table is None else table.scale
    return row


def put_sensors(plants: Plants, rows: FloatArray, period: float, noise: bool) -> None:
    """Noise of a sample, and quantisation."""
    if rows.size == 0:
        return
    # Sensors that do not differ from plant to plant are the same objects: the noise of a sample is found once.
    sampled: dict[int, float] = {}
    kinds = [p.sensors for p in plants.made]
    for sensor in (sensor for sensors in kinds for sensor in sensors):
        if id(sensor) not in sampled:
            sampled[id(sensor)] = sensor.sampled_noise(period) if noise else 0.0
    rows[:, :, layout.RMS] = np.array([[sampled[id(sensor)] for sensor in sensors] for sensors in kinds])[plants.which]
    rows[:, :, layout.QUANTISATION] = np.array([[one.quantisation for one in sensors] for sensors in kinds])[
        plants.which
    ]


def put_torquers(plants: Plants, rows: FloatArray, half: FloatArray) -> None:
    """Limits, and how torques follow in half a substep of each segment, `half` (N, 2)."""
    if rows.size == 0:
        return
    limit, slew, lag = np.array(
        [
            [
                (math.inf if t.limit is None else t.limit, math.inf if t.rate_limit is None else t.rate_limit, t.lag)
                for t in p.torquers
            ]
            for p in plants.made
        ]
    )[plants.which].transpose(2, 0, 1)
    rows[:, :, layout.LIMIT] = limit
    rows[:, :, layout.AT_ONCE] = np.where(np.isinf(slew), math.inf, 0.0)
    for segment in range(2):
        step = half[:, segment, None]
        # No limit stays none over a segment of no length.
        with np.errstate(invalid="ignore"):
            rows[:, :, layout.SLEW + segment] = np.where(np.isinf(slew), math.inf, step * slew)
        lagging = np.where(lag > 0.0, lag, 1.0)
        rows[:, :, layout.DECAY + segment] = np.where(lag > 0.0, np.exp(-step / lagging), 0.0)


def put_stops(plants: Plants, rows: FloatArray) -> None:
    """Where the stops are, and what they give back."""
    if rows.size == 0:
        return
    rows[:, :, layout.LOW], rows[:, :, layout.HIGH], rows[:, :, layout.RESTITUTION] = np.array(
        [[(*(g.stops or (-math.inf, math.inf)), g.restitution) for g in p.gimbals] for p in plants.made]
    )[plants.which].transpose(2, 0, 1)


def put_faults(happening: Sequence[dict[FaultKey, Fault]], order: Sequence[FaultKey], rows: FloatArray) -> None:
    """Begin, end and numbers of what happens to each scenario; `order` are the columns."""
    rows[:, :, : layout.STUCK] = math.inf, math.inf, 1.0, 1.0  # what does not happen in a run begins never
    column = {key: k for k, key in enumerate(order)}
    for row, faults in zip(rows, happening, strict=True):
        for key, fault in faults.items():
            row[column[key], : layout.STUCK] = _numbers(fault)


def put_rotors(shape: Skeleton, plants: Plants, rotors: Sequence[int], rows: FloatArray) -> None:
    """L s of rotors that fail, in the kernel's axes; the nominal spin of servo rotors."""
    for j, k in enumerate(rotors):
        if k in shape.servos:
            rows[:, j, 0] = np.array([p.rotors[k].spin for p in plants.made])[plants.which]
        else:
            L = np.array([p.rotors[k].angular_momentum for p in plants.made])[plants.which]
            rows[:, j, :3] = L[:, None] * (shape.frames[shape.carriers[k]] @ shape.spin_axes[k])


def _numbers(fault: Fault) -> tuple[float, float, float, float]:
    """Begin, end and the two numbers of a fault."""
    match fault.kind:
        case "rotor run-down" | "rotor run-up":
            return fault.at, fault.until, fault.share, fault.time_constant
        case "speed ripple":
            return fault.at, fault.until, fault.amplitude, 2.0 * math.pi * fault.frequency_hz
        case "torquer weak":
            first = fault.share
        case "pick-off drift":
            first = fault.rate
        case "pick-off dropout" | "controller overrun":
            first = fault.probability
        case "stop contact":
            first = fault.impulse
        case _:
            first = 0.0
    return fault.at, fault.until, first, 0.0


def put_lines(scenarios: Sequence[Scenario], rows: FloatArray, half: FloatArray) -> None:
    """Amplitudes of the vibrations' lines, and how far they turn in half a substep of each segment."""
    place = 0
    for k, vibration in enumerate(scenarios[0].vibrations):
        known: dict[int, FloatArray] = {}
        for scenario in scenarios:
            one = scenario.vibrations[k]
            if id(one) not in known:
                omega, known[id(one)] = one.amplitudes
        own = rows[:, place : place + vibration.lines]
        own[:, :, layout.AMPLITUDE] = [known[id(scenario.vibrations[k])] for scenario in scenarios]
        for segment in range(2):
            turn = omega * half[:, segment, None]
            own[:, :, layout.TURN + 2 * segment] = np.cos(turn)
            own[:, :, layout.TURN + 2 * segment + 1] = np.sin(turn)
        place += vibration.lines
