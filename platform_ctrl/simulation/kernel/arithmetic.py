"""Arithmetic of the kernel: functions of its numbers, and vectors and inertias in the memory of a run.

Cosine and sine, exponential, logarithm and hyperbolic tangent are correct to an ulp or two: arguments are brought to a
small interval in steps of pi/2 or ln 2 held in two or three parts (Cody and Waite 1980); there Taylor's series in the
nested form, long enough for a double.
"""

from __future__ import annotations

from platform_ctrl.common.compiling import hand_on_by_reference, inlined
from platform_ctrl.common.simd import Number, choose, load, mantissa_and_exponent, power_of_two, store, whole
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arrays import At, Links

Vector = tuple[Number, Number, Number]

hand_on_by_reference(arrays.At, arrays.Layout, arrays.Links, arrays.PlacedLinks, arrays.Shared)

# pi/2 and ln 2 in parts; the first ones have zeros at their ends, so that a multiple of them is exact.
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_TWO_OVER_PI, _PER_LN2 = 0.63661977236758134308, 1.44269504088896338700
_ROOT_HALF = 1.4142135623730951


@inlined
def cosine_and_sine(x: Number) -> tuple[Number, Number]:
    """Return (cos x, sin x); to the last places up to |x| = 1e5 rad, losing as many as |x| gains beyond."""
    k = whole(x * _TWO_OVER_PI + 0.5)
    r = ((x - k * _HALF_PI[0]) - k * _HALF_PI[1]) - k * _HALF_PI[2]
    z = r * r
    # The series by Horner's rule, two terms a line.
    s = 1.0 / 6227020800.0 - z / 1307674368000.0
    s = 1.0 / 362880.0 + z * (-1.0 / 39916800.0 + z * s)
    s = 1.0 / 120.0 + z * (-1.0 / 5040.0 + z * s)
    s = r + r * z * (-1.0 / 6.0 + z * s)
    c = 1.0 / 87178291200.0 - z / 20922789888000.0
    c = 1.0 / 3628800.0 - z * (1.0 / 479001600.0 - z * c)
    c = 1.0 / 720.0 - z * (1.0 / 40320.0 - z * c)
    c = 1.0 - z * (0.5 - z * (1.0 / 24.0 - z * c))
    quarter = k - 4.0 * whole(0.25 * k)
    odd = (quarter == 1.0) | (quarter == 3.0)
    cosine, sine = choose(odd, s, c), choose(odd, c, s)
    cosine = choose((quarter > 0.5) & (quarter < 2.5), -cosine, cosine)
    return cosine, choose(quarter > 1.5, -sine, sine)


@inlined
def exponential(x: Number) -> Number:
    """Return exp x, from exp(-700) to exp(700)."""
    x = choose(x < -700.0, -700.0, choose(x > 700.0, 700.0, x))  # NaN stays NaN
    k = whole(x * _PER_LN2 + 0.5)
    r = (x - k * _LN2[0]) - k * _LN2[1]
    series = 1.0 + r / 13.0
    for i in range(12, 0, -1):
        series = 1.0 + r * series / i
    return series * power_of_two(k)


@inlined
def logarithm(x: Number) -> Number:
    """Return ln x of a normal x > 0."""
    m, e = mantissa_and_exponent(x)
    high = m > _ROOT_HALF
    m, e = choose(high, 0.5 * m, m), choose(high, e + 1.0, e)
    # With t = f/(2 + f), ln(1 + f) = 2 artanh t = f - t (f - series), where f is exact.
    f = m - 1.0
    t = f / (2.0 + f)
    z = t * t
    series = 2.0 / 21.0 + 0.0 * z
    for i in range(19, 1, -2):
        series = series * z + 2.0 / i
    return e * _LN2[0] + (f - (t * (f - z * series) - e * _LN2[1]))


@inlined
def hyperbolic_tangent(x: Number) -> Number:
    """Return tanh x, to 1e-16 of 1."""
    size = choose(x < 0.0, -x, x)
    decay = exponential(-2.0 * size)
    up = (1.0 - decay) / (1.0 + decay)
    return choose(x < 0.0, -up, up)


@inlined
def vector(mem: FloatArray, slot: int) -> Vector:
    """Return the vector at a slot."""
    return load(mem, slot), load(mem, slot + 1), load(mem, slot + 2)


@inlined
def put(mem: FloatArray, slot: int, x: Number, y: Number, z: Number) -> None:
    """Store a vector at a slot."""
    store(mem, slot, x)
    store(mem, slot + 1, y)
    store(mem, slot + 2, z)


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
def to_parent(
    links: Links, mem: FloatArray, m: int, slot: int, c: Number, s: Number, x: Number, y: Number, z: Number
) -> None:
    """Add a vector of gimbal m of the order to one of its parent."""
    tree, turn = links.tree, links.turn
    x, y = c * x - s * y, s * x + c * y
    if tree[m, arrays.SKEW] != 0:
        for i in range(3):
            add(mem, slot + i, turn[m, 0, i] * x + turn[m, 1, i] * y + turn[m, 2, i] * z)
    else:
        add(mem, slot + tree[m, arrays.X], x)
        add(mem, slot + tree[m, arrays.Y], y)
        add(mem, slot + tree[m, arrays.Z], z)


@inlined
def times(mem: FloatArray, slot: int, x: Number, y: Number, z: Number) -> Vector:
    """The inertia at `slot` times a vector."""
    xx, yy, zz = vector(mem, slot)
    xy, xz, yz = vector(mem, slot + 3)
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


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
