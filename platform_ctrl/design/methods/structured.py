"""The structured caging loop: a controller of fixed structure, tuned on the loop's own requirements over its plants.

The requirements themselves are optimised, without weights: limits are hard, goals are soft. The search starts from
physics and goes up in steps: the cross-axis loop of the classical design, its numbers moved; a full PID with filter;
from there, if requested, every matrix entry of a controller of fixed order behind a PI in every channel.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.norms import stationary_covariance
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.descent import Found, Search
from platform_ctrl.design.fixed_structure.sections import PID, Named, Sampled, Sections, Series
from platform_ctrl.design.fixed_structure.structures import Parametrised, StateSpaceOrder, Static, Units, entry
from platform_ctrl.design.loop import Design
from platform_ctrl.design.loop_signals import Channels
from platform_ctrl.design.method import LoopProblem, Method, Option, SectionedMethod, hertz, number
from platform_ctrl.design.methods.classical import Classical
from platform_ctrl.design.methods.hinf import hinf_controller
from platform_ctrl.design.methods.pi import PI
from platform_ctrl.design.sections import between, first_order, gain, side_by_side
from platform_ctrl.design.tuning import of_sight, with_sight
from platform_ctrl.errors import DesignError
from platform_ctrl.job.judging import STABLE
from platform_ctrl.job.methods import DesignSpec, Structure
from platform_ctrl.job.requirements import LoopRequirement, requirement

# Share of the integral rate that the slowest closed-loop pole keeps: slower integral action has no effect.
_INTEGRAL_KEPT = 0.5
# Least damping of the PID's filter: with less it gains phase by a resonance, which would lift the gain at frequencies
# where gimbals and mountings bend.
_FILTER_DAMPING = 0.4
# Hankel singular values below this share of the largest are negligible.
_NEGLIGIBLE = 1e-7
# Poles this near to z = 1 are integrators.
_INTEGRATOR = 1e-5
# Shares of the evaluations that a structure gets on the way to the next one, which has the rest.
_SHARES = {"cross-axis": 0.05, "pid": 0.3}
# Sections start between these multiples of the slowest and the fastest resonance: of poles with less damping than the
# third number that are faster than the last share of the reference frequency.
_SLOWEST, _FASTEST, _RESONANT, _SLOW = 0.5, 2.5, 0.2, 0.05
# Fastest start of a filter or a section, rad in a sample period.
_SAMPLED = 0.8 * np.pi


# Options of some structures alone.
_STRUCTURES: dict[str, tuple[Structure, ...]] = {
    "order": ("state-space",),
    "sections": ("sections",),
    "starts": ("pid", "sections", "state-space"),
    "rolloff_hz": ("pid", "state-space"),
}
DEFAULT: Structure = "pid"

OPTIONS: dict[str, Option] = {
    "order": number("order", "states beside the integrators", 1, 30, whole=True, logarithmic=False),
    "starts": number("starts", "starting points of the search", 1, 8, whole=True, logarithmic=False),
    "sections": number("sections", "second-order sections on every reading", 1, 12, whole=True, logarithmic=False),
    "integral_hz": hertz("integral", "design", "corner of the integral at the start", high=0.4, below_nyquist=True),
    "rolloff_hz": hertz("roll-off", "design", "where the filter starts", high=0.45, below_nyquist=True),
    "reserve": number("reserve", "share by which limits are met", 1e-3, 0.5),
    "evaluations": number("evaluations", "most evaluations of the search", 10, 5000, whole=True),
}


class Structured(Method):
    """A controller of fixed structure, tuned on the loop's own requirements over its plants."""

    key = "structured"
    any_sensors = True
    options = OPTIONS
    advice = "weaker limits, or another structure"
    structures = ("cross-axis", "pid", "sections", "state-space")
    libraries = ("clarabel",)
    goals = True

    def defaults(self, design: DesignSpec, channel: Channels, nutation: float, period: float) -> dict[str, float]:
        """Return all options of a structure, those not given from rules of thumb."""
        given, structure = design.options, design.structure or DEFAULT
        defaults = {
            "order": 3.0 * len(channel.basis),
            "starts": 1.0,
            "sections": 6.0,
            "integral_hz": 0.024 * nutation / (2.0 * np.pi),
            "rolloff_hz": 0.4 / period,
            "reserve": 0.01,
            "evaluations": 400.0,
        }
        own = {name: x for name, x in defaults.items() if structure in _STRUCTURES.get(name, (structure,))}
        out = self.completed(given, own, period, f'structured, structure = "{structure}"')
        if not out["reserve"] < 1.0:
            raise DesignError(f"structured: reserve must be less than 1, got {out['reserve']:g}")
        return out

    def design(self, problem: LoopProblem) -> Design:
        """Return the loop: its limits as constraints, its goals minimised."""
        spec, design, channel = problem.spec, problem.design, problem.channel
        plants, structure = problem.plants, design.structure or DEFAULT
        options = self.defaults(design, channel, plants.nutation, plants.period)
        cross_axis = cross_axis_structure(options["integral_hz"], channel, plants)
        if structure == "cross-axis" and cross_axis.nmeas > cross_axis.ncon:
            raise DesignError(
                'structured: structure = "cross-axis" works axis by axis, and this loop has further readings: choose '
                '"pid" or "state-space", or give the design sensors of its own'
            )
        if structure == "sections" and channel.order != 1:
            raise DesignError('structured: structure = "sections" is for loops of rates: choose "pid" or "state-space"')
        full_order = dataclasses.replace(problem, design=DesignSpec(name=design.name, method="hinf", options={}))

        def progress(limits: float, goals: float) -> None:
            ratios = f"limits at {limits:.0%}" + (f", goals at {goals:.0%}" if spec.goals else "")
            problem.progress(
                f"{spec.name}: {design.name}, {ratios if math.isfinite(limits) else 'not stable with all plants yet'}"
            )

        others = [lambda: hinf_controller(full_order, "riccati")[0]]
        return problem.made(
            *tuned_controller(options, structure, cross_axis, channel, plants, spec.requests, others, progress)
        )


def tuned_controller(
    options: dict[str, float],
    structure: Structure,
    cross_axis: Parametrised,
    channel: Channels,
    plants: PlantSet,
    requirements: Sequence[LoopRequirement],
    others: Sequence[Callable[[], System]],
    progress: Callable[[float, float], None],
) -> tuple[System, dict[str, float], dict[str, float]]:
    """Return a controller of a structure that meets the requirements, or comes nearest, its options and its claims.

    `options` are complete. ``order``: states of "state-space" beside the integrators;
    ``integral_hz``: of the PI, kept; ``rolloff_hz``: where the PID's filter starts; ``starts``: how many starting
    points there are. Every search starts at the classical loop `cross_axis`; `others` are tried in turn where
    ``starts`` asks for more. `progress` is called with the largest ratio of a limit and of a goal; infinite where a
    loop is not stable yet.
    """
    integral = 2.0 * np.pi * options["integral_hz"]
    # A rate loop against a spring leaves the angle free, which integrals do not change.
    kept = _INTEGRAL_KEPT * integral if channel.order == 2 else STABLE.limit
    requested = _with_decay(requirements, kept)
    alone, shown, sight = structure == "cross-axis", channel.shown(plants), of_sight(requested)
    if sight:
        rest = Search(plants, [one for one in requested if not one.metric.of_sight], options["reserve"], progress)
        plants = with_sight(
            plants,
            cross_axis.block(cross_axis.start),
            lambda: cross_axis.block(rest.run(cross_axis, int(options["evaluations"])).x),
        )
    searches, spent = Search(plants, requested, options["reserve"], progress), 0

    def search(family: Parametrised, share: float, sketch: bool = False) -> Found:
        nonlocal spent
        found = searches.run(family, int(share * options["evaluations"]), sketch)
        spent += found.evaluations
        return found

    first = search(cross_axis, 1.0 if alone else _SHARES["cross-axis"], sketch=not alone)
    tried: list[tuple[Found, Parametrised]] = [(first, cross_axis)]
    starts = [] if alone else [lambda: cross_axis.block(first.x), *others][: int(options["starts"])]
    for start in starts:
        try:
            block = start()
        except DesignError:
            # Another method that finds nothing is no reason to give up the first start.
            continue
        pid = started_structure(structure, options, block, channel, plants)
        found = search(pid, _SHARES["pid"] if structure == "state-space" else 1.0 - _SHARES["cross-axis"])
        tried.append((found, pid))
        if structure == "state-space":
            inner = without_integrators(pid.block(found.x), channel, integral, plants.period)
            if inner is None:
                continue
            inner = of_order(inner, int(options["order"]), plants.nutation * plants.period)
            free = free_structure(inner, channel, plants.period, plants.nutation, integral, shown)
            tried.append((search(free, 1.0 - sum(_SHARES.values())), free))
    found, family = reduce(lambda a, b: b if b[0].better_than(a[0], options["reserve"]) else a, tried)
    if sight and found.hard < 1.0:
        # Dry friction is that with this controller now.
        family.start, plants = found.x, plants.with_sight(family.block(found.x))
        searches = Search(plants, requested, options["reserve"], progress)
        found = search(family, _SHARES["pid"])
    controller = family.block(found.x)
    claims = {
        "parameters": float(len(family.start)),
        "order": float(len(controller.A)),
        "starts": float(max(1, len(starts))),
        "evaluations": float(spent),
    }
    if structure == "cross-axis":
        options = options | cross_axis.named(found.x)
    return controller, options, claims


def _with_decay(requirements: Sequence[LoopRequirement], kept: float) -> list[LoopRequirement]:
    """Return requirements of which stability is a decay rate of at least `kept`, 1/s."""
    out = [dataclasses.replace(r, limit=max(r.limit, kept)) if r.kind == "stability" else r for r in requirements]
    return out if any(r.kind == "stability" for r in out) else [*out, requirement("stability", kept)]


def cross_axis_structure(integral_hz: float, channel: Channels, plants: PlantSet) -> Parametrised:
    """Return the classical loop, of rates with a second integral, over the numbers that its tuner moves."""
    period, given = plants.period, {"integral_hz": integral_hz}
    method: SectionedMethod = Classical()
    if channel.order == 1:
        method, given = PI(), given | {"double_integral_hz": 0.3 * integral_hz}
    design = DesignSpec(name="first", method=method.key, options=given)
    options = method.defaults(design, channel, plants.nutation, period)
    moved = [name for name in method.tunable if name in options]
    fixed = {name: number for name, number in options.items() if name not in moved}

    def build(trial: dict[str, float]) -> System:
        return between(np.eye(size, read), method.of_directions(trial, channel, period), np.eye(size))

    values = {name: options[name] for name in (*moved, *fixed)}
    size, read = len(channel.basis), len(plants.angles)
    structure = Named(build=build, values=values, largest=method.upper_bounds(period), fixed=fixed)
    return Parametrised(structure, read, size, Units(gain=np.ones((size, read)), rate=1.0))


def started_structure(
    structure: Structure, options: dict[str, float], like: System, channel: Channels, plants: PlantSet
) -> Parametrised:
    """Return the structure that the search goes on with from the classical loop, started near a controller."""
    integral = 2.0 * np.pi * options["integral_hz"]
    rolloff = min(2.0 * np.pi * options.get("rolloff_hz", np.inf), _SAMPLED / plants.period)
    if structure == "sections":
        return sectioned_structure(like, channel, plants, integral, rolloff, int(options["sections"]))
    return pid_structure(like, channel, plants.period, plants.nutation, integral, rolloff, channel.shown(plants))


def pid_structure(
    like: System,
    channel: Channels,
    period: float,
    nutation: float,
    integral: float,
    rolloff: float,
    shown: FloatArray | None = None,
) -> Parametrised:
    """Return a matrix PID with a second-order low-pass, at first at `rolloff`, in every channel of the gyros.

    The start resembles the response of `like`, which has a PI with `integral`, between a tenth of the nutation and a
    fifth of the sample rate. Frequencies and rates are in rad/s. Further readings, which show `shown`, have
    proportional gains alone.
    """
    n, read = like.D.shape
    shown = np.ones(n) if shown is None else shown
    K_P, K_I, K_D = _fitted(like, channel, period, nutation, rolloff)
    unit = float(np.abs(K_P[:, :n]).max() + nutation * np.abs(K_D).max()) or 1.0
    own = np.arange(read) < n
    start = {
        f"{name}{i + 1}{j + 1}": float(K[i, j])
        for name, K in (("kp", K_P), ("ki", K_I), ("kd", K_D))
        for i, j in np.ndindex(n, read)
        if own[j] or name == "kp"
    }
    bounds: dict[str, tuple[float, float]] = {}
    for k in range(read):
        start |= {f"filter{k + 1}": rolloff, f"damping{k + 1}": 0.8}
        # Beyond 1/π of the sample rate Tustin's poles turn negative, and ring.
        bounds |= {f"filter{k + 1}": (0.0, 0.9 * np.pi / period), f"damping{k + 1}": (_FILTER_DAMPING, 2.0)}
    mask = np.tile(own, (n, 1))
    pid = PID(I=mask, D=mask, start=start, bounds=bounds)
    structure = Sampled(inner=pid, period=period, basis=channel.basis, read=channel.turned(read))
    gain = np.tile(unit / shown, (n, 1))
    return Parametrised(structure, read, n, Units(gain=gain, rate=nutation, integral=integral))


def sectioned_structure(
    like: System, channel: Channels, plants: PlantSet, integral: float, rolloff: float, count: int
) -> Parametrised:
    """Return gains behind a PI, 1 + integral/s, and so many second-order sections on every reading of rates.

    The gains start at those of the PID that is nearest to `like`, the sections about the nominal plant's resonances.
    """
    n, read = like.D.shape
    K_P, _, K_D = _fitted(like, channel, plants.period, plants.nutation, rolloff)
    poles = np.log(np.linalg.eigvals(plants.A[0]).astype(np.complex128) + 1e-300) / plants.period
    resonant = (poles.imag > _SLOW * plants.nutation) & (-poles.real < _RESONANT * np.abs(poles))
    fast = np.abs(poles[resonant]) if resonant.any() else plants.nutation * np.array([0.4, 1.0])
    last = min(_FASTEST * float(fast.max()), _SAMPLED / plants.period)
    sections = Sections(rates=[float(w) for w in np.geomspace(_SLOWEST * float(fast.min()), last, count)])
    gains = Static(start={entry("k", K_P.shape, i, j): float(K_P[i, j]) for i, j in np.ndindex(n, read)})
    series = Series(blocks=(_pi(np.arange(read) < n, integral, plants.period), sections, gains))
    structure = Sampled(inner=series, period=plants.period, basis=channel.basis, read=channel.turned(read))
    unit = float(np.abs(K_P[:, :n]).max() + plants.nutation * np.abs(K_D).max()) or 1.0
    return Parametrised(
        structure, read, n, Units(gain=np.tile(unit / channel.shown(plants), (n, 1)), rate=plants.nutation)
    )


def _fitted(like: System, channel: Channels, period: float, nutation: float, rolloff: float) -> FloatArray:
    """Return the gains K_P, K_I, K_D of the PID whose response is nearest to a controller's, by least squares.

    Of readings behind the directions K_P alone counts.
    """
    n, read = like.D.shape
    w = np.geomspace(0.1 * nutation, min(4.0 * nutation, 0.4 * np.pi / period), 40)
    target = channel.basis @ frequency_response(like, w, -3) @ channel.turned(read).T
    s = 2.0 / period * 1j * np.tan(0.5 * w * period)
    F = rolloff**2 / (s**2 + 1.6 * rolloff * s + rolloff**2)
    terms = np.array([F, F / s, F * s]).T
    weight = 1.0 / np.linalg.norm(target, axis=(1, 2))
    left, right = terms * weight[:, None], target.reshape(len(w), -1) * weight[:, None]
    left, right = (np.vstack([one.real, one.imag]) for one in (left, right))
    found = np.linalg.lstsq(left, right, rcond=None)[0].reshape(3, n, read)
    found[0, :, n:] = np.linalg.lstsq(left[:, :1], right, rcond=None)[0].reshape(n, read)[:, n:]
    return np.asarray(found, dtype=np.float64)


def free_structure(
    inner: System, channel: Channels, period: float, nutation: float, integral: float, shown: FloatArray
) -> Parametrised:
    """Return a controller of fixed order behind a PI, 1 + integral/s, in every channel: so integral action stays.

    `inner` is what is behind the PI, sampled, in the channels of the gyros (see `without_integrators`). The unit of
    rates is the nutation frequency; it and `integral` are in rad/s.
    """
    n, read, rate = len(channel.basis), len(shown), nutation
    A, B, C, D, _ = inner
    # In (z − 1)/period the search is among the entries of the sampled matrices themselves.
    A, B = (A - np.eye(len(A))) / period, B / period
    unit = float(np.abs(D).max()) or float(np.linalg.norm(C) * np.linalg.norm(B)) or 1.0
    # States in units in which they are as large in B, in units of the rate, as in C, in units of the gain.
    scale = float(np.sqrt(np.linalg.norm(C) * rate / (np.linalg.norm(B) * unit))) if len(A) else 1.0
    entries = (("a", A), ("b", B * scale), ("c", C / scale), ("d", D))
    start = {entry(name, K.shape, i, j): float(K[i, j]) for name, K in entries for i, j in np.ndindex(*K.shape)}
    pi = _pi(np.arange(read) < n, integral, period)
    series = Series(blocks=(pi, StateSpaceOrder(states=len(A), start=start)))
    structure = Sampled(inner=series, period=period, basis=channel.basis, read=channel.turned(read), forward=True)
    return Parametrised(structure, read, n, Units(gain=np.tile(unit / shown, (n, 1)), rate=rate))


def _pi(integrated: NDArray[np.bool_], integral: float, period: float) -> PID:
    """Return 1 + integral/s by Tustin's rule, in channels that are integrated, fixed."""
    gains = {f"kp{k + 1}{k + 1}": 1.0 + 0.5 * integral * period * one for k, one in enumerate(integrated)}
    gains |= {f"ki{k + 1}{k + 1}": integral for k in np.flatnonzero(integrated)}
    return PID(P="diagonal", I=np.diag(integrated), D="none", filter_order=0, fixed=gains)


def without_integrators(controller: System, channel: Channels, integral: float, period: float) -> System | None:
    """Return a controller without its PI, 1 + integral/s, in the channels of the gyros; None if unstable then."""
    from scipy.linalg import schur, solve_sylvester

    basis, read = channel.basis, controller.B.shape[1]
    undone = [first_order(1.0, 0.0, 1.0, integral, period)] * len(basis) + [gain(1.0)] * (read - len(basis))
    A, B, C, D, _ = side_by_side(*undone).series(between(channel.turned(read).T, controller, basis))
    triangle, vectors, kept = schur(A, sort=lambda re, im=0.0: bool(abs(complex(re, im) - 1.0) > _INTEGRATOR))
    left, right = triangle[:kept, :kept], triangle[kept:, kept:]
    if kept and np.abs(np.linalg.eigvals(left)).max() >= 1.0:
        return None
    # The integrators are no longer excited: what remains is split from them.
    X = solve_sylvester(left, -right, -triangle[:kept, kept:]) if kept < len(A) else np.zeros((kept, 0))
    B, C = vectors.T @ B, C @ vectors
    return System(left, B[:kept] - X @ B[kept:], C[:, :kept], D, period)


def of_order(system: System, order: int, rate: float) -> System:
    """Return a stable sampled system with `order` states: balanced truncation, or with faint modes of its own added.

    These lie, well damped, at `rate`, the nutation frequency times the period.
    """
    less = balanced_truncation(system, order)
    A, B, C, D, period = less
    missing, (outputs, inputs) = order - len(A), D.shape
    if missing <= 0:
        return less
    size = max(D.shape)
    own = np.zeros((missing, missing))
    for k in range(0, missing, 2):
        pair = slice(k, min(k + 2, missing))
        turn = np.array([[-0.7, 1.0], [-1.0, -0.7]]) * (1.0 + 0.15 * k)
        own[pair, pair] = np.eye(2)[: missing - k, : missing - k] + rate * turn[: missing - k, : missing - k]
    # Every mode sees and drives another mixture of channels, faintly.
    phase = np.pi * np.outer(np.arange(missing) + 0.5, np.arange(size) + 0.5) / max(missing, size)
    unit = float(np.abs(D).max()) or 1.0
    turn_size = float(np.sqrt(np.linalg.norm(C) / np.linalg.norm(B) / unit)) if len(A) else 1.0
    into, out = np.sqrt(rate) / turn_size * 0.3 * np.cos(phase), unit * np.sqrt(rate) * turn_size * 0.02 * np.sin(phase)
    first, into, out = len(A), into[:, :inputs], out[:, :outputs]
    whole = np.zeros((order, order))
    whole[:first, :first], whole[first:, first:] = A, own
    return System(whole, np.vstack([B, into]), np.hstack([C, out.T]), D, period)


def balanced_truncation(system: System, order: int) -> System:
    """Return the balanced truncation of a stable sampled system, by square roots (Tombs and Postlethwaite 1987).

    Fewer than `order` states are kept where Hankel singular values are negligible.
    """
    A, B, C, D, dt = system
    if not len(A):
        return system
    reach, show = (_root(stationary_covariance(a, b)) for a, b in ((A, B), (A.T, C.T)))
    U, s, V = np.linalg.svd(show.T @ reach)
    order = min(order, int(np.sum(s > _NEGLIGIBLE * s[0])))
    scale = 1.0 / np.sqrt(s[:order])
    right, left = reach @ V[:order].T * scale, (show @ U[:, :order] * scale).T
    first, into, out = (np.asarray(item, dtype=np.float64) for item in (left @ A @ right, left @ B, C @ right))
    return System(first, into, out, D, dt)


def _root(gramian: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    out: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return out
