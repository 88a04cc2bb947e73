"""Numbers, vectors and inertias in the memory of a run."""

from __future__ import annotations

from platform_ctrl.common.compiling import hand_on_by_reference, inlined
from platform_ctrl.common.simd import Mask, Number, choose, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.vectors import Vector, dot

hand_on_by_reference(arrays.At, arrays.Layout, arrays.Links, arrays.PlacedLinks, arrays.Shared)


@inlined
def vector(mem: FloatArray, slot: int) -> Vector:
    """Return the vector at a slot."""
    return load(mem, slot), load(mem, slot + 1), load(mem, slot + 2)


@inlined
def put(mem: FloatArray, slot: int, a: Vector) -> None:
    """Store a vector at a slot."""
    store(mem, slot, a[0])
    store(mem, slot + 1, a[1])
    store(mem, slot + 2, a[2])


@inlined
def put_where(mem: FloatArray, slot: int, mask: Mask, number: Number) -> None:
    """Store a number at a slot of the scenarios where the mask holds."""
    store(mem, slot, choose(mask, number, load(mem, slot)))


@inlined
def copy(mem: FloatArray, slot: int, source: int, count: int) -> None:
    """Store the numbers at some slots, from `source` on, at as many from `slot` on."""
    for i in range(count):
        store(mem, slot + i, load(mem, source + i))


@inlined
def add(mem: FloatArray, slot: int, number: Number) -> None:
    """Add to the number at a slot."""
    store(mem, slot, load(mem, slot) + number)


@inlined
def add_vector(mem: FloatArray, slot: int, a: Vector) -> None:
    """Add to the vector at a slot."""
    add(mem, slot, a[0])
    add(mem, slot + 1, a[1])
    add(mem, slot + 2, a[2])


@inlined
def times(mem: FloatArray, slot: int, a: Vector) -> Vector:
    """The inertia at `slot` times a vector."""
    xx, yy, zz = vector(mem, slot)
    xy, xz, yz = vector(mem, slot + 3)
    return dot((xx, xy, xz), a), dot((xy, yy, yz), a), dot((xz, yz, zz), a)
