"""Plants that are affine in parameters of a box: their vertices, which of them are needed, and what lies between."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.common.arguments import real_array
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.partition import Partition, partition
from platform_ctrl.errors import ArgumentError, IllPosedError

if TYPE_CHECKING:
    from control import StateSpace

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
