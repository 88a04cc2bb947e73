"""A platform's equations, worked out in series and written down in SymPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy

from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.mechanics.kinematics import Topology, topology
from platform_ctrl.mechanics.symbolic import elements as row_algebra
from platform_ctrl.mechanics.symbolic.expressions import (
    ONE,
    Algebra,
    Expression,
    Series,
    Taylor,
    Trigonometric,
    Writer,
    add,
    apply,
    derivative,
    up_to,
)
from platform_ctrl.mechanics.symbolic.names import NamedSymbol, Names
from platform_ctrl.mechanics.symbolic.options import HIGHEST_ORDER, Terms
from platform_ctrl.mechanics.symbolic.parameters import (
    Motion,
    Parameters,
    axial,
    directions,
    mass,
    motion_symbols,
    parameters,
    spin_momenta,
    symbol_table,
)
from platform_ctrl.mechanics.symbolic.result import LINEAR, PARTIALLY_LINEAR, PRECESSION, Equations, RowTerms
from platform_ctrl.plant.platform import Platform

# Trees whose exact trigonometric form can still be read.
_MOST_GIMBALS, _DEEPEST = 5, 3

# Singular values this small against the largest are zero.
_SINGULAR = 1e-9


@value
class _Core:
    """The matrices of a platform as series."""

    algebra: Algebra
    B: Series
    BtL: Series
    A: Series
    BtA_RB: Series
    A_star: Series


def derived(platform: Platform, order: int | None, terms: Terms) -> Equations:
    """Return the equations of a platform, matrices to `order` in the angles (None: exact)."""
    tree = topology(platform)
    names = Names()
    motion = motion_symbols(platform, names)
    forces = _specific_force(platform, names)
    known = parameters(platform, tree, names)
    # (27) needs BᵀL to second order; G_A and G_R are derivatives.
    linear = _core(tree, known, Taylor(2 if order is None else max(2, order + 1)), constant_A=terms == "paper")
    shown = linear
    if order is None:
        _not_too_large(platform, tree)
        shown = _core(tree, known, Trigonometric(), constant_A=False)
    writer = Writer(known.symbols, motion.angles, trigonometric=order is None)
    matrices = _matrices(platform, known, motion, shown, writer, order, terms)
    full = _rows(known, motion, linear, terms)
    equations, groups = _written_rows(full, known, motion, writer), row_algebra.coupled_groups(full)
    used = _used(known, up_to(shown.A, order), full)
    return Equations(
        platform=platform,
        order=order,
        terms=terms,
        symbols=symbol_table(motion, used, forces),
        q=_column(motion.angles),
        rates=_column(motion.rates),
        accelerations=_column(motion.accelerations),
        Omega=_column(motion.Omega),
        Omega_dot=_column(motion.Omega_dot),
        velocity=_column(motion.Omega + motion.rates),
        forces=_column(motion.root_torques + motion.torques),
        rows=equations,
        groups=tuple(tuple(platform.gimbal_names[k] for k in group) for group in groups),
        notes=(*known.notes, *_singular(platform, known, linear, groups)),
        **matrices,
    )


def _core(tree: Topology, known: Parameters, algebra: Algebra, constant_A: bool) -> _Core:
    B = directions(tree, algebra)
    A = mass(tree, Taylor(0) if constant_A else algebra, known.S)
    BtA_RB = axial(tree, algebra, B, known.C)
    A_star: Series = {}
    add(A_star, A)
    add(A_star, BtA_RB)
    return _Core(algebra=algebra, B=B, BtL=spin_momenta(B, known.L), A=A, BtA_RB=BtA_RB, A_star=A_star)


def _matrices(
    platform: Platform,
    known: Parameters,
    motion: Motion,
    core: _Core,
    writer: Writer,
    order: int | None,
    terms: Terms,
) -> dict[str, Expression]:
    m, n = len(platform.rotors), len(platform.gimbals)
    square = (3 + n, 3 + n)
    # The paper differentiates the truncated (24); the exact derivative needs one order more.
    in_G_A = up_to(core.A_star, order) if terms == "paper" else core.A_star
    B = core.B if order is None else up_to(core.B, order + 1)
    zero = _at_zero(core.B, order)
    B0 = writer.numeric_matrix({ONE: zero} if zero is not None else {}, (m, 3 + n))
    A, BtA_RB = (writer.matrix(up_to(series, order), square) for series in (core.A, core.BtA_RB))
    velocity = [sympy.Symbol(s.name) for s in motion.Omega + motion.rates]
    return {
        "L": writer.matrix({ONE: known.L.T[:, :, None]}, (m, 1)),
        "A_R": sympy.ImmutableDenseMatrix(sympy.diag(*[writer.form(c) for c in known.C], unpack=True))
        if m
        else sympy.ImmutableDenseMatrix(0, 0, []),
        "B0": B0,
        "B_A": sympy.ImmutableDenseMatrix(writer.numeric_matrix(B, (m, 3 + n)) - B0)
        if order is None
        else writer.numeric_matrix(B, (m, 3 + n), skip=ONE),
        "A": A,
        "BtA_RB": BtA_RB,
        "A_star": writer.matrix(up_to(core.A_star, order), square),
        "G_A": _coriolis(core.algebra, in_G_A, writer, velocity, order),
        "G_R": writer.matrix(up_to(_gyroscopic(core.algebra, core.BtL, n), order), square),
        "G_root": _root_turning(core, writer, velocity, order, terms),
    }


def _at_zero(series: Series, order: int | None) -> FloatArray | None:
    """Return the value at zero angles: odd factors of a trigonometric monomial are cosines."""
    if order is not None:
        return series.get(ONE)
    kept = [c for monomial, c in series.items() if all(i % 2 for i in monomial)]
    return sum(kept[1:], kept[0]) if kept else None


def _gyroscopic(algebra: Algebra, BtL: Series, n: int) -> Series:
    """N − Nᵀ with N = ∂(BᵀL)/∂q (14), root columns zero, for n gimbals."""
    out: Series = {}
    for j in range(n):
        for monomial, c in derivative(algebra, BtL, j).items():
            into = out.setdefault(monomial, np.zeros((len(c), 3 + n, 3 + n)))
            into[:, :, 3 + j] += c
            into[:, 3 + j, :] -= c
    return out


def _coriolis(
    algebra: Algebra, A_star: Series, writer: Writer, velocity: list[Expression], order: int | None
) -> Expression:
    """N − ½ Nᵀ with N = ∂(A* u)/∂q (13), root columns of N zero."""
    size = len(velocity)
    change = {3 + j: up_to(derivative(algebra, A_star, j), order) for j in range(size - 3)}
    cells = []
    for x, z in np.ndindex(size, size):
        entry: Series = {}
        if z in change:
            add(entry, {m: c[:, x] for m, c in change[z].items()})
        if x in change:
            add(entry, {m: c[:, z] for m, c in change[x].items()}, -0.5)
        cells.append(writer.contracted(entry, velocity))
    return sympy.ImmutableDenseMatrix(size, size, cells)


def _root_turning(
    core: _Core, writer: Writer, velocity: list[Expression], order: int | None, terms: Terms
) -> Expression:
    """−[∂T/∂Omega]× in the root's block; with the paper's terms of the rotors' momentum alone."""
    size = len(velocity)
    h = []
    for a in range(3):
        momentum = up_to(apply(core.BtL, lambda c, a=a: c[:, a : a + 1]), order)  # type: ignore[misc]
        h.append(writer.contracted(momentum, [sympy.S.One]))
        if terms == "exact" or order is None:
            carried = up_to(apply(core.A_star, lambda c, a=a: c[:, a]), order)  # type: ignore[misc]
            h[a] += writer.contracted(carried, velocity)
    out = sympy.zeros(size, size)
    out[:3, :3] = sympy.Matrix([[0, h[2], -h[1]], [-h[2], 0, h[0]], [h[1], -h[0], 0]])
    return sympy.ImmutableDenseMatrix(out)


def _rows(known: Parameters, motion: Motion, core: _Core, terms: Terms) -> tuple[row_algebra.Row, ...]:
    names = (tuple(s.name for s in motion.Omega), tuple(s.name for s in motion.Omega_dot))
    carried = core.BtA_RB if terms == "paper" else None
    return row_algebra.gimbal_rows(core.A_star, core.BtL, carried, names, known.element_terms)


def _used(known: Parameters, A: Series, rows: tuple[row_algebra.Row, ...]) -> tuple[NamedSymbol, ...]:
    """Return the parameters without inertias that appear nowhere."""
    seen = np.array([s.kind != "inertia" for s in known.symbols], dtype=bool)
    for coefficient in A.values():
        seen |= coefficient.any(axis=(1, 2))
    for row in rows:
        for forms in row.values():
            for form in forms.values():
                seen |= form != 0.0
    return tuple(symbol for symbol, kept in zip(known.symbols, seen, strict=True) if kept)


def _written_rows(
    full: tuple[row_algebra.Row, ...], known: Parameters, motion: Motion, writer: Writer
) -> dict[str, tuple[RowTerms, ...]]:
    moving = tuple(s.name for s in motion.Omega + motion.Omega_dot)
    kinds = {
        PARTIALLY_LINEAR: full,
        LINEAR: tuple(row_algebra.at_rest(row, moving) for row in full),
        PRECESSION: tuple(row_algebra.without_inertia(row, known.is_momentum | known.is_element) for row in full),
    }
    return {kind: tuple(_written(row, motion, writer) for row in rows) for kind, rows in kinds.items()}


def _written(row: row_algebra.Row, motion: Motion, writer: Writer) -> RowTerms:
    symbols = {"acceleration": motion.accelerations, "rate": motion.rates, "angle": motion.angles}
    out = []
    for kind in ("acceleration", "rate", "angle", "constant"):
        for k in range(len(motion.angles) if kind != "constant" else 1):
            forms: dict[Any, FloatArray] = row.get((kind, k), {})
            coefficient = writer.collected((_product(factors), form) for factors, form in forms.items())
            if coefficient != 0:
                out.append((coefficient, sympy.S.One if kind == "constant" else sympy.Symbol(symbols[kind][k].name)))
    return tuple(out)


def _product(factors: tuple[str, ...]) -> Expression:
    return sympy.Mul(
        *(
            1 / sympy.Symbol(name.removeprefix("1/")) if name.startswith("1/") else sympy.Symbol(name)
            for name in factors
        )
    )


def _column(symbols: tuple[NamedSymbol, ...]) -> Expression:
    return sympy.ImmutableDenseMatrix(len(symbols), 1, [sympy.Symbol(s.name) for s in symbols])


def _specific_force(platform: Platform, names: Names) -> tuple[NamedSymbol, ...]:
    """f1 to f3 and f, where unbalance or an erecting device feels them."""
    if not (platform.unbalances or platform.erections):
        return ()
    f = platform.specific_force
    along = [
        names.parameter(
            "f", str(a + 1), "", "specific force", f"specific force along root axis {a + 1}", "m/s²", float(f[a])
        )
        for a in range(3)
    ]
    size = float(np.linalg.norm(f))
    about = "size of the specific force, sqrt(f1² + f2² + f3²)"
    return (*along, names.parameter("f", "", "", "specific force", about, "m/s²", size))


def _not_too_large(platform: Platform, tree: Topology) -> None:
    n, depth = len(platform.gimbals), int(tree.on_path.sum(axis=1).max(initial=0))
    if n > _MOST_GIMBALS or depth > _DEEPEST:
        raise ArgumentError(
            f"order: None is possible up to {_MOST_GIMBALS} gimbals, {_DEEPEST} deep, not for {n}, {depth} deep; "
            f"take an order from 0 to {HIGHEST_ORDER}"
        )


def _singular(
    platform: Platform, known: Parameters, core: _Core, groups: tuple[tuple[int, ...], ...]
) -> tuple[str, ...]:
    """Say where G_R of a subsystem cannot be inverted, so that (15) does not determine its rates."""
    if not platform.rotors:
        return ()
    numbers = np.array([s.value for s in known.symbols], dtype=np.float64)
    n = len(platform.gimbals)
    zero = np.zeros((len(numbers), 3 + n, 3 + n))
    G_R = np.tensordot(numbers, _gyroscopic(core.algebra, core.BtL, n).get(ONE, zero), axes=1)
    damping = np.zeros(n)
    for term in known.element_terms:
        if term.variable == "rate":
            damping[term.row] += term.coefficient * numbers[term.position]
    found: dict[str, list[str]] = {}
    for group in groups:
        rows = [3 + k for k in group]
        block = G_R[np.ix_(rows, rows)]
        rank, order = _rank(block), len(group)
        if rank == order:
            continue
        odd = " (skew, and of odd order)" if order % 2 else ""
        cured = _rank(block + np.diag(damping[list(group)])) == order
        then = "with the damping of the plant it is regular" if cured else "(15) does not determine the rates: use (27)"
        line = f"is singular at zero angles, order {order}, rank {rank}{odd}; {then}"
        found.setdefault(line, []).append(", ".join(platform.gimbal_names[k] for k in group))
    return tuple(f"G_R of {'; of '.join(names)} {line}" for line, names in found.items())


def _rank(matrix: FloatArray) -> int:
    sizes = np.linalg.svd(matrix, compute_uv=False)
    return int((sizes > _SINGULAR * sizes.max(initial=0.0)).sum()) if sizes.max(initial=0.0) > 0.0 else 0
