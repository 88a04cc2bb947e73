"""Coefficients as integers: as many digits as the word and the accumulator allow, row by row."""

from __future__ import annotations

from collections.abc import Mapping

import flint

from platform_ctrl.export.fixed.exact import Rational, Sum, power_of_two
from platform_ctrl.export.fixed.values import IntegerRow, Product

# An integral's register and any 64-bit accumulator stay below.
LARGEST_64 = 2**63 - 1
LARGEST_32 = 2**31 - 1
# Bounds of what is zero are no smaller than the smallest numbers.
_NOTHING = 1e-280


def nearest(number: Rational) -> int:
    """Return the nearest integer, half up."""
    return int((number + flint.fmpq(1, 2)).floor())


def fraction_for(bound: float, bits: int) -> int:
    """Return the most digits behind the point with which `bound` fits a signed integer of so many bits."""
    if bound <= _NOTHING:
        return 0
    numerator, denominator = float(bound).as_integer_ratio()
    fraction = bits - 1 - (numerator.bit_length() - denominator.bit_length())
    while count_of(bound, fraction) > 2 ** (bits - 1) - 1:
        fraction -= 1
    return fraction


def count_of(bound: float, fraction: int) -> int:
    """Return ⌊bound · 2^fraction⌋."""
    numerator, denominator = float(bound).as_integer_ratio()
    return (numerator << fraction) // denominator if fraction >= 0 else numerator // (denominator << -fraction)


def _digits(number: Rational) -> int:
    """Return e with 2^e ≤ |number| < 2^(e + 1), or one less."""
    return int(abs(number.p)).bit_length() - int(number.q).bit_length() - 1


def _rounded(number: Rational, mantissa: int) -> int:
    """Return the nearest integer with no more than `mantissa` significant bits."""
    whole = nearest(number)
    beyond = max(abs(whole).bit_length() - mantissa, 0)
    if not beyond:
        return whole
    return nearest(number / power_of_two(beyond)) << beyond


def integer_row(
    target: str, row: Sum, largest: Mapping[str, int], mantissa: int, *, keeps: bool, narrow: bool
) -> IntegerRow:
    """Return a row of counts in integers.

    Parameters
    ----------
    target
        Its target.
    row
        Coefficients in counts per count; of a row that `keeps`, without the state itself.
    largest
        Largest magnitude of every source's count.
    mantissa
        Significant bits of a coefficient.
    keeps
        Whether the state is added behind the shift.
    narrow
        Whether an accumulator of 32 bits may do.
    """
    exact = {name: coefficient for name, coefficient in row.items() if coefficient != 0}
    shift = max([mantissa - 1 - _digits(x) for x in exact.values()], default=0)
    shift = min(max(shift, 0), 62)
    if narrow:
        small = _fitted(exact, largest, mantissa, shift, LARGEST_32)
        if small is not None and _lost(exact, small[0], small[1], largest) <= flint.fmpq(1, 4):
            return _row(target, *small, largest, keeps, 32)
    fitted = _fitted(exact, largest, mantissa, shift, LARGEST_64)
    return _row(target, *(fitted or ({name: nearest(x) for name, x in exact.items()}, 0)), largest, keeps, 64)


def _fitted(
    exact: Sum, largest: Mapping[str, int], mantissa: int, shift: int, most: int
) -> tuple[dict[str, int], int] | None:
    """Return coefficients and the largest shift with which their sum stays within `most`; None where none does."""
    while shift >= 0:
        whole = {name: _rounded(x * power_of_two(shift), mantissa) for name, x in exact.items()}
        if sum(abs(k) * largest[name] for name, k in whole.items()) + (1 << shift) // 2 <= most:
            return whole, shift
        shift -= 1
    return None


def _lost(exact: Sum, whole: Mapping[str, int], shift: int, largest: Mapping[str, int]) -> Rational:
    """Return the largest change of the target by rounded coefficients, counts."""
    return sum((abs(whole[name] / power_of_two(shift) - x) * largest[name] for name, x in exact.items()), flint.fmpq(0))


def _row(
    target: str, whole: Mapping[str, int], shift: int, largest: Mapping[str, int], keeps: bool, accumulator: int
) -> IntegerRow:
    whole = {name: k for name, k in whole.items() if k}
    while shift and all(k % 2 == 0 for k in whole.values()):
        whole, shift = {name: k // 2 for name, k in whole.items()}, shift - 1
    return IntegerRow(
        target=target,
        products=tuple(Product(coefficient=k, source=name) for name, k in whole.items()),
        shift=shift,
        keeps=keeps,
        accumulator=accumulator,
        largest=sum(abs(k) * largest[name] for name, k in whole.items()) + (1 << shift) // 2,
    )


def integral_row(target: str, row: Sum, limit: int, largest: Mapping[str, int], mantissa: int) -> IntegerRow:
    """Return an integral's row, in counts per count: nothing of what it gains is cut off."""
    shift = min(max([mantissa - 1 - _digits(x) for x in row.values() if x != 0], default=0), 62)
    shift = max(shift, 0)
    while True:
        products = {name: _rounded(x * power_of_two(shift), mantissa) for name, x in row.items()}
        gained = sum(abs(k) * largest[name] for name, k in products.items())
        if (limit << shift) + gained <= LARGEST_64 or shift == 0:
            break
        shift -= 1
    return IntegerRow(
        target=target,
        products=tuple(Product(coefficient=k, source=name) for name, k in products.items() if k),
        shift=shift,
        keeps=True,
        accumulator=64,
        largest=(limit << shift) + gained,
    )
