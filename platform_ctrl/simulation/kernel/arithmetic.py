"""Arithmetic of the kernel: functions of its numbers.

Cosine and sine, exponential, logarithm and hyperbolic tangent are correct to an ulp or two: arguments are brought to a
small interval in steps of pi/2 or ln 2 held in two or three parts (Cody and Waite 1980); there Taylor's series in the
nested form, long enough for a double.
"""

from __future__ import annotations

from platform_ctrl.common.compiling import inlined
from platform_ctrl.common.simd import Number, choose, exponent, greater, lesser, mantissa, power_of_two, whole

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
    m, e = mantissa(x), exponent(x)
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
def within(x: Number, limit: Number) -> Number:
    """Return x, or where it is beyond ± a limit that limit."""
    return lesser(greater(x, -limit), limit)
