"""Loops to start from for a given plant: sample rate, manoeuvre and classical loops, as rules of thumb suggest them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.frozen import value

if TYPE_CHECKING:
    from platform_ctrl.job import Job, LoopSpec
    from platform_ctrl.linearisation import LinearModel

# How long the turn's rate rises, s.
RISE = 0.2
# Samples in a period of the fastest mode, and the slowest rate that is proposed, Hz.
_SAMPLES, _SLOWEST = 12.0, 1000.0
# Fastest turn that is proposed, rad/s; share of the torque limits that it may take; rms of noise in the same share.
_TURN, _TURN_SHARE, _NOISE_SHARE = 0.1, 0.3, 0.1
# Starting values are the method's defaults times halves of one, down to here. They have this much to spare: the tuner's
# reserve, so that it need not move far.
_HALVINGS, _ENOUGH = 8, 0.95
# Platform rates about each axis at which subsystems are looked for: both ends, as in a job.
_RATES = 2
_DISK_MARGIN, _LEAST_DISK_MARGIN = 0.3, 0.05


@value
class StartingLoop:
    """A caging loop with starting values.

    Attributes
    ----------
    gimbals
        A subsystem.
    torque_limit, torque_noise
        The weakest torquer's limit and what noise may take of it, N m; None where no torquer has a limit.
    disk_margin
        Limit: 0.3, or what the starting values reach where that is less.
    options
        Of the classical method, Hz.
    """

    gimbals: tuple[str, ...]
    disk_margin: float
    torque_limit: float | None
    torque_noise: float | None
    options: dict[str, float]


@value
class Start:
    """What a job for a plant can start from.

    Attributes
    ----------
    fastest_hz
        The plant's fastest mode, Hz.
    rate_hz
        Sample rate, Hz.
    axis, rate
        Root axis about which a turn torques the gyros most, and a rate for it, rad/s.
    loops
        One for each subsystem.
    """

    fastest_hz: float
    rate_hz: float
    axis: int
    rate: float
    loops: tuple[StartingLoop, ...]


def starting_loops(plant: dict[str, Any]) -> Start:
    """Return a start for the plant in a file's tables; all its gimbals have torquers and pick-offs.

    The starting values are the first, from fast to slow, with which a loop is stable and near its limits, or else the
    best: what the tuner finds its way from.

    Raises
    ------
    InputError
        No job can be made for this plant.
    """
    from platform_ctrl.design.plants import subsystems_over
    from platform_ctrl.linearisation import linearise
    from platform_ctrl.reading import read_job, read_platform
    from platform_ctrl.state_space import state_space

    platform = read_platform(plant)
    model = linearise(platform)
    fastest = float(np.abs(np.linalg.eigvals(state_space(model).A)).max(initial=0.0)) / (2.0 * math.pi)
    rate_hz = max(_round(_SAMPLES * fastest, up=True), _SLOWEST)
    limits = {one.gimbal: one.limit for one in platform.torquers if one.gimbal is not None and one.limit is not None}
    axis, rate = _turn(model, limits)
    bare = {
        "schema": 1,
        "name": "start",
        "plant": plant,
        "operation": {"Omega": [rate] * 3},
        "sampling": {"rate_hz": rate_hz, "delay": 1.0 / rate_hz},
        "loop": [
            {
                "name": " ".join(gimbals),
                "kind": "caging",
                "gimbals": list(gimbals),
                "use": "classical",
                "limits": {"disk_margin": _DISK_MARGIN} | _noise_limit(gimbals, limits),
                "design": [{"name": "classical", "method": "classical"}],
            }
            for gimbals in subsystems_over(platform, np.full(3, rate), _RATES)
        ],
    }
    job = read_job(bare)
    loops = tuple(_loop(job, spec, model, limits) for spec in job.loops)
    return Start(fastest_hz=fastest, rate_hz=rate_hz, axis=axis, rate=rate, loops=loops)


def _turn(model: LinearModel, limits: dict[str, float]) -> tuple[int, float]:
    """Return the axis about which a turn asks the most torque, and a rate for which the torquers have enough.

    The torques for each rad/s: of the rotors at the rate itself, of the inertias while it rises along half a cosine.
    """
    torques = np.abs(model.G_Omega) + 0.5 * math.pi / RISE * np.abs(model.M_Omega)
    axis = int(torques.sum(axis=0).argmax())
    rates = [
        _TURN_SHARE * limits[name] / torque
        for name, torque in zip(model.gimbal_names, torques[:, axis], strict=True)
        if name in limits and torque > 0.0
    ]
    return axis + 1, _round(min([_TURN, *rates]), up=False)


def _noise_limit(gimbals: tuple[str, ...], limits: dict[str, float]) -> dict[str, float]:
    known = [limits[name] for name in gimbals if name in limits]
    return {"torque_noise": _round(_NOISE_SHARE * min(known), up=False)} if known else {}


def _loop(job: Job, spec: LoopSpec, model: LinearModel, limits: dict[str, float]) -> StartingLoop:
    from platform_ctrl.design.channels import channels
    from platform_ctrl.design.classical import classical_controller, starting_values
    from platform_ctrl.design.plants import plants_of, rows_of
    from platform_ctrl.design.tuning import worst_ratio
    from platform_ctrl.requirements import loop_requirements

    plants = plants_of(job, spec)
    assert plants is not None, "a caging loop has plants"
    channel = channels(model, rows_of(model, spec.gimbals))
    requirements = loop_requirements(spec.limits)
    best: tuple[float, dict[str, float]] = (math.inf, {})
    for given in _tried(starting_values({}, channel, plants.nutation, plants.period)):
        complete = starting_values(given, channel, plants.nutation, plants.period)
        ratio = worst_ratio(classical_controller(complete, channel, plants.period), plants, requirements)
        if ratio < best[0]:
            best = (ratio, given)
        if ratio <= _ENOUGH:
            break
    reached = _DISK_MARGIN if best[0] <= 1.0 else _round(_ENOUGH * _DISK_MARGIN / best[0], up=False)
    return StartingLoop(
        gimbals=spec.gimbals,
        torque_limit=min((limits[name] for name in spec.gimbals if name in limits), default=None),
        torque_noise=spec.limits.torque_noise,
        disk_margin=max(reached, _LEAST_DISK_MARGIN),
        options=best[1],
    )


def _tried(default: dict[str, float]) -> Iterator[dict[str, float]]:
    """Go through starting values, from fast to slow: the roll-off stays where it is."""
    moved = [name for name in default if "rolloff" not in name]
    for halvings in range(_HALVINGS + 1):
        yield {name: float(f"{default[name] * 0.5**halvings:.2g}") for name in moved}


def _round(number: float, *, up: bool) -> float:
    """Return the next of 1, 2, 5, 10, ... above or below a positive number, in its decade."""
    if not number > 0.0:
        return 0.0
    decade = 10.0 ** math.floor(math.log10(number))
    steps, slack = [step * decade for step in (0.5, 1.0, 2.0, 5.0, 10.0)], 1e-9 * number
    chosen = min(x for x in steps if x >= number - slack) if up else max(x for x in steps if x <= number + slack)
    return float(f"{chosen:.1g}")
