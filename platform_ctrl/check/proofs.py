"""What every certificate proves, held against what the designs claim."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.certificates import Certificate, Verification, stability_certificate
from platform_ctrl.check.coupled import CoupledCheck
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.errors import NotCertifiedError
from platform_ctrl.frozen import value
from platform_ctrl.requirements import CheckResult, Requirement, Stage

if TYPE_CHECKING:
    import control

PROVED = Requirement(name="claims proved", limit=1.0, unit="", sense="at least")


@value
class Proofs:
    """What became of the certificates of one design, or of the coupled system.

    Attributes
    ----------
    certificates, verifications
        One to one.
    unproved
        A line for each claim that has no certificate.
    """

    certificates: tuple[Certificate, ...]
    verifications: tuple[Verification, ...]
    unproved: tuple[str, ...]

    @property
    def proved(self) -> int:
        """Number of claims proved."""
        return sum(one.proved for one in self.verifications)

    @property
    def of(self) -> int:
        """Number of claims."""
        return len(self.verifications) + len(self.unproved)

    def judged(self, subject: str, design: str, stage: Stage) -> tuple[CheckResult, ...]:
        """Return the share of the claims that is proved as a requirement; nothing where nothing is claimed."""
        if self.of == 0:
            return ()
        failed = [f"{one.statement}: {one.reason}" for one in self.verifications if not one.proved] + [*self.unproved]
        bits = max((one.precision for one in self.verifications), default=0)
        many = "" if self.of == 1 else "s"
        evidence = failed[0] if failed else f"{self.of} certificate{many} in interval arithmetic, {bits} bits"
        return (
            PROVED.judge(
                self.proved / self.of,
                subject=subject,
                design=design,
                stage=stage,
                evidence=evidence,
                method="proved",
            ),
        )


def proofs_of(design: LoopDesign) -> Proofs:
    """Return what becomes of the certificates that `design` carries; those of other loops prove nothing of it."""
    own = [one for one in design.certificates if _is_of(one, design)]
    others = [f"{one.statement}: of another loop" for one in design.certificates if not _is_of(one, design)]
    return _verified(own, [*design.unproved, *others])


def _is_of(certificate: Certificate, design: LoopDesign) -> bool:
    """Return whether every loop of `certificate` is a plant of `design` with its controller, to the last bit."""
    K = state_arrays(design.controller, "controller")[:4]
    return design.plants is not None and all(
        loop.controller is not None
        and all(np.array_equal(*pair) for pair in zip(loop.controller, K, strict=True))
        and loop.dt == design.plants.period
        and any(np.array_equal(loop.A, A) for A in design.plants.A)
        for loop in certificate.loops
    )


def coupled_proofs(check: CoupledCheck, controllers: Sequence[control.StateSpace]) -> Proofs:
    """Return the proof that the coupled system is stable with all `controllers`; empty where it is not stable."""
    if not check.stable:
        return _verified((), ())
    plant, K = _side_by_side(check.plant, controllers)
    try:
        found = stability_certificate(
            plant.A, plant.dt, B=plant.B, C=plant.C, D=plant.D, controller=K, label="all loops closed"
        )
    except NotCertifiedError as error:
        return _verified((), (str(error),))
    return _verified((found,), ())


def _verified(certificates: Sequence[Certificate], unproved: Sequence[str]) -> Proofs:
    return Proofs(
        certificates=tuple(certificates),
        verifications=tuple(one.verify() for one in certificates),
        unproved=tuple(unproved),
    )


def _side_by_side(
    plant: control.StateSpace, controllers: Sequence[control.StateSpace]
) -> tuple[StateArrays, StateArrays]:
    """Return plant and controllers such that closing them rounds nothing.

    Controllers stand side by side. What one takes from an earlier one is fed through the plant, whose measurement
    then contains that control itself.
    """
    from scipy.linalg import block_diag

    P = state_arrays(plant, "coupled plant")
    parts = [state_arrays(K, "controller") for K in controllers]
    made = [name for K in controllers for name in K.output_labels]
    taken = [name for K in controllers for name in K.input_labels]
    inputs, outputs = list(plant.input_labels), list(plant.output_labels)
    B = np.zeros((len(P.A), len(made)))
    C = np.zeros((len(taken), len(P.A)))
    D = np.zeros((len(taken), len(made)))
    acting = [j for j, name in enumerate(made) if name in inputs]
    columns = [inputs.index(made[j]) for j in acting]
    B[:, acting] = P.B[:, columns]
    for i, name in enumerate(taken):
        if name in outputs:
            row = outputs.index(name)
            C[i], D[i, acting] = P.C[row], P.D[row, columns]
        else:
            D[i, made.index(name)] = 1.0
    A_K, B_K, C_K, D_K = (np.asarray(block_diag(*(part[i] for part in parts)), dtype=np.float64) for i in range(4))
    return StateArrays(P.A, B, C, D, P.dt), StateArrays(A_K, B_K, C_K, D_K, P.dt)
