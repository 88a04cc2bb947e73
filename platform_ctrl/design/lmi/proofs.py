"""What is proved in interval arithmetic: loops as certificates have them, and a design's claims one by one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import state_arrays
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.certificates import (
    Certificate,
    h2_certificate,
    norm_certificate,
    region_certificate,
    stability_certificate,
)
from platform_ctrl.certificates.closed_loop import ClosedLoop
from platform_ctrl.design.lmi.regions import region
from platform_ctrl.design.lmi.tasks import CONTROLLER, NORMS
from platform_ctrl.design.partition import Partition, Realisation, whole
from platform_ctrl.requirements import LoopRequirement

if TYPE_CHECKING:
    from control import StateSpace


def claimed_loop(plant: Partition, K: Realisation, label: str) -> ClosedLoop:
    """Return a plant and u = K y as a certificate holds them."""
    one = whole(plant)
    return ClosedLoop(A=one.A, B=one.B, C=one.C, D=one.D, A_K=K.A, B_K=K.B, C_K=K.C, D_K=K.D, label=label)


def proofs(
    requirements: Sequence[LoopRequirement], closed_loop: StateSpace, controller: StateSpace
) -> tuple[Certificate, ...]:
    """Return stability and a certificate for each requirement: norms just above what they are, regions as asked.

    Raises
    ------
    NotCertifiedError
        A claim was not proved; the message says which.
    """
    loop, K = (state_arrays(system, "proofs") for system in (closed_loop, controller))
    out = [stability_certificate(loop.A, loop.dt)]
    for asked in requirements:
        if asked.kind in NORMS:
            part = (asked.channel or Channel()).of(loop, closed_loop.input_labels, closed_loop.output_labels)
            prove = h2_certificate if asked.kind == "H2 norm" else norm_certificate
            out.append(prove(*part[:4], part.dt, label=asked.name))
        elif asked.kind == CONTROLLER:
            L, M = -asked.limit * np.eye(2), np.array([[0.0, 1.0], [0.0, 0.0]])
            out.append(region_certificate(K.A, L, M, K.dt, label=asked.name))
        else:
            wanted = region(asked, loop.dt)
            out.append(region_certificate(loop.A, wanted.L, wanted.M, loop.dt, label=asked.name))
    return tuple(out)
