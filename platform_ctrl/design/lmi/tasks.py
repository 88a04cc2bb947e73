"""Requirements in the form of the inequalities: weighted channels of a plant with their bounds, and pole regions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.closed_loop import ClosedLoop
from platform_ctrl.analysis.certificates.makers import h2_certificate, norm_certificate, stability_certificate
from platform_ctrl.analysis.certificates.plant_set import region_certificate
from platform_ctrl.analysis.channel import Channel, weight_arrays
from platform_ctrl.analysis.feedback import series
from platform_ctrl.analysis.sampling import to_w_plane
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Partition, in_w_plane, side_by_side, whole
from platform_ctrl.design.scaling import ScaledPlant
from platform_ctrl.errors import ArgumentError, IllPosedError, NotCertifiedError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace

    from platform_ctrl.design.lmi.conic import Solver

REGIONS = ("stability", "damping", "fastest pole")
NORMS = ("H-infinity norm", "H2 norm")
CONTROLLER = "fastest controller pole"
# Singular value of [A − sI, B2] (or its dual), relative to A, below which a mode cannot be moved.
FIXED = 1e-9


@value
class NormTask:
    """A norm of one channel of the extended plant, between its w and z (indices); a soft one is minimised."""

    requested: LoopRequirement
    w: tuple[int, ...]
    z: tuple[int, ...]

    @property
    def h2(self) -> bool:
        """Whether it is an H2 norm."""
        return self.requested.kind == "H2 norm"


@value
class Tasks:
    """The requirements, sorted."""

    # The plant, in the w-plane if it is sampled, extended by the channels' weights: its w and z are those of the
    # channels, one after the other.
    plant: Partition
    # norms, regions: the norms and pole regions.
    norms: tuple[NormTask, ...]
    regions: tuple[LoopRequirement, ...]
    controller: tuple[LoopRequirement, ...]  # bounds on the modulus of the controller's poles


def tasks(P: StateSpace, plant: Partition, requirements: Sequence[LoopRequirement], where: str) -> Tasks:
    """Sort requirements and extend the plant by their channels."""
    if not requirements:
        raise ArgumentError(f"{where}: requirements must contain at least one, of kind {_kinds()}")
    norms: list[LoopRequirement] = []
    regions: list[LoopRequirement] = []
    controller: list[LoopRequirement] = []
    for requested in requirements:
        if not isinstance(requested, LoopRequirement) or requested.kind not in (*NORMS, *REGIONS, CONTROLLER):
            kind = getattr(requested, "kind", type(requested).__name__)
            raise ArgumentError(
                f"{where}: requirements must be of kind {_kinds()}, got {kind!r}; for others use design.structured"
            )
        if requested.kind in REGIONS:
            region(requested, plant.dt)
        elif requested.sense != "at most" or not (math.isfinite(requested.limit) and requested.limit > 0):
            raise ArgumentError(
                f"{where}: {requested.name}: must be at most a positive number, got {requested.sense} "
                f"{requested.limit!r}"
            )
        if not requested.hard and requested.kind not in NORMS:
            raise ArgumentError(f"{where}: {requested.name} must be hard: only norms are minimised")
        {CONTROLLER: controller}.get(requested.kind, norms if requested.kind in NORMS else regions).append(requested)
    if norms:
        extended, placed = _extended(P, plant, norms)
    else:
        extended, placed = in_w_plane(plant), ()
    return Tasks(plant=extended, norms=placed, regions=tuple(regions), controller=tuple(controller))


def _kinds() -> str:
    return ", ".join(map(repr, (*NORMS, *REGIONS, CONTROLLER)))


def _extended(
    P: StateSpace, plant: Partition, norms: Sequence[LoopRequirement]
) -> tuple[Partition, tuple[NormTask, ...]]:
    """Return the plant whose w and z are the weighted signals of the channels, one after the other."""
    p = in_w_plane(plant)
    (nz, nw), n = p.D11.shape, len(p.A)
    before: list[StateArrays] = []
    after: list[StateArrays] = []
    columns: list[int] = []
    rows: list[int] = []
    for requested in norms:
        channel = requested.channel or Channel()
        w = [known_name(f"{requested.name}: w", name, P.input_labels[:nw]) for name in channel.inputs]
        z = [known_name(f"{requested.name}: z", name, P.output_labels[:nz]) for name in channel.outputs]
        w, z = w or list(range(nw)), z or list(range(nz))
        weight = _weight(channel.input_weight, len(w), "input_weight", plant.dt)
        white = requested.kind == "H2 norm" and plant.dt > 0
        before.append(_white(weight, plant.dt) if white else weight)
        after.append(_weight(channel.output_weight, len(z), "output_weight", plant.dt))
        columns, rows = columns + w, rows + z
    # States: the plant's, those of the weights before it, those of the weights behind it.
    A_i, B_i, C_i, D_i, _ = side_by_side(*before)
    A_o, B_o, C_o, D_o, _ = side_by_side(*after)
    C_i, D_i = np.eye(nw)[:, columns] @ C_i, np.eye(nw)[:, columns] @ D_i
    B_o, D_o = B_o @ np.eye(nz)[rows], D_o @ np.eye(nz)[rows]
    a, b = len(A_i), len(A_o)
    A = np.block(
        [
            [p.A, p.B1 @ C_i, np.zeros((n, b))],
            [np.zeros((a, n)), A_i, np.zeros((a, b))],
            [B_o @ p.C1, B_o @ p.D11 @ C_i, A_o],
        ]
    )
    none = np.zeros((a, p.B2.shape[1]))
    extended = Partition(
        A=A,
        B1=np.vstack([p.B1 @ D_i, B_i, B_o @ p.D11 @ D_i]),
        B2=np.vstack([p.B2, none, B_o @ p.D12]),
        C1=np.hstack([D_o @ p.C1, D_o @ p.D11 @ C_i, C_o]),
        C2=np.hstack([p.C2, p.D21 @ C_i, np.zeros((len(p.C2), b))]),
        D11=D_o @ p.D11 @ D_i, D12=D_o @ p.D12, D21=p.D21 @ D_i, D22=p.D22,
    )  # fmt: skip
    inputs, outputs = _ranges([one.B.shape[1] for one in before]), _ranges([one.C.shape[0] for one in after])
    return extended, tuple(NormTask(requested=r, w=i, z=o) for r, i, o in zip(norms, inputs, outputs, strict=True))


def _ranges(sizes: list[int]) -> list[tuple[int, ...]]:
    """Return the indices of parts that follow one another."""
    return [tuple(range(end - size, end)) for size, end in zip(sizes, itertools.accumulate(sizes), strict=True)]


def _weight(weight: Any, size: int, where: str, period: float) -> StateArrays:
    """Return a weight of `size` signals, a sampled one in the w-plane."""
    out = weight_arrays(1.0 if weight is None else weight, size, period, where)
    if (out.D.shape[0] if where == "input_weight" else out.D.shape[1]) != size:
        raise ArgumentError(f"{where}: must fit {size} signals, got shape {out.D.shape}")
    return to_w_plane(out) if period > 0 and len(out.A) else out


def _white(weight: StateArrays, period: float) -> StateArrays:
    """Return the weight behind √T / (1 + w T/2): with it the H2 norm in the w-plane is that of the sampled system."""
    m = weight.B.shape[1]
    corner, eye = 2 / period, np.eye(m)
    first = StateArrays(-corner * eye, corner * eye, np.sqrt(period) * eye, np.zeros((m, m)), 0.0)
    return series(first, weight)


def checked(
    requirements: Sequence[LoopRequirement],
    closed_loop: StateSpace,
    controller: StateSpace,
    solver: Solver,
    soft: float,
    plant: str = "the plant",
) -> tuple[CheckResult, ...]:
    """Return the requirements checked for the actual loop; hard ones must be met, soft ones within `soft` times."""
    outcomes = tuple(
        requested.check_controller(controller, subject=solver.where)
        if requested.kind == CONTROLLER
        else requested.check_closed_loop(closed_loop, subject=solver.where)
        for requested in requirements
    )
    for outcome in outcomes:
        allowed = 1.0 if outcome.hard else soft
        if not outcome.ratio <= allowed:
            raise NotCertifiedError(
                f"{solver.where}: {outcome.name} is {outcome.value:.6g} {outcome.unit} with {plant}, a ratio of "
                f"{outcome.ratio:.4g} to the limit, more than {allowed:.4g}; {solver.cure}",
                solver.P,
            )
    return outcomes


def claimed_loop(plant: Partition, K: StateArrays, label: str) -> ClosedLoop:
    """Return a plant and u = K y as a certificate holds them."""
    one = whole(plant)
    return ClosedLoop(A=one.A, B=one.B, C=one.C, D=one.D, A_K=K.A, B_K=K.B, C_K=K.C, D_K=K.D, label=label)


def proofs(
    requirements: Sequence[LoopRequirement], closed_loop: StateSpace, controller: StateSpace
) -> tuple[Certificate, ...]:
    """Return stability and a certificate for each requirement: norms just above what they are, regions as requested."""
    loop, K = (state_arrays(system, "proofs") for system in (closed_loop, controller))
    out = [stability_certificate(loop.A, loop.dt)]
    for requested in requirements:
        if requested.kind in NORMS:
            part = (requested.channel or Channel()).of(loop, closed_loop.input_labels, closed_loop.output_labels)
            prove = h2_certificate if requested.kind == "H2 norm" else norm_certificate
            out.append(prove(*part[:4], part.dt, label=requested.name))
        elif requested.kind == CONTROLLER:
            L, M = -requested.limit * np.eye(2), np.array([[0.0, 1.0], [0.0, 0.0]])
            out.append(region_certificate(K.A, L, M, K.dt, label=requested.name))
        else:
            wanted = region(requested, loop.dt)
            out.append(region_certificate(loop.A, wanted.L, wanted.M, loop.dt, label=requested.name))
    return tuple(out)


@value
class Region:
    """L and M of a region, (k, k), and its requirement."""

    requested: LoopRequirement
    L: FloatArray
    M: FloatArray

    def contains(self, s: complex) -> bool:
        """Whether a pole lies in it."""
        return float(np.linalg.eigvalsh(self.L + s * self.M + np.conj(s) * self.M.T)[-1]) < 0


def region(requested: LoopRequirement, period: float = 0.0, rate: float = 1.0, tighter: float = 1.0) -> Region:
    """Return the region of "stability" (minimum decay rate), "damping" or "fastest pole", s in units of `rate`, rad/s.

    With a sample `period`, s, it is one of the w-plane, w = (2/T) (z − 1)/(z + 1): a decay is a disc there, exactly; a
    damping is a sector that is narrow enough for poles up to 1/T rad/s. Limits are `tighter` by a factor >= 1; the
    distance of a damping from 1 is divided by it.
    """
    limit, kind = requested.limit, requested.kind
    sense = "at most" if kind == "fastest pole" else "at least"
    if requested.sense != sense or not (math.isfinite(limit) and limit > 0) or (kind == "damping" and limit >= 1):
        below = " below 1" if kind == "damping" else ""
        raise ArgumentError(
            f"{requested.name}: must be {sense} a positive number{below}, got {requested.sense} {limit!r}"
        )
    disc = np.array([[0.0, 1.0], [0.0, 0.0]])
    if kind == "damping":
        cosine = 1 - (1 - _sector(limit, period)) / tighter
        sine = math.sqrt(1 - cosine**2)
        # The sector |arg(−s)| < θ, cos θ the damping.
        return Region(requested=requested, L=np.zeros((2, 2)), M=np.array([[sine, cosine], [-cosine, sine]]))
    if kind == "fastest pole":
        return Region(requested=requested, L=-limit / tighter / rate * np.eye(2), M=disc)
    decay = limit * tighter
    if period == 0.0:
        return Region(requested=requested, L=np.array([[2 * decay / rate]]), M=np.eye(1))
    # |z| < exp(−decay T) is the disc |w + c|² < c² − 4/T². Its c is large: 2 Re w + 4/T²/c + |w|²/c < 0.
    near = 2 / period * math.tanh(decay * period / 2)
    centre = (near + 4 / period**2 / near) / 2 / rate
    return Region(
        requested=requested,
        L=np.diag([4 / (period * rate) ** 2 / centre, -1.0]),
        M=np.array([[1.0, 0.0], [1 / math.sqrt(centre), 0.0]]),
    )


def _sector(damping: float, period: float) -> float:
    """Return the damping in the w-plane that is sufficient for `damping` of poles up to 1 / `period`, rad/s."""
    if period == 0.0:
        return damping
    s = np.linspace(0.0, 1.0, 101)[1:] * complex(-damping, math.sqrt(1 - damping**2))
    w = np.tanh(s / 2)
    return float(np.max(-w.real / np.abs(w)))


def require_movable(scaled: ScaledPlant, wanted: Sequence[Region], where: str, P: object) -> None:
    """Raise an IllPosedError that names a mode outside a region, in units of `scaled`, that no controller moves.

    Such modes, as a rule poles of weights, are poles of every closed loop.
    """
    plant = scaled.plant
    size = max(1.0, float(np.linalg.norm(plant.A, 2)))
    for pole in np.linalg.eigvals(plant.A):
        outside = [one.requested for one in wanted if not one.contains(complex(pole))]
        shifted = plant.A - pole * np.eye(len(plant.A))
        for text, pencil in (
            ("no control u moves it", np.hstack([shifted, plant.B2])),
            ("no measurement y sees it", np.vstack([shifted, plant.C2])),
        ):
            if outside and float(np.linalg.svd(pencil, compute_uv=False)[-1]) < FIXED * size:
                real = complex(pole) * scaled.rate
                requested = outside[0]
                raise IllPosedError(
                    f"{where}: the mode at {real.real:.4g}{real.imag:+.4g}j rad/s violates {requested.name} "
                    f"{requested.sense} {requested.limit:.4g}, and {text}; relax the limit, or give the weight another "
                    "pole",
                    P,
                )
