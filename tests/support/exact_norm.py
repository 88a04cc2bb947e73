"""Whether a system's gain exceeds a level anywhere on the frequency axis, in exact rational arithmetic.

An oracle that shares nothing with `analysis`: the entries of A, B, C, D are taken as the rational numbers that they
are, the Hamiltonian matrix of the level (Boyd, Balakrishnan and Kabamba, Math. Control Signals Systems 2, 1989) is
formed without rounding, and FLINT isolates the roots of its characteristic polynomial in s^2, so "on the
axis" is decided and not judged by a tolerance. Sampled systems go through the bilinear map, exact as well.
"""

from __future__ import annotations

from itertools import pairwise

import control
import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly


def gain_exceeds(system: control.StateSpace, level: float) -> bool:
    """Whether the largest singular value exceeds `level` somewhere; no poles on the axis, gain at its end included."""
    A, B, C, D = (_exact(item) for item in (system.A, system.B, system.C, system.D))
    if system.dt:
        A, B, C, D = _continuous(A, B, C, D)
    g = _rational(level)
    n, m, p = A.nrows(), B.ncols(), C.nrows()
    R = _eye(m, g * g) - D.transpose() * D
    if not _positive(R):
        return True
    if n == 0:
        return False
    inverse = R.inv()
    F = A + B * inverse * D.transpose() * C
    S = _eye(p, fmpq(1)) + D * inverse * D.transpose()
    H = _blocks(F, B * inverse * B.transpose(), -(C.transpose() * S * C), -F.transpose())
    coefficients = H.charpoly().coeffs()
    assert all(c == 0 for c in coefficients[1::2])
    return _has_root_up_to_zero(fmpq_poly(coefficients[0::2]))


def _has_root_up_to_zero(polynomial: fmpq_poly) -> bool:
    """Whether a polynomial has a real root <= 0 (Sturm)."""
    if polynomial[0] == 0:
        return True
    chain = [polynomial, polynomial.derivative()]
    while chain[-1].degree() > 0:
        _, rest = divmod(chain[-2], chain[-1])
        if rest == 0:
            break
        # Only signs count: a positive factor keeps the numbers short.
        chain.append(-rest * fmpq(rest.denom(), _content(rest)))
    at_zero = [_sign(q[0]) for q in chain]
    at_minus_infinity = [_sign(q[q.degree()]) * (-1) ** q.degree() for q in chain]
    return _changes(at_minus_infinity) - _changes(at_zero) > 0


def _content(polynomial: fmpq_poly) -> int:
    content = 0
    for number in polynomial.numer().coeffs():
        content = number.gcd(content)
    return content


def _changes(signs: list[int]) -> int:
    kept = [sign for sign in signs if sign]
    return sum(a != b for a, b in pairwise(kept))


def _sign(number: fmpq) -> int:
    return (number > 0) - (number < 0)


def _rational(number: float) -> fmpq:
    return fmpq(*float(number).as_integer_ratio())


def _exact(array: np.ndarray) -> fmpq_mat:
    rows, columns = np.shape(array)
    return fmpq_mat(rows, columns, [_rational(x) for x in np.asarray(array).ravel()])


def _eye(n: int, size: fmpq) -> fmpq_mat:
    return fmpq_mat(n, n, [size if i == j else 0 for i in range(n) for j in range(n)])


def _blocks(a: fmpq_mat, b: fmpq_mat, c: fmpq_mat, d: fmpq_mat) -> fmpq_mat:
    n = a.nrows()
    rows = [[one[i, j] for one in pair for j in range(n)] for pair in ((a, b), (c, d)) for i in range(n)]
    return fmpq_mat(2 * n, 2 * n, [x for row in rows for x in row])


def _positive(R: fmpq_mat) -> bool:
    """Whether all leading minors are > 0."""
    m = R.nrows()
    return all(fmpq_mat(k, k, [R[i, j] for i in range(k) for j in range(k)]).det() > 0 for k in range(1, m + 1))


def _continuous(A: fmpq_mat, B: fmpq_mat, C: fmpq_mat, D: fmpq_mat) -> tuple[fmpq_mat, fmpq_mat, fmpq_mat, fmpq_mat]:
    """Return the system in w = (z - 1)/(z + 1): the circle becomes the axis."""
    eye = _eye(A.nrows(), fmpq(1))
    inverse = (A + eye).inv()
    return inverse * (A - eye), fmpq(2) * inverse * B, C * inverse, D - C * inverse * B
