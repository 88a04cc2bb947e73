"""Requirements in the form of the inequalities: weighted channels of a plant with their bounds, and pole regions."""

from __future__ import annotations

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
from platform_ctrl.design.lmi.regions import REGIONS, region
from platform_ctrl.design.partition import Partition, in_w_plane, whole
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.judging import CheckResult
from platform_ctrl.job.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace

NORMS = ("H-infinity norm", "H2 norm")
CONTROLLER = "fastest controller pole"


@value
class NormTask:
    """A norm of one channel of the extended plant.

    Attributes
    ----------
    requested
        The requirement; a soft one is minimised, relative to its limit.
    w, z
        Indices of the channel's inputs and outputs in the extended plant.
    """

    requested: LoopRequirement
    w: tuple[int, ...]
    z: tuple[int, ...]

    @property
    def h2(self) -> bool:
        """Whether it is an H2 norm."""
        return self.requested.kind == "H2 norm"


@value
class Tasks:
    """The requirements, sorted.

    Attributes
    ----------
    plant
        The plant, in the w-plane if it is sampled, extended by the channels' weights: its w and z are those of the
        channels, one after the other.
    norms, regions
        The norms and pole regions.
    controller
        Bounds on the modulus of the controller's poles.
    """

    plant: Partition
    norms: tuple[NormTask, ...]
    regions: tuple[LoopRequirement, ...]
    controller: tuple[LoopRequirement, ...]


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
    nw, nz = plant.B1.shape[1], plant.C1.shape[0]
    names_w, names_z = P.input_labels[:nw], P.output_labels[:nz]
    n = len(plant.A)
    into: list[tuple[StateArrays, FloatArray]] = []
    out: list[tuple[StateArrays, FloatArray]] = []
    for requested in norms:
        channel = requested.channel or Channel()
        columns = [known_name(f"{requested.name}: w", name, names_w) for name in channel.inputs] or list(range(nw))
        rows = [known_name(f"{requested.name}: z", name, names_z) for name in channel.outputs] or list(range(nz))
        before = _weight(channel.input_weight, len(columns), "input_weight", plant.dt)
        if requested.kind == "H2 norm" and plant.dt > 0:
            before = _white(before, plant.dt)
        into.append((before, np.eye(nw)[:, columns]))
        out.append((_weight(channel.output_weight, len(rows), "output_weight", plant.dt), np.eye(nz)[rows]))
    # States: the plant's, those of the weights before it, those of the weights behind it.
    first = [len(weight.A) for weight, _ in into]
    last = [len(weight.A) for weight, _ in out]
    a, b, w, z = sum(first), sum(last), sum(i.B.shape[1] for i, _ in into), sum(o.C.shape[0] for o, _ in out)
    A_i, B_i, C_i, D_i = np.zeros((a, a)), np.zeros((a, w)), np.zeros((nw, a)), np.zeros((nw, w))
    A_o, B_o, C_o, D_o = np.zeros((b, b)), np.zeros((b, nz)), np.zeros((z, b)), np.zeros((z, nz))
    placed, x, j = [], 0, 0
    ranges: list[tuple[tuple[int, ...], tuple[int, ...]]] = []
    for (weight, select), k in zip(into, first, strict=True):
        m = weight.B.shape[1]
        A_i[x : x + k, x : x + k], B_i[x : x + k, j : j + m] = weight.A, weight.B
        C_i[:, x : x + k], D_i[:, j : j + m] = select @ weight.C, select @ weight.D
        ranges.append((tuple(range(j, j + m)), ()))
        x, j = x + k, j + m
    x, j = 0, 0
    for number, ((weight, select), k) in enumerate(zip(out, last, strict=True)):
        m = weight.C.shape[0]
        A_o[x : x + k, x : x + k], B_o[x : x + k] = weight.A, weight.B @ select
        C_o[j : j + m, x : x + k], D_o[j : j + m] = weight.C, weight.D @ select
        placed.append(NormTask(requested=norms[number], w=ranges[number][0], z=tuple(range(j, j + m))))
        x, j = x + k, j + m
    p = in_w_plane(plant)
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
    return extended, tuple(placed)


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
    requirements: Sequence[LoopRequirement], closed_loop: StateSpace, controller: StateSpace, method: str
) -> tuple[CheckResult, ...]:
    """Return the requirements checked for the actual closed loop and controller."""
    return tuple(
        requested.check_controller(controller, subject=method)
        if requested.kind == CONTROLLER
        else requested.check_closed_loop(closed_loop, subject=method)
        for requested in requirements
    )


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
