"""Linear feedforward of the platform's rate, derived from the linear model at zero angles.

A loop has to keep the rates T q̇ + c Omega at zero; it does so where its gimbals turn at q̇ = W Omega, W = −T⁺ c.

Into the torque: with W in the equations M q̈ + D q̇ + K q + M_Omega Omega' + G_Omega Omega = Q the gimbals need

    Q = (M W + M_Omega) Omega' + (D W + G_Omega) Omega + (K W − F) ∫Omega dt,

for the inertia that couples, viscous friction and rotors, springs, and the torque F θ of gravity, fixed in space, as
the platform turns by θ. Omega' is filtered, the integral decays slowly, so that what the sensors' bias adds up to stays
bounded.

Into the readings y = T_y q̇ + c_y Omega: y + w Omega is zero at q̇ = W Omega, where W is that of the inertial rates of
the same bodies about the same axes: w = −(T_y W + c_y). Angles get w ∫Omega dt.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.between_samples import RateFeedforward
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.sampling import every_nth, from_w_plane, held_input, late_outputs
from platform_ctrl.analysis.system import System, seen_states
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.loop_signals import LoopSignals, loop_signals, without_sensors
from platform_ctrl.design.plants import plants_of
from platform_ctrl.design.sight import LoopSight
from platform_ctrl.errors import InputError
from platform_ctrl.job.drive import Feedforward
from platform_ctrl.job.job import Job, LoopSpec
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.job.resolve import ideal
from platform_ctrl.mechanics.linearisation import LinearModel, linearise
from platform_ctrl.mechanics.outputs import observed_system
from platform_ctrl.mechanics.state_space import linear_system, tilting
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform
from platform_ctrl.plant.sensors import Sensor, body_rates, body_rotations, components, gimbal_rate

# Bandwidth of the filtered derivative over the sample rate, where none is given.
_DERIVATIVE = 0.1
# Rate at which integrals of the platform's rate decay in feedforward, 1/s.
_LEAK = 0.2
# A share of the largest that is rounding.
_ROUNDING = 1e-9


def design_plants(job: Job, spec: LoopSpec, design: DesignSpec, known: PlantSet | None) -> PlantSet | None:
    """Return the plants of a design of a loop, its feedforward in them; None where the loop has none of its own.

    `known` are those of a design with the same sensors and no feedforward.
    """
    read = spec.read_by(design)
    plants = plants_of(job, read) if known is None else known
    if plants is not None and design.feedforward is not None:
        plants = plants.fed_forward(rate_feedforward(job, read, design))
    if plants is None or not any(one.metric.of_sight for one in spec.requests):
        return plants
    return replaced(plants, {"sight_budget": LoopSight(job=job, loop=spec.name, plants=plants)})


def rate_feedforward(job: Job, spec: LoopSpec, design: DesignSpec) -> RateFeedforward:
    """Return the feedforward of a design of a loop, sampled."""
    assert design.feedforward is not None, "the design has feedforward"
    platform, fed, every, period = job.platform, design.feedforward, job.every(spec), job.period_of(spec)
    where = f"loop {spec.name!r}: {design.name}: feedforward"
    model, signals = linearise(platform), loop_signals(platform, spec)
    by_name = {sensor.name: sensor for sensor in platform.sensors}
    sensors = [by_name[name] for name in fed.sensors]
    seen = np.array([[ideal(s).signals(platform).get(name, 0.0) for name in OMEGA_NAMES] for s in sensors])
    scale = np.array([1.0 + sensor.scale_error for sensor in sensors])
    if fed.into == "torque":
        path = _torque(model, signals, fed, seen, period)
    else:
        weights = _weights(model, signals)
        w = weights @ np.linalg.pinv(seen)
        _expect_whole(where, weights, w @ seen, signals)
        # What the rates add to rates that are read, or their integrals to angles.
        rates = np.array(signals.orders)[:, None] == 1
        path = _filtered(w * rates, [(w * ~rates, _LEAK)], period)
        # The signs of the sensors' errors that hurt most: a body at rest shows −weights Omega in the readings, with the
        # readings' own errors. Of a rate that one sensor subtracts from another the difference of the errors is left.
        left = (np.array([sensor.scale_error for sensor in signals.sensors])[:, None] * weights) @ seen.T
        sign = np.where(np.einsum("ik,ik->k", w, left) > 0.0, -1.0, 1.0)
        scale = 1.0 + sign * np.abs([sensor.scale_error for sensor in sensors])
    if not path.D.any():
        words = f"with into = {fed.into!r} the rates {', '.join(fed.sensors)} add nothing to this loop"
        raise InputError(f"{where}: {words}; leave it out, or choose other sensors")
    late = [sensor.periods_late(job.sampling.period, every) for sensor in sensors]
    smooth = _measured(model, signals, sensors, scale)
    return RateFeedforward(
        into=fed.into,
        sensors=tuple(fed.sensors),
        path=path,
        measured=_held(smooth, late, job.sampling.period, every),
        smooth=smooth,
        late=job.sampling.period * np.array(late),
        noise=np.array([sensor.sampled_noise(job.sampling.period, every) for sensor in sensors]),
    )


def _rates_of(platform: Platform, sensor: Sensor) -> dict[str, float]:
    """Return the reading of a sensor, or the rate of a measured angle, as a sum of rates."""
    rates = {gimbal.angle: gimbal_rate(gimbal.angle) for gimbal in platform.gimbals}
    for body in range(len(platform.gimbals) + 1):
        rates |= dict(zip(body_rotations(platform, body), body_rates(platform, body), strict=True))
    return {rates.get(name, name): weight for name, weight in ideal(sensor).signals(platform).items()}


def _inertial(platform: Platform, rates: dict[str, float]) -> dict[str, float]:
    """Return rates with those of gimbals against their parents replaced by their bodies' against inertial space."""
    own = {gimbal_rate(gimbal.angle): k for k, gimbal in enumerate(platform.gimbals)}
    out: dict[str, float] = {}
    for name, weight in rates.items():
        parts = {name: 1.0}
        if name in own:
            parts = components(body_rates(platform, own[name] + 1), platform.gimbals[own[name]].axis)
        for part, share in parts.items():
            out[part] = out.get(part, 0.0) + weight * share
    return out


def _shown(model: LinearModel, signals: LoopSignals, sums: Sequence[dict[str, float]]) -> tuple[FloatArray, FloatArray]:
    """Return T (p, n) and c (p, 3) of sums of rates at zero angles: T q̇ + c Omega."""
    names = list(dict.fromkeys(name for one in sums for name in one))
    bare = without_sensors(model.platform)
    system = observed_system(linear_system(model, signals.gimbals, others="held"), bare, names, model.q0)
    mixing = np.array([[one.get(name, 0.0) for name in names] for one in sums])
    rows, n = rows_of(model, signals.gimbals), len(signals.gimbals)
    # The states are angles and momenta p = M q̇ + M_Omega Omega, gimbals in the model's order.
    in_file = sorted(rows)
    T = mixing @ system.C[:, n : 2 * n] @ model.M[np.ix_(in_file, in_file)]
    columns = [system.input_labels.index(name) for name in OMEGA_NAMES]
    c = mixing @ (system.D[:, columns] + system.C[:, n : 2 * n] @ model.M_Omega[in_file])
    return T[:, [in_file.index(row) for row in rows]], c


def _torque(model: LinearModel, signals: LoopSignals, fed: Feedforward, seen: FloatArray, period: float) -> System:
    """Return F from the sensors' rates to the torques that hold what the loop keeps at zero."""
    kept = signals.sensors[: signals.kept]
    T, c = _shown(model, signals, [_rates_of(model.platform, sensor) for sensor in kept])
    W = -np.linalg.pinv(T) @ c
    rows = rows_of(model, signals.gimbals)
    part = np.ix_(rows, rows)
    turned = np.array([[float(t.gimbal == name) for t in signals.torquers] for name in signals.gimbals])
    to_torques = np.linalg.pinv(turned)
    rate = 2.0 * np.pi * (fed.bandwidth_hz or _DERIVATIVE / period)
    fixed = tilting(model.Q_force[rows], model.platform)
    of_change, of_rate, of_angle = (
        _without_rounding(to_torques @ needed, to_torques @ np.abs(scale)) @ np.linalg.pinv(seen)
        for needed, scale in (
            (model.M[part] @ W + model.M_Omega[rows], model.M[part] @ np.abs(W)),
            (model.damping[part] @ W + model.G_Omega[rows], model.damping[part] @ np.abs(W)),
            (model.stiffness[part] @ W - fixed, model.stiffness[part] @ np.abs(W)),
        )
    )
    # s/(1 + s/rate) = rate − rate²/(s + rate)
    return _filtered(of_rate + rate * of_change, [(-(rate**2) * of_change, rate), (of_angle, _LEAK)], period)


def _without_rounding(matrix: FloatArray, scale: FloatArray) -> FloatArray:
    """Return a difference with entries that are rounding of what it was taken of, of size `scale`, as zeros."""
    size = max(float(np.abs(scale).max(initial=0.0)), float(np.abs(matrix).max(initial=0.0)))
    return np.where(np.abs(matrix) > _ROUNDING * size, matrix, 0.0)


def _filtered(direct: FloatArray, parts: Sequence[tuple[FloatArray, float]], period: float) -> System:
    """Return direct + Σ gain/(s + rate) by Tustin's rule; parts of zero gain take no states."""
    k = direct.shape[1]
    kept = [(gain, rate) for gain, rate in parts if gain.any()]
    A = np.diag(np.repeat([-rate for _, rate in kept], k))
    B = np.vstack([np.zeros((0, k)), *(np.eye(k) for _ in kept)])
    C = np.hstack([np.zeros((len(direct), 0)), *(gain for gain, _ in kept)])
    if not kept:
        return System(A.reshape(0, 0), B, C, direct, period)
    return from_w_plane(System(A, B, C, direct), period)


def _weights(model: LinearModel, signals: LoopSignals) -> FloatArray:
    """Return what makes inertial rates of the loop's readings, per rate of the platform: (p, 3)."""
    platform = model.platform
    read = [_rates_of(platform, sensor) for sensor in signals.sensors]
    T, c = _shown(model, signals, [_inertial(platform, one) for one in read])
    W = -np.linalg.pinv(T) @ c
    T, c = _shown(model, signals, read)
    return _without_rounding(-(T @ W + c), np.abs(T) @ np.abs(W))


def _expect_whole(where: str, weights: FloatArray, supplied: FloatArray, signals: LoopSignals) -> None:
    """Refuse sensors that do not measure all that makes inertial rates of the readings."""
    if not weights.any():
        raise InputError(
            f"{where}: {', '.join(sensor.name for sensor in signals.sensors)} measure against inertial space already; "
            'with into = "torque" feedforward can gain something, or let the design read rates or angles of gimbals'
        )
    lacking = np.abs(weights - supplied).max(axis=0) > _ROUNDING * np.abs(weights).max()
    if lacking.any():
        names = ", ".join(name for name, one in zip(OMEGA_NAMES, lacking, strict=True) if one)
        words = f"its sensors do not measure {names}, which the readings lack to become inertial"
        raise InputError(f"{where}: {words}; add rate sensors of the root about these axes")


def _measured(model: LinearModel, signals: LoopSignals, sensors: Sequence[Sensor], scale: FloatArray) -> System:
    """Return the sensors of the platform's rate, not late: low-passes and scale factors; continuous."""
    bare = linear_system(model, signals.gimbals, others="held")
    shown = observed_system(bare, model.platform, [sensor.name for sensor in sensors], model.q0, model.Omega0)
    A, B, C, D = shown[:4]
    kept, columns = seen_states(A[None], C[None]), [shown.input_labels.index(name) for name in OMEGA_NAMES]
    factor = (scale / np.array([1.0 + sensor.scale_error for sensor in sensors]))[:, None]
    return System(A[np.ix_(kept, kept)], B[np.ix_(kept, columns)], factor * C[:, kept], factor * D[:, columns])


def _held(sensors: System, late: Sequence[int], period: float, every: int) -> System:
    """Return sensors of a rate that is held between samples, late by whole periods, at every n-th sample."""
    A, B = held_input(sensors.A, sensors.B, period)
    found = late_outputs(System(A, B, sensors.C, sensors.D, period), late)
    return every_nth(found, every)[0] if every > 1 else found
