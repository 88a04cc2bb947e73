"""How high a gain can rise between frequencies at which it is known, and its largest value by that, compiled.

On the frequency axis every entry u* H v of a response is a rational function with the poles of the system. Along the
phase of the all-pass function that has the same n poles, phi = sum 2 atan((w - Im p)/|Re p|), its square |u* H v|^2
is as steep as a cosine at most: where it is the share cos^2(alpha/2) of its largest value, |d alpha/d phi| <= 1
(inequality of Bernstein and Szegö for rational functions: P. Borwein, T. Erdélyi, Polynomials and Polynomial
Inequalities, 1995, sec. 7.1). So where the largest gain lies between two frequencies, the gains there are not far below
it, in phase. If a level is exceeded, then between the two where the largest gain lies this holds for the level all
the more: where it holds nowhere, nothing exceeds the level. That takes no eigenvalues of a Hamiltonian matrix.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.analysis.gain_kernel import largest_singular_values
from platform_ctrl.analysis.resolvent import quick
from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import compiled

# Poles are known to a few digits at least: phases are granted this factor.
GRANTED = 1.05
# Ratio of neighbouring distances from a peak.
STEP = 2.5
# Frequencies of a climb, steps at most, and how much nearer the next ones are where the gain bends and where not.
FAN, CLIMBS, BENT, STRAIGHT = 15, 12, 0.07, 0.5
# Frequencies at which the gain may be looked at before eigenvalues of a Hamiltonian matrix take less.
MOST, MOST_PER_POLE = 500, 40


class AllPass(NamedTuple):
    """The all-pass function with a system's poles, along the frequency axis.

    Attributes
    ----------
    centre, width : (n,)
        Imaginary part and distance from the axis of each pole, in rad/s; of a sampled system in the plane of
        (z - 1)/(z + 1).
    dt
        Sample period, s; 0: continuous.
    """

    centre: FloatArray
    width: FloatArray
    dt: float


def all_pass(s: ComplexArray, dt: float) -> AllPass:
    """Return it for continuous(-equivalent) poles (n,), none of them on the stability boundary."""
    if dt > 0.0:
        poles = np.full(len(s), -1.0 + 0j)
        finite = np.isfinite(s)
        poles[finite] = np.tanh(0.5 * dt * s[finite])
        s = poles
    # On which side of the axis a pole stands does not matter to a gain.
    return AllPass(np.ascontiguousarray(s.imag), np.abs(s.real), dt)


@compiled
def _mapped(w: float, dt: float) -> float:
    if dt == 0.0:
        return w
    half = 0.5 * dt * w
    return math.inf if half >= 0.5 * math.pi else math.tan(half)


@compiled
def phases(w: FloatArray, centre: FloatArray, width: FloatArray, dt: float) -> FloatArray:
    """Return the phase, rad, at frequencies (N,), rad/s; infinite ones are the end of the axis."""
    out = np.empty(len(w))
    for k in range(len(w)):
        at, total = _mapped(w[k], dt), 0.0
        for i in range(len(centre)):
            total += math.atan((at - centre[i]) / width[i])
        out[k] = 2.0 * total
    return out


@compiled
def around(w: float, centre: FloatArray, width: FloatArray, dt: float, tolerance: float) -> FloatArray:
    """Return frequencies on both sides of a peak at w, from where its gain differs by `tolerance` of itself on."""
    at, least, slope = _mapped(w, dt), 0.5 * math.sqrt(8.0 * tolerance), 0.0
    for i in range(len(centre)):
        slope += 2.0 * width[i] * (1.0 if at == math.inf else 1.0 / ((at - centre[i]) ** 2 + width[i] ** 2))
    count = math.ceil(math.log(1.5 / least) / math.log(STEP))
    out = np.empty(2 * count)
    for k in range(count):
        distance = least * STEP**k
        out[2 * k] = slope / distance if at == math.inf else at + distance / slope
        out[2 * k + 1] = out[2 * k] if at == math.inf else at - distance / slope
    for k in range(2 * count):
        out[k] = max(0.0, out[k] if dt == 0.0 else 2.0 / dt * math.atan(out[k]))
    return out


@compiled
def doubtful(w: FloatArray, gain: FloatArray, level: float, phi: FloatArray) -> NDArray[np.int64]:
    """Return between which sorted frequencies, k and k + 1, the largest gain may lie if it exceeds `level`.

    Between others the gain may exceed it too, but not be the largest. `phi` are the phases there.
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
    """Return a frequency behind each of the `chosen` ones of w, between it and the next; `edge` ends the axis."""
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


class Small(NamedTuple):
    """A system of few states as the compiled search takes it.

    Attributes
    ----------
    rows, lasts, norms
        As of `chains.Chains`.
    D : (p, m)
        The direct term.
    work
        Memory for `resolvent.quick`.
    size, dt, edge
        1 + p + n; sample period, s; end of the axis, rad/s.
    tolerated
        Error of an entry of the response, relative to the largest gain where that is more than itself.
    """

    rows: FloatArray
    lasts: NDArray[np.int64]
    norms: FloatArray
    D: FloatArray
    work: FloatArray
    size: int
    dt: float
    edge: float
    tolerated: float


@compiled
def peak(
    small: Small, s: ComplexArray, centre: FloatArray, width: FloatArray, tolerance: float
) -> tuple[bool, float, float]:
    """Return whether the largest gain was found with all digits, the gain and its frequency; s are finite poles."""
    w = _first_look(s, small.edge)
    sizes, fine = _gains(small, w, 0.0)
    phi = phases(w, centre, width, small.dt)
    best, frequency = 0.0, 0.0
    while fine:
        k = int(np.argmax(sizes))
        if sizes[k] == math.inf or len(w) > MOST + MOST_PER_POLE * len(centre):
            break
        if sizes[k] > best * (1.0 + 0.1 * tolerance):
            best, frequency, fine = _climbed(small, s, sizes[k], w[k], 0.01 * tolerance)
            new = np.minimum(np.append(around(frequency, centre, width, small.dt, tolerance), frequency), small.edge)
        else:
            chosen = doubtful(w, sizes, best * (1.0 + tolerance), phi) if best > 0.0 else np.empty(0, dtype=np.int64)
            if len(chosen) == 0:
                return True, best, frequency
            new = middles(w, chosen, small.edge)
            for i in range(len(new)):
                if not w[chosen[i]] < new[i] < w[chosen[i] + 1]:
                    return False, best, frequency
        more, certain = _gains(small, new, best)
        fine = fine and certain
        w, sizes = np.append(w, new), np.append(sizes, more)
        phi = np.append(phi, phases(new, centre, width, small.dt))
        order = np.argsort(w)
        w, sizes, phi = w[order], sizes[order], phi[order]
    return False, best, frequency


@compiled
def _first_look(s: ComplexArray, edge: float) -> FloatArray:
    """Return sorted frequencies about the poles of the upper half-plane, and the ends of the axis."""
    out, count = np.empty(2 + 8 * len(s)), 2
    out[0], out[1] = 0.0, edge
    for pole in s:
        if pole.imag >= 0.0:
            rate, damping = abs(pole), abs(pole.real)
            for k in range(5):
                out[count + k] = abs(pole.imag + 0.75 * (k - 2) * damping)
            out[count + 5], out[count + 6], out[count + 7] = rate, 2.0 * rate, 0.5 * rate
            count += 8
    return np.sort(np.minimum(out[:count], edge))


@compiled
def _gains(small: Small, w: FloatArray, best: float) -> tuple[FloatArray, bool]:
    """Return the largest singular value at each frequency, and whether they are right."""
    (p, m), N, dt = small.D.shape, len(w), small.dt
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
    H, poor = np.empty((p * m, N), dtype=np.complex128), np.empty(N, dtype=np.int64)
    rows, lasts, norms, D, size, work = small.rows, small.lasts, small.norms, small.D, small.size, small.work
    count = quick(z, rows, lasts, norms, D, H, size, m, 1, small.tolerated, best, poor, work)
    matrices, out = np.empty((N, p, m), dtype=np.complex128), np.empty(N)
    for k in range(N):
        for i in range(p):
            for j in range(m):
                entry = H[i * m + j, k]
                real = w[k] == 0.0 or w[k] == small.edge
                matrices[k, i, j] = D[i, j] if w[k] == math.inf else complex(entry.real, 0.0) if real else entry
    largest_singular_values(matrices, out)
    if count > 0:
        best = max(best, out.max())
        count = quick(z, rows, lasts, norms, D, H, size, m, 1, small.tolerated, best, poor, work)
    for k in poor[:count]:
        if w[k] != math.inf:
            return out, False
    return out, True


@compiled
def _climbed(small: Small, s: ComplexArray, best: float, frequency: float, slack: float) -> tuple[float, float, bool]:
    """Return the local maximum near `frequency`, by fans of frequencies that contract, and whether it is right."""
    if frequency == 0.0 or frequency == math.inf:
        return best, frequency, True
    width = frequency
    for pole in s:
        width = min(width, abs(pole - complex(0.0, frequency)))
    centre = frequency
    for _ in range(CLIMBS):
        fan = np.minimum(np.abs(centre + width * np.linspace(-1.0, 1.0, FAN)), small.edge)
        sizes, fine = _gains(small, fan, best)
        if not fine:
            return best, frequency, False
        i = int(np.argmax(sizes))
        if sizes[i] > best:
            best, frequency = sizes[i], fan[i]
        low, high = sizes[max(i - 1, 0)], sizes[min(i + 1, FAN - 1)]
        # The top lies between the neighbours of the highest: it cannot rise much above where these are as high.
        if best - min(low, high, sizes[i]) <= slack * best or width < 1e-15 * frequency:
            break
        centre = frequency
        bend = low + high - 2.0 * sizes[i]
        if bend < 0.0 and 0 < i < FAN - 1:
            centre += 0.25 * (low - high) / bend * (fan[i + 1] - fan[i - 1])
            width *= BENT
        else:
            width *= STRAIGHT
    return best, frequency, True
