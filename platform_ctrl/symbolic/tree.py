"""B, A and BᵀA_R B of a tree as series whose coefficients are linear forms in the inertias.

All body frames coincide at zero angles. With S_k what turns with gimbal k at zero angles, a body's own inertia is
S_k − Σ S_c over the gimbals c that it carries, and what turns with it at any angles is

    X_k = S_k + Σ (R_c X_c R_cᵀ − S_c):

the composite-rigid-body recursion, in which S_k alone stay as symbols.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray
from platform_ctrl.mechanics.kinematics import Topology
from platform_ctrl.symbolic.series import ONE, Algebra, Series, add, apply, product, pruned


def composites(tree: Topology) -> FloatArray:
    """Return S_k at zero angles, (1 + n, 3, 3), without C; body 0 is the whole."""
    out: FloatArray = tree.inertias.copy()
    for k in reversed(tree.order):
        out[1 + tree.parents[k]] += out[1 + k]
    return out


def directions(tree: Topology, algebra: Algebra) -> Series:
    """Return B (3), coefficients (m, 3 + n)."""
    n, m = len(tree.parents), len(tree.carriers)
    rotations = [algebra.rotation(k, tree.axes[k]) for k in range(n)]
    out: Series = {}
    for rotor, carrier in enumerate(tree.carriers):
        spin: Series = {ONE: tree.spin_axes[rotor]}
        k = int(carrier) - 1
        while k >= 0:
            _place(out, apply(spin, lambda s, a=tree.axes[k]: np.asarray(s @ a)), (m, 3 + n), (rotor, 3 + k))  # type: ignore[misc]
            spin = product(algebra, rotations[k], spin, np.matmul)
            k = int(tree.parents[k])
        _place(out, spin, (m, 3 + n), (rotor, slice(0, 3)))
    return out


def mass(tree: Topology, algebra: Algebra, forms: FloatArray) -> Series:
    """Return A, coefficients (symbols, 3 + n, 3 + n).

    Parameters
    ----------
    tree, algebra
        The tree, and what the angles become.
    forms : (1 + n, symbols, 3, 3)
        S_k as linear forms in the symbols.
    """
    n, symbols = len(tree.parents), forms.shape[1]
    rotations = [algebra.rotation(k, tree.axes[k]) for k in range(n)]
    carried: list[Series] = [{ONE: form} for form in forms]
    for k in reversed(tree.order):
        half = product(algebra, rotations[k], carried[1 + k], np.matmul)
        turned = product(algebra, half, rotations[k], lambda x, r: np.asarray(x @ r.T))
        add(turned, {ONE: forms[1 + k]}, -1.0)
        above = 1 + int(tree.parents[k])
        add(carried[above], turned)
        carried[above] = pruned(carried[above])
    shape = (symbols, 3 + n, 3 + n)
    out: Series = {}
    _place(out, carried[0], shape, (slice(None), slice(0, 3), slice(0, 3)))
    for k in range(n):
        momentum = apply(carried[1 + k], lambda x, a=tree.axes[k]: np.asarray(x @ a))  # type: ignore[misc]
        i = k
        while i >= 0:
            along = apply(momentum, lambda x, a=tree.axes[i]: np.asarray(x @ a))  # type: ignore[misc]
            _place(out, along, shape, (slice(None), 3 + i, 3 + k))
            if i != k:
                _place(out, along, shape, (slice(None), 3 + k, 3 + i))
            momentum = product(algebra, momentum, rotations[i], lambda x, r: np.asarray(x @ r.T))
            i = int(tree.parents[i])
        _place(out, momentum, shape, (slice(None), slice(0, 3), 3 + k))
        _place(out, momentum, shape, (slice(None), 3 + k, slice(0, 3)))
    return pruned(out)


def axial(tree: Topology, algebra: Algebra, B: Series, forms: FloatArray) -> Series:
    """Return BᵀA_R B, coefficients (symbols, 3 + n, 3 + n), with A_R as linear forms `forms` (m, symbols)."""
    n = len(tree.parents)
    out: Series = {}
    for rotor in np.flatnonzero(forms.any(axis=1)):
        row = apply(B, lambda b, r=rotor: b[r])  # type: ignore[misc]
        add(out, product(algebra, row, row, lambda x, y, c=forms[rotor]: np.einsum("s,i,j->sij", c, x, y)))  # type: ignore[misc]
    return pruned(out) or {ONE: np.zeros((forms.shape[1], 3 + n, 3 + n))}


def spin_momenta(B: Series, forms: FloatArray) -> Series:
    """Return BᵀL, coefficients (symbols, 3 + n), with L as linear forms `forms` (m, symbols)."""
    return apply(B, lambda b: np.asarray(forms.T @ b))


def _place(into: Series, terms: Series, shape: tuple[int, ...], where: tuple[int | slice, ...]) -> None:
    for monomial, coefficient in terms.items():
        if monomial not in into:
            into[monomial] = np.zeros(shape)
        into[monomial][where] = coefficient
