"""Vectors of the kernel: three numbers."""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined
from platform_ctrl.common.simd import Number

Vector = tuple[Number, Number, Number]


@inlined
def plus(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def minus(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def scaled(factor: Number, a: Vector) -> Vector:
    """A number times a vector."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def dot(a: Vector, b: Vector) -> Number:
    """Scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def turned(c: Number, s: Number, a: Vector) -> Vector:
    """A vector in axes that have turned about the third one, by the angle with this cosine and sine."""
    return c * a[0] + s * a[1], c * a[1] - s * a[0], a[2]
