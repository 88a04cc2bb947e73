"""Synthesis of a controller of fixed structure: the least worst norm over several plants, from several starts.

The plants are augmented by the controller's integrators, so that all of the controller is one matrix (see `norm`); a
sampled plant is carried to the w-plane, where stability and H-infinity norm are the same. What the search finds is
measured on the closed loops of the plants as given, and compared with a controller of full order.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import whole as whole_number
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design import partition as partitions
from platform_ctrl.design.fixed_structure.minimax import Effort, Minimum, minimise
from platform_ctrl.design.fixed_structure.norm import AugmentedLoop, WorstNorm, augmented
from platform_ctrl.design.fixed_structure.structures import Parametrised, Structure, Units
from platform_ctrl.design.synthesis import hinf
from platform_ctrl.errors import ArgumentError, DesignError, NotCertifiedError, NotFoundError

if TYPE_CHECKING:
    from control import StateSpace

# Plants whose full-order controllers starts are fitted to.
_FITTED = 2
# Matrix inequalities of more states than this take minutes.
_LMI_STATES = 20
# Back-offs of the controllers that starts are fitted to: near the least norm they have needlessly fast poles, and far
# from it they are simple. What is added to the plant where the Riccati equations' assumptions do not hold.
_BACKOFFS = (0.1, 0.5, 2.0)
# What the recomputed norm may exceed that of the search by, relative.
_AGREEMENT = 1e-3
# Frequencies of a fit, and how far beyond the poles they reach.
_POINTS, _BEYOND = 60, 10.0
# Decades over which the length of random starts of gains is spread, either side of the units, and width of the scatter
# of positive numbers.
_DECADES, _SCATTER = 1.5, 0.7
# Largest gains, in their units, and the share of the starts that go on with each: where the infimum lies at infinite
# gain, a search without limit runs there on a way of its own; along a limit it finds the best way first.
_STAGES = ((1e1, 1.0), (1e2, 1.0), (1e3, 0.5), (1e4, 0.25), (1e5, 0.25))
# Share of the largest number by which the first step of a stage may move it.
_FIRST = 0.1
# Most steps of a search, rounds of a start in the last stage, and the decrease that is worth another one, relative.
_STEPS, _ROUNDS, _WORTH = 300, 6, 1e-5


def structured(
    plants: StateSpace | Sequence[StateSpace],
    nmeas: int,
    ncon: int,
    *,
    structure: Structure,
    starts: int = 16,
    seed: int = 0,
    evaluations: int = 40000,
    progress: Callable[[str], None] | None = None,
) -> StructuredDesign:
    """Controller of fixed structure with the least worst norm over several plants, measured on the actual closed loops.

    Non-smooth optimisation from several starts, by quadratic programs over all peaks near the highest (after Apkarian
    and Noll 2006): a local method, so that more starts may find more.

    Parameters
    ----------
    plants
        One plant, or several that one controller has to serve, with inputs [w, u] and outputs [z, y], as in
        `control.hinfsyn`; all continuous, or all sampled with one period.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    structure
        What the controller looks like (see `structures`); its numbers may be bounded and fixed.
    starts
        From how many points the search begins. The first ones are the structure's own values and fits to full-order
        controllers, the others scattered.
    seed
        Of the scatter.
    evaluations
        Most evaluations of the closed loops (poles, or peaks and their gradients, of all plants at once) over all
        starts. The result depends on it, and not on the machine or its load.
    progress
        Called with a line after every start.

    Returns
    -------
    StructuredDesign
        The best controller found, with its evidence.

    Raises
    ------
    ArgumentError
        The plants or numbers do not make sense together.
    NotStabilisableError
        No controller of any kind stabilises one of the plants; the message names the mode.
    NotFoundError
        No start led to a controller of this structure that stabilises every plant, which does not show that there is
        none; the nearest is attached.
    NotCertifiedError
        The closed loops do not confirm what the search found.

    References
    ----------
    P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006.

    See docs/methods/structured.md.
    """
    given = tuple(plants) if isinstance(plants, list | tuple) else (plants,)
    if not isinstance(structure, Structure):
        raise ArgumentError(f"structured: structure must be a Structure, such as design.PID(), got {structure!r}")
    for name, number in (("starts", starts), ("evaluations", evaluations)):
        whole_number(f"structured: {name}", number, 1)
    whole_number("structured: seed", seed, 0)
    parts = _partitions(given, nmeas, ncon)
    for P, part in zip(given, parts, strict=True):
        partitions.require_stabilisable(part, P, "structured")
    flat = [partitions.in_w_plane(part) for part in parts]
    scaled = [partitions.autoscale(one) for one in flat]
    # Units by the first plant: the others are its neighbours.
    gain = np.outer(np.linalg.norm(scaled[0].control, axis=1), np.linalg.norm(scaled[0].measurement, axis=0))
    family = Parametrised(structure, nmeas, ncon, Units(gain=gain, rate=scaled[0].rate))
    least, known = zip(*(full_order(one) for one in flat), strict=True)
    fitted = [(plant, K) for plant, own in zip(flat[:_FITTED], known, strict=False) for K in own]
    points = starting_points(family, [p for p, _ in fitted], [K for _, K in fitted], starts, seed)
    wide = [augmented(one, structure.order(nmeas, ncon)) for one in flat]
    ends = searched(wide, family, points, evaluations, progress or (lambda line: None))
    best = min(ends, key=rank)
    M = family.matrix(best.x)  # in the w-plane where the plant is sampled
    k = len(M) - parts[0].B2.shape[1]
    K = partitions.out_of_w_plane(System(M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:]), parts[0].dt)
    controller = partitions.controller_system(given[0], K)
    if not best.at.stable:
        worst, at = max((abscissa(part, controller), k) for k, part in enumerate(parts, 1))
        raise NotFoundError(
            f"structured: none found: no {type(structure).__name__} controller with a stable loop with every plant in "
            f"{starts} starts; the nearest has the rightmost pole at {worst:+.4g} rad/s, with plant {at}; a local "
            "search does not show that there is none: give more starts or evaluations, starting values (start=...), or "
            "a richer structure",
            given,
            controller,
        )
    loops, gammas = measured(given, parts, controller, best.at.largest(hard=False))
    gamma = float(gammas.max())
    return StructuredDesign(
        plants=given,
        nmeas=nmeas,
        ncon=ncon,
        structure=structure,
        controller=controller,
        parameters=family.named(best.x),
        closed_loops=tuple(loops),
        gammas=gammas,
        gamma=gamma,
        gamma_optimal=min(max(least), gamma),
        poles=tuple(np.asarray(loop.poles()) for loop in loops),
        reached=np.array([one.at.largest(hard=False) if one.at.stable else np.inf for one in ends]),
        finished=best.finished,
    )


def _partitions(given: tuple[StateSpace, ...], nmeas: int, ncon: int) -> list[partitions.Partition]:
    if not given:
        raise ArgumentError("structured: there must be at least one plant, got no plants")
    parts = [partitions.partition(P, nmeas, ncon, sampled=True) for P in given]
    for k, one in enumerate(parts[1:], 2):
        if one.dt != parts[0].dt:
            raise ArgumentError(
                f"structured: plant {k} has dt = {one.dt:g} s, but the first {parts[0].dt:g} s; all must have the same"
            )
    return parts


@value
class StructuredDesign:
    """A controller of fixed structure with the evidence that it does what is claimed.

    Attributes
    ----------
    plants, nmeas, ncon
        The problem.
    structure
        What was requested.
    controller
        K, u = K y; sampled where the plants are.
    parameters
        Every number of the structure by name, in its unit; for sampled plants those of the w-plane controller.
    closed_loops
        From w to z, one a plant.
    gammas : (plants,)
        H-infinity norm of each closed loop, in units of z per w, recomputed from it.
    gamma
        The largest of them, in the same units.
    gamma_optimal
        Least norm of a full-order controller, in the same units: the largest over the plants; 0 where none was found.
    poles
        Closed-loop poles, one array (n,) a plant: rad/s, or in z (dimensionless).
    reached : (starts,)
        The norm that the search from each start found; inf where it found no stable loop.
    finished
        Whether the search ended by itself, not by its evaluations.
    """

    plants: tuple[StateSpace, ...]
    nmeas: int
    ncon: int
    structure: Structure
    controller: StateSpace
    parameters: dict[str, float]
    closed_loops: tuple[StateSpace, ...]
    gammas: FloatArray
    gamma: float
    gamma_optimal: float
    poles: tuple[ComplexArray, ...]
    reached: FloatArray
    finished: bool

    @property
    def price(self) -> float:
        """What the structure costs at most: ratio of gamma to the full-order bound; inf where that is 0."""
        return self.gamma / self.gamma_optimal if self.gamma_optimal > 0.0 else float("inf")


def full_order(plant: partitions.Partition) -> tuple[float, list[System]]:
    """Return the least norm of a continuous plant, 0 where none is found, and controllers of several back-offs.

    By matrix inequalities where the Riccati equations have no solution.
    """
    import control

    A, B, C, D, _ = partitions.whole(plant)
    P = control.StateSpace(A, B, C, D, remove_useless_states=False)
    nmeas, ncon = plant.C2.shape[0], plant.B2.shape[1]
    least, controllers = 0.0, list[System]()
    try:
        found = hinf(P, nmeas, ncon, method=None if len(plant.A) <= _LMI_STATES else "riccati", backoff=_BACKOFFS[0])
        least, controllers = found.gamma_optimal, [System.of(found.controller, "structured")]
    except DesignError:
        return least, controllers
    for backoff in _BACKOFFS[1:]:
        with contextlib.suppress(DesignError):
            found = hinf(P, nmeas, ncon, method="riccati", backoff=backoff)
            controllers.append(System.of(found.controller, "structured"))
    return least, controllers


def abscissa(part: partitions.Partition, K: StateSpace) -> float:
    """Return the largest real part, rad/s, of a loop's continuous(-equivalent) poles."""
    loop = partitions.closed_loop(part, System.of(K, "controller"))
    return float(spectral_abscissa(continuous_poles(poles(loop.A), part.dt)))


def measured(
    given: Sequence[StateSpace], parts: Sequence[partitions.Partition], controller: StateSpace, promised: float
) -> tuple[list[StateSpace], FloatArray]:
    """Return the loops closed with the plants as given, and their norms, which must be what the search promised."""
    loops = [partitions.closed_loop(part, System.of(controller, "controller")) for part in parts]
    for k, part in enumerate(parts, 1):
        if not abscissa(part, controller) < 0.0:
            raise NotCertifiedError(f"structured: the closed loop of plant {k} is not stable; give other starts", given)
    systems = [partitions.closed_loop_system(P, loop) for P, loop in zip(given, loops, strict=True)]
    gammas = np.array([float(hinf_norm(one)[0]) for one in systems])
    if not gammas.max() <= (1.0 + _AGREEMENT) * promised + 1e-9:
        raise NotCertifiedError(
            f"structured: the closed loops have the norm {gammas.max():.6g}, the search promised {promised:.6g}; "
            "bound the structure's numbers: gains this large are at the limit of floating point",
            given,
        )
    return systems, gammas


def starting_points(
    structured: Parametrised, plants: Sequence[partitions.Partition], known: Sequence[System], count: int, seed: int
) -> list[FloatArray]:
    """Return `count` starts: the structure's own, fits to controllers `known` of single `plants`, and random ones."""
    rng = np.random.default_rng(seed)
    points, fits = [structured.start], []
    for plant, K in zip(plants, known, strict=True):
        try:
            fit = Fit(plant, K, structured)
            points.append(fit.everything(fit.gains(structured.start)))
            fits.append(fit)
        except (np.linalg.LinAlgError, ValueError):
            continue
    centres, positive = points[1:] or points, structured.positive
    for k in range(count - len(points)):
        drawn = rng.standard_normal(len(structured.start))
        if np.any(positive):
            x = centres[k % len(centres)] + _SCATTER * drawn * positive
            x = np.clip(x, structured.lower, structured.upper)
            points.append(fits[k % len(fits)].gains(x) if fits else x)
        else:
            x = structured.start + drawn * 10.0 ** rng.uniform(-_DECADES, _DECADES)
            points.append(np.clip(x, structured.lower, structured.upper))
    return points[:count]


class Fit:
    """Fits of a structure to a full-order controller, to first order in the closed loop.

    With L and R the loop around `full` from u to z and from w to y, T(K) ≈ T(full) + L (K − full) R: least squares of
    that difference over frequency.
    """

    def __init__(self, plant: partitions.Partition, full: System, structured: Parametrised) -> None:
        self.structured = structured
        order = len(full.A)
        loop = AugmentedLoop(augmented(plant, order), np.block([[full.A, full.B], [full.C, full.D]]))
        speeds = np.abs(np.concatenate([loop.poles, np.linalg.eigvals(plant.A)]))
        speeds = speeds[speeds > 1e-6 * speeds.max()]
        self.frequency = np.geomspace(speeds.min() / _BEYOND, _BEYOND * np.median(speeds), _POINTS)
        _, left, right = loop.responses(self.frequency)
        self.left, self.right = left[:, :, order:], right[:, order:]
        self.wanted = frequency_response(System(full.A, full.B, full.C, full.D, 0.0), self.frequency, -3)
        self._order = structured.structure.order(structured.nmeas, structured.ncon)

    def difference(self, x: FloatArray) -> FloatArray:
        """Return real and imaginary parts of the closed loops' difference."""
        M, k = self.structured.matrix(x), self._order
        try:
            K = frequency_response(System(M[:k, :k], M[:k, k:], M[k:, :k], M[k:, k:], 0.0), self.frequency, -3)
            error = (self.left @ (K - self.wanted) @ self.right).ravel()
        except (np.linalg.LinAlgError, ArithmeticError):
            error = np.full(self.left.shape[0] * self.left.shape[1] * self.right.shape[2], np.inf, dtype=complex)
        out = np.concatenate([error.real, error.imag])
        return np.where(np.isfinite(out), out, 1e6)

    def gains(self, x: FloatArray) -> FloatArray:
        """Return x with the numbers that enter affinely fitted, the positive ones kept."""
        affine = ~self.structured.positive
        base = x.copy()
        base[affine] = 0.0
        at = self.difference(base)
        columns = []
        for k in np.flatnonzero(affine):
            one = base.copy()
            one[k] = 1.0
            columns.append(self.difference(one) - at)
        if not columns:
            return x
        out = base
        out[affine] = np.linalg.lstsq(np.array(columns).T, -at, rcond=1e-12)[0]
        return np.clip(out, self.structured.lower, self.structured.upper)

    def everything(self, start: FloatArray) -> FloatArray:
        """Return all numbers fitted, from `start` on."""
        from scipy.optimize import least_squares

        low, high = self.structured.lower, self.structured.upper
        room = 1e-9 * np.maximum(1.0, np.abs(start))
        found = least_squares(
            self.difference, np.clip(start, low + room, high - room), bounds=(low, high), x_scale="jac", max_nfev=60
        )
        return np.clip(np.asarray(found.x, dtype=np.float64), low, high)


def rank(found: Minimum) -> tuple[bool, float]:
    """The smaller the better: stability first."""
    return not found.at.stable, found.at.largest(hard=False)


def searched(
    plants: Sequence[partitions.Partition],
    family: Parametrised,
    points: Sequence[FloatArray],
    evaluations: int,
    progress: Callable[[str], None],
) -> list[Minimum]:
    """Return where the searches from `points` end, in their order.

    Gains may grow in stages; the best starts go on with larger ones, and once more each time that it was worth it: a
    search may end at a kink that a new region and curvature lead away from.
    """
    functions = [WorstNorm(plants, family) for _ in points]
    ends: dict[int, Minimum] = {}
    left, order = evaluations, list(range(len(points)))
    for stage, (gain, share) in enumerate(_STAGES):
        chosen = order[: max(2, round(share * len(points)))]
        for n, k in enumerate(chosen):
            most = left // ((len(chosen) - n) * (len(_STAGES) - stage))
            for again in range(_ROUNDS if stage == len(_STAGES) - 1 else 1):
                before = ends.get(k)
                if before is not None and most <= 0:
                    break
                found = _within(functions[k], family, points[k] if before is None else before.x, gain, max(most, 1))
                most, left = most - found.evaluations, left - found.evaluations
                if before is None or rank(found) < rank(before):
                    ends[k] = found
                if before is not None and again and not rank(found)[1] < (1.0 - _WORTH) * rank(before)[1]:
                    break
            progress(f"structured: start {k + 1} of {len(points)}, gains to {gain:g}: {rank(ends[k])[1]:.6g}")
        order.sort(key=lambda k: rank(ends[k]))
    return [ends[k] for k in range(len(points))]


def _within(function: WorstNorm, family: Parametrised, x: FloatArray, gain: float, evaluations: int) -> Minimum:
    """Return where the search from x ends with gains up to `gain`, in their units."""
    size = float(np.abs(x[~family.positive]).max(initial=0.0))
    limits = np.where(family.positive, np.inf, max(gain, 2.0 * size))
    bounds = np.maximum(family.lower, -limits), np.minimum(family.upper, limits)
    effort = Effort(evaluations=evaluations, steps=_STEPS, radius=_FIRST * max(1.0, size), least=1e-10)
    return minimise(function, x, bounds, effort)
