"""Upper bound of a gain between frequencies at which it is known, and a compiled peak search that uses it.

On the frequency axis every entry u* H v of a response is a rational function with the poles of the system. Along the
phase of the all-pass function that has the same n poles, phi = sum 2 atan((w - Im p)/|Re p|), its square |u* H v|^2
is at most as steep as a cosine: where it is cos^2(alpha/2) times its largest value, |d alpha/d phi| <= 1
(inequality of Bernstein and Szegö for rational functions: P. Borwein, T. Erdélyi, Polynomials and Polynomial
Inequalities, 1995, sec. 7.1). If the largest gain lies between two frequencies, this limits how far the gains at these
can be below it, given their distance in phase. If the largest gain exceeds a level, the same limit holds for the level.
Where it holds between no two neighbours, no gain exceeds the level. No eigenvalues of a Hamiltonian matrix are needed.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgebal, dgeev

from platform_ctrl.analysis.arrays import MANY_STATES, ComplexArray, StateArrays
from platform_ctrl.analysis.hessenberg_form import reduce
from platform_ctrl.analysis.hessenberg_recurrence import quick
from platform_ctrl.analysis.kernels import largest_of_columns
from platform_ctrl.analysis.resolvent import AVERAGED, ON_A_GRID, TOLERATED, plain
from platform_ctrl.analysis.singular_values import DOUBTFUL, EPSILON
from platform_ctrl.common.simd import LANES, compiled, internal
from platform_ctrl.common.values import FloatArray

# Safety factor on phases, for errors of the poles.
GRANTED = 1.05
# Ratio of neighbouring distances from a peak.
STEP = 2.5
# Local search: frequencies a step, steps at most, and contraction of the interval where the gain is concave and where
# it is not.
FAN, CLIMBS, BENT, STRAIGHT = 16, 12, 0.06, 0.5
# Evaluations of the gain from which on eigenvalues of a Hamiltonian matrix take less time.
MOST, MOST_PER_POLE = 500, 40


class AllPass(NamedTuple):
    """The all-pass function with a system's poles, along the frequency axis."""

    # centre, width: (n,): imaginary part and distance from the axis of each pole, in rad/s; of a sampled system in
    # the plane of (z - 1)/(z + 1)
    centre: FloatArray
    width: FloatArray
    dt: float  # sample period, s; 0: continuous


def all_pass(s: ComplexArray, dt: float) -> AllPass:
    """Return it for continuous(-equivalent) poles (n,), none of them on the stability boundary."""
    if dt > 0.0:
        poles = np.full(len(s), -1.0 + 0j)
        finite = np.isfinite(s)
        poles[finite] = np.tanh(0.5 * dt * s[finite])
        s = poles
    # The gain does not depend on the side of the axis on which a pole lies.
    return AllPass(np.ascontiguousarray(s.imag), np.abs(s.real), dt)


@internal
def _mapped(w: float, dt: float) -> float:
    if dt == 0.0:
        return w
    half = 0.5 * dt * w
    return math.inf if half >= 0.5 * math.pi else math.tan(half)


@compiled
def phases(w: FloatArray, centre: FloatArray, width: FloatArray, dt: float) -> FloatArray:
    """Return the phase, rad, at frequencies (N,), rad/s, which may be infinite."""
    out = np.empty(len(w))
    for k in range(len(w)):
        at, total = _mapped(w[k], dt), 0.0
        for i in range(len(centre)):
            total += math.atan((at - centre[i]) / width[i])
        out[k] = 2.0 * total
    return out


@compiled
def around(w: float, centre: FloatArray, width: FloatArray, dt: float, tolerance: float) -> FloatArray:
    """Return frequencies on both sides of a peak at w, outwards from where the gain is lower by `tolerance`."""
    at, least, slope = _mapped(w, dt), 0.5 * math.sqrt(8.0 * tolerance), 0.0
    for i in range(len(centre)):
        slope += 2.0 * width[i] * (1.0 if at == math.inf else 1.0 / ((at - centre[i]) ** 2 + width[i] ** 2))
    steps, count = math.ceil(math.log(1.5 / least) / math.log(STEP)), 0
    out = np.empty(2 * steps)
    for k in range(steps):
        distance = least * STEP**k
        above = slope / distance if at == math.inf else at + distance / slope
        out[count] = above if dt == 0.0 else 2.0 / dt * math.atan(above)
        count += 1
        if at < math.inf and at > distance / slope:
            below = at - distance / slope
            out[count] = below if dt == 0.0 else 2.0 / dt * math.atan(below)
            count += 1
    return out[:count]


@compiled
def doubtful(w: FloatArray, gain: FloatArray, level: float, phi: FloatArray) -> NDArray[np.int64]:
    """Return the indices k of intervals from w[k] to w[k + 1] in which the largest gain may lie if it exceeds `level`.

    In other intervals the gain may exceed it too, but is not the largest. `phi` are the phases at w.
    """
    found, count, before = np.empty(len(w), dtype=np.int64), 0, 0.0
    for k in range(len(w)):
        alpha = 2.0 * math.acos(min(gain[k] / level, 1.0))
        if k > 0 and not alpha + before > GRANTED * (phi[k] - phi[k - 1]):
            found[count] = k - 1
            count += 1
        before = alpha
    return found[:count]


@compiled
def middles(w: FloatArray, chosen: NDArray[np.int64], edge: float) -> FloatArray:
    """Return a frequency within each of the `chosen` intervals of w; the axis ends at `edge`."""
    out = np.empty(len(chosen))
    for k in range(len(chosen)):
        low, high = w[chosen[k]], w[chosen[k] + 1]
        if low == 0.0:
            out[k] = 1.0 if high == math.inf else 0.25 * high
        elif high == math.inf:
            out[k] = 4.0 * low
        elif high > 4.0 * low and high != edge:
            out[k] = math.sqrt(low) * math.sqrt(high)
        else:
            out[k] = 0.5 * (low + high)
    return out


class Few(NamedTuple):
    """A system of few states, in the form of the compiled search."""

    # rows, lasts, norms: as of `chains.Chains`
    rows: FloatArray
    lasts: NDArray[np.int64]
    norms: FloatArray
    D: FloatArray  # (p, m): the direct term
    work: FloatArray  # work array of `resolvent.quick`
    tolerated: float  # error bound of a response, relative
    # size, dt, edge: 1 + p + n; sample period, s; end of the axis, rad/s
    size: int
    dt: float
    edge: float


def norm_of_few(system: StateArrays, tolerance: float, unstable: bool, least: float = 0.0) -> tuple[bool, float, float]:
    """Return whether the H-infinity norm of a system with few states was found, the norm and its frequency.

    It is not found for poles next to the stability boundary, and for unstable systems only if `unstable`. Of a norm up
    to `least` only that is found out, and `least` returned.
    """
    A, B, C, D = plain(system.A), plain(system.B), plain(system.C), plain(system.D)
    poles = _balanced_poles(A.tobytes())
    if poles is None:
        return False, 0.0, 0.0
    scale, real, imaginary = poles
    bordered = _bordered(A, B, C, scale)
    if not np.all(np.isfinite(bordered)):
        return False, 0.0, 0.0
    further = dgebal(bordered, scale=1, permute=0)[3]
    return _norm((A, B, C, D), system.dt, (scale, further), (real, imaginary), tolerance, unstable, least)


@functools.lru_cache(maxsize=8)
def _balanced_poles(A: bytes) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return the scale of each state of a matrix and the parts of its eigenvalues; None where these are not found.

    Kept, because it is asked for norms of several parts of one closed loop, one after another.
    """
    matrix = np.frombuffer(A)
    n = math.isqrt(len(matrix))
    if not np.all(np.isfinite(matrix)):
        return None
    # LAPACK directly: SciPy's wrappers take longer than small matrices.
    first, _, _, scale, _ = dgebal(matrix.reshape(n, n), scale=1, permute=0)
    real, imaginary, _, _, failed = dgeev(first, compute_vl=0, compute_vr=0)
    return None if failed else (scale, real, imaginary)


# Loops below, not expressions of arrays: numba compiles these five times as long.


@compiled
def _bordered(A: FloatArray, B: FloatArray, C: FloatArray, scale: FloatArray) -> FloatArray:
    """Return [A B; C 0] in scaled states, B and C as large as A."""
    (n, m), p = B.shape, C.shape[0]
    out, squares = np.zeros((n + m + p, n + m + p)), np.zeros(3)
    for i in range(n):
        for k in range(n):
            out[i, k] = A[i, k] * scale[k] / scale[i]
            squares[0] += out[i, k] * out[i, k]
        for j in range(m):
            out[i, n + j] = B[i, j] / scale[i]
            squares[1] += out[i, n + j] * out[i, n + j]
        for j in range(p):
            out[n + m + j, i] = C[j, i] * scale[i]
            squares[2] += out[n + m + j, i] * out[n + m + j, i]
    for k in range(3):
        squares[k] = math.sqrt(squares[k]) if squares[k] > 0.0 else 1.0
    for i in range(n):
        for j in range(m):
            out[i, n + j] *= squares[0] / squares[1]
        for j in range(p):
            out[n + m + j, i] *= squares[0] / squares[2]
    return out


@compiled
def _norm(
    system: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    dt: float,
    scales: tuple[FloatArray, FloatArray],
    poles: tuple[FloatArray, FloatArray],
    tolerance: float,
    unstable: bool,
    least: float,
) -> tuple[bool, float, float]:
    """Return what `norm_of_few` does, with states scaled by the product of both `scales`."""
    (A, B, C, D), (real, imaginary) = system, poles
    A, B, C = A.copy(), B.copy(), C.copy()
    n, square, s = len(A), 0.0, np.empty(len(A), dtype=np.complex128)
    for i in range(n):
        unit = scales[0][i] * scales[1][i]
        for k in range(n):
            A[i, k] /= unit
            A[k, i] *= unit
        for j in range(B.shape[1]):
            B[i, j] /= unit
        for j in range(len(C)):
            C[j, i] *= unit
    for i in range(n):
        for k in range(n):
            square += A[i, k] * A[i, k]
    doubtful_below = DOUBTFUL * EPSILON * math.sqrt(square)
    for k in range(n):
        s[k] = complex(real[k], imaginary[k])
        distance = 1.0 - abs(s[k]) if dt > 0.0 else -real[k]
        # True for NaN too.
        if not abs(distance) > doubtful_below or (distance < 0.0 and not unstable):
            return False, 0.0, 0.0
        if dt > 0.0:
            s[k] = _logarithm(s[k]) / dt
    return peak(A, B, C, D, dt, s, tolerance, least)


@internal
def _logarithm(z: complex) -> complex:
    if z == 0.0:
        return complex(-math.inf, 0.0)
    square = (z.real - 1.0) * (z.real + 1.0) + z.imag * z.imag
    # No cancellation next to z = 1.
    growth = 0.5 * math.log1p(square) if abs(z - 1.0) < 0.5 else math.log(abs(z))
    return complex(growth, math.atan2(z.imag, z.real))


@compiled
def peak(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    dt: float,
    s: ComplexArray,
    tolerance: float,
    least: float,
) -> tuple[bool, float, float]:
    """Return whether the largest gain was found to `tolerance`, the gain and its frequency.

    The system is balanced, of few states, inputs or outputs; s are its continuous(-equivalent) poles. Where no gain is
    above `least` by more than the tolerance, that is returned in its place.
    """
    few = _prepared(A, B, C, D, dt)
    finite, centre, width = s[np.isfinite(s)], np.zeros(len(s)), np.ones(len(s))
    for k in range(len(s)):
        pole = s[k]
        if dt > 0.0:
            pole = np.tanh(0.5 * dt * pole) if abs(pole) < math.inf else complex(-1.0, 0.0)
        centre[k], width[k] = pole.imag, abs(pole.real)
    w = _first_look(finite, few.edge)
    sizes, fine = _gains(few, w, least)
    phi = phases(w, centre, width, dt)
    best, frequency = least, 0.0
    while fine:
        k = int(np.argmax(sizes))
        if sizes[k] == math.inf or len(w) > MOST + MOST_PER_POLE * len(s):
            break
        if sizes[k] > best * (1.0 + 0.1 * tolerance):
            best, frequency, fine = _climbed(few, finite, sizes[k], w[k], 0.01 * tolerance)
            new = np.append(around(frequency, centre, width, dt, tolerance), frequency)
        else:
            chosen = doubtful(w, sizes, best * (1.0 + tolerance), phi) if best > 0.0 else np.empty(0, dtype=np.int64)
            if len(chosen) == 0:
                return True, best, frequency
            new = middles(w, chosen, few.edge)
            for i in range(len(new)):
                if not w[chosen[i]] < new[i] < w[chosen[i] + 1]:
                    return False, best, frequency
        more, certain = _gains(few, new, best)
        fine = fine and certain
        w, sizes = np.append(w, new), np.append(sizes, more)
        phi = np.append(phi, phases(new, centre, width, dt))
        order = _order(w)
        w, sizes, phi = w[order], sizes[order], phi[order]
    return False, best, frequency


@internal
def _prepared(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> Few:
    """Return the chains of the system, or of the transposed one if it has fewer outputs than inputs."""
    if D.shape[0] < D.shape[1]:
        first, driven, seen, direct = A.T.copy(), C.T.copy(), B.T.copy(), D.T.copy()
    else:
        first, driven, seen, direct = A.copy(), B, C, D
    n, (p, m) = len(first), direct.shape
    if dt > 0.0:
        # The response is evaluated as a function of z - 1.
        for i in range(n):
            first[i, i] -= 1.0
    size = p + 1 + n
    rows, lasts, norms = np.empty((m + 1) * size * size), np.empty(m + 1, dtype=np.int64), np.empty(p + 1)
    reduce(first, driven, seen, np.empty((size * size, LANES)), np.empty((n, LANES)), rows, lasts, norms)
    work = np.zeros((4 * (size + p * m + 1) + 2 * (m + 1), LANES))
    tolerated = TOLERATED * (AVERAGED * n if n >= MANY_STATES else 1.0)
    return Few(rows, lasts, norms, direct, work, tolerated, size, dt, math.inf if dt == 0.0 else math.pi / dt)


@internal
def _first_look(s: ComplexArray, edge: float) -> FloatArray:
    """Return sorted frequencies about the poles of the upper half-plane, and the ends of the axis."""
    out, count = np.empty(2 + 8 * len(s)), 2
    out[0], out[1] = 0.0, edge
    for pole in s:
        if pole.imag >= 0.0:
            rate, damping = abs(pole), abs(pole.real)
            for k in range(0 if pole.imag > 0.0 else 5, 5):
                out[count] = abs(pole.imag + 0.75 * (k - 2) * damping)
                count += 1
            out[count], out[count + 1], out[count + 2] = rate, 2.0 * rate, 0.5 * rate
            count += 3
    for k in range(count):
        out[k] = min(out[k], edge)
    out = out[:count]
    return out[_order(out)]


@internal
def _order(w: FloatArray) -> NDArray[np.int64]:
    """Return in which order numbers increase, by insertion: most of them are in that order already."""
    order = np.empty(len(w), dtype=np.int64)
    for k in range(len(w)):
        place = k
        while place > 0 and w[order[place - 1]] > w[k]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
    return order


@internal
def _gains(few: Few, w: FloatArray, best: float) -> tuple[FloatArray, bool]:
    """Return the largest singular value at each frequency, and whether all are accurate."""
    (p, m), N, dt = few.D.shape, len(w), few.dt
    z = np.zeros(N, dtype=np.complex128)
    for k in range(N):
        if w[k] == math.inf:
            continue
        if dt == 0.0:
            z[k] = complex(0.0, w[k])
        else:
            tangent = math.tan(0.5 * dt * w[k])
            imaginary = 2.0 * tangent / (1.0 + tangent * tangent)
            z[k] = complex(-tangent * imaginary, imaginary)
    H, poor, out = np.empty((p * m, N), dtype=np.complex128), np.empty(N, dtype=np.int64), np.empty(N)
    rows, lasts, norms, D, size, work = few.rows, few.lasts, few.norms, few.D, few.size, few.work
    count = quick(z, rows, lasts, norms, D, H, size, m, 1, few.tolerated, best, poor, work)
    for k in range(N):
        if w[k] == 0.0 or w[k] == few.edge:
            for i in range(p * m):
                H[i, k] = D[i // m, i % m] if w[k] == math.inf else H[i, k].real
    largest_of_columns(H, p, m, out)
    if count > 0:
        best = max(best, out.max())
        count = quick(z, rows, lasts, norms, D, H, size, m, 1, few.tolerated, best, poor, work)
    if count == 0:
        return out, True
    # Below the best gain few digits do where the gain is taken as larger by their error.
    inexact = poor[:count].copy()
    count = quick(z, rows, lasts, norms, D, H, size, m, 1, ON_A_GRID, best, poor, work)
    for k in poor[:count]:
        if w[k] != math.inf:
            return out, False
    for k in inexact:
        if w[k] != math.inf:
            out[k] += p * m * ON_A_GRID * best
            if out[k] > best:
                return out, False
    return out, True


@internal
def _climbed(few: Few, s: ComplexArray, best: float, frequency: float, slack: float) -> tuple[float, float, bool]:
    """Return the local maximum near `frequency`, from contracting sets of frequencies, and whether it is accurate."""
    if frequency == 0.0 or frequency == math.inf:
        return best, frequency, True
    width, last = frequency, False
    for pole in s:
        width = min(width, abs(pole - complex(0.0, frequency)))
    centre = frequency
    for _ in range(CLIMBS):
        fan = np.full(1, centre) if last else np.abs(centre + width * np.linspace(-1.0, 1.0, FAN))
        sizes, fine = _gains(few, np.minimum(fan, few.edge), best)
        if not fine:
            return best, frequency, False
        i = int(np.argmax(sizes))
        if sizes[i] > best:
            best, frequency = sizes[i], min(fan[i], few.edge)
        if last:
            break
        low, high = sizes[max(i - 1, 0)], sizes[min(i + 1, FAN - 1)]
        fall = best - min(low, high, sizes[i])
        # The maximum lies between the neighbours of the largest value and is close to it where these are.
        if fall <= slack * best or width < 1e-15 * frequency:
            break
        centre = fan[i]
        bend = low + high - 2.0 * sizes[i]
        if bend < 0.0 and 0 < i < FAN - 1:
            centre += 0.25 * (low - high) / bend * (fan[i + 1] - fan[i - 1])
            width *= BENT
            # The error of the parabola's maximum is about the square of the relative fall.
            last = fall * fall <= 0.1 * slack * best * best
        else:
            width *= STRAIGHT
    return best, frequency, True
