"""The exact non-linear plant and the sampled closed loop, compiled: bare floats and arrays only.

Everything is written in the root's axes. Bodies are numbered 0 (root) and 1 + k (gimbal k); all turn about one fixed
point, so inertias and angular momenta of a subtree simply add up. With the rates w, the axes a, the carriers'
inertias I (rotors included: A(1 - ss') + C ss' where regulated, A(1 - ss') where free) and h = sum L s of the rotors:

    N = I wdot + w x (I w + h)                            moment of one carrier
    Q_j = a_j . (sum of N over the subtree of j)          joint torque; the root's M is the sum over all bodies
    p_j = a_j . (sum of H = I w + h over the subtree)     joint momentum, eq. (9): dT/dqdot_j
    dT/dq_j = a_j . (H_subtree x w_parent)                only w_parent turns against the frame of j

The root rows are Boltzmann-Hamel's by construction: they are the moment of momentum in turning axes.

The state vector is [q (n), v (3 + n), attitude (4), P (m), x (m)] with v = [Omega, qdot] for a free root and
v = [Omega(t), p] for a prescribed Omega; attitude is the unit quaternion w, x, y, z that takes root axes to inertial
axes. P and x belong to the m servo rotors: axial momentum C (phidot + s . w) and integral of the speed error.

A servo rotor is a free rotor, P s in place of L s, whose momentum the motor changes: Pdot = tau. N of its carrier then
has hdot = tau s besides, in other words the motor's reaction -tau s acts on the carrier. With dT/dqdot as momenta there
is no reaction: the motor's torque does virtual work along phi alone, and dT/dq at constant phidot is that above.

The force elements add to [M, Q]: springs, friction, cages and erections at their gimbals; an unbalance as the moment
-(m r) x f on its carrier, which acts at the root and at every gimbal between the root and the carrier.

A plant is the pair (tree, body), see `platform_ctrl.simulation.plant`. Nothing is allocated inside the time loops.
Non-positive pivots give NaN, which the callers take as divergence.

All compiled functions stand in this one file: numba's cache notices changes of a function's own file only. Flags
are handed down as variables, rows are copied by loops: numba compiles a function anew for every literal, and slice
assignments bring the text of their error messages with them. What belongs to a body stands in one row of one array:
every further array costs its reference count in each call, more than the arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from platform_ctrl.frozen import FloatArray

Tree = NDArray[np.int64]
Flags = NDArray[np.bool_]
Vector = tuple[float, float, float]
F = TypeVar("F", bound=Callable[..., Any])

# Columns of a body's row in the workspace, root axes: the rotation (3 x 3) from 0 on; its axis; inertia (xx, yy, zz,
# xy, xz, yz) and rotors' momentum h, first its own, then its subtree's; rate; moment; I a of the subtree.
AXIS, INERTIA, MOMENTUM, RATE, MOMENT, PER_RATE, COLUMNS = 9, 12, 18, 21, 24, 27, 30

# Columns of a body's row in the plant that are there only where force elements are.
UNBALANCE, STIFFNESS, PRELOAD, VISCOUS, COULOMB, PER_COULOMB_RATE, CAGE = 12, 15, 16, 17, 18, 20, 21


def _compiled(function: F, **options: Any) -> F:
    # error_model="numpy": a vanishing pivot becomes inf or NaN instead of an exception in the middle of a run.
    try:
        return cast(F, njit(cache=True, nogil=True, error_model="numpy", **options)(function))
    except RuntimeError:  # nowhere to keep a cache: compile in every process
        return cast(F, njit(nogil=True, error_model="numpy", **options)(function))


def _internal(function: F) -> F:
    """Compile for callers in this file alone: the wrappers for Python and C take as long as a small function."""
    return _compiled(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _inlined(function: F) -> F:
    return _compiled(function, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True)


def workspace(n: int) -> tuple[FloatArray, FloatArray]:
    """Scratch for n gimbals: a row per body; the mass matrix with the vector of unknowns as its last row."""
    return np.zeros((n + 1, COLUMNS)), np.zeros((n + 4, n + 3))


@_inlined
def _dot(work: FloatArray, b: int, first: int, second: int) -> float:
    """Scalar product of two vectors of body b."""
    x: float = (
        work[b, first] * work[b, second]
        + work[b, first + 1] * work[b, second + 1]
        + work[b, first + 2] * work[b, second + 2]
    )
    return x


@_inlined
def _times_inertia(work: FloatArray, b: int, x: float, y: float, z: float) -> Vector:
    """The inertia of body b times a vector."""
    xx, yy, zz = work[b, INERTIA], work[b, INERTIA + 1], work[b, INERTIA + 2]
    xy, xz, yz = work[b, INERTIA + 3], work[b, INERTIA + 4], work[b, INERTIA + 5]
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@_inlined
def _in_root_axes(work: FloatArray, b: int, x: float, y: float, z: float) -> Vector:
    """A vector given in the axes of body b."""
    return (
        work[b, 0] * x + work[b, 1] * y + work[b, 2] * z,
        work[b, 3] * x + work[b, 4] * y + work[b, 5] * z,
        work[b, 6] * x + work[b, 7] * y + work[b, 8] * z,
    )


@_inlined
def _turn_carrier(work: FloatArray, body: FloatArray, b: int) -> None:
    """Turn body b's inertia and its rotors' momentum into root axes."""
    xx, yy, zz, xy, xz, yz = body[b, 3], body[b, 4], body[b, 5], body[b, 6], body[b, 7], body[b, 8]
    r0, r1, r2 = work[b, 0], work[b, 1], work[b, 2]
    s0, s1, s2 = work[b, 3], work[b, 4], work[b, 5]
    t0, t1, t2 = work[b, 6], work[b, 7], work[b, 8]
    a0, a1, a2 = r0 * xx + r1 * xy + r2 * xz, r0 * xy + r1 * yy + r2 * yz, r0 * xz + r1 * yz + r2 * zz
    b0, b1, b2 = s0 * xx + s1 * xy + s2 * xz, s0 * xy + s1 * yy + s2 * yz, s0 * xz + s1 * yz + s2 * zz
    c0, c1, c2 = t0 * xx + t1 * xy + t2 * xz, t0 * xy + t1 * yy + t2 * yz, t0 * xz + t1 * yz + t2 * zz
    work[b, INERTIA] = a0 * r0 + a1 * r1 + a2 * r2
    work[b, INERTIA + 1] = b0 * s0 + b1 * s1 + b2 * s2
    work[b, INERTIA + 2] = c0 * t0 + c1 * t1 + c2 * t2
    work[b, INERTIA + 3] = a0 * s0 + a1 * s1 + a2 * s2
    work[b, INERTIA + 4] = a0 * t0 + a1 * t1 + a2 * t2
    work[b, INERTIA + 5] = b0 * t0 + b1 * t1 + b2 * t2
    x, y, z = body[b, 9], body[b, 10], body[b, 11]
    work[b, MOMENTUM] = r0 * x + r1 * y + r2 * z
    work[b, MOMENTUM + 1] = s0 * x + s1 * y + s2 * z
    work[b, MOMENTUM + 2] = t0 * x + t1 * y + t2 * z


@_inlined
def _moment_of_carrier(work: FloatArray, b: int) -> None:
    """Replace body b's angular acceleration, kept in MOMENT, by the moment I wdot + w x (I w + h)."""
    w0, w1, w2 = work[b, RATE], work[b, RATE + 1], work[b, RATE + 2]
    H0, H1, H2 = _times_inertia(work, b, w0, w1, w2)
    H0, H1, H2 = H0 + work[b, MOMENTUM], H1 + work[b, MOMENTUM + 1], H2 + work[b, MOMENTUM + 2]
    N0, N1, N2 = _times_inertia(work, b, work[b, MOMENT], work[b, MOMENT + 1], work[b, MOMENT + 2])
    work[b, MOMENT] = N0 + w1 * H2 - w2 * H1
    work[b, MOMENT + 1] = N1 + w2 * H0 - w0 * H2
    work[b, MOMENT + 2] = N2 + w0 * H1 - w1 * H0


@_compiled
def assemble(tree: Tree, body: FloatArray, moments: bool, y: FloatArray, work: FloatArray, mass: FloatArray) -> None:
    """Fill the workspace at a state: axes, subtrees' inertias and momenta, lower triangle of A*.

    With `moments` (free root: v holds the rates) also the moments at zero generalised acceleration, summed over
    the subtrees.
    """
    n = tree.shape[1]
    for i in range(9):
        work[0, i] = 0.0
    work[0, 0], work[0, 4], work[0, 8] = 1.0, 1.0, 1.0
    for i in range(3):
        work[0, RATE + i] = y[n + i]
        work[0, MOMENT + i] = 0.0
        work[0, MOMENTUM + i] = body[0, 9 + i]
    for i in range(6):
        work[0, INERTIA + i] = body[0, 3 + i]
    # A child takes its parent's rate and acceleration before the parent's acceleration turns into a moment below.
    for m in range(n):
        k = tree[0, m]
        b, f = k + 1, tree[1, k]
        x0, x1, x2 = body[b, 0], body[b, 1], body[b, 2]
        c, s = math.cos(y[k]), math.sin(y[k])
        for i in range(3):
            r0, r1, r2 = work[f, 3 * i], work[f, 3 * i + 1], work[f, 3 * i + 2]
            along = r0 * x0 + r1 * x1 + r2 * x2
            work[b, AXIS + i] = along
            along *= 1.0 - c
            work[b, 3 * i] = c * r0 + s * (r1 * x2 - r2 * x1) + along * x0
            work[b, 3 * i + 1] = c * r1 + s * (r2 * x0 - r0 * x2) + along * x1
            work[b, 3 * i + 2] = c * r2 + s * (r0 * x1 - r1 * x0) + along * x2
        _turn_carrier(work, body, b)
        if moments:
            rate = y[n + 3 + k]
            w0, w1, w2 = work[f, RATE], work[f, RATE + 1], work[f, RATE + 2]
            a0, a1, a2 = work[b, AXIS] * rate, work[b, AXIS + 1] * rate, work[b, AXIS + 2] * rate
            work[b, RATE], work[b, RATE + 1], work[b, RATE + 2] = w0 + a0, w1 + a1, w2 + a2
            work[b, MOMENT] = work[f, MOMENT] + w1 * a2 - w2 * a1
            work[b, MOMENT + 1] = work[f, MOMENT + 1] + w2 * a0 - w0 * a2
            work[b, MOMENT + 2] = work[f, MOMENT + 2] + w0 * a1 - w1 * a0
    servos = (y.shape[0] - 2 * n - 7) // 2
    for r in range(servos):
        row, p = n + 1 + r, y[2 * n + 7 + r]
        b = int(body[row, 3])
        s0, s1, s2 = _in_root_axes(work, b, body[row, 0], body[row, 1], body[row, 2])
        work[b, MOMENTUM] += p * s0
        work[b, MOMENTUM + 1] += p * s1
        work[b, MOMENTUM + 2] += p * s2
    if moments:
        for b in range(n + 1):
            _moment_of_carrier(work, b)
    for i in range(3, n + 3):
        for j in range(3, i):
            mass[i, j] = 0.0
    for m in range(n - 1, -1, -1):
        k = tree[0, m]
        b, f = k + 1, tree[1, k]
        F0, F1, F2 = _times_inertia(work, b, work[b, AXIS], work[b, AXIS + 1], work[b, AXIS + 2])
        work[b, PER_RATE], work[b, PER_RATE + 1], work[b, PER_RATE + 2] = F0, F1, F2
        mass[3 + k, 0], mass[3 + k, 1], mass[3 + k, 2] = F0, F1, F2
        up = b
        while up > 0:
            turned = work[up, AXIS] * F0 + work[up, AXIS + 1] * F1 + work[up, AXIS + 2] * F2
            mass[max(up, b) + 2, min(up, b) + 2] = turned
            up = tree[1, up - 1]
        for i in range(INERTIA, RATE):
            work[f, i] += work[b, i]
        for i in range(MOMENT, PER_RATE):
            work[f, i] += work[b, i]
    mass[0, 0], mass[1, 1], mass[2, 2] = work[0, INERTIA], work[0, INERTIA + 1], work[0, INERTIA + 2]
    mass[1, 0], mass[2, 0], mass[2, 1] = work[0, INERTIA + 3], work[0, INERTIA + 4], work[0, INERTIA + 5]


@_inlined
def _factor(mass: FloatArray, low: int) -> None:
    """Cholesky factor, in place, of the rows and columns from `low`; the diagonal holds its reciprocals."""
    size = mass.shape[1]
    for j in range(low, size):
        s = mass[j, j]
        for k in range(low, j):
            s -= mass[j, k] * mass[j, k]
        d = 1.0 / math.sqrt(s)
        mass[j, j] = d
        for i in range(j + 1, size):
            s = mass[i, j]
            for k in range(low, j):
                s -= mass[i, k] * mass[j, k]
            mass[i, j] = s * d


@_inlined
def _solve(mass: FloatArray, low: int) -> None:
    """Solve, in place of the last row, with what `_factor` left in `mass`."""
    size = mass.shape[1]
    for i in range(low, size):
        s = mass[size, i]
        for k in range(low, i):
            s -= mass[i, k] * mass[size, k]
        mass[size, i] = s * mass[i, i]
    for i in range(size - 1, low - 1, -1):
        s = mass[size, i]
        for k in range(i + 1, size):
            s -= mass[k, i] * mass[size, k]
        mass[size, i] = s * mass[i, i]


@_internal
def _push(tree: Tree, work: FloatArray, carrier: int, x: float, y: float, z: float, dy: FloatArray) -> None:
    """Add what a moment on a carrier does to [M, Q] in `dy`."""
    n = tree.shape[1]
    dy[n] += x
    dy[n + 1] += y
    dy[n + 2] += z
    b = carrier
    while b > 0:
        dy[n + 2 + b] += work[b, AXIS] * x + work[b, AXIS + 1] * y + work[b, AXIS + 2] * z
        b = tree[1, b - 1]


@_internal
def _act(tree: Tree, body: FloatArray, servos: int, y: FloatArray, work: FloatArray, dy: FloatArray) -> None:
    """Add [M, Q] of the force elements to `dy` in the place of v; the first n of `dy` hold the gimbals' rates."""
    n = tree.shape[1]
    f0, f1, f2 = body[0, 0], body[0, 1], body[0, 2]
    size = math.sqrt(f0 * f0 + f1 * f1 + f2 * f2)
    for b in range(n + 1):
        u0, u1, u2 = body[b, UNBALANCE], body[b, UNBALANCE + 1], body[b, UNBALANCE + 2]
        if size > 0.0 and (u0 != 0.0 or u1 != 0.0 or u2 != 0.0):
            r0, r1, r2 = _in_root_axes(work, b, u0, u1, u2)
            _push(tree, work, b, r2 * f1 - r1 * f2, r0 * f2 - r2 * f0, r1 * f0 - r0 * f1, dy)
    for k in range(n):
        b, rate = k + 1, dy[k]
        Q = body[b, PRELOAD] - body[b, STIFFNESS] * y[k] - body[b, VISCOUS] * rate
        level = body[b, COULOMB] if rate < 0.0 else body[b, COULOMB + 1]
        if level > 0.0:
            Q -= level * math.tanh(rate * body[b, PER_COULOMB_RATE])
        # No cage is one with infinite clearance.
        stiffness, damping, clearance = body[b, CAGE], body[b, CAGE + 1], body[b, CAGE + 2]
        out = y[k] - body[b, CAGE + 3]
        if clearance == 0.0:
            Q -= stiffness * out + damping * rate
        elif out > clearance:
            Q -= max(stiffness * (out - clearance) + damping * rate, 0.0)
        elif out < -clearance:
            Q -= min(stiffness * (out + clearance) + damping * rate, 0.0)
        dy[n + 3 + k] += Q
    if size > 0.0:
        for row in range(n + 1 + servos, body.shape[0]):
            s0, s1, s2 = _in_root_axes(work, int(body[row, 4]), body[row, 0], body[row, 1], body[row, 2])
            Q = body[row, 5] * (s0 * f0 + s1 * f1 + s2 * f2) / size
            dy[n + 2 + int(body[row, 3])] += min(max(Q, -body[row, 6]), body[row, 6])


@_internal
def _spin(body: FloatArray, y: FloatArray, work: FloatArray, r: int) -> float:
    """Spin of servo rotor r against its carrier, whose rate the workspace holds."""
    n = work.shape[0] - 1
    row = n + 1 + r
    b = int(body[row, 3])
    s0, s1, s2 = _in_root_axes(work, b, body[row, 0], body[row, 1], body[row, 2])
    spin: float = y[2 * n + 7 + r] / body[row, 4] - (
        s0 * work[b, RATE] + s1 * work[b, RATE + 1] + s2 * work[b, RATE + 2]
    )
    return spin


@_internal
def _drive(
    tree: Tree, body: FloatArray, react: bool, servos: int, y: FloatArray, work: FloatArray, dy: FloatArray
) -> None:
    """Derivatives of the servo rotors' states into `dy`, and with `react` the motors' reactions on [M, Q] there."""
    n = tree.shape[1]
    p, x = 2 * n + 7, 2 * n + 7 + servos
    for r in range(servos):
        row = n + 1 + r
        error = _spin(body, y, work, r) - body[row, 5]
        wanted = -body[row, 6] * error - body[row, 7] * y[x + r]
        limit = body[row, 8]
        torque = min(max(wanted, -limit), limit)
        further = (wanted >= limit and error < 0.0) or (wanted <= -limit and error > 0.0)
        dy[p + r] = torque
        dy[x + r] = 0.0 if further else error
        if react:
            b = int(body[row, 3])
            s0, s1, s2 = _in_root_axes(work, b, body[row, 0], body[row, 1], body[row, 2])
            _push(tree, work, b, -torque * s0, -torque * s1, -torque * s2, dy)


@_compiled
def derivative(
    tree: Tree,
    body: FloatArray,
    free: bool,
    locked: Flags,
    y: FloatArray,
    force: FloatArray,
    row: int,
    work: FloatArray,
    mass: FloatArray,
    dy: FloatArray,
) -> None:
    """Derivative of the state vector under the generalised force [M, Q] in `force[row]`; leaves `mass` factored.

    With a prescribed Omega, v[:3] must hold its value at this instant. A gimbal that is `locked` does not turn: its
    row gives way to qdot = const (free root) or qdot = 0 (prescribed Omega; its momentum then means nothing).
    """
    n = tree.shape[1]
    x = n + 3
    servos = (y.shape[0] - 2 * n - 7) // 2
    acting = body.shape[1] > UNBALANCE
    assemble(tree, body, free, y, work, mass)
    for k in range(n):
        if locked[k]:
            for i in range(n + 3):
                mass[max(i, 3 + k), min(i, 3 + k)] = 0.0
            mass[3 + k, 3 + k] = 1.0
    W0, W1, W2 = y[n], y[n + 1], y[n + 2]
    if free:
        for i in range(3):
            mass[x, i] = force[row, i] - work[0, MOMENT + i]
        for k in range(n):
            mass[x, 3 + k] = force[row, 3 + k] - _dot(work, k + 1, AXIS, MOMENT)
            dy[k] = 0.0 if locked[k] else y[n + 3 + k]
        if acting or servos > 0:
            for i in range(n + 3):
                dy[n + i] = 0.0
            if acting:
                _act(tree, body, servos, y, work, dy)
            if servos > 0:
                _drive(tree, body, free, servos, y, work, dy)
            for i in range(n + 3):
                mass[x, i] += dy[n + i]
        for k in range(n):
            if locked[k]:
                mass[x, 3 + k] = 0.0
        _factor(mass, 0)
        _solve(mass, 0)
        for i in range(n + 3):
            dy[n + i] = mass[x, i]
    else:
        for k in range(n):
            b = k + 1
            carried = work[b, PER_RATE] * W0 + work[b, PER_RATE + 1] * W1 + work[b, PER_RATE + 2] * W2
            own = y[n + 3 + k] - carried - _dot(work, b, AXIS, MOMENTUM)
            mass[x, 3 + k] = 0.0 if locked[k] else own
        _factor(mass, 3)
        _solve(mass, 3)
        for m in range(n):
            k = tree[0, m]
            b, f = k + 1, tree[1, k]
            rate = mass[x, 3 + k]
            dy[k] = rate
            for i in range(3):
                work[b, RATE + i] = work[f, RATE + i] + work[b, AXIS + i] * rate
                work[b, MOMENT + i] = 0.0
        # MOMENT becomes the angular momentum of the subtree: as one body, and what the joints below add to that.
        for m in range(n - 1, -1, -1):
            k = tree[0, m]
            b, f = k + 1, tree[1, k]
            H0, H1, H2 = _times_inertia(work, b, work[b, RATE], work[b, RATE + 1], work[b, RATE + 2])
            below0, below1, below2 = work[b, MOMENT], work[b, MOMENT + 1], work[b, MOMENT + 2]
            H0 += work[b, MOMENTUM] + below0
            H1 += work[b, MOMENTUM + 1] + below1
            H2 += work[b, MOMENTUM + 2] + below2
            p0, p1, p2 = work[f, RATE], work[f, RATE + 1], work[f, RATE + 2]
            dy[n + 3 + k] = (
                force[row, 3 + k]
                + work[b, AXIS] * (H1 * p2 - H2 * p1)
                + work[b, AXIS + 1] * (H2 * p0 - H0 * p2)
                + work[b, AXIS + 2] * (H0 * p1 - H1 * p0)
            )
            rate = mass[x, 3 + k]
            work[f, MOMENT] += below0 + work[b, PER_RATE] * rate
            work[f, MOMENT + 1] += below1 + work[b, PER_RATE + 1] * rate
            work[f, MOMENT + 2] += below2 + work[b, PER_RATE + 2] * rate
            work[b, MOMENT], work[b, MOMENT + 1], work[b, MOMENT + 2] = H0, H1, H2
        if acting:
            _act(tree, body, servos, y, work, dy)
        if servos > 0:
            _drive(tree, body, free, servos, y, work, dy)
        for i in range(3):
            dy[n + i] = 0.0
    e = 2 * n + 3
    e0, e1, e2, e3 = 0.5 * y[e], 0.5 * y[e + 1], 0.5 * y[e + 2], 0.5 * y[e + 3]
    dy[e] = -e1 * W0 - e2 * W1 - e3 * W2
    dy[e + 1] = e0 * W0 + e2 * W2 - e3 * W1
    dy[e + 2] = e0 * W1 + e3 * W0 - e1 * W2
    dy[e + 3] = e0 * W2 + e1 * W1 - e2 * W0


@_compiled
def joint_momenta(
    tree: Tree, body: FloatArray, moments: bool, y: FloatArray, work: FloatArray, mass: FloatArray, p: FloatArray
) -> None:
    """Joint momenta dT/dqdot of a state whose v holds the rates; `moments` as in `assemble`."""
    n = tree.shape[1]
    assemble(tree, body, moments, y, work, mass)
    for k in range(n):
        s = _dot(work, k + 1, AXIS, MOMENTUM)
        for i in range(n + 3):
            s += mass[max(3 + k, i), min(3 + k, i)] * y[n + i]
        p[k] = s


@_compiled
def rotor_spins(tree: Tree, body: FloatArray, moments: bool, states: FloatArray, spins: FloatArray) -> None:
    """Spins (N, m) of the servo rotors in `states` (N, 2 n + 7 + 2 m) whose v holds the rates; `moments` is True."""
    n = tree.shape[1]
    work, mass = np.zeros((n + 1, COLUMNS)), np.zeros((n + 4, n + 3))
    for k in range(states.shape[0]):
        assemble(tree, body, moments, states[k], work, mass)
        for r in range(spins.shape[1]):
            spins[k, r] = _spin(body, states[k], work, r)


@_internal
def rk4_step(
    tree: Tree,
    body: FloatArray,
    free: bool,
    locked: Flags,
    y: FloatArray,
    Omega: FloatArray,
    force: FloatArray,
    step: float,
    work: FloatArray,
    mass: FloatArray,
    stages: FloatArray,
) -> None:
    """One step of the classical Runge-Kutta method, in place.

    `force` (3, 3 + n) and, for a prescribed rate, `Omega` (3, 3) hold the values at the step's beginning, middle and
    end; `stages` (3, size of y) is scratch.
    """
    n = tree.shape[1]
    size = y.shape[0]
    at, dy, total = stages[0], stages[1], stages[2]
    for i in range(size):
        at[i] = y[i]
        total[i] = 0.0
    for s in range(4):
        row = (s + 1) // 2
        if not free:
            for i in range(3):
                at[n + i] = Omega[row, i]
        derivative(tree, body, free, locked, at, force, row, work, mass, dy)
        weight = 1.0 if s == 0 or s == 3 else 2.0
        ahead = step if s == 2 else 0.5 * step
        for i in range(size):
            total[i] += weight * dy[i]
            at[i] = y[i] + ahead * dy[i]
    norm = 0.0
    for i in range(size):
        y[i] += step / 6.0 * total[i]
    for i in range(2 * n + 3, 2 * n + 7):
        norm += y[i] * y[i]
    norm = 1.0 / math.sqrt(norm)
    for i in range(2 * n + 3, 2 * n + 7):
        y[i] *= norm
    if not free:
        for i in range(3):
            y[n + i] = Omega[2, i]


@_compiled
def advance(
    tree: Tree, body: FloatArray, free: bool, states: FloatArray, force: FloatArray, step: float, steps: int
) -> None:
    """Move every row of `states` (N, 2 n + 7 + 2 m) on by `steps` steps with its `force` (N, 3 + n) held.

    `free` is True: with a prescribed Omega use `closed_loop`.
    """
    n = tree.shape[1]
    work, mass = np.zeros((n + 1, COLUMNS)), np.zeros((n + 4, n + 3))
    stages = np.empty((3, states.shape[1]))
    held = np.empty((3, n + 3))
    Omega = np.zeros((3, 3))
    locked = np.zeros(n, dtype=np.bool_)
    for r in range(states.shape[0]):
        for i in range(n + 3):
            held[0, i] = held[1, i] = held[2, i] = force[r, i]
        y = states[r]
        for _ in range(steps):
            rk4_step(tree, body, free, locked, y, Omega, held, step, work, mass, stages)


@_compiled
def half_cosine(t: float, profile: FloatArray, Omega: FloatArray) -> None:
    """Omega at t; `profile` is the rate vector, the rise and the hold."""
    rise, hold = profile[3], profile[4]
    share = 0.0
    if t < 0.0 or t > 2.0 * rise + hold:
        share = 0.0
    elif t < rise:
        share = 0.5 - 0.5 * math.cos(math.pi * t / rise)
    elif t <= rise + hold:
        share = 1.0
    else:
        share = 0.5 - 0.5 * math.cos(math.pi * (2.0 * rise + hold - t) / rise)
    for i in range(3):
        Omega[i] = share * profile[i]


@_internal
def _hold(
    tree: Tree,
    body: FloatArray,
    free: bool,
    y: FloatArray,
    begin: FloatArray,
    Omega: FloatArray,
    force: FloatArray,
    step: float,
    stops: FloatArray,
    touching: Flags,
    locked: Flags,
    work: FloatArray,
    mass: FloatArray,
    stages: FloatArray,
) -> None:
    """Repeat a step from `begin` with those gimbals locked that lay at a stop and have gone past it."""
    n = tree.shape[1]
    pressed = False
    for k in range(n):
        locked[k] = touching[k] and (y[k] < stops[k, 0] or y[k] > stops[k, 1])
        pressed = pressed or locked[k]
    if not pressed:
        return
    for i in range(y.shape[0]):
        y[i] = begin[i]
    rk4_step(tree, body, free, locked, y, Omega, force, step, work, mass, stages)
    if not free:
        derivative(tree, body, free, locked, y, force, force.shape[0] - 1, work, mass, stages[1])
        for k in range(n):
            if locked[k]:
                y[n + 3 + k] = _dot(work, k + 1, AXIS, MOMENT)


@_internal
def _meet_stops(
    tree: Tree,
    body: FloatArray,
    free: bool,
    y: FloatArray,
    stops: FloatArray,
    touching: Flags,
    locked: Flags,
    contacts: NDArray[np.int64],
    zero: FloatArray,
    work: FloatArray,
    mass: FloatArray,
    dy: FloatArray,
) -> None:
    """Put every gimbal that has gone past its stop back on it: a perfectly inelastic impact."""
    n = tree.shape[1]
    hit = False
    for k in range(n):
        past = y[k] < stops[k, 0] or y[k] > stops[k, 1]
        if past:
            hit = True
            y[k] = min(max(y[k], stops[k, 0]), stops[k, 1])
            if not touching[k]:
                contacts[k] += 1
        touching[k] = past or locked[k]
        locked[k] = False
    if not hit:
        return
    derivative(
        tree, body, free, locked, y, zero, zero.shape[0] - 1, work, mass, dy
    )  # dy[:n] = qdot, and the factored mass matrix
    low, x = 0 if free else 3, n + 3
    # Impulses in turn until no gimbal that touches moves outwards; one pass does it for one contact.
    for _ in range(100):
        settled = True
        for k in range(n):
            outward = dy[k] if y[k] >= stops[k, 1] else -dy[k]
            if not touching[k] or outward <= 1e-12:
                continue
            settled = False
            for i in range(n + 3):
                mass[x, i] = 0.0
            mass[x, 3 + k] = 1.0
            _solve(mass, low)
            impulse = -dy[k] / mass[x, 3 + k]
            for j in range(n):
                dy[j] += impulse * mass[x, 3 + j]
            if free:
                for i in range(n + 3):
                    y[n + i] += impulse * mass[x, i]
            else:
                y[n + 3 + k] += impulse
        if settled:
            return


@_compiled
def closed_loop(
    tree: Tree,
    body: FloatArray,
    free: bool,
    y: FloatArray,
    profile: FloatArray,
    root_torque: FloatArray,
    controller: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    pickoffs: tuple[NDArray[np.int64], FloatArray, FloatArray],
    torquers: tuple[NDArray[np.int64], FloatArray, FloatArray],
    stops: FloatArray,
    period: float,
    whole: int,
    segments: tuple[NDArray[np.int64], FloatArray],
    records: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    saturated: NDArray[np.int64],
    contacts: NDArray[np.int64],
) -> int:
    """Run the sampled loop; return how many samples were recorded before the run ended.

    Parameters
    ----------
    controller
        One discrete state space from all readings to all torquers' commands.
    pickoffs
        Gimbal index, noise (samples, pick-offs), quantisation.
    torquers
        Index into [M, Q], limit (inf: none), decay of the lag over half a substep (2 segments, torquers).
    whole, segments
        A period has two segments, before and after the command changes: number of substeps and substep. The first
        holds the command of `whole` + 1 samples ago, the second that of `whole` samples ago.
    records
        q, v = [Omega, qdot], p, attitude with reading behind it, command, torque, the servo rotors' spins with their
        motors' torques behind them; a row per sample.
    """
    Ac, Bc, Cc, Dc = controller
    sensed, noise, quantisation = pickoffs
    target, limit, decay = torquers
    count, steps = segments
    out_q, out_v, out_p, out_attitude, out_command, out_torque, out_rotors = records
    n, nx, ny, nu = tree.shape[1], Ac.shape[0], sensed.shape[0], target.shape[0]
    samples: int = out_q.shape[0]
    work, mass = np.zeros((n + 1, COLUMNS)), np.zeros((n + 4, n + 3))
    size = y.shape[0]
    servos = (size - 2 * n - 7) // 2
    stages = np.empty((3, size))
    dy = np.empty(size)
    force = np.zeros((3, n + 3))
    zero = np.zeros((1, n + 3))
    Omega = np.zeros((3, 3))
    x, x_next = np.zeros(nx), np.zeros(nx)
    torque, held = np.zeros(nu), np.zeros(nu)
    touching, locked = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    begin = np.empty(size)
    fastest = 1.0 / max(steps[0], steps[1])
    for k in range(samples):
        # Rates and momenta at the sample.
        if free:
            joint_momenta(tree, body, free, y, work, mass, out_p[k])
            for i in range(n):
                dy[i] = y[n + 3 + i]
            if servos > 0:
                _drive(tree, body, free, servos, y, work, dy)
        else:
            half_cosine(k * period, profile, y[n : n + 3])
            derivative(tree, body, free, locked, y, zero, zero.shape[0] - 1, work, mass, dy)
            for i in range(n):
                out_p[k, i] = y[n + 3 + i]
        for i in range(n):
            out_q[k, i] = y[i]
            out_v[k, 3 + i] = dy[i]
        for i in range(3):
            out_v[k, i] = y[n + i]
        for i in range(4):
            out_attitude[k, i] = y[2 * n + 3 + i]
        for i in range(servos):
            out_rotors[k, i] = _spin(body, y, work, i)
            out_rotors[k, servos + i] = dy[2 * n + 7 + i]
        for i in range(size):
            if not math.isfinite(y[i]):
                return k
        for i in range(n + 3):
            if not abs(out_v[k, i]) < fastest:
                return k
        # The controllers.
        reading = out_attitude[k, 4:]
        for i in range(ny):
            reading[i] = y[sensed[i]] + noise[k, i]
            if quantisation[i] > 0.0:
                reading[i] = quantisation[i] * math.floor(reading[i] / quantisation[i] + 0.5)
        command = out_command[k]
        for i in range(nu):
            s = 0.0
            for j in range(nx):
                s += Cc[i, j] * x[j]
            for j in range(ny):
                s += Dc[i, j] * reading[j]
            if not math.isfinite(s):
                return k
            command[i] = s
            if abs(s) >= limit[i]:
                saturated[i] += 1
        for i in range(nx):
            s = 0.0
            for j in range(nx):
                s += Ac[i, j] * x[j]
            for j in range(ny):
                s += Bc[i, j] * reading[j]
            x_next[i] = s
        x, x_next = x_next, x
        # The plant up to the next sample.
        start = k * period
        for g in range(2):
            if g == 1 or count[0] > 0:
                source = k - whole - 1 + g
                for i in range(nu):
                    held[i] = min(max(out_command[source, i], -limit[i]), limit[i]) if source >= 0 else 0.0
                    if decay[g, i] == 0.0:
                        torque[i] = held[i]
            if (g == 0 and count[0] > 0) or (g == 1 and count[0] == 0):
                for i in range(nu):
                    out_torque[k, i] = torque[i]
            if k == samples - 1:
                continue
            h = steps[g]
            for m in range(count[g]):
                for s in range(3):
                    for i in range(n + 3):
                        force[s, i] = root_torque[i] if i < 3 else 0.0
                    for i in range(nu):
                        force[s, target[i]] += torque[i]
                    if s < 2:
                        for i in range(nu):
                            torque[i] = held[i] + (torque[i] - held[i]) * decay[g, i]
                    if not free:
                        half_cosine(start + (m + 0.5 * s) * h, profile, Omega[s])
                for i in range(size):
                    begin[i] = y[i]
                rk4_step(tree, body, free, locked, y, Omega, force, h, work, mass, stages)
                _hold(tree, body, free, y, begin, Omega, force, h, stops, touching, locked, work, mass, stages)
                _meet_stops(tree, body, free, y, stops, touching, locked, contacts, zero, work, mass, dy)
            start += count[g] * h
    return samples
