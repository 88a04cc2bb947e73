"""Vectors and inertias in the memory of a run, and their way between a gimbal's axes and its parent's."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined
from platform_ctrl.common.simd import Number, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import At, Links

Vector = tuple[Number, Number, Number]


@inlined
def vector(mem: FloatArray, lane: int, slot: int) -> Vector:
    """Return the vector at a slot."""
    return load(mem, slot, lane), load(mem, slot + 1, lane), load(mem, slot + 2, lane)


@inlined
def put(mem: FloatArray, lane: int, slot: int, x: Number, y: Number, z: Number) -> None:
    """Store a vector at a slot."""
    store(mem, slot, lane, x)
    store(mem, slot + 1, lane, y)
    store(mem, slot + 2, lane, z)


@inlined
def add(mem: FloatArray, lane: int, slot: int, number: Number) -> None:
    """Add to the number at a slot."""
    store(mem, slot, lane, load(mem, slot, lane) + number)


@inlined
def from_parent(links: Links, mem: FloatArray, lane: int, m: int, slot: int) -> Vector:
    """A vector of the parent, in the axes that gimbal m of the order has at q = 0."""
    tree, turn = links.tree, links.turn
    x, y, z = (
        load(mem, slot + tree[m, arrays.X], lane),
        load(mem, slot + tree[m, arrays.Y], lane),
        load(mem, slot + tree[m, arrays.Z], lane),
    )
    if tree[m, arrays.SKEW] != 0:
        return (
            turn[m, 0, 0] * x + turn[m, 0, 1] * y + turn[m, 0, 2] * z,
            turn[m, 1, 0] * x + turn[m, 1, 1] * y + turn[m, 1, 2] * z,
            turn[m, 2, 0] * x + turn[m, 2, 1] * y + turn[m, 2, 2] * z,
        )
    return x, y, z


@inlined
def to_parent(
    links: Links, mem: FloatArray, lane: int, m: int, slot: int, c: Number, s: Number, x: Number, y: Number, z: Number
) -> None:
    """Add a vector of gimbal m of the order to one of its parent."""
    tree, turn = links.tree, links.turn
    x, y = c * x - s * y, s * x + c * y
    if tree[m, arrays.SKEW] != 0:
        for i in range(3):
            add(mem, lane, slot + i, turn[m, 0, i] * x + turn[m, 1, i] * y + turn[m, 2, i] * z)
    else:
        add(mem, lane, slot + tree[m, arrays.X], x)
        add(mem, lane, slot + tree[m, arrays.Y], y)
        add(mem, lane, slot + tree[m, arrays.Z], z)


@inlined
def times(mem: FloatArray, lane: int, slot: int, x: Number, y: Number, z: Number) -> Vector:
    """The inertia at `slot` times a vector."""
    xx, yy, zz = vector(mem, lane, slot)
    xy, xz, yz = vector(mem, lane, slot + 3)
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@inlined
def whole_inertia_to_parent(links: Links, mem: FloatArray, lane: int, at: At, m: int, slot: int) -> None:
    """Add the articulated inertia at `slot`, all six of it, to the parent's: skew axes and locked joints."""
    tree, turn = links.tree, links.turn
    work = slot - arrays.INERTIA
    c, s = load(mem, work + arrays.COS, lane), load(mem, work + arrays.SIN, lane)
    xx, yy, zz = vector(mem, lane, slot)
    xy, xz, yz = vector(mem, lane, slot + 3)
    a, b = c * xx - s * xy, c * xy - s * yy
    trace = xx + yy
    xx, xy = c * a - s * b, s * a + c * b
    yy = trace - xx
    xz, yz = c * xz - s * yz, s * xz + c * yz
    up = at.work + tree[m, arrays.PARENT] * arrays.WORK + arrays.INERTIA
    if tree[m, arrays.SKEW] != 0:
        for i in range(3):
            ax, ay, az = turn[m, 0, i], turn[m, 1, i], turn[m, 2, i]
            u, v, w = xx * ax + xy * ay + xz * az, xy * ax + yy * ay + yz * az, xz * ax + yz * ay + zz * az
            add(mem, lane, up + i, ax * u + ay * v + az * w)
            for j in range(i):
                turned = turn[m, 0, j] * u + turn[m, 1, j] * v + turn[m, 2, j] * w
                add(mem, lane, up + 2 + i + j, turned)  # xy 3, xz 4, yz 5
    else:
        add(mem, lane, up + tree[m, arrays.XX], xx)
        add(mem, lane, up + tree[m, arrays.YY], yy)
        add(mem, lane, up + tree[m, arrays.ZZ], zz)
        add(mem, lane, up + tree[m, arrays.XY], xy)
        add(mem, lane, up + tree[m, arrays.XZ], xz)
        add(mem, lane, up + tree[m, arrays.YZ], yz)
