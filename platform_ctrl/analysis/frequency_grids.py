"""Grids of frequencies, rad/s, and panels of frequency for integrals.

Three kinds of grids, because they serve three purposes: `tuning_grid` is fixed for a set of plants, so that a search
compares controllers at the same frequencies; `following_grid` is for curves of known closed loops, with few points at
each resonance; `around_resonances` gives the points around poles or zeros that show the shape of the sharpest of them.
Integrals are taken by Gauss and Kronrod's rule of 21 nodes, over many panels at once.
"""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray

# Grids of sampled systems end at this share of the Nyquist frequency.
_LAST = 0.999
# Points below, around and above the nutation frequency: for a search, and for one that misses no resonance.
_COUNTS, _FINE_COUNTS = (15, 60, 15), (15, 130, 25)

# Offsets from a resonance in units of its half-width: its shape is drawn whatever its sharpness.
_OFFSETS = np.array([0.0, 0.35, 0.7, 1.0, 1.5, 2.5, 4.0, 7.0, 12.0])
# A pole sharper than this is drawn as if it had this damping ratio: no spike of one point, no division by zero.
_MINIMUM_DAMPING = 2e-3
# Relative spacing below which two frequencies are one.
_RESOLUTION = 2e-4

# Offsets next to a pole or zero in units of its half-width, then growing by a factor.
_NEAR = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.7, 2.2, 3.0, 4.0])
_GROWTH = 1.5


def tuning_grid(nutation: float, period: float, fine: bool = False) -> FloatArray:
    """Return frequencies, rad/s, dense where margins are lost: between a sixth and about twice the nutation."""
    last = _LAST * np.pi / period
    # Where nutation is faster than what is sampled, the grid covers what is left below the Nyquist frequency.
    slowest = min(nutation / 150.0, np.pi / period / 100.0)
    edges = np.minimum([slowest, nutation / 6.0, 2.2 * nutation, last], last)
    parts = [
        np.geomspace(low, high, k, endpoint=False)
        for low, high, k in zip(edges, edges[1:], _FINE_COUNTS if fine else _COUNTS, strict=False)
        if high > low
    ]
    return np.append(np.concatenate(parts), last)


def following_grid(poles: ComplexArray, low: float, high: float, points: int = 220) -> FloatArray:
    """Return frequencies from `low` to `high`, logarithmic, denser around every resonance of `poles` (s-plane)."""
    s = np.asarray(poles).ravel()
    s = s[np.isfinite(s)]
    centre, distance = np.abs(s.imag), np.abs(s.real)
    sharp = (centre > low) & (centre < high) & (distance < 0.5 * centre)
    centre, distance = centre[sharp], distance[sharp]
    width = np.maximum(distance, _MINIMUM_DAMPING * centre)
    near = centre[:, None] + width[:, None] * np.concatenate([-_OFFSETS, _OFFSETS[1:]])
    grid = np.unique(np.concatenate([np.geomspace(low, high, points), near.ravel()]))
    grid = grid[(grid >= low) & (grid <= high)]
    # Next to an undamped pole the response is infinite, and sensitivities have no digits left.
    for at in centre[distance < _MINIMUM_DAMPING * centre]:
        grid = grid[np.abs(grid - at) > 0.3 * _MINIMUM_DAMPING * at]
    kept = np.concatenate([[True], np.diff(np.log(grid)) > _RESOLUTION])
    return np.asarray(grid[kept])


def around_resonances(s: ComplexArray, low: float, high: float, undamped: float, closest: float) -> FloatArray:
    """Return frequencies around each resonance among poles (or zeros) `s`, out to a quarter of its frequency.

    One with a damping ratio below `undamped` is approached to the relative distance `closest`.
    """
    s = np.unique(s[(np.abs(s.imag) > low) & (np.abs(s.imag) < high) & (np.abs(s.real) < 0.5 * np.abs(s.imag))])
    out = [np.zeros(0)]
    for centre, distance in sorted({(abs(one.imag), abs(one.real)) for one in s}):
        width = distance if distance > undamped * centre else closest * centre
        count = math.ceil(math.log(max(0.25 * centre / (4.0 * width), 1.0)) / math.log(_GROWTH))
        offsets = width * np.concatenate([_NEAR, 4.0 * _GROWTH ** np.arange(1, count + 1)])
        out += [centre + offsets, centre - offsets]
    return np.concatenate(out)


# QUADPACK (Piessens and de Doncker, 1983): Kronrod's nodes above zero from the outside, then their weights; every
# second one from the second on is a node of Gauss's rule of ten.
_NODES = (
    0.995657163025808080735527280689003,
    0.973906528517171720077964012084452,
    0.930157491355708226001207180059508,
    0.865063366688984510732096688423493,
    0.780817726586416897063717578345042,
    0.679409568299024406234327365114874,
    0.562757134668604683339000099272694,
    0.433395394129247190799265943165784,
    0.294392862701460198131126603103866,
    0.148874338981631210884826001129720,
)
_WEIGHTS = (
    0.011694638867371874278064396062192,
    0.032558162307964727478818972459390,
    0.054755896574351996031381300244580,
    0.075039674810919952767043140916190,
    0.093125454583697605535065465083366,
    0.109387158802297641899210590325805,
    0.123491976262065851077958109831074,
    0.134709217311473325928054001771707,
    0.142775938577060080797094273138717,
    0.147739104901338491374841515972068,
)
_MIDDLE = 0.149445554002916905664936468389821

NODES = np.array([*(-x for x in _NODES), 0.0, *reversed(_NODES)])
KRONROD = np.array([*_WEIGHTS, _MIDDLE, *reversed(_WEIGHTS)])
GAUSS = np.zeros(21)
GAUSS[1::2] = np.polynomial.legendre.leggauss(10)[1]

# Integrals of a polynomial through the nodes, from -1 to each node and to 1, in terms of its values there.
_DEGREES = np.polynomial.legendre.legvander(NODES, len(NODES) - 1)
_INTEGRALS = np.polynomial.legendre.legvander(np.append(NODES, 1.0), len(NODES)) @ np.polynomial.legendre.legint(
    np.eye(len(NODES)), lbnd=-1.0
)
UP_TO = np.linalg.solve(_DEGREES.T, _INTEGRALS.T).T

Panel = tuple[float, float]
# Relative distance of edges of panels below which they are one.
_SAME = 1e-9


def nodes(panels: list[Panel]) -> tuple[FloatArray, FloatArray]:
    """Return the nodes of each panel (P, 21) and half the width of each (P,)."""
    ends = np.array(panels).reshape(-1, 2)
    half = 0.5 * (ends[:, 1] - ends[:, 0])
    return ends[:, :1] + half[:, None] * (1.0 + NODES), half


def between(edges: FloatArray, low: float, high: float) -> list[Panel]:
    """Return the panels between `low`, the `edges` inside, and `high`; edges that hardly differ are one."""
    inside = np.unique(edges[(edges > low) & (edges < high)])
    kept = [low]
    for one in inside:
        if one - kept[-1] > _SAME * one and high - one > _SAME * high:
            kept.append(float(one))
    return list(zip(kept, [*kept[1:], high], strict=True))


def halves(panel: Panel) -> list[Panel]:
    """Return both halves; of a panel over more than a factor of four, the parts beside its geometric mean."""
    low, high = panel
    middle = float(np.sqrt(low * high)) if 0.0 < 4.0 * low < high else 0.5 * (low + high)
    if low == 0.0:
        middle = high / 16.0
    return [(low, middle), (middle, high)]


# Poles with less damping than this have panels of their own, unless panels around are within so many of their widths.
_SHARP, WIDE = 0.1, 30.0


def edges_around(s: ComplexArray) -> FloatArray:
    """Return edges around the resonances of poles."""
    sharp = (s.imag > 0.0) & (np.abs(s.real) < _SHARP * np.abs(s))
    centre, width = s[sharp].imag, np.maximum(np.abs(s[sharp].real), 1e-6 * s[sharp].imag)
    edges = [np.abs(s[np.isfinite(s)]), *(centre + k * width for k in (-12.0, -3.0, 0.0, 3.0, 12.0))]
    out: FloatArray = np.concatenate(edges)
    return out[out > 0.0]
