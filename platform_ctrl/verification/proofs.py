"""Proofs in interval arithmetic: stability, disk margin and norm of a sampled loop, of the given matrices exactly.

A double is a rational number, so matrices of doubles enter without rounding, and what balls (midpoint and radius, Arb
by python-flint) compute from them encloses the exact value. A claim that balls are too wide to decide is tried with
more bits. Three tests, each on the coefficients of a characteristic polynomial:

- stability: the recursion of Schur and Cohn (Jury, Theory and Application of the z-Transform Method, 1964);
- norm below g: in the w-plane, where stability and norm are the same, g²I − D'D is positive definite and the
  Hamiltonian matrix of g has no eigenvalue on the imaginary axis (Boyd, Balakrishnan and Kabamba, Mathematics of
  Control, Signals and Systems 2, 1989);
- no positive root of a polynomial: Descartes' rule of signs on parts of the axis (Collins and Akritas 1976).

A disk margin above a: the norms of (S − T)/2 = S − I/2 at the torques and at the pick-offs are below 1/a.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, Literal

import numpy as np

from platform_ctrl.analysis.interconnection import interconnected_by_sample
from platform_ctrl.analysis.periodic import lifted
from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.common.text import at_least
from platform_ctrl.common.values import FloatArray, replaced, value
from platform_ctrl.design.loop import Design
from platform_ctrl.design.sections import side_by_side
from platform_ctrl.errors import InputError
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.job.judging import PROVED, STABLE, CheckResult, Stage
from platform_ctrl.verification.coupled import CoupledCheck

# Matrices and polynomials of balls: python-flint has no types.
Balls = Any

# Bits at which a claim is tried, one after the other. Coefficients lose a few bits for each state.
_BITS = (256, 512, 1024, 2048)
# States of plant and controller, and samples of a cycle, up to which proofs are made: of more they take minutes.
_MOST_STATES, _MOST_SAMPLES = 64, 32
# Share of the measured decay rate and disk margin that is claimed: both are computed with rounding.
_OF_DECAY, _OF_MARGIN = 0.99, 1.0 - 1e-5
# Halvings of the frequency axis down to which a polynomial is tested.
_HALVINGS = 200


def flint() -> ModuleType:
    """Return python-flint, which the extra `proofs` installs."""
    try:
        import flint as module
    except ModuleNotFoundError:
        raise InputError(
            "--prove: proofs need python-flint, which is not installed: pip install 'platform_ctrl[proofs]'"
        ) from None
    return module


@value
class Claim:
    """A property of one closed loop, and whether it is proved for exactly its matrices.

    Attributes
    ----------
    plant
        Label of the plant, or "all loops closed".
    kind
        ``"stability"``: every solution decays at `bound`, 1/s, or faster; ``"disk margin"``: it exceeds `bound`.
    bits
        Precision that decided; 0 where none did.
    """

    plant: str
    kind: Literal["stability", "disk margin"]
    bound: float
    bits: int

    @property
    def proved(self) -> bool:
        """Whether the claim is proved."""
        return self.bits > 0

    def __str__(self) -> str:
        bound = at_least(self.bound, 6)
        words = f"decays at {bound} 1/s or faster" if self.kind == "stability" else f"has a disk margin above {bound}"
        return f"the loop with {self.plant} {words}"


@value
class Proofs:
    """Claims about a design, or about the coupled system; `left_out` says why there are none."""

    claims: tuple[Claim, ...] = ()
    left_out: str = ""

    @property
    def proved(self) -> int:
        """Number of claims that are proved."""
        return sum(one.proved for one in self.claims)


def with_proofs(
    results: Sequence[CheckResult], proofs: Proofs | None, subject: str, design: str = ""
) -> list[CheckResult]:
    """Return results and, where something is claimed, the requirement that all of it is proved.

    Where proofs are left out, the result on stability says why.
    """
    if proofs is None:
        return [*results]
    if not proofs.claims:
        words = f"; no proof in interval arithmetic: {proofs.left_out}" if proofs.left_out else ""
        return [
            replaced(one, {"evidence": one.evidence + words}) if one.name == STABLE.name else one for one in results
        ]
    count = len(proofs.claims)
    words = f"{count} claim{'s' * (count > 1)} in interval arithmetic, {max(one.bits for one in proofs.claims)} bits"
    words = next((f"not proved: {one}" for one in proofs.claims if not one.proved), words)
    stage: Stage = "decoupled" if design else "coupled"
    share = proofs.proved / count
    judged = PROVED.judge(share, subject=subject, design=design, stage=stage, evidence=words, method="proved")
    return [*results, judged]


def proofs_of(spec: LoopSpec, design: Design) -> Proofs:
    """Return the proofs of a design: with each plant its decay rate, and the disk margin that is required of it.

    With the nominal plant the disk margin itself is claimed. Nothing is claimed of an unstable loop, nor of one in
    which nothing holds an angle: its poles at z = 1 are no numbers that intervals decide.
    """
    plants, measures = design.plants, design.measures
    if plants is None or measures is None or measures.free_angles:
        return Proofs()
    K = System.of(design.own_controller, "controller")
    if left_out := _too_many(plants.A.shape[-1] + len(K.A)):
        return Proofs(left_out=left_out)
    required = np.zeros(len(plants.labels))
    for one in spec.requests:
        if one.kind == "disk margin" and one.hard:
            np.maximum.at(required, measures.of(one.over), one.limit)
    claims: list[Claim] = []
    for k in np.flatnonzero(measures.decay > 0.0):
        P, label, measured = plants.arrays.at(k), plants.labels[k], _OF_MARGIN * measures.disk_margin[k]
        claims.append(_stability(P, K, label, measures.decay[k]))
        margin = measured if k == 0 else required[k]
        if 0.0 < margin < measures.disk_margin[k]:
            claims.append(_disk_margin(P, K, label, float(margin)))
    return Proofs(claims=tuple(claims))


def coupled_proofs(check: CoupledCheck, controllers: Sequence[StateSpace]) -> Proofs:
    """Return the proof that the coupled system is stable with all `controllers`; empty where it is not stable."""
    if not check.stable or set(check.free_angles) & set(check.plant.state_labels):
        return Proofs()
    samples = round(check.period / check.plant.dt)
    states = check.plant.nstates + sum(K.nstates for K in controllers)
    if left_out := _too_many(states) or ("" if samples <= _MOST_SAMPLES else f"a cycle of {samples} samples"):
        return Proofs(left_out=left_out)
    if check.controller is not None:
        loop = _side_by_side(check.plant, controllers)
    else:
        # All samples after which the order of the controllers repeats are one step.
        P = System.of(check.plant, "coupled plant")
        by_sample = interconnected_by_sample(controllers, check.plant.output_labels, check.plant.input_labels, P.dt)
        loop = lifted([P] * len(by_sample)), lifted(by_sample)
    decay = -float(np.log(np.abs(check.poles).max(initial=1e-300))) / check.period
    return Proofs(claims=(_stability(*loop, "all controllers", decay),))


def _too_many(states: int) -> str:
    return f"{states} states, more than {_MOST_STATES}" if states > _MOST_STATES else ""


def _stability(P: System, K: System, label: str, decay: float) -> Claim:
    rate = _OF_DECAY * float(decay)
    bits = _decided(lambda: _decays(_loop(P, K)[0], rate * P.dt))
    return Claim(plant=label, kind="stability", bound=rate, bits=bits)


def _disk_margin(P: System, K: System, label: str, margin: float) -> Claim:
    bits = _decided(lambda: all(_norm_below(loop, 1 / flint().arb(margin)) for loop in (_loop(P, K), _loop(K, P))))
    return Claim(plant=label, kind="disk margin", bound=margin, bits=bits)


def _decided(claim: Callable[[], bool]) -> int:
    """Return the bits with which a claim is proved; 0 where none suffice."""
    for bits in _BITS:
        with flint().ctx.workprec(bits):
            try:
                if claim():
                    return bits
            except ZeroDivisionError:  # a matrix that the balls cannot tell from a singular one
                continue
    return 0


def _balls(array: FloatArray) -> Balls:
    """Return a matrix of doubles as balls of radius zero."""
    return flint().arb_mat(*array.shape, array.ravel().tolist())


def _blocks(rows: Sequence[Sequence[Balls]]) -> Balls:
    out = [x for row in rows for i in range(row[0].nrows()) for part in row for x in part.tolist()[i]]
    return flint().arb_mat(sum(row[0].nrows() for row in rows), sum(part.ncols() for part in rows[0]), out)


def _loop(P: System, K: System) -> tuple[Balls, Balls, Balls, Balls]:
    """Return A, B, C, D of S − I/2 at the input of P with u = K y: from w, added to u, to u + w/2.

    With plant and controller exchanged it is that at the output of P. Nothing is rounded.
    """
    A, B, C, D = map(_balls, P[:4])
    A_K, B_K, C_K, D_K = map(_balls, K[:4])
    eye = _balls(np.eye(D.ncols()))
    E = (eye - D_K * D).inv()
    F = _blocks([[E * D_K * C, E * C_K]])
    into = _blocks([[B], [B_K * D]])
    zeros = flint().arb_mat
    alone = _blocks([[A, zeros(A.nrows(), A_K.nrows())], [B_K * C, A_K]])
    return alone + into * F, into * E, F, E - flint().arb(0.5) * eye


def _decays(A: Balls, rate: float) -> bool:
    """Return whether all eigenvalues of A lie within exp(−rate)."""
    n, step = A.nrows(), flint().arb(rate).exp()
    p = [c * step ** (n - k) for k, c in enumerate(A.charpoly().coeffs())]
    while len(p) > 1:
        # z^k p(1/z) in p's place removes the constant term; the ratio is the product of the zeros.
        ratio = p[0] / p[-1]
        if not abs(ratio) < 1:
            return False
        p = [a - ratio * b for a, b in zip(p[1:], p[-2::-1], strict=True)]
    return True


def _norm_below(loop: tuple[Balls, Balls, Balls, Balls], level: Balls) -> bool:
    """Return whether the H-infinity norm of a sampled system lies below a level; False where that is undecided."""
    A, B, C, D = loop
    if not _decays(A, 0.0):
        return False
    eye = _balls(np.eye(A.nrows()))
    inverse = (A + eye).inv()
    # B has the factors sqrt(2) of B and C.
    A, B, C, D = inverse * (A - eye), 2 * inverse * B, C * inverse, D - C * inverse * B
    R = level * level * _balls(np.eye(D.ncols())) - D.transpose() * D
    if not all(c > 0 for c in (-1 * R).charpoly().coeffs()):
        return False
    gain = R.inv()
    F = A + B * gain * D.transpose() * C
    Q = C.transpose() * C + C.transpose() * D * gain * D.transpose() * C
    coefficients = _blocks([[F, B * gain * B.transpose()], [-1 * Q, -1 * F.transpose()]]).charpoly().coeffs()
    # An even polynomial: in x of s = j sqrt(x).
    return _no_positive_root([-c if k % 2 else c for k, c in enumerate(coefficients[::2])])


def _no_positive_root(p: list[Balls]) -> bool:
    """Return whether a polynomial with these coefficients has no root in [0, ∞); False where that is undecided."""
    parts = [p]
    for _ in range(_HALVINGS):
        if not parts:
            return True
        p = parts.pop()
        if all(c > 0 for c in p) or all(c < 0 for c in p):
            continue
        if not (abs(p[0]) > 0 and abs(p[-1]) > 0):
            return False
        # Divided at the geometric mean of the roots, moved to 1: p(x + 1) is the upper part, that of 1/x the lower one.
        scale = flint().arb(2) ** round(float((abs(p[0]) / abs(p[-1])).log()) / len(p[1:]) / float(np.log(2.0)))
        poly = flint().arb_poly
        p = [c * scale**k for k, c in enumerate(p)]
        parts += [poly(half)(poly([1, 1])).coeffs() for half in (p, p[::-1])]
    return False


def _side_by_side(plant: StateSpace, controllers: Sequence[StateSpace]) -> tuple[System, System]:
    """Return plant and controllers such that closing them rounds nothing.

    Controllers are side by side. Signals that one takes from an earlier one are fed through the plant, whose
    measurement then contains that control itself.
    """
    P = System.of(plant, "coupled plant")
    made = [name for K in controllers for name in K.output_labels]
    taken = [name for K in controllers for name in K.input_labels]
    # Entries 0 and 1 alone: products with them round nothing.
    into, out = _same(plant.input_labels, made), _same(taken, plant.output_labels)
    earlier = _same(["" if name in plant.output_labels else name for name in taken], made)
    together = side_by_side(*(System.of(K, "controller") for K in controllers))
    return System(P.A, P.B @ into, out @ P.C, out @ P.D @ into + earlier, P.dt), together


def _same(rows: Sequence[str], columns: Sequence[str]) -> FloatArray:
    return np.array([float(row == column) for row in rows for column in columns]).reshape(len(rows), len(columns))
