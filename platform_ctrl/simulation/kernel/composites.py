"""Subtrees of bodies that lie anywhere: their masses, moments and inertias, the mass matrix of these, and its solution.

Vectors and inertias of a body count from its joint, in its own axes; see `placed` for what they are.
"""

from __future__ import annotations

from platform_ctrl.common.compiling import internal
from platform_ctrl.common.simd import choose, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.axes import from_parent, to_parent, whole_inertia_to_parent
from platform_ctrl.simulation.kernel.forces import felt_by_root
from platform_ctrl.simulation.kernel.slots import add, add_vector, copy, put, vector
from platform_ctrl.simulation.kernel.vectors import Vector, cross, dot, plus, scaled, turned


@internal
def in_parent(links: Links, mem: FloatArray, at: At, m: int, a: Vector) -> Vector:
    """A vector of gimbal m of the order, in the parent's axes."""
    work = at.work + (links.tree[m, arrays.GIMBAL] + 1) * arrays.WORK
    put(mem, at.scratch, scaled(0.0, a))
    to_parent(links, mem, m, at.scratch, load(mem, work), load(mem, work + arrays.SIN), a)
    return vector(mem, at.scratch)


@internal
def in_gimbal(links: Links, mem: FloatArray, at: At, m: int, a: Vector) -> Vector:
    """A vector of the parent, in the axes of gimbal m of the order."""
    work = at.work + (links.tree[m, arrays.GIMBAL] + 1) * arrays.WORK
    put(mem, at.scratch, a)
    return turned(load(mem, work), load(mem, work + arrays.SIN), from_parent(links, mem, m, at.scratch))


@internal
def gather(links: Links, mem: FloatArray, at: At, y: int, around: int) -> None:
    """Joints' cosines and sines, specific force, and what the subtrees are about their joints: J, m, S, unbalance."""
    for b in range(at.n + 1):
        work, place, own = at.work + b * arrays.WORK, at.place + b * arrays.PLACE, at.moving + b * arrays.MOVING
        copy(mem, work + arrays.INERTIA, at.body + b * arrays.BODY, 6)
        copy(mem, own + arrays.WHOLE, place + arrays.MASS, 4)
        copy(mem, own + arrays.LOPSIDED, at.body + b * arrays.BODY + arrays.UNBALANCE, 3)
    put(mem, at.work + arrays.FORCE, felt_by_root(mem, at, y, around))
    for m in range(at.n):
        k, up = links.tree[m, arrays.GIMBAL], at.work + links.tree[m, arrays.PARENT] * arrays.WORK
        work = at.work + (k + 1) * arrays.WORK
        c, s = cosine_and_sine(load(mem, y + k))
        store(mem, work + arrays.COS, c)
        store(mem, work + arrays.SIN, s)
        put(mem, work + arrays.FORCE, in_gimbal(links, mem, at, m, vector(mem, up + arrays.FORCE)))
    for m in range(at.n - 1, -1, -1):
        b, parent = links.tree[m, arrays.GIMBAL] + 1, links.tree[m, arrays.PARENT]
        own, up = at.moving + b * arrays.MOVING, at.moving + parent * arrays.MOVING
        inertia = at.work + parent * arrays.WORK + arrays.INERTIA
        whole_inertia_to_parent(links, mem, at, m, at.work + b * arrays.WORK + arrays.INERTIA)
        mass = load(mem, own + arrays.WHOLE)
        d, S = vector(mem, at.place + b * arrays.PLACE + arrays.ARM), vector(mem, own + arrays.SUM)
        S = in_parent(links, mem, at, m, S)
        # m (d² 1 - d d') + 2 d.S 1 - d S' - S d'
        e = plus(scaled(mass, d), S)
        f = plus(e, S)
        across = dot(d, f)
        add_vector(mem, inertia, (across - d[0] * f[0], across - d[1] * f[1], across - d[2] * f[2]))
        xy, xz, yz = -d[0] * e[1] - S[0] * d[1], -d[0] * e[2] - S[0] * d[2], -d[1] * e[2] - S[1] * d[2]
        add_vector(mem, inertia + 3, (xy, xz, yz))
        add(mem, up + arrays.WHOLE, mass)
        add_vector(mem, up + arrays.SUM, e)
        add_vector(mem, up + arrays.LOPSIDED, in_parent(links, mem, at, m, vector(mem, own + arrays.LOPSIDED)))


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
    put(mem, P, (zero, -S2, S1))
    put(mem, P + 3, (S2, zero, -S0))
    put(mem, P + 6, (-S1, S0, zero))
    for m in range(at.n):
        column = 3 + links.tree[m, arrays.GIMBAL]
        work, own = at.work + (column - 2) * arrays.WORK, at.moving + (column - 2) * arrays.MOVING
        geared = load(mem, at.place + (column - 2) * arrays.PLACE + arrays.GEARED)
        zz, _, xz = vector(mem, work + arrays.INERTIA + 2)
        p = -load(mem, own + arrays.SUM + 1), load(mem, own + arrays.SUM), zero
        twice = load(mem, at.place + (column - 2) * arrays.PLACE + arrays.GEARED + 1)
        store(mem, A + column * size + column, zz + twice)
        # The geared rotor's momentum is the parent's.
        h, walk = (xz, load(mem, work + arrays.INERTIA + 5), zz + geared), m
        while walk >= 0:
            arm = vector(mem, at.place + (links.tree[walk, arrays.GIMBAL] + 1) * arrays.PLACE + arrays.ARM)
            p = in_parent(links, mem, at, walk, p)
            h = plus(in_parent(links, mem, at, walk, h), cross(arm, p))
            row = 2 + links.tree[walk, arrays.PARENT]
            walk = links.tree[walk, arrays.UP]
            if walk >= 0:
                store(mem, A + row * size + column, h[2])
                store(mem, A + column * size + row, h[2])
        put(mem, P + 3 * column, p)
        put(mem, A + column * size, h)
        for i in range(3):
            store(mem, A + i * size + column, load(mem, A + column * size + i))
    if at.floating != 0:
        ease = 1.0 / load(mem, at.moving + arrays.WHOLE)
        for i in range(size):
            for j in range(size):
                add(mem, A + i * size + j, -ease * dot(vector(mem, P + 3 * i), vector(mem, P + 3 * j)))
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
