"""Requirements of a synthesis: weighted channels of a plant with their bounds, and the decay of the poles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.channel import Channel, weight_arrays
from platform_ctrl.analysis.feedback import series
from platform_ctrl.analysis.sampling import to_w_plane
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import value
from platform_ctrl.design.partition import Partition, in_w_plane, side_by_side
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace


REGIONS = ("stability", "damping", "fastest pole")
NORMS = ("H-infinity norm", "H2 norm")
CONTROLLER = "fastest controller pole"


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
            sense = "at most" if requested.kind == "fastest pole" else "at least"
            if requested.sense != sense or not (math.isfinite(requested.limit) and requested.limit > 0):
                raise ArgumentError(
                    f"{requested.name}: must be {sense} a positive number, got {requested.sense} {requested.limit!r}"
                )
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
