"""Parts of a closed loop: their names, responses at single frequencies, and differentials of these by the controller.

The parts are named by where they begin and end:

    [torque, Omega, noise] → [torque, angle, sight]        u = K (y + noise),  y = P (u + torque) + P_Omega Omega

"angle" is what is measured and kept at zero or at commands, of rate loops rates; "sight" are the rates of the line of
sight. Readings that help a loop beside these, in other units perhaps, are "helping", each by itself with all others
closed. A controller may also have inputs for commands, behind those for what is measured: "command" enters there, with
the other sign, and without them as noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from platform_ctrl.analysis.between_samples import Disturbed
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray


class Transfer(NamedTuple):
    """A part of the closed loop: from `source` to `target`, and `direct` times the identity.

    From torque to torque the closed loop is −T = S − I at the plants' input, from noise to angle at their output, from
    helping to helping at one of the further readings.
    With `of_limit` every torque is taken by itself, over its torquer's limit, for platform rates over the set's Omega.
    """

    source: Literal["torque", "Omega", "noise", "command", "helping"]
    target: Literal["torque", "angle", "sight", "helping"]
    direct: float = 0.0
    of_limit: bool = False


S_OUTPUT, S_INPUT = Transfer("noise", "angle", 1.0), Transfer("torque", "torque", 1.0)
FOLLOWING = Transfer("command", "angle", 1.0)  # from a command to its error
# What counts in peaks of S, of T, and of (S − T)/2 = S − I/2.
OF_S, OF_T, OF_HALF = (
    tuple(Transfer(*ends, direct) for ends in (("noise", "angle"), ("torque", "torque"), ("helping", "helping")))
    for direct in (1.0, 0.0, 0.5)
)
ANGLE_PER_OMEGA, ANGLE_PER_TORQUE = Transfer("Omega", "angle"), Transfer("torque", "angle")
SIGHT_PER_OMEGA = Transfer("Omega", "sight")
TORQUE_SHARE = Transfer("Omega", "torque", of_limit=True)
SENSITIVITIES = (S_OUTPUT, S_INPUT)
Parts = tuple[Transfer, ...]


class Responses(NamedTuple):
    """Plant, controller, sensitivities, and what disturbances do to what is measured, to it and the sight between.

    Each complex (..., rows, columns); the last three as in `between_samples.Disturbed`. `fed`: platform rate → torques
    that feedforward adds, where it does.
    """

    P: ComplexArray
    K: ComplexArray
    S_output: ComplexArray
    S_input: ComplexArray
    fed: ComplexArray
    read: ComplexArray
    angle: ComplexArray
    sight: ComplexArray


UNDISTURBED = Disturbed(*(np.zeros((0, 0, 0), dtype=np.complex128),) * 3)

# Singular vectors u, v → a (k, m), b (k, p) with d(uᴴ X v) = a dK b.
Differential = Callable[[Responses, ComplexArray, ComplexArray], tuple[ComplexArray, ComplexArray]]


class Map(NamedTuple):
    """A map of the closed loop: its response, its differential, and whether it is from a continuous disturbance."""

    response: Callable[[Responses], ComplexArray]
    differential: Differential
    disturbed: bool = False


def row_of(left: ComplexArray, *factors: ComplexArray) -> ComplexArray:
    """Return the rows (k, n) times the matrices (k, n, ...), in this order."""
    out = left[:, None, :]
    for factor in factors:
        out = out @ factor
    return out[:, 0, :]


def column_of(*factors: ComplexArray) -> ComplexArray:
    """Return the matrices (k, ..., n) times the columns (k, n), which come last."""
    out = factors[-1][:, :, None]
    for factor in factors[-2::-1]:
        out = factor @ out
    return out[:, :, 0]


def _plus(S: ComplexArray, factor: float) -> ComplexArray:
    return S if factor == 0.0 else S + factor * np.eye(S.shape[-1])


def _at_output(direct: float, part: slice, commanded: FloatArray | None = None) -> Map:
    """Return S at some outputs, or from their commands, less the identity, and `direct` times that."""

    def right(r: Responses) -> ComplexArray:
        return r.S_output[..., part] if commanded is None else np.asarray(r.S_output @ commanded)

    return Map(
        lambda r: _plus(right(r)[..., part, :], direct - 1.0),
        lambda r, u, v: (row_of(u, r.S_output[..., part, :], r.P), column_of(right(r), v)),
    )


def _at_input(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    return row_of(u, r.S_input), column_of(r.P, r.S_input, v)


CONTROLLER = Map(lambda r: r.K, lambda r, u, v: (u, v))


def maps_of(transfer: Transfer, plants: PlantSet) -> list[Map]:
    """Return the maps of a part: one for each helping reading, and for each torque over its limit; none without any."""
    source, target, direct, of_limit = transfer
    kept = plants.kept
    match source, target:
        case "helping", _:
            return [_at_output(direct, slice(i, i + 1)) for i in range(kept, len(plants.angles))]
        case "noise", "angle":
            return [_at_output(direct, slice(kept))]
        case "command", "angle":
            return [_at_output(direct, slice(kept), plants.commanded)]
        case "torque", "torque":
            return [Map(lambda r: _plus(r.S_input, direct - 1.0), _at_input)]
        case "noise", "torque":
            return [Map(lambda r: r.K @ r.S_output, lambda r, u, v: (row_of(u, r.S_input), column_of(r.S_output, v)))]
        case "Omega", "torque" if of_limit:
            return [_torque_share(int(k), plants) for k in np.flatnonzero(np.isfinite(plants.torque_limit))]
        case "Omega", "torque":
            return [
                Map(
                    _torque_per_Omega,
                    lambda r, u, v: (row_of(u, r.S_input), column_of(r.S_output, r.read[..., -3:], v)),
                    True,
                )
            ]
    return [_between(source, target, slice(kept))]


def _torque_per_Omega(r: Responses, torques: slice = slice(None)) -> ComplexArray:
    return r.K[..., torques, :] @ r.S_output @ r.read[..., -3:] + r.fed[..., torques, :]


def _between(source: str, target: str, kept: slice) -> Map:
    """Return the map from a continuous disturbance to what is measured or to the line of sight, between samples.

    Of commands in place of torques at the samples.
    """

    def sampled(r: Responses) -> bool:
        return source == "torque" and r.read.shape[-1] != 2 * r.P.shape[-1] + 3

    def parts(r: Responses) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return what the inputs and the disturbance do to what is seen, and the latter to what is read."""
        seen, m = getattr(r, target), r.P.shape[-1]
        columns = slice(-3, None) if source == "Omega" else slice(m, 2 * m)
        return seen[..., :m], seen[..., columns], r.read[..., columns]

    def response(r: Responses) -> ComplexArray:
        if sampled(r):
            return r.P[..., kept, :] @ r.S_input
        of_inputs, direct, read = parts(r)
        return np.asarray(direct + of_inputs @ (r.K @ r.S_output @ read))

    def differential(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        if sampled(r):
            return _at_input(r, row_of(u, r.P[..., kept, :]), v)
        of_inputs, _, read = parts(r)
        return row_of(u, of_inputs, r.S_input), column_of(r.S_output, read, v)

    return Map(response, differential, True)


def _torque_share(k: int, plants: PlantSet) -> Map:
    """Return the map from the platform's rate, in units of the set's Omega, to torque `k` over its limit."""
    weight = plants.Omega / plants.torque_limit[k]

    def differential(r: Responses, u: ComplexArray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        return u * r.S_input[:, k, :], column_of(r.S_output, r.read[..., -3:], weight * v)

    return Map(lambda r: _torque_per_Omega(r, slice(k, k + 1)) * weight, differential, True)
