"""Integrals over panels of frequency: Gauss and Kronrod's rule of 21 nodes, for many panels at once."""

from __future__ import annotations

import numpy as np

from platform_ctrl.common.values import FloatArray

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


def nodes(panels: list[Panel]) -> tuple[FloatArray, FloatArray]:
    """Return the nodes of each panel (P, 21) and half the width of each (P,)."""
    ends = np.array(panels).reshape(-1, 2)
    half = 0.5 * (ends[:, 1] - ends[:, 0])
    return ends[:, :1] + half[:, None] * (1.0 + NODES), half


def between(edges: FloatArray, low: float, high: float, resolution: float = 1e-9) -> list[Panel]:
    """Return the panels between `low`, the `edges` inside, and `high`; edges that hardly differ are one."""
    inside = np.unique(edges[(edges > low) & (edges < high)])
    kept = [low]
    for one in inside:
        if one - kept[-1] > resolution * one and high - one > resolution * high:
            kept.append(float(one))
    return list(zip(kept, [*kept[1:], high], strict=True))


def halves(panel: Panel) -> list[Panel]:
    """Return both halves; of a panel over more than a factor of four, the parts beside its geometric mean."""
    low, high = panel
    middle = float(np.sqrt(low * high)) if 0.0 < 4.0 * low < high else 0.5 * (low + high)
    if low == 0.0:
        middle = high / 16.0
    return [(low, middle), (middle, high)]
