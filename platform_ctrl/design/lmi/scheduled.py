"""Gain-scheduled output feedback with a proof for any motion of the parameters (Apkarian, Gahinet and Becker 1995).

The plant is affine in parameters rho(t) of a box, for example in Omega and its products. One Lyapunov matrix serves all
vertices, so it serves every rho in the box and every rho(t), however fast it changes; the controller at rho is the
convex combination of the vertices' controllers.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.certificates.certificate import Certificate, proved
from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.common.arguments import positive, real_array
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.lmi.quadratic import quadratic_hinf
from platform_ctrl.design.lmi.tasks import claimed_loop
from platform_ctrl.design.partition import Partition, closed_loop, controller_system, partition
from platform_ctrl.design.scaling import require_stabilisable
from platform_ctrl.errors import ArgumentError, IllPosedError, NotCertifiedError, UnscalableError
from platform_ctrl.mechanics.polynomials import monomial_values

if TYPE_CHECKING:
    from control import StateSpace

WHERE = "scheduled, lmi"
# Factors of the solver's level at which the bound is certified, tried in turn.
SLACK = (1.0, 1.001, 1.01)
# Entries that differ by less than this share of the largest of their matrix are the same; also what affine means.
SAME = 1e-9
# Vertices at most: 2^10.
MOST_PARAMETERS = 10


@value
class Box:
    """Names of parameters and their bounds, (p,) each."""

    names: tuple[str, ...]
    low: FloatArray
    high: FloatArray

    def vertices(self) -> FloatArray:
        """Return the corners, (corners, p); a parameter whose bounds are equal has one end."""
        ends = [sorted({a, b}) for a, b in zip(self.low.tolist(), self.high.tolist(), strict=True)]
        return np.array(list(itertools.product(*ends)), dtype=np.float64).reshape(-1, len(self.names))

    def shares(self, parameters: ArrayLike) -> FloatArray:
        """Return the convex coordinates of a point, in the order of `vertices`."""
        point = real_array("parameters", parameters, (len(self.names),))
        out = np.ones(1)
        for name, x, a, b in zip(self.names, point, self.low, self.high, strict=True):
            slack = SAME * max(abs(a), abs(b))
            if not a - slack <= x <= b + slack:
                raise ArgumentError(f"parameters: {name} must be within [{a:.6g}, {b:.6g}], got {x:.6g}")
            share = np.array([1.0]) if a == b else np.clip(np.array([b - x, x - a]) / (b - a), 0.0, 1.0)
            out = np.outer(out, share).ravel()
        return out


def box(names: Sequence[str], low: ArrayLike, high: ArrayLike, where: str) -> Box:
    """Return a box."""
    if isinstance(names, str) or not names or len(set(names)) < len(names):
        raise ArgumentError(f"{where}: names must be a list of different names, one for each parameter, got {names!r}")
    names = tuple(names)
    a, b = (real_array(f"{where}: {word}", x, (len(names),)) for word, x in (("low", low), ("high", high)))
    if not np.all(a <= b):
        raise ArgumentError(f"{where}: low must not exceed high for any of {', '.join(names)}")
    if np.sum(a < b) > MOST_PARAMETERS:
        raise ArgumentError(f"{where}: at most {MOST_PARAMETERS} parameters may vary, got {np.sum(a < b)}")
    return Box(names=names, low=a, high=b)


def combined(matrices: Sequence[StateArrays], shares: FloatArray) -> StateArrays:
    """Return the convex combination of realisations in common states."""
    A, B, C, D = (np.tensordot(shares, np.array([getattr(one, name) for one in matrices]), axes=1) for name in "ABCD")
    return StateArrays(A=A, B=B, C=C, D=D)


def vertex_plants(
    plant: Callable[[FloatArray], StateSpace], corners: Box, nmeas: int, ncon: int, where: str
) -> tuple[list[StateSpace], list[Partition]]:
    """Return the plants at the vertices, after a check that those between are affine."""
    points = corners.vertices()
    systems = [plant(point) for point in points]
    parts = [partition(system, nmeas, ncon) for system in systems]
    require_alike(systems, where)
    # At two points that are on no edge.
    for share in (0.5, 0.3):
        weights = share ** np.arange(1, len(corners.names) + 1)
        point = corners.low + weights * (corners.high - corners.low)
        there, mean = plant(point), combined([state_arrays(one, where) for one in systems], corners.shares(point))
        for name in "ABCD":
            size = max(float(np.max(np.abs(getattr(system, name)), initial=0.0)) for system in systems)
            if np.max(np.abs(getattr(there, name) - getattr(mean, name)), initial=0.0) > SAME * size:
                raise ArgumentError(
                    f"{where}: {name} of the plant must be affine in {', '.join(corners.names)}; "
                    "take its monomials for parameters, as parameter_varying does"
                )
    return systems, parts


def require_alike(systems: Sequence[StateSpace], where: str) -> None:
    """Raise an ArgumentError where plants have different numbers of states or signals."""
    shapes = [(one.nstates, one.ninputs, one.noutputs) for one in systems]
    other = next((shape for shape in shapes if shape != shapes[0]), None)
    if other is not None:
        raise ArgumentError(f"{where}: plants must have equal (states, inputs, outputs), got {shapes[0]} and {other}")


def require_common(parts: Sequence[Partition], names: Sequence[str], system: StateSpace, where: str) -> None:
    """Raise an IllPosedError that names the signal where a matrix that all plants must share differs between them."""
    u, y = system.input_labels[-parts[0].B2.shape[1] :], system.output_labels[-len(parts[0].C2) :]
    for name in names:
        stack = np.array([getattr(part, name) for part in parts])
        difference = np.ptp(stack, axis=0)
        size = float(np.max(np.abs(stack), initial=0.0))
        if np.max(difference, initial=0.0) <= SAME * size:
            continue
        row, column = np.unravel_index(int(np.argmax(difference)), difference.shape)
        if name in ("B2", "D12"):
            signal, cure = f"control {u[column]!r}", "a lag between the controller and this control"
        else:
            signal, cure = f"measurement {y[row]!r}", "a lag between this measurement and the controller"
        raise IllPosedError(
            f"{where}: {name} must not depend on the parameters, but does for {signal}; put {cure}, which moves the "
            "dependence into A",
            system,
        )


def needed(parts: Sequence[Partition]) -> list[int]:
    """Return indices of plants whose convex hull contains all: fewer than the box has if parameters act alike."""
    data = np.array([np.concatenate([p.A.ravel(), p.B1.ravel(), p.C1.ravel(), p.D11.ravel()]) for p in parts])
    size = np.max(np.abs(data), axis=0)
    data = (data - data.mean(axis=0))[:, size > 0] / size[size > 0]
    U, sigma, _ = np.linalg.svd(data, full_matrices=False)
    rank = int(np.sum(sigma > 1e-13 * max(1.0, sigma[0]) * len(sigma)))
    if rank == 0:
        return [0]
    points = U[:, :rank] * sigma[:rank]
    if rank == 1:
        return sorted({int(np.argmin(points)), int(np.argmax(points))})
    if len(parts) <= 2**rank:
        return list(range(len(parts)))
    from scipy.spatial import ConvexHull, QhullError

    try:
        return sorted(int(k) for k in ConvexHull(points / sigma[:rank]).vertices)
    except QhullError:
        return list(range(len(parts)))


@value
class Scheduled:
    """A controller that follows the parameters, with the proof that it may.

    Attributes
    ----------
    box
        Parameters and their bounds.
    plants, controllers
        At the vertices, in the order of ``box.vertices()``; the controllers in common states, u = K y.
    nmeas, ncon
        Number of measurements and of controls.
    gamma
        For any rho(t) in the box, and x = 0 at the start, the energy of z is below gamma² times that of w; in units of
        z per w.
    gamma_optimal
        The least gamma with a common Lyapunov matrix, as the solver found it, in the same units: sufficient, so other
        controllers may have less.
    norms : (vertices,)
        H-infinity norms of the closed loops frozen at the vertices, in the same units.
    backoff
        Relative distance from the least gamma.
    certificate
        One Lyapunov matrix for all vertices, proved for these matrices.
    residual
        Figures of merit of the route by name, in scaled units.
    """

    box: Box
    plants: tuple[StateSpace, ...]
    controllers: tuple[StateSpace, ...]
    nmeas: int
    ncon: int
    gamma: float
    gamma_optimal: float
    norms: FloatArray
    backoff: float
    certificate: Certificate
    residual: dict[str, float]

    @property
    def lyapunov(self) -> FloatArray:
        """X of the certificate, (n, n): x'Xx falls along every motion.

        x are the states of plant and controller, in their units.
        """
        return self.certificate.X

    def at(self, parameters: ArrayLike) -> StateSpace:
        """Return the controller, u = K y, frozen at values (p,) of the parameters, inside the box, in its units.

        Its states keep their meaning while these change. An `ArgumentError` outside the box.
        """
        return _combined(self.controllers, self.box.shares(parameters))

    def controller(self, Omega: ArrayLike) -> StateSpace:
        """Return the controller, u = K y, frozen at a platform rate (3,), rad/s.

        The parameters are then monomials of Omega; else, or outside the range, it is an `ArgumentError`.
        """
        return self.at(monomial_values(self.box.names, Omega))

    def plant(self, parameters: ArrayLike) -> StateSpace:
        """Return the plant frozen at values (p,) of the parameters, inside the box, in its units."""
        return _combined(self.plants, self.box.shares(parameters))


@check_arguments
def scheduled(
    plant: Callable[[FloatArray], StateSpace],
    names: Sequence[str],
    low: ArrayLike,
    high: ArrayLike,
    nmeas: int,
    ncon: int,
    *,
    backoff: float = 0.02,
    time_limit: float = 60.0,
) -> Scheduled:
    """Gain-scheduled H-infinity output feedback for a plant that is affine in parameters.

    Parameters
    ----------
    plant
        ``plant(rho)`` is the continuous plant with inputs [w, u] and outputs [z, y] at parameter values (p,), in their
        units. It is affine in them, and what u drives and y sees directly (B2, C2, D12, D21, D22) does not depend on
        them.
    names
        Names of the p parameters.
    low, high : (p,)
        Their bounds, in the parameters' units.
    nmeas, ncon
        Number of measurements y and of controls u: the last outputs and the last inputs.
    backoff
        Relative distance from the least gamma, positive.
    time_limit
        Longest time that one call of the solver may take, s.

    Returns
    -------
    Scheduled
        Controllers at the vertices, and the certificate for all between.

    Raises
    ------
    ArgumentError
        The arguments do not make sense, or the plant is not affine.
    IllPosedError
        B2, C2, D12, D21 or D22 depends on the parameters; the message names the signal.
    NotStabilisableError
        At a vertex no controller stabilises the plant.
    InfeasibleError, UnscalableError, TimeLimitError
        No common Lyapunov matrix was found.
    NotCertifiedError
        The proof for the controllers as returned failed.

    References
    ----------
    P. Apkarian, P. Gahinet, G. Becker, Automatica 31, 1995.

    P. Gahinet, Automatica 32, 1996.

    See docs/lmi.md.
    """
    backoff, time_limit = positive(f"{WHERE}: backoff", backoff), positive(f"{WHERE}: time_limit", time_limit)
    corners = box(names, low, high, WHERE)
    systems, parts = vertex_plants(plant, corners, nmeas, ncon, WHERE)
    require_common(parts, ("B2", "C2", "D12", "D21", "D22"), systems[0], WHERE)
    for system, part in zip(systems, parts, strict=True):
        require_stabilisable(part, system, WHERE)
    try:
        found = quadratic_hinf(parts, backoff, time_limit, systems, WHERE, needed(parts))
    except np.linalg.LinAlgError as error:
        raise UnscalableError(f"{WHERE}: {str(error).lower()} within the scaled problem", systems) from None
    level = (1 + backoff) * found.least
    certificate = _certificate(parts, found.controllers, level, found.lyapunov, systems)
    loops = [closed_loop(part, K) for part, K in zip(parts, found.controllers, strict=True)]
    return Scheduled(
        box=corners,
        plants=tuple(systems),
        controllers=tuple(controller_system(systems[0], K) for K in found.controllers),
        nmeas=nmeas,
        ncon=ncon,
        gamma=certificate.bound,
        gamma_optimal=found.least,
        norms=np.array([hinf_norm(loop, allow_unstable=True)[0] for loop in loops]),
        backoff=backoff,
        certificate=certificate,
        residual=found.residual,
    )


def _certificate(
    parts: Sequence[Partition], controllers: Sequence[StateArrays], level: float, V: FloatArray, problem: object
) -> Certificate:
    """Return the proof for all vertices with one matrix, at the level or slightly above it."""
    loops = tuple(
        claimed_loop(p, K, f"vertex {number + 1}") for number, (p, K) in enumerate(zip(parts, controllers, strict=True))
    )
    failure: NotCertifiedError | None = None
    for slack in SLACK:
        bound = slack * level
        try:
            return proved(Certificate(claim="norm", bound=bound, loops=loops, X=level * V), problem)
        except NotCertifiedError as error:
            failure = error
    assert failure is not None
    raise NotCertifiedError(f"{WHERE}: {failure}; give a larger backoff", problem) from None


def _combined(systems: Sequence[StateSpace], shares: FloatArray) -> StateSpace:
    mean = combined([state_arrays(system, "scheduled") for system in systems], shares)
    return named_system(mean, systems[0].input_labels, systems[0].output_labels)
