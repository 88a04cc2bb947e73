"""The certificates of a sampled loop over its plant set: stable with every plant, and what disk margin it has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.certificates.certificate import Certificate, Claim, proved
from platform_ctrl.analysis.certificates.closed_loop import closed, matrices_of, real_modes
from platform_ctrl.analysis.certificates.makers import found_in_doubles, norm_certificate, stability_certificate
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, NotCertifiedError


@value
class Evidence:
    """What proves a claim about a loop that is known otherwise."""

    bound: float  # as of a `Certificate`
    X: FloatArray  # (n, n): as of a `Certificate`
    coordinates: FloatArray | None = None  # (n, n), optional: as of a `Certificate`


# States of plant and controller up to which proofs are made: of more they take minutes, of delays of long cycles hours.
MOST_STATES = 64

# By the kind of the claim and the label of its loop.
KnownProofs = Mapping[tuple[Claim, str], Evidence]


def evidence_of(certificates: Sequence[Certificate]) -> KnownProofs:
    """Return what proves the claims of certificates of one loop each, without the loops."""
    return {
        (one.claim, one.loops[0].label): Evidence(bound=one.bound, X=one.X, coordinates=one.coordinates)
        for one in certificates
    }


class _Claimed(NamedTuple):
    """A claim about a plant closed by the controller: its bound, if it is required, and a norm that is known."""

    claim: Claim
    system: StateArrays
    label: str
    gamma: float | None = None
    norm: float | None = None


@check_arguments
def plant_set_certificates(
    plants: PlantSet,
    controller: StateArrays,
    decay: FloatArray,
    margin: FloatArray,
    required: FloatArray,
    known: KnownProofs | None = None,
) -> tuple[tuple[Certificate, ...], tuple[str, ...]]:
    """Return what is proved of a loop u = K y, and a line for each claim without a proof.

    `decay` (N,), 1/s, and `margin` (N,) are measured with each plant: exactly for the worst one, and not below the true
    value for the others. No claim is made of an unstable loop. `required` (N,) is the disk margin required with each
    plant, 0 for none. Where the measured margin is larger, the required one is proved; with the nominal plant the
    measured one.

    The certificates say, in the order of the plants, that the loop with each plant decays at its own rate; then they
    bound the norm of (S − T)/2 at the torques and at the pick-offs: the larger of the two is 1/disk margin.

    Of a loop with more than `MOST_STATES` nothing is claimed.

    With `known` proofs nothing is searched: every claim has to be proved by what is known, for the plants and the
    controller given here, else a `NotCertifiedError` is raised.
    """
    for name, numbers in (("decay", decay), ("margin", margin), ("required", required)):
        if numbers.shape != (len(plants.labels),):
            raise ArgumentError(f"plant_set_certificates: {name} must be ({len(plants.labels)},), got {numbers.shape}")
    if plants.A.shape[-1] + len(controller.A) > MOST_STATES:
        return (), ()
    claims = _claims(plants, decay, margin, required)
    if known is not None:
        return tuple(_proved_by(known, one, controller) for one in claims), ()
    proved: list[Certificate] = []
    unproved: list[str] = []
    for one in claims:
        try:
            proved.append(_made(one, controller))
        except NotCertifiedError as error:
            unproved.append(str(error))
    return tuple(proved), tuple(unproved)


def _claims(plants: PlantSet, decay: FloatArray, margin: FloatArray, required: FloatArray) -> Iterator[_Claimed]:
    for k in np.flatnonzero(decay > 0.0):
        yield _Claimed("stability", plants.arrays.at(k), plants.labels[k])
    for k in np.flatnonzero((decay > 0.0) & ((required < margin) & (required > 0.0) | (np.arange(len(decay)) == 0))):
        # With the nominal plant the norm itself; with the others the required bound. Of these the norm is known, or,
        # where another plant is the worst, known from below.
        gamma = None if k == 0 else 1.0 / float(required[k])
        norm = None if k == 0 else 1.0 / float(margin[k])
        for system, where in zip(sensitivity_plants(plants.arrays.at(k)), ("torques", "pick-offs"), strict=True):
            yield _Claimed("norm", system, f"{plants.labels[k]}, (S − T)/2 at the {where}", gamma, norm)


def _made(one: _Claimed, controller: StateArrays) -> Certificate:
    A, B, C, D, dt = one.system
    if one.claim == "stability":
        return stability_certificate(A, dt, B=B, C=C, D=D, controller=controller, label=one.label)
    try:
        return norm_certificate(*one.system, one.gamma, controller=controller, norm=one.norm, label=one.label)
    except NotCertifiedError:
        if one.norm is None:
            raise
    return norm_certificate(*one.system, one.gamma, controller=controller, label=one.label)


def _proved_by(known: KnownProofs, one: _Claimed, controller: StateArrays) -> Certificate:
    evidence = known.get((one.claim, one.label))
    if evidence is None or (one.gamma is not None and evidence.bound != one.gamma):
        raise NotCertifiedError(f"plant_set_certificates: no proof of {one.claim} is known of {one.label}", known)
    loop = closed(one.system, controller, one.label)
    return proved(
        Certificate(
            claim=one.claim, bound=evidence.bound, loops=(loop,), X=evidence.X, coordinates=evidence.coordinates
        )
    )


@check_arguments
def margin_certificates(plant: StateArrays, controller: StateArrays) -> tuple[Certificate, Certificate, Certificate]:
    """Return the proofs that one loop is stable, and of the norms of (S − T)/2 at its torques and at its pick-offs.

    The plant leads from torques to angles, the controller is u = K y with the same sample period. A missing proof is a
    `NotCertifiedError`.
    """
    A, B, C, D, dt = plant
    torque, pickoff = sensitivity_plants(plant)
    return (
        stability_certificate(A, dt, B=B, C=C, D=D, controller=controller),
        norm_certificate(*torque, controller=controller, label="(S − T)/2 at the torques"),
        norm_certificate(*pickoff, controller=controller, label="(S − T)/2 at the pick-offs"),
    )


def sensitivity_plants(plant: StateArrays) -> tuple[StateArrays, StateArrays]:
    """Return a plant with inputs [w, u] and outputs [z, y] such that u = K y leaves z = (S − T)/2 w.

    First at the torques: z = u + w/2, where w adds to the torque; then at the pick-offs: z = y − w/2, where w adds to
    what they measure. (S − T)/2 = S − I/2, and nothing is rounded on the way.
    """
    A, B, C, D, dt = plant
    (p, m), n = D.shape, len(A)
    torque = StateArrays(
        A,
        np.hstack([B, B]),
        np.vstack([np.zeros((m, n)), C]),
        np.block([[0.5 * np.eye(m), np.eye(m)], [D, D]]),
        dt,
    )
    pickoff = StateArrays(
        A,
        np.hstack([np.zeros((n, p)), B]),
        np.vstack([C, C]),
        np.block([[0.5 * np.eye(p), D], [np.eye(p), D]]),
        dt,
    )
    return torque, pickoff


@check_arguments
@found_in_doubles
def region_certificate(A: ArrayLike, L: ArrayLike, M: ArrayLike, dt: float = 0.0, label: str = "") -> Certificate:
    """Return a proved certificate that every pole of A lies in the region {s : L + s M + s* M' < 0}.

    L (symmetric) and M are (k, k), s is in rad/s. Damping above cos θ: L = 0, M = [[sin θ, cos θ], [−cos θ, sin θ]].
    With a sample period `dt` > 0 the region is one of the w-plane, w = (2/dt) (z − 1)/(z + 1).

    X is the identity in the coordinates of the modes, which proves whatever is true of every pole alone (Chilali and
    Gahinet 1996); where poles are nearly multiple the modes do not show it.
    """
    where = "region_certificate"
    loop = closed(matrices_of(A, None, None, None, dt, where), None, label, where)
    try:
        L, M = np.array(L, dtype=np.float64), np.array(M, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(f"{where}: L and M are no matrices of real numbers") from None
    if not loop.finite:
        raise ArgumentError(f"{where}: the matrices must be finite and dt at least zero")
    try:
        T = real_modes(loop.rounded().A)
    except (ArgumentError, np.linalg.LinAlgError):
        T = np.eye(loop.order)
    certificate = Certificate(claim="region", bound=0.0, loops=(loop,), X=np.eye(loop.order), coordinates=T, L=L, M=M)
    found = certificate.verify()
    if not found.proved:
        raise NotCertifiedError(
            f"{where}: no proof that {found.statement}: {found.reason}; try a larger region", certificate
        )
    return certificate
