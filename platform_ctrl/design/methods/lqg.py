"""LQG loops: `control.dlqr` and `control.dlqe` on the exactly sampled plant, with integral action.

In the directions of the gyros (see `design.loop_signals.Channels`), with hold, delay and torquer lag in the states x,

    x[k+1] = A x + B (u + r) + B_Omega Omega,    y = C x + D u + n,    xi[k+1] = xi + 2π integral_hz T y

and the controller minimises the expected sum over the samples of

    |y / largest_error|² + |(C x)' / largest_rate|² + |xi / largest_error|² + |u / largest_torque|².

n is the noise of the sensors from the plant file, Omega the platform's rate, which turns gyros without any torque, and
r a torque at the torquers: the larger it is, the more the loop approaches the state feedback (loop transfer recovery).
All three are white samples. The controller uses the present sample: u = −K [x̂(k|k), xi].

The gains are those that python-control returns for the matrices of `QuadraticProblem`.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import System, block, seen_states, state_scaling
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import LoopProblem, Option, TunedMethod, hertz
from platform_ctrl.design.sections import between, gain
from platform_ctrl.errors import ArgumentError, DesignError, NotStabilisableError
from platform_ctrl.job.methods import DesignSpec

# Rules of thumb. The largest error over the noise of a sample; without noise the largest error, rad or rad per sample.
_ERROR, _NO_NOISE = 20.0, 1e-4
# Torques of gyroscopic pairs over h ω_nutation and the error or noise, the platform's rate over ω_nutation and noise.
_PAIR_TORQUE, _PAIR_RECOVERY, _PLATFORM_RATE = 3.0, 40.0, 15.0
# Other directions: torques over J ω (rates) or J ω² (angles) and the error or noise, ω this share of the reference
# frequency of the plants' grids.
_CROSSOVER, _RECOVERY = 0.7, {1: 3.0, 2: 0.8}
# Poles nearer to the unit circle than this are on it but for rounding.
_ON_CIRCLE = 1e-9
# Share by which the tuner meets limits: the weights of three gimbals at once reach little more.
_RESERVE = 0.02
# Other starts of the tuner: the torques by the rules of thumb times these.
_STARTS = (0.1, 0.3, 1.0, 3.0, 10.0)


_AMPLITUDE, _MARGIN = (
    "amplitude that counts as much as the largest error",
    "torque noise of the estimator: larger, more margin",
)


def _newton_metres(label: str, tip: str) -> Option:
    return Option(label=label, unit="N m", tip=tip)


OPTIONS: dict[str, Option] = {
    "largest_error": Option(label="largest error", unit="rad", tip="amplitude of what is measured; rate loops: rad/s"),
    "largest_rate": Option(label="largest rate", unit="rad/s", tip="amplitude of its rate; rate loops: rad/s²"),
    "largest_torque": _newton_metres("largest torque", _AMPLITUDE),
    "largest_torque2": _newton_metres("largest torque 2", f"{_AMPLITUDE}: second axis of a pair"),
    "inertial_largest_torque": _newton_metres("inertial largest torque", f"{_AMPLITUDE}: where no gyro acts"),
    "integral_hz": hertz("integral", "design", "below this frequency the integral acts", high=0.4, below_nyquist=True),
    "platform_rate": Option(label="platform rate", unit="rad/s", tip="white platform rate that the estimator expects"),
    "recovery": _newton_metres("recovery", _MARGIN),
    "recovery2": _newton_metres("recovery 2", f"{_MARGIN}: second axis of a pair"),
    "inertial_recovery": _newton_metres("inertial recovery", f"{_MARGIN}: where no gyro acts"),
}


class LQG(TunedMethod):
    """LQG loops."""

    key = "lqg"
    any_sensors = True
    options = OPTIONS
    advice = "a smaller largest_torque, a larger recovery, or tune = true"
    # The integral action is the user's; only ratios of the other amplitudes count.
    tunable = (
        "largest_torque",
        "largest_torque2",
        "inertial_largest_torque",
        "platform_rate",
        "recovery",
        "recovery2",
        "inertial_recovery",
    )
    reserve = _RESERVE

    def controller(self, options: dict[str, float], channel: Channels, plants: PlantSet) -> System:
        """Return the sampled controller of complete options; states are x̂(k|k−1) and the sums."""
        problem = quadratic_problem(options, channel, plants)
        (A, B, C, D, period), (K, L, M) = problem.plant, lqg_gains(problem)
        # From y and u to the present estimate and the sums, of which u is the state feedback.
        one = np.eye(len(problem.sums))
        estimator = block(
            [
                [A - L @ C, 0, L, B - L @ D],
                [0, one, np.diag(problem.sums) @ np.eye(len(one), len(C)), 0],
                [np.eye(len(A)) - M @ C, 0, M, -M @ D],
                [0, one, 0, 0],
            ]
        )
        n, p, m = len(A) + len(one), len(C), len(K)
        try:
            closed = System.split(estimator, n, period).feedback(gain(-K), range(p, p + m))
        except ArgumentError:
            raise DesignError("lqg: the loop has no solution at one instant; try a delay of one sample") from None
        made = closed.part(slice(m), slice(p))
        return between(channel.turned(p) / problem.error[:, None], made, channel.basis.T * problem.torque)

    def starts(self, problem: LoopProblem, options: dict[str, float]) -> list[dict[str, float]]:
        """Return other starts of the tuner: torques around those by the rules of thumb."""
        design, channel, plants = problem.design, problem.channel, problem.plants
        movable = self.movable(options, channel)
        kept = {name: x for name, x in design.options.items() if name not in movable}
        by_rule = self.defaults(replace(design, options=kept), channel, plants.nutation, plants.period)
        torques = [name for name in movable if "largest_torque" in name]
        return [by_rule | {name: factor * by_rule[name] for name in torques} for factor in _STARTS]

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options, those that are not given by rules of thumb."""
        given = design.options
        pairs = 2 * len(channel.momenta)
        measured = 0.0 if channel.noise is None else float(channel.noise.max(initial=0.0))
        unit = 1.0 if channel.order > 1 else nutation
        error = given.get("largest_error", _ERROR * measured if measured > 0.0 else _NO_NOISE * unit)
        noise = measured if measured > 0.0 else error / _ERROR
        out = {"largest_error": error, "largest_rate": 10.0 * nutation * error, "integral_hz": 0.003 * nutation}
        if pairs:
            torque = float(channel.momenta.max()) * nutation
            out |= {"largest_torque": _PAIR_TORQUE * torque * error, "recovery": _PAIR_RECOVERY * torque * noise}
            out |= {f"{name}2": given.get(name, out[name]) for name in ("largest_torque", "recovery")}
            out["platform_rate"] = _PLATFORM_RATE * nutation * noise
        if channel.inertial:
            torque = float(channel.inertias[pairs:].max()) * (_CROSSOVER * nutation) ** channel.order
            out |= {
                "inertial_largest_torque": torque * error,
                "inertial_recovery": _RECOVERY[channel.order] * torque * noise,
            }
        return self.completed(given, out, period)


@value
class QuadraticProblem:
    """What `control.dlqr` and `control.dlqe` are called with, in units of the largest errors and torques.

    Attributes
    ----------
    plant
        From the torques to the measurements, in balanced states.
    A, B, Q, R
        Plant and sums of the measurements behind it, with the weights: the arguments of `control.dlqr`.
    G, QN, RN
        With A and C of `plant` the arguments of `control.dlqe`.
    sums : (k,)
        What the sums add of each of the first measurements, which the loop keeps, per sample.
    error, torque : (p,), (m,)
        The units of measurements and torques, rad (rate loops: rad/s) and N m.
    """

    plant: System
    A: FloatArray
    B: FloatArray
    Q: FloatArray
    R: FloatArray
    G: FloatArray
    QN: FloatArray
    RN: FloatArray
    sums: FloatArray
    error: FloatArray
    torque: FloatArray


class Gains(NamedTuple):
    """u = −K [x̂(k|k), xi]; x̂(k+1|k) = A x̂(k|k−1) + B u + L e, x̂(k|k) = x̂(k|k−1) + M e, e = y − C x̂(k|k−1) − D u."""

    K: FloatArray
    L: FloatArray
    M: FloatArray


def quadratic_problem(options: dict[str, float], channel: Channels, plants: PlantSet) -> QuadraticProblem:
    """Return the problem of the nominal plant for complete `options`."""
    pairs, size, period = len(channel.momenta), len(channel.basis), plants.period

    def by_channel(name: str) -> FloatArray:
        both = [options.get(name, 0.0), options.get(f"{name}2", 0.0)]
        return np.array(both * pairs + [options.get(f"inertial_{name}", 0.0)] * channel.inertial)

    basis, torque = channel.turned(len(plants.angles)), by_channel("largest_torque")
    noise = plants.noise_of(basis)
    error = options["largest_error"] * channel.shown(plants)
    A, B, C, D, _ = between(channel.basis.T * torque, plants.of_torques(), basis / error[:, None])
    from_rate = plants.B_Omega[0][: len(A)]
    seen = seen_states(A[None], C[None])
    A, B, C, from_rate = A[np.ix_(seen, seen)], B[seen], C[:, seen], from_rate[seen]
    s = state_scaling(A, B, C)
    s *= np.sqrt(np.linalg.norm(B / s[:, None]) / np.linalg.norm(C * s))
    A, B, C, from_rate = A * s / s[:, None], B / s[:, None], C * s, from_rate / s[:, None]
    n, sums = len(A), np.full(size, 2.0 * np.pi * options["integral_hz"] * period)
    kept = C[:size]
    rate = options["largest_error"] / options["largest_rate"] / period * kept @ (A - np.eye(n))
    noise = np.where(noise > 0.0, noise / error, 1.0 / _ERROR)
    return QuadraticProblem(
        plant=System(A, B, C, D, period),
        A=block([[A, 0], [sums[:, None] * kept, np.eye(size)]]),
        B=np.vstack([B, sums[:, None] * D[:size]]),
        Q=block([[kept.T @ kept + rate.T @ rate, 0], [0, np.eye(size)]]),
        R=np.eye(B.shape[1]),
        G=np.hstack([B * (by_channel("recovery") / torque), from_rate * options.get("platform_rate", 0.0)]),
        QN=np.eye(B.shape[1] + 3),
        RN=np.diag(noise**2),
        sums=sums,
        error=error,
        torque=torque,
    )


def lqg_gains(problem: QuadraticProblem) -> Gains:
    """Return the gains of `control.dlqr` and `control.dlqe`; a `NotStabilisableError` says which of them has none."""
    import control

    A, _, C, _, _ = problem.plant
    K, _ = _solved(
        lambda: control.dlqr(problem.A, problem.B, problem.Q, problem.R, method="scipy"),
        "control.dlqr finds no state feedback that stabilises the plant: try a larger largest_torque or integral_hz",
        problem,
    )
    L, P = _solved(
        lambda: control.dlqe(A, problem.G, C, problem.QN, problem.RN, method="scipy"),
        "control.dlqe finds no estimator of the plant that is stable: try a larger recovery, or more sensors",
        problem,
    )
    M = np.asarray(np.linalg.solve(C @ P @ C.T + problem.RN, C @ P), dtype=np.float64).T
    return Gains(K, L, M)


def _solved(
    solve: Callable[[], tuple[Any, Any, Any]], advice: str, problem: QuadraticProblem
) -> tuple[FloatArray, FloatArray]:
    """Return gain and Riccati solution of a call of python-control."""
    with warnings.catch_warnings(), contextlib.suppress(ArithmeticError, RuntimeError, ValueError):
        warnings.simplefilter("ignore", RuntimeWarning)  # of balancing in SciPy, before it finds no solution
        gain, solution, poles = solve()
        if np.isfinite(gain).all() and np.abs(poles).max() < 1.0 - _ON_CIRCLE:
            return np.asarray(gain), np.asarray(solution)
    raise NotStabilisableError(f"lqg: {advice}", problem)
