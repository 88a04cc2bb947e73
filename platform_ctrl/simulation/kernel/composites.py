"""Subtrees of bodies that lie anywhere: their masses, moments and inertias, the mass matrix of these, and its solution.

Vectors and inertias of a body count from its joint, in its own axes; see `placed` for what they are.
"""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined, internal
from platform_ctrl.common.simd import Number, choose, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import (
    Vector,
    add,
    copy,
    cosine_and_sine,
    from_parent,
    put,
    to_parent,
    vector,
    whole_inertia_to_parent,
)
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.forces import cross, felt_by_root


@inlined
def add_vector(mem: FloatArray, slot: int, x: Number, y: Number, z: Number) -> None:
    """Add to the vector at a slot."""
    add(mem, slot, x)
    add(mem, slot + 1, y)
    add(mem, slot + 2, z)


@internal
def in_parent(links: Links, mem: FloatArray, at: At, m: int, x: Number, y: Number, z: Number) -> Vector:
    """A vector of gimbal m of the order, in the parent's axes."""
    work = at.work + (links.tree[m, arrays.GIMBAL] + 1) * arrays.WORK
    put(mem, at.scratch, 0.0 * x, 0.0 * x, 0.0 * x)
    to_parent(links, mem, m, at.scratch, load(mem, work), load(mem, work + arrays.SIN), x, y, z)
    return vector(mem, at.scratch)


@internal
def in_gimbal(links: Links, mem: FloatArray, at: At, m: int, x: Number, y: Number, z: Number) -> Vector:
    """A vector of the parent, in the axes of gimbal m of the order."""
    work = at.work + (links.tree[m, arrays.GIMBAL] + 1) * arrays.WORK
    put(mem, at.scratch, x, y, z)
    x, y, z = from_parent(links, mem, m, at.scratch)
    c, s = load(mem, work), load(mem, work + arrays.SIN)
    return c * x + s * y, c * y - s * x, z


@internal
def gather(links: Links, mem: FloatArray, at: At, y: int, around: int) -> None:
    """Joints' cosines and sines, specific force, and what the subtrees are about their joints: J, m, S, unbalance."""
    for b in range(at.n + 1):
        work, place, own = at.work + b * arrays.WORK, at.place + b * arrays.PLACE, at.moving + b * arrays.MOVING
        copy(mem, work + arrays.INERTIA, at.body + b * arrays.BODY, 6)
        copy(mem, own + arrays.WHOLE, place + arrays.MASS, 4)
        copy(mem, own + arrays.LOPSIDED, at.body + b * arrays.BODY + arrays.UNBALANCE, 3)
    f0, f1, f2 = felt_by_root(mem, at, y, around)
    put(mem, at.work + arrays.FORCE, f0, f1, f2)
    for m in range(at.n):
        k, up = links.tree[m, arrays.GIMBAL], at.work + links.tree[m, arrays.PARENT] * arrays.WORK
        work = at.work + (k + 1) * arrays.WORK
        c, s = cosine_and_sine(load(mem, y + k))
        store(mem, work + arrays.COS, c)
        store(mem, work + arrays.SIN, s)
        f0, f1, f2 = vector(mem, up + arrays.FORCE)
        f0, f1, f2 = in_gimbal(links, mem, at, m, f0, f1, f2)
        put(mem, work + arrays.FORCE, f0, f1, f2)
    for m in range(at.n - 1, -1, -1):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        own, up = at.moving + b * arrays.MOVING, at.moving + parent * arrays.MOVING
        inertia = at.work + parent * arrays.WORK + arrays.INERTIA
        whole_inertia_to_parent(links, mem, at, m, at.work + b * arrays.WORK + arrays.INERTIA)
        mass = load(mem, own + arrays.WHOLE)
        d0, d1, d2 = vector(mem, at.place + b * arrays.PLACE + arrays.ARM)
        S0, S1, S2 = vector(mem, own + arrays.SUM)
        S0, S1, S2 = in_parent(links, mem, at, m, S0, S1, S2)
        # m (d² 1 - d d') + 2 d.S 1 - d S' - S d'
        e0, e1, e2 = mass * d0 + S0, mass * d1 + S1, mass * d2 + S2
        across = d0 * (e0 + S0) + d1 * (e1 + S1) + d2 * (e2 + S2)
        add_vector(mem, inertia, across - d0 * (e0 + S0), across - d1 * (e1 + S1), across - d2 * (e2 + S2))
        add_vector(mem, inertia + 3, -d0 * e1 - S0 * d1, -d0 * e2 - S0 * d2, -d1 * e2 - S1 * d2)
        add(mem, up + arrays.WHOLE, mass)
        add_vector(mem, up + arrays.SUM, e0, e1, e2)
        u0, u1, u2 = vector(mem, own + arrays.LOPSIDED)
        u0, u1, u2 = in_parent(links, mem, at, m, u0, u1, u2)
        add_vector(mem, up + arrays.LOPSIDED, u0, u1, u2)


@internal
def mass_matrix(links: Links, mem: FloatArray, at: At, locking: bool) -> None:
    """A* and P of what `_gather` found; with `locking` rows and columns of locked joints are those of the unit matrix.

    Column by column: momenta of a subtree that turns at rate 1, from joint to joint toward the root.
    """
    size, A, P, root = at.n + 3, at.matrix, at.push, at.work + arrays.INERTIA
    zero = 0.0 * load(mem, root)
    for i in range(size * size):
        store(mem, A + i, zero)
    for i in range(3):
        store(mem, A + i * size + i, load(mem, root + i))
        for j in range(i):
            product = load(mem, root + 2 + i + j)
            store(mem, A + i * size + j, product)
            store(mem, A + j * size + i, product)
    S0, S1, S2 = vector(mem, at.moving + arrays.SUM)
    put(mem, P, zero, -S2, S1)
    put(mem, P + 3, S2, zero, -S0)
    put(mem, P + 6, -S1, S0, zero)
    for m in range(at.n):
        column = 3 + links.tree[m, arrays.GIMBAL]
        work, own = at.work + (column - 2) * arrays.WORK, at.moving + (column - 2) * arrays.MOVING
        geared = load(mem, at.place + (column - 2) * arrays.PLACE + arrays.GEARED)
        h2, _, h0 = vector(mem, work + arrays.INERTIA + 2)
        h1 = load(mem, work + arrays.INERTIA + 5)
        p1, p0, p2 = load(mem, own + arrays.SUM), -load(mem, own + arrays.SUM + 1), zero
        twice = load(mem, at.place + (column - 2) * arrays.PLACE + arrays.GEARED + 1)
        store(mem, A + column * size + column, h2 + twice)
        walk = m
        while walk >= 0:
            d0, d1, d2 = vector(mem, at.place + (links.tree[walk, arrays.GIMBAL] + 1) * arrays.PLACE + arrays.ARM)
            # The geared rotor's momentum is the parent's.
            h0, h1, h2 = in_parent(links, mem, at, walk, h0, h1, h2 + geared)
            p0, p1, p2 = in_parent(links, mem, at, walk, p0, p1, p2)
            x, y, z = cross(d0, d1, d2, p0, p1, p2)
            h0, h1, h2, geared = h0 + x, h1 + y, h2 + z, zero
            row = 2 + links.tree[walk, arrays.PARENT]
            walk = links.tree[walk, arrays.UP]
            if walk >= 0:
                store(mem, A + row * size + column, h2)
                store(mem, A + column * size + row, h2)
        put(mem, P + 3 * column, p0, p1, p2)
        put(mem, A + column * size, h0, h1, h2)
        for i in range(3):
            store(mem, A + i * size + column, load(mem, A + column * size + i))
    if at.floating != 0:
        ease = 1.0 / load(mem, at.moving + arrays.WHOLE)
        for i in range(size):
            a0, a1, a2 = vector(mem, P + 3 * i)
            for j in range(size):
                b0, b1, b2 = vector(mem, P + 3 * j)
                add(mem, A + i * size + j, -ease * (a0 * b0 + a1 * b1 + a2 * b2))
    for i in range(size * at.modes):
        own = at.mode + i // size * (at.shape + at.torquers) + arrays.INERTIAL
        for j in range(size):
            product = load(mem, own + i % size) * load(mem, own + j)
            add(mem, A + i % size * size + j, -product)
    if locking:
        for k in range(at.n):
            locked = load(mem, at.work + (k + 1) * arrays.WORK + arrays.LOCKED)
            for i in range(size):
                for slot in (A + (3 + k) * size + i, A + i * size + 3 + k):
                    store(mem, slot, load(mem, slot) * (1.0 - locked))
            add(mem, A + (3 + k) * (size + 1), locked)


@internal
def solve(mem: FloatArray, at: At, low: int, right: int) -> None:
    """Solve A[low:, low:] x = right[low:] in place; A is symmetric, A = L D L' takes its place."""
    size, A = at.n + 3, at.matrix
    for j in range(low, size):
        D = load(mem, A + j * size + j)
        ease = choose(D > 0.0, 1.0 / D, float("nan") * D)
        store(mem, A + j * size + j, ease)
        for i in range(j + 1, size):
            share = load(mem, A + i * size + j) * ease
            for c in range(j + 1, i + 1):
                add(mem, A + i * size + c, -share * load(mem, A + c * size + j))
            add(mem, right + i, -share * load(mem, right + j))
    for j in range(size - 1, low - 1, -1):
        rest = load(mem, right + j)
        for i in range(j + 1, size):
            rest = rest - load(mem, A + i * size + j) * load(mem, right + i)
        store(mem, right + j, rest * load(mem, A + j * size + j))
