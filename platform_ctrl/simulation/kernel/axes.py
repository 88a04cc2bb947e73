"""From the axes of a body to those of its parent, and back."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined
from platform_ctrl.common.simd import Number, load
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import At, Links
from platform_ctrl.simulation.kernel.slots import add, vector
from platform_ctrl.simulation.kernel.vectors import Vector


@inlined
def from_parent(links: Links, mem: FloatArray, m: int, slot: int) -> Vector:
    """A vector of the parent, in the axes that gimbal m of the order has at q = 0."""
    tree, turn = links.tree, links.turn
    i, j, k = slot + tree[m, arrays.X], slot + tree[m, arrays.Y], slot + tree[m, arrays.Z]
    x, y, z = load(mem, i), load(mem, j), load(mem, k)
    if tree[m, arrays.SKEW] != 0:
        return (
            turn[m, 0, 0] * x + turn[m, 0, 1] * y + turn[m, 0, 2] * z,
            turn[m, 1, 0] * x + turn[m, 1, 1] * y + turn[m, 1, 2] * z,
            turn[m, 2, 0] * x + turn[m, 2, 1] * y + turn[m, 2, 2] * z,
        )
    return x, y, z


@inlined
def to_parent(links: Links, mem: FloatArray, m: int, slot: int, c: Number, s: Number, a: Vector) -> None:
    """Add a vector of gimbal m of the order to one of its parent."""
    tree, turn = links.tree, links.turn
    x, y, z = c * a[0] - s * a[1], s * a[0] + c * a[1], a[2]
    if tree[m, arrays.SKEW] != 0:
        for i in range(3):
            add(mem, slot + i, turn[m, 0, i] * x + turn[m, 1, i] * y + turn[m, 2, i] * z)
    else:
        add(mem, slot + tree[m, arrays.X], x)
        add(mem, slot + tree[m, arrays.Y], y)
        add(mem, slot + tree[m, arrays.Z], z)


@inlined
def whole_inertia_to_parent(links: Links, mem: FloatArray, at: At, m: int, slot: int) -> None:
    """Add the articulated inertia at `slot`, all six of it, to the parent's: skew axes and locked joints."""
    tree, turn = links.tree, links.turn
    work = slot - arrays.INERTIA
    c, s = load(mem, work + arrays.COS), load(mem, work + arrays.SIN)
    xx, yy, zz = vector(mem, slot)
    xy, xz, yz = vector(mem, slot + 3)
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
            add(mem, up + i, ax * u + ay * v + az * w)
            for j in range(i):
                turned = turn[m, 0, j] * u + turn[m, 1, j] * v + turn[m, 2, j] * w
                add(mem, up + 2 + i + j, turned)  # xy 3, xz 4, yz 5
    else:
        add(mem, up + tree[m, arrays.XX], xx)
        add(mem, up + tree[m, arrays.YY], yy)
        add(mem, up + tree[m, arrays.ZZ], zz)
        add(mem, up + tree[m, arrays.XY], xy)
        add(mem, up + tree[m, arrays.XZ], xz)
        add(mem, up + tree[m, arrays.YZ], yz)
