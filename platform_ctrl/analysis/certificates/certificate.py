"""A certificate and its proof: what is claimed of a closed loop, and the matrix that anybody can check it with.

With V(x) = x'Xx, X = X' > 0, along every solution of the closed loop x' = Ax + Bw, z = Cx + Dw (Lyapunov; Kalman,
Yakubovich, Popov; Boyd, El Ghaoui, Feron and Balakrishnan, Linear Matrix Inequalities in System and Control Theory,
SIAM 1994):

- stability with decay rate a:  V' < −2a V                  discrete: V(k+1) < exp(−2a dt) V(k)
- H-infinity norm below g:      V' < g² w'w − z'z           discrete: V(k+1) − V(k) < g² w'w − z'z
- H2 norm below h:              V' < −z'z for w = 0, and trace(B'XB + D'D) < h²
- poles in a region:            L ⊗ X + M ⊗ XA + M' ⊗ A'X < 0, the region {s: L + sM + s*M' < 0} (Chilali and
                                Gahinet, IEEE Trans. Automatic Control 41, 1996); discrete: A and s of the w-plane,
                                w = (2/dt) (z − 1)/(z + 1)

Each is a matrix inequality in X with the closed loop's matrices as data. For a fixed X it only asks whether two
symmetric matrices are positive definite, which balls decide for good.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import Literal

import flint
import numpy as np

from platform_ctrl.analysis.certificates.closed_loop import BallSystem, ClosedLoop, enclosed_by, is_matrix
from platform_ctrl.analysis.certificates.intervals import (
    Ball,
    Balls,
    Enclosure,
    balls,
    blocks,
    positive_definite,
    rounded,
)
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.text import at_least, at_most
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError, NotCertifiedError

Claim = Literal["stability", "norm", "h2", "region"]

# Bits at which a proof is tried: first those of doubles, then of balls; each doubling takes about twice the time.
_OF_DOUBLES, _OF_BALLS = 53, 128
_DOUBLINGS = 3

_LARGEST = int(np.finfo(np.float64).max)

_INEQUALITY = {
    "stability": ("−(A'X + XA) − 2 bound X", "exp(−2 bound dt) X − A'XA"),
    "norm": ("the bounded-real matrix", "the bounded-real matrix"),
    "h2": ("−(A'X + XA) − C'C", "X − A'XA − C'C"),
    "region": ("the region's matrix", "the region's matrix"),
}


@value
class Verification:
    """What became of a proof.

    Attributes
    ----------
    proved
        Whether the claim is proved for the given matrices.
    statement
        The claim in words.
    reason
        What was shown, or what failed and where.
    margin
        Distance from failing, relative: a lower bound of the smallest eigenvalue of the matrices that have to be
        positive definite, each scaled to a unit diagonal; 0 if not proved.
    precision
        Bits that it took.
    """

    proved: bool
    statement: str
    reason: str
    margin: float
    precision: int


@value
class Certificate:
    """A claim about one closed loop or about several at once, and the matrix X that proves it.

    Attributes
    ----------
    claim
        ``"stability"``, ``"norm"`` (H-infinity), ``"h2"`` or ``"region"``.
    bound
        Decay rate, 1/s, that no solution falls short of (0: stability alone); the norm that is not reached, in units of
        z per w; of no meaning for a region.
    loops
        The closed loops, all with the same X. With several the claim holds for every system whose [A B; C D] lies in
        the convex hull of theirs, and stability and norm however it moves there in time. A sampled region then has to
        have L + (2/dt) (M + M') > 0, without which what lies between is not covered.
    X : (n, n)
        Symmetric. The function that decreases is x'Xx, x the states of plant and controller in their units.
    coordinates : (n, n), optional
        T, in the units of these states: then the function is (Tx)'X(Tx).
    L, M : (k, k), optional
        Of a region {s : L + s M + s* M' < 0} with s in rad/s; L symmetric.

    References
    ----------
    S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and Control Theory, 1994.

    M. Chilali, P. Gahinet, IEEE Trans. Automatic Control 41, 1996.

    See docs/certificates.md.
    """

    claim: Claim
    bound: float
    loops: tuple[ClosedLoop, ...]
    X: FloatArray
    coordinates: FloatArray | None = None
    L: FloatArray | None = None
    M: FloatArray | None = None
    _shown: dict[int, Verification] = field(init=False, repr=False, default_factory=dict)

    @property
    def statement(self) -> str:
        """The claim in words."""
        order, many = len(self.X), len(self.loops)
        if self.claim == "stability":
            rate = at_least(self.bound, 6)
            text = f"stable, every solution decays at {rate} 1/s or faster" if self.bound else "stable"
        elif self.claim == "region":
            text = "such that every pole lies in the region"
        else:
            bound = at_most(self.bound, 9)
            text = f"stable with {'H-infinity' if self.claim == 'norm' else 'H2'} norm below {bound}"
        label = next((loop.label for loop in self.loops if many == 1 and loop.label), "")
        where = f"every system between {many} vertices" if many > 1 else "the closed loop"
        return f"{where}{f' ({label})' if label else ''} of order {order} is {text}"

    @check_arguments
    def verify(self, precision: int = _OF_DOUBLES) -> Verification:
        """Prove the claim in ball arithmetic, or say what fails; a false or a senseless certificate never raises.

        Done once for each precision: a certificate does not change.

        Parameters
        ----------
        precision
            Bits to begin with. 53 are those of doubles, with bounds of their rounding, and 128 are next; more bits are
            doubled up to three times where the balls are too wide to tell.

        Returns
        -------
        Verification
            Whether it is proved, by what margin, and if not what fails.

        Raises
        ------
        ArgumentError
            `precision` is not a whole number of at least 2.
        """
        if not isinstance(precision, int) or precision < 2:
            raise ArgumentError(f"Certificate.verify: precision must be a number of bits, 2 or more, got {precision!r}")
        if precision not in self._shown:
            self._shown[precision] = self._verified(precision)
        return self._shown[precision]

    def _verified(self, precision: int) -> Verification:
        wrong, bits = self._senseless(), precision
        if wrong:
            statement = "the certificate makes sense"
            return Verification(proved=False, statement=statement, reason=wrong, margin=0.0, precision=bits)
        tried = [precision << doubled for doubled in range(_DOUBLINGS + 1)]
        if precision == _OF_DOUBLES:
            tried = [precision, *(_OF_BALLS << doubled for doubled in range(_DOUBLINGS + 1))]
        for bits in tried:
            with flint.ctx.workprec(bits), np.errstate(all="ignore"):
                shown, wrong, margin = self._tried(rounded if bits == _OF_DOUBLES else balls)
            if shown:
                reason = f"X and {self._inequality} are positive definite ({bits} bits)"
                return Verification(proved=True, statement=self.statement, reason=reason, margin=margin, precision=bits)
            if not wrong.startswith("undecided"):
                break
        return Verification(proved=False, statement=self.statement, reason=wrong, margin=0.0, precision=bits)

    @property
    def _inequality(self) -> str:
        return _INEQUALITY[self.claim][int(self.loops[0].dt > 0)]

    def _senseless(self) -> str:
        """Say what is wrong before any arithmetic, or nothing."""
        if not isinstance(self.claim, str) or self.claim not in _INEQUALITY:
            return f"claim must be one of {', '.join(_INEQUALITY)}, got {self.claim!r}"
        loops = self.loops
        if not isinstance(loops, tuple) or not loops or not all(isinstance(loop, ClosedLoop) for loop in loops):
            return "loops must be a tuple of closed loops, at least one"
        wrong = next((loop.mistake for loop in loops if loop.mistake), "")
        if wrong:
            return wrong
        n, dt = loops[0].order, loops[0].dt
        if any(loop.order != n or loop.dt != dt for loop in loops):
            return "the closed loops have different orders or sample periods"
        if len({(loop.B.shape, loop.C.shape) for loop in loops}) > 1 and self.claim in ("norm", "h2"):
            return "the closed loops have different numbers of inputs or outputs"
        return self._senseless_figures(n)

    def _senseless_figures(self, n: int) -> str:
        if not isinstance(self.bound, float | int) or not 0 <= self.bound <= _LARGEST:
            return f"bound must be a positive number, got {self.bound!r}"
        if self.bound == 0 and self.claim in ("norm", "h2"):
            return f"bound must be a positive number, got {self.bound!r}"
        if self.claim == "region" and not _is_region(self.L, self.M):
            return "L and M are no finite square matrices of one size, L symmetric"
        for name, matrix in (("X", self.X), ("the matrix of coordinates", self.coordinates)):
            if matrix is None and name != "X":
                continue
            if not is_matrix(matrix):
                return f"{name} is no matrix of doubles"
            if matrix.shape != (n, n):
                return f"{name} must be {(n, n)}, got {matrix.shape}"
            if not np.all(np.isfinite(matrix)):
                return "a matrix is not finite"
        return "" if np.array_equal(self.X, self.X.T) else "X is not symmetric"

    def _tried(self, enclosure: Enclosure) -> tuple[bool, str, float]:
        """Return whether all is shown, else what fails ("undecided ..." if more bits may help), and the margin."""
        margin = 1.0
        try:
            for matrix, name in self._matrices(enclosure):
                definite, found = positive_definite(matrix)
                if definite is None:
                    return False, f"undecided: {name} cannot be distinguished from a singular matrix", 0.0
                if not definite:
                    return False, f"{name} is not positive definite", 0.0
                margin = min(margin, found)
        except ZeroDivisionError:
            return False, "undecided: the loop is not well posed, or the coordinates are singular", 0.0
        except _Refuted as refuted:
            return False, str(refuted), 0.0
        return True, "", margin

    def _matrices(self, enclosure: Enclosure) -> Iterator[tuple[Balls, str]]:
        """Yield every matrix that has to be positive definite, with its name."""
        X, dt = enclosure(self.X), self.loops[0].dt
        yield X, "X"
        region = None if self.L is None or self.M is None else (enclosure(self.L), enclosure(self.M))
        if self.claim == "region" and len(self.loops) > 1 and dt > 0 and region is not None:
            # s of a vertex is no linear function of A: without this the inequality need not hold between them.
            L, M = region
            yield L + 2 / flint.arb(dt) * (M + M.transpose()), "L + (2/dt) (M + M') for what lies between vertices"
        coordinates = None if self.coordinates is None else enclosure(self.coordinates)
        inverse = None if coordinates is None else coordinates.inv()
        for number, loop in enumerate(self.loops, 1):
            system = enclosed_by(enclosure, loop)
            if coordinates is not None:
                moved = coordinates * system.A * inverse
                system = BallSystem(moved, coordinates * system.B, system.C * inverse, system.D)
            label = f", {loop.label}" if loop.label else f", loop {number}" if len(self.loops) > 1 else ""
            if self.L is not None and self.M is not None and self.claim == "region":
                matrix = _region(system, X, self.L, self.M, dt, enclosure)
            else:
                matrix = inequality(self.claim, system, X, self.bound, dt, enclosure)
            yield matrix, f"{self._inequality}{label}"
            if self.claim == "h2":
                yield _energy_left(system, X, self.bound, dt), f"bound² − trace(B'XB + D'D){label}"


class _Refuted(Exception):
    """The claim is false for a reason other than a matrix."""


def inequality(
    claim: Claim, system: BallSystem, X: Balls, bound: float, dt: float, enclosure: Enclosure = balls
) -> Balls:
    """Return the matrix that has to be positive definite besides X, from balls made by `enclosure`."""
    A, B, C, D = system
    if claim == "stability":
        rate = flint.arb(bound)
        if dt > 0:
            return (-2 * rate * flint.arb(dt)).exp() * X - A.transpose() * X * A
        return -1 * (A.transpose() * X + X * A) - 2 * rate * X
    less = A.transpose() * X * A - X if dt > 0 else A.transpose() * X + X * A
    rest = -1 * (less + C.transpose() * C)
    if claim == "h2":
        return rest
    gamma = flint.arb(bound)
    corner = gamma * gamma * enclosure(np.eye(D.ncols())) - D.transpose() * D
    if dt > 0:
        cross = -1 * (A.transpose() * X * B + C.transpose() * D)
        corner = corner - B.transpose() * X * B
    else:
        cross = -1 * (X * B + C.transpose() * D)
    return blocks([[rest, cross], [cross.transpose(), corner]])


def _is_region(L: FloatArray | None, M: FloatArray | None) -> bool:
    if L is None or M is None or not is_matrix(L) or not is_matrix(M) or not L.size:
        return False
    if L.shape != (len(L), len(L)) or M.shape != L.shape:
        return False
    return bool(np.all(np.isfinite(L)) and np.all(np.isfinite(M)) and np.array_equal(L, L.T))


def _region(system: BallSystem, X: Balls, L: FloatArray, M: FloatArray, dt: float, enclosure: Enclosure) -> Balls:
    """Return −(L ⊗ E'XE + M ⊗ E'XF + M' ⊗ F'XE): s E x = F x, F E^-1 is A, or A in the w-plane."""
    E = enclosure(np.eye(X.nrows()))
    F = system.A
    if dt > 0:
        E, F = system.A + E, (2 / flint.arb(dt)) * (system.A - E)
    square, turned = E.transpose() * X * E, E.transpose() * X * F
    back = turned.transpose()
    k = range(len(L))
    ball = flint.arb
    return blocks(
        [[-1 * (ball(L[i, j]) * square + ball(M[i, j]) * turned + ball(M[j, i]) * back) for j in k] for i in k]
    )


def _energy_left(system: BallSystem, X: Balls, bound: float, dt: float) -> Balls:
    """Return bound² less the squared H2 norm that X allows, 1 x 1."""
    energy: Ball = (system.B.transpose() * X * system.B).trace() if system.B.ncols() else flint.arb(0)
    direct = (system.D.transpose() * system.D).trace() if system.D.ncols() else flint.arb(0)
    if dt > 0:
        energy = energy + direct
    elif not direct.is_zero():
        raise _Refuted("D is not exactly zero: a continuous system with a direct term has no H2 norm")
    return flint.arb_mat([[flint.arb(bound) ** 2 - energy]])


@check_arguments
def proved(certificate: Certificate, problem: object = None) -> Certificate:
    """Return `certificate` if it verifies, else raise `NotCertifiedError` with `problem` attached."""
    found = certificate.verify()
    if not found.proved:
        raise NotCertifiedError(
            f"certificate: not proved that {found.statement}: {found.reason}; try a larger bound, or another X",
            problem if problem is not None else certificate,
        )
    return certificate
