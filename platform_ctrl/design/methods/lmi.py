"""The method "lmi" of jobs: least torque noise for a weighted H-infinity norm, with the loop's limits as inequalities.

In the channels of the gyros and in the w-plane of the exactly sampled plant, with the weights of the H-infinity method
(see `design.methods.hinf`; e = n + angle is what is measured, y = W_e e),

    performance   ‖[n, d] → [W_e e, W_t angle, W_u u]‖∞ < γ           (6) at α = 1, β = γ²
    disk margin   ‖n → (S − T)/2‖∞ < 1/(share · limit)                (6)
    rejection     ‖Omega → angle‖∞ < limit/rejection_share            (6)
    torque noise  ‖n → torque‖₂ < ν, the largest of all torquers      (7), its first part is a part of the performance
    poles         decay and, if it is given, damping                  (8)

share one Lyapunov matrix; the numbers are those of `inequalities`. The least γ is that of two Riccati equations. At
(1 + backoff) times it the least ν is found among X and Y that keep a distance from X Y = I (9): the controller would
have arbitrarily fast poles otherwise. Because of the common matrix the norms of the loop are below their bounds:
`share` says which part of a limit its inequality has to prove. The rejection is required
only if `rejection_share` is given: W_e bounds it too, as a rate of the platform is above all an angle that ramps.
Readings beside the channels are measured too, with noise of their own among n, as in the H-infinity method; their
own disk margins are measured alone: with a common matrix their inequalities contradict the performance.
Channels that the plant does not couple are designed one after the other: the effort grows with the sixth power of the
number of states. D̂ = 0: the controller has a zero at the Nyquist frequency, and ν is above the rms of the sampled loop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.sampling import from_w_plane, to_w_plane
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.loop import Design
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import LoopProblem, Method, Option, number, tuned
from platform_ctrl.design.methods import hinf as mixed
from platform_ctrl.design.partition import Partition, autoscale, balance, closed_loop, split, unscale, whole
from platform_ctrl.design.sections import between, side_by_side
from platform_ctrl.design.synthesis import hinf
from platform_ctrl.errors import DesignError, InfeasibleError, UnscalableError
from platform_ctrl.job.methods import DesignSpec

if TYPE_CHECKING:
    from platform_ctrl.design.inequalities import LinearLoop

# Pole decay where it is not given, relative to the slowest bandwidth in rad/s.
_DECAY = 0.05
# Separations of X and Y tried in turn, and by how much the norms may exceed their bounds for it.
SEPARATIONS, SLACK = (1.15, 1.02), 0.03
# Tolerance of the solver.
TOLERANCE = 1e-3
# Gain between channels, relative to those of the channels, below which it counts as zero; relative singular values of
# the observability matrix below which states count as not seen.
UNCOUPLED, UNSEEN = 1e-7, 1e-9
# Evaluations of the tuner: each is a design.
EVALUATIONS = 80
CURE = "try a lower bandwidth_hz, a smaller share or pole_decay, or a larger backoff"


OPTIONS: dict[str, Option] = (
    mixed.WEIGHTS
    | {"backoff": mixed.BACKOFF}
    | {
        "share": number("share", "part of a limit that its inequality must prove", 0.1, 1.0),
        "pole_decay": number("pole decay", "decay rate that all poles must have", 1e-2, 1e4, unit="1/s"),
        "pole_damping": number(
            "pole damping", "damping ratio that all poles must have: four times the effort", 0.01, 0.7
        ),
        "rejection_share": number("rejection share", "the same for the rejection of Omega", 0.05, 1.0),
        "time_limit": number("time limit", "longest time for one convex problem", 0.1, 600.0, unit="s"),
    }
)


class LMI(Method):
    """Least torque noise for a weighted H-infinity norm, with the loop's limits as matrix inequalities."""

    key = "lmi"
    any_sensors = True
    options = OPTIONS
    advice = "a lower bandwidth_hz, or a larger backoff"
    tunable = tuple(mixed.WEIGHTS)
    tunes = True
    libraries = ("cvxpy",)
    families: ClassVar = {"speed": {"bandwidth_hz": 1.0, "inertial_bandwidth_hz": 1.0}}

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options, those not given from rules of thumb; `pole_damping` is there only if it is given."""
        weights = mixed.default_weights(channel, nutation)
        slowest = min(design.options.get(name, x) for name, x in weights.items() if name.endswith("bandwidth_hz"))
        decay = _DECAY * 2.0 * np.pi * slowest
        optional = {name: x for name, x in design.options.items() if name in ("pole_damping", "rejection_share")}
        defaults = weights | {"backoff": 0.1, "share": 0.5, "pole_decay": decay, "time_limit": 30.0} | optional
        return self.completed(design.options, defaults, period)

    def design(self, problem: LoopProblem) -> Design:
        """Return the loop.

        Claims: ``gamma`` of the performance, its least value, ν, plants that share a Lyapunov matrix.
        """
        from platform_ctrl.design.inequalities import sharing

        channel, plants = problem.channel, problem.plants.regular()
        options = self.defaults(problem.design, channel, plants.nutation, plants.period)

        def synthesis(numbers: dict[str, float]) -> tuple[System, dict[str, float]]:
            return _synthesis(problem, numbers, channel, plants)

        controller, claims = synthesis(options)
        if problem.design.tune:
            movable = [name for name in self.tunable if name in options]
            options = tuned(problem, options, movable, lambda numbers: synthesis(numbers)[0], evaluations=EVALUATIONS)
            controller, claims = synthesis(options)
        loops = Loop(plants, controller._replace(dt=plants.period))
        if loops.decay[0] > 0.0:
            shared = sharing(loops.own_arrays.A)
            claims |= {"plants with one Lyapunov matrix": float(shared), "plants": float(len(plants.labels))}
        return problem.made(controller, options, claims)


def _synthesis(
    problem: LoopProblem, options: dict[str, float], channel: Channels, plants: PlantSet
) -> tuple[System, dict[str, float]]:
    """Return the sampled controller of the plants, and claims."""
    unit = mixed.torque_units(channel, plants.nutation)
    A, B, C, D, period = plants.of_torques()
    into, size, turned = channel.basis.T * unit, len(unit), channel.turned(len(C))
    B, D = np.hstack([B @ into, plants.B_Omega[0, : len(A)]]), np.hstack([D @ into, plants.D_Omega[0]])
    flat = to_w_plane(System(A, B, turned @ C, turned @ D, period))
    rms = plants.noise_of()
    own = np.sqrt(np.mean(rms[:size] ** 2))
    noise = channel.basis.T * unit * own * np.sqrt(plants.period)
    further = mixed.FURTHER * channel.shown(plants)[size:]
    if not noise.any():
        raise DesignError(
            "the least torque noise is asked for, but no sensor that the loop keeps has noise: give noise_rms of its"
            " [[pickoff]] or noise_density of its [[rate_sensor]], or take another method"
        )
    weights = mixed.by_direction(options, channel)
    parts = [
        _weighted(flat, group, weights, options["complementary"], noise, further) for group in _uncoupled(flat, size)
    ]
    found = [_designed(problem, part, options) for part in parts]
    torques = np.argsort([k for part in parts for k in part.channels])
    readings = np.argsort([k for part in parts for k in part.rows])
    K = mixed.error_weight(weights[0], weights[1], len(further)).series(
        side_by_side(*(K for K, _, _ in found)).part(torques, readings)
    )
    # Of readings with more noise than was assumed the bound is that many times as large.
    noisier = max([1.0, *(rms[size:] / (further * own))])
    claims = {
        "gamma": max(_gamma(part, made) for part, (made, _, _) in zip(parts, found, strict=True)),
        "gamma_optimal": max(gamma for _, gamma, _ in found),
        "torque noise bound, N m": float(noisier * np.linalg.norm([bound for _, _, bound in found])),
    }
    return between(turned, from_w_plane(K, plants.period), channel.basis.T * unit), claims


def _uncoupled(flat: System, size: int) -> list[list[int]]:
    """Return the outputs in groups that the plant does not couple: `size` channels, readings with what they show."""
    from scipy.sparse.csgraph import connected_components

    rate, X = np.linalg.norm(flat.A, 2), flat.B[:, :size]
    coupling = np.abs(flat.D[:, :size])
    for _ in range(len(flat.A)):
        coupling = np.maximum(coupling, np.abs(flat.C @ X))
        X = flat.A @ X / rate
    own = np.sqrt(np.diag(coupling))
    joined = np.zeros((len(coupling), len(coupling)), dtype=bool)
    joined[:size, :size] = coupling[:size] > UNCOUPLED * np.outer(own, own)
    joined[size:, :size] = coupling[size:] > UNCOUPLED * coupling[size:].max(axis=1, keepdims=True)
    _, label = connected_components(joined, directed=False)
    return [[int(k) for k in np.flatnonzero(label == one)] for one in np.unique(label)]


def _seen(flat: System, rows: list[int]) -> System:
    """Return some of a system's outputs, with the states that they see alone."""
    rate = np.linalg.norm(flat.A, 2)
    d = balance(flat.A / rate, flat.B / rate, flat.C)
    A, B, C = flat.A / d[:, None] * d, flat.B / d[:, None], flat.C[rows] * d
    blocks = [C]
    for _ in range(len(A) - 1):
        blocks.append(blocks[-1] @ A / np.linalg.norm(blocks[-1] @ A))
    _, sigma, Vt = np.linalg.svd(np.vstack(blocks))
    V = Vt[: int(np.sum(sigma > UNSEEN * sigma[0]))].T
    return System(V.T @ A @ V, V.T @ B, C @ V, flat.D[rows])


@value
class _Weighted:
    """The weighted plant of channels and readings, [n, d, Omega, u] to [z1, z2, z3, (S − T)/2 n, angle, torques, y]."""

    channels: list[int]
    rows: list[int]  # of what is measured: the channels, then further readings
    plant: Partition
    unit: float  # of the torques among z, for n as white noise of unit density, N m √s

    @property
    def w(self) -> list[list[int]]:
        """Indices of n, d and Omega in w."""
        k, p = len(self.channels), len(self.rows)
        return [part.tolist() for part in np.split(np.arange(self.plant.B1.shape[1]), [p, p + k])]

    @property
    def z(self) -> list[list[int]]:
        """Indices in z: performance, disk margin, angle, torques."""
        k = len(self.channels)
        return [part.tolist() for part in np.split(np.arange(len(self.plant.C1)), [3 * k, 4 * k, 5 * k])]


def _weighted(
    flat: System, rows: list[int], weights: FloatArray, complementary: float, noise: FloatArray, further: FloatArray
) -> _Weighted:
    """Return the weighted plant of the outputs `rows`, with `weights` of all channels (see `by_direction`).

    `further` is the noise of the readings beside the channels.
    """
    size, measured, own = len(flat.C) - len(further), rows, _seen(flat, rows)
    rows = [row for row in rows if row < size]
    (gains, rates, disturbance, torque), k = weights[:, rows], len(rows)
    more = further[[row - size for row in measured[k:]]]
    disturbed = own._replace(
        B=np.hstack([own.B[:, rows] * disturbance, own.B[:, size:]]),
        D=np.hstack([own.D[:, rows] * disturbance, own.D[:, size:]]),
    )
    A, B, C, D, _ = mixed.mixed_sensitivity(
        own.part(slice(None), rows), disturbed, gains, rates, (np.eye(k), np.diag(torque)), more
    )
    unit = float(np.linalg.norm(noise[:, rows], 2) / torque.min())

    def shown(X: FloatArray) -> FloatArray:
        error, angle, control, y = np.split(X, [k, 2 * k, 3 * k])
        torques = noise[:, rows] / unit / torque @ control
        return np.vstack([error, complementary * angle, control, angle, angle, torques, y])

    C, D = shown(C), shown(D)
    # e = n + angle, and so (S − T)/2 n = n/2 + angle.
    D[3 * k : 4 * k, :k] += 0.5 * np.eye(k)
    P = split(System(A, B, C, D), len(C) - len(measured), B.shape[1] - k)
    return _Weighted(channels=rows, rows=measured, plant=P, unit=unit)


class _Norm(NamedTuple):
    """An H-infinity norm from w to z (indices) that is to be below √(αβ), with the levels of its inequality."""

    name: str
    w: list[int]
    z: list[int]
    beta: float
    alpha: float = 1.0


def _norms(
    p: Partition, part: _Weighted, options: dict[str, float], limits: Mapping[str, float], gamma: float
) -> list[_Norm]:
    """Return the norms: performance, disk margin, rejection."""
    (n, d, Omega), (performance, margin, angle, _) = part.w, part.z
    out = [_Norm("the performance", n + d, performance, ((1.0 + options["backoff"]) * gamma) ** 2)]
    if "disk_margin" in limits:
        own = n[: len(part.channels)]
        out.append(_Norm("the disk margin", own, margin, (options["share"] * limits["disk_margin"]) ** -2.0))
    if "Omega_rejection" in limits and "rejection_share" in options:
        # One matrix serves all norms best where their inputs are of similar size.
        of_n, of_d, of_Omega = (float(np.linalg.norm(p.B1[:, w])) for w in part.w)
        bound, alpha = limits["Omega_rejection"] / options["rejection_share"], of_Omega**2 / (of_n * of_d)
        out.append(_Norm("the rejection of Omega", Omega, angle, bound**2 / alpha, alpha))
    return out


def _designed(problem: LoopProblem, part: _Weighted, options: dict[str, float]) -> tuple[System, float, float]:
    """Return the controller of a weighted plant, the least γ, and the bound ν, N m."""
    from platform_ctrl.design.inequalities import LinearLoop, cp, in_states, sector, solve

    where, scaled = f"{problem.spec.name}, {problem.design.name}", autoscale(part.plant)
    p, gamma = in_states(scaled.plant, _first_states(scaled.plant, part)), _least(part)
    norms = _norms(p, part, options, problem.spec.limits, gamma)
    # Poles to the left of −decay, or within an angle about the real axis.
    regions = [(np.array([[2.0 * options["pole_decay"] / scaled.rate]]), np.eye(1))]
    if "pole_damping" in options:
        regions.append(sector(options["pole_damping"]))

    def posed(noise: Any, looser: Any, separation: float) -> tuple[LinearLoop, list[Any], list[Any]]:
        """Return a loop, the inequalities of the norms, with bounds squared times `looser`, and all others."""
        loop, slack = LinearLoop(p, direct=False), (1.0 + SLACK) ** 2
        own = [loop.hinf_below(one.w, one.z, one.alpha, looser * slack * one.beta) for one in norms]
        rest = [*loop.outputs_below(part.z[-1], noise), *(loop.poles_in(*region) for region in regions)]
        return loop, own, [loop.separated(separation), *rest]

    def run(goal: Any, inequalities: list[Any], step: str) -> None:
        problem = cp.Problem(cp.Minimize(goal), inequalities)
        solve(problem, f"{where}: {step}", CURE, options["time_limit"], TOLERANCE, part.plant)

    failure: DesignError | None = None
    for separation in SEPARATIONS:
        noise = cp.Variable()
        loop, own, rest = posed(noise, 1.0, separation)
        try:
            run(noise, own + rest, "the least torque noise")
        except (InfeasibleError, UnscalableError) as error:
            failure = error
        else:
            return unscale(loop.controller(), scaled), gamma, float(np.sqrt(noise.value * scaled.rate)) * part.unit
    looser = cp.Variable()
    _, own, rest = posed(cp.Variable(), looser, SEPARATIONS[-1])
    run(looser, own + rest, "the nearest bounds")
    if looser.value <= 1.0 and failure is not None:
        raise failure
    prices = [
        np.trace(x.dual_value[-len(one.z) :, -len(one.z) :]) * one.beta for one, x in zip(norms, own, strict=True)
    ]
    raise InfeasibleError(
        f"{where}: none found: with one Lyapunov matrix, {', '.join(one.name for one in norms)} are possible at "
        f"{(1.0 + SLACK) * np.sqrt(looser.value):.4g} times their bounds at best; the tightest is "
        f"{norms[int(np.argmax(prices))].name}; {CURE}",
        part.plant,
    )


def _performance(part: _Weighted) -> Partition:
    """Return the weighted plant with the signals of the performance alone."""
    (n, d, _), (z, *_), p = part.w, part.z, part.plant
    return replace(p, B1=p.B1[:, n + d], D21=p.D21[:, n + d], C1=p.C1[z], D12=p.D12[z], D11=p.D11[np.ix_(z, n + d)])


def _least(part: _Weighted) -> float:
    """Return the least γ of the performance alone, by Riccati equations."""
    k, p = len(part.channels), len(part.rows)
    P = whole(_performance(part)).to_control(*mixed.signal_names(k, p - k))
    return hinf(P, p, k, method="riccati").gamma_optimal


def _gamma(part: _Weighted, controller: System) -> float:
    """Return γ of the performance with a controller; infinite where it does not stabilise."""
    loop = closed_loop(_performance(part), controller)
    return float(hinf_norm(loop)[0]) if np.linalg.eigvals(loop.A).real.max() < 0.0 else float("inf")


def _first_states(p: Partition, part: _Weighted) -> FloatArray:
    """Return states in which the solutions of the LQ and the filter problem of the performance are balanced."""
    from scipy.linalg import solve_continuous_are

    from platform_ctrl.design.inequalities import balancing

    w, z, solutions = part.w[0] + part.w[1], part.z[0], []
    for A, B, C, D in ((p.A, p.B2, p.C1[z], p.D12[z]), (p.A.T, p.C2.T, p.B1[:, w].T, p.D21[:, w].T)):
        weight = D.T @ D + 1e-6 * np.eye(len(D.T))
        solutions.append(np.linalg.inv(solve_continuous_are(A, B, C.T @ C, weight, s=C.T @ D)))
    return balancing(*solutions)
