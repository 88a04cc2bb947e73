"""The whole platform, free to turn, sampled: nominal, at other rates, and with all of a spread moved together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.response import frequency_response_arrays
from platform_ctrl.analysis.sampled import held_input, sampled_arrays
from platform_ctrl.check.coupled import measuring
from platform_ctrl.description import OMEGA_NAMES, ROOT_TORQUE_NAMES, Platform
from platform_ctrl.design.plants import changed
from platform_ctrl.frozen import FloatArray, value
from platform_ctrl.job import Job
from platform_ctrl.linearisation import linearise
from platform_ctrl.state_space import state_space as linear_state_space

ATTITUDE = ("attitude1", "attitude2", "attitude3")
# Frequencies of the band: it needs no more to be drawn.
_BAND_POINTS = 70


@value
class FreePlants:
    """Sampled plants of the free platform: torquers → sensors, and what acts on the platform itself.

    Attributes
    ----------
    labels
        Of the N plants, the nominal one first.
    torquers, sensors
        Names of inputs and outputs that controllers use.
    arrays
        A, B, C, D of torquers → sensors, stacks (N, ...).
    turned
        The same with the platform's attitude as states and outputs: torques M1 to M3 on the platform, held and not
        delayed, behind the torquers' inputs; ATTITUDE behind the sensors.
    period
        s.
    frequency : (F,)
        Of the band, rad/s.
    response : complex (N, F, sensors, torquers)
        Of `arrays` there.
    """

    labels: tuple[str, ...]
    torquers: tuple[str, ...]
    sensors: tuple[str, ...]
    arrays: StateArrays
    turned: StateArrays
    period: float
    frequency: FloatArray
    response: ComplexArray


def corners(job: Job) -> list[tuple[str, Platform, FloatArray]]:
    """Return label, platform and rate of the nominal plant, of the corners of Omega, and of those of the spread.

    All inertias move together there, and all momenta: a corner for each sign of each would be hundreds.
    """
    platform, still = job.platform, np.zeros(3)
    out = [("nominal", platform, still)]
    gimbals, rotors = [g.name for g in platform.gimbals], [r.name for r in platform.rotors]
    widths = [("J", job.spread.inertia, gimbals), ("L", job.spread.spin, rotors)]
    widths = [one for one in widths if one[1] > 0.0 and one[2]]
    for signs in product((-1.0, 1.0), repeat=len(widths)) if widths else ():
        moved: dict[str, dict[str, float]] = {"J": {}, "L": {}}
        words = []
        for (letter, width, names), sign in zip(widths, signs, strict=True):
            moved[letter] = dict.fromkeys(names, sign * width)
            words.append(f"all {letter}{sign * width:+.0%}")
        out.append((" ".join(words), changed(platform, moved["J"], moved["L"]), still))
    axes = [(-rate, rate) if rate > 0.0 else (0.0,) for rate in map(float, job.Omega)]
    for rates in product(*axes):
        if any(rates):
            label = f"Omega = ({rates[0]:g}, {rates[1]:g}, {rates[2]:g}) rad/s"
            out.append((label, platform, np.array(rates)))
    return out


def free_plants(
    job: Job, chosen: Sequence[tuple[str, Platform, FloatArray]], rates: Sequence[str], band: bool
) -> FreePlants:
    """Sample the free platform with all of its torquers, pick-offs, and the rate sensors named in `rates`.

    Raises
    ------
    ArgumentError
        The platform cannot be sampled at this rate.
    MechanicsError
        The mass matrix is singular at rest.
    """
    sensors = [*(s.name for s in job.platform.pickoffs), *rates]
    signals = [t.signal for t in job.platform.torquers]
    A, B, C, B_M, C_rate = [], [], [], [], []
    for _, platform, Omega in chosen:
        system = linear_state_space(linearise(platform, Omega=Omega), root="free")
        part = measuring(system, sensors)
        B.append(system.B[:, [system.input_labels.index(name) for name in signals]])
        B_M.append(system.B[:, [system.input_labels.index(name) for name in ROOT_TORQUE_NAMES]])
        C_rate.append(system.C[[system.output_labels.index(name) for name in OMEGA_NAMES]])
        A.append(system.A)
        C.append(part.C)
    stack = {"A": np.array(A), "B": np.array(B), "C": np.array(C)}
    N, _, m = stack["B"].shape
    period, delay, lags = job.sampling.period, job.sampling.delay, [t.lag for t in job.platform.torquers]
    D = np.zeros((N, len(sensors), m))
    arrays = StateArrays(*sampled_arrays(stack["A"], stack["B"], stack["C"], D, period, delay, lags), dt=period)
    turned = _turned(stack, np.array(B_M), np.array(C_rate), len(sensors), period, delay, lags)
    nyquist = np.pi / period
    poles = np.linalg.eigvals(stack["A"][0])
    fastest = float(np.abs(poles).max(initial=0.0)) or 0.1 * nyquist
    low = min(1e-3 * fastest, 0.01 * nyquist)
    grid = np.geomspace(low, 0.999 * nyquist, _BAND_POINTS) if band else np.zeros(0)
    return FreePlants(
        labels=tuple(label for label, _, _ in chosen),
        torquers=tuple(t.name for t in job.platform.torquers),
        sensors=tuple(sensors),
        arrays=arrays,
        turned=turned,
        period=period,
        frequency=grid,
        response=frequency_response_arrays(*arrays, grid) if band else np.zeros((N, 0, len(sensors), m), np.complex128),
    )


def _turned(
    stack: Mapping[str, FloatArray],
    B_M: FloatArray,
    C_rate: FloatArray,
    sensors: int,
    period: float,
    delay: float,
    lags: Sequence[float],
) -> StateArrays:
    N, n, m = stack["B"].shape
    A = np.zeros((N, n + 3, n + 3))
    A[:, :n, :n], A[:, n:, :n] = stack["A"], C_rate
    B, acting = (np.concatenate([item, np.zeros((N, 3, item.shape[-1]))], axis=1) for item in (stack["B"], B_M))
    C = np.zeros((N, sensors + 3, n + 3))
    C[:, :sensors, :n], C[:, sensors:, n:] = stack["C"], np.eye(3)
    D = np.zeros((N, sensors + 3, m))
    held = held_input(A, acting, period)[1]
    A, B, C, D = sampled_arrays(A, B, C, D, period, delay, lags)
    both = np.zeros((N, A.shape[-1], m + 3))
    both[..., :m] = B
    # The sampled states begin with the plant's own, which lags and held torques do not hear of.
    both[:, : n + 3, m:] = held
    return StateArrays(A, both, C, np.concatenate([D, np.zeros((N, sensors + 3, 3))], axis=-1), period)
