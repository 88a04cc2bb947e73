"""The rows of a scheme as rational numbers, multiplied out without any rounding, and the poles that they have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import flint

from platform_ctrl.analysis.certificates.intervals import Balls
from platform_ctrl.common.values import value
from platform_ctrl.export.c99.scheme import Rows, Sum, multiplied_out
from platform_ctrl.export.fixed_point.model import IntegerRow, Product

# A rational number of flint, which ships no types.
Rational = Any


def rational(number: float | int) -> Rational:
    """Return a double or an integer as a rational number, exactly."""
    return flint.fmpq(*number.as_integer_ratio())


def power_of_two(exponent: int) -> Rational:
    """Return 2^exponent."""
    return flint.fmpq(2) ** exponent


@value
class ExactSystem:
    """x⁺ = A x + B u + v, s = C x + D u, with u the free sources and then a disturbance of every signal."""

    # states, signals, free: Names; the disturbance of a signal is named by noise_of
    states: tuple[str, ...]
    signals: tuple[str, ...]
    free: tuple[str, ...]
    # following, shown: The sums, by state and signal, of states, free sources and disturbances
    following: dict[str, Sum]
    shown: dict[str, Sum]

    def balls(self, sources: Sequence[str]) -> tuple[Balls, Balls, Balls, Balls]:
        """Return A, B, C, D for some of the free sources and disturbances."""
        following = [self.following[name] for name in self.states]
        shown = [self.shown[name] for name in self.signals]
        return (
            _matrix(following, self.states),
            _matrix(following, sources),
            _matrix(shown, self.states),
            _matrix(shown, sources),
        )


def _matrix(sums: Sequence[Sum], names: Sequence[str]) -> Balls:
    rows = [[flint.arb(one.get(name, flint.fmpq(0))) for name in names] for one in sums]
    return flint.arb_mat(rows) if rows and names else flint.arb_mat(len(rows), len(names))


def exact_system(rows: Rows, free: Sequence[str], states: Sequence[str]) -> ExactSystem:
    """Return the rows with every signal replaced by its sum; states not in `states` are left out."""
    shown, following = multiplied_out(rows, free, states, flint.fmpq(1))
    return ExactSystem(
        states=tuple(states), signals=tuple(rows.signals), free=tuple(free), following=following, shown=shown
    )


def joined_states(following: Mapping[str, Sum], states: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the states in groups that act on one another (strongly connected), in the order of their first ones."""
    reach = {name: {name} for name in states}
    for name in states:
        frontier = [name]
        while frontier:
            for source in following[frontier.pop()]:
                if source in reach and source not in reach[name]:
                    reach[name].add(source)
                    frontier.append(source)
    groups: list[tuple[str, ...]] = []
    placed: set[str] = set()
    for name in states:
        if name not in placed:
            group = tuple(other for other in states if other in reach[name] and name in reach[other])
            placed |= set(group)
            groups.append(group)
    return groups


def characteristic_polynomial(following: Mapping[str, Sum], group: Sequence[str]) -> Any:
    """Return the characteristic polynomial of a group of states, `flint.fmpq_poly`."""
    zero = flint.fmpq(0)
    return flint.fmpq_mat([[following[row].get(column, zero) for column in group] for row in group]).charpoly()


def inside_circle(polynomial: Any) -> bool:
    """Decide by Schur and Cohn's recursion, exactly, whether all roots lie inside the unit circle."""
    coefficients = [polynomial[k] for k in range(polynomial.degree() + 1)]
    while len(coefficients) > 1:
        first, last = coefficients[0], coefficients[-1]
        if not abs(first) < abs(last):
            return False
        mirrored = coefficients[::-1]
        coefficients = [(last * a - first * b) for a, b in zip(coefficients, mirrored, strict=True)][1:]
        coefficients = [a / coefficients[-1] for a in coefficients]
    return True


def largest_root(polynomial: Any) -> float:
    """Return the largest magnitude of the roots."""
    if polynomial.degree() == 1:
        return abs(float(flint.arb(-polynomial[0] / polynomial[1])))
    # Multiple roots are found once.
    numerator = polynomial.numer()
    squarefree = numerator / numerator.gcd(numerator.derivative())
    if isinstance(squarefree, flint.fmpq_poly):
        squarefree = squarefree.numer()
    return max(float(abs(root)) for root, _ in squarefree.complex_roots())


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


def _first_shift(row: Sum, mantissa: int) -> int:
    """Return the shift with which the smallest coefficient has `mantissa` significant bits, or one more."""
    # Number of binary digits before the point, or one less.
    digits = [int(abs(x.p)).bit_length() - int(x.q).bit_length() - 1 for x in row.values() if x != 0]
    return min(max(mantissa - 1 - min(digits, default=mantissa - 1), 0), 62)


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
    """Return a row of counts in integers, coefficients with `mantissa` significant bits.

    `row` has coefficients in counts per count, of a row that `keeps` (adds the state behind the shift) without the
    state itself; `largest` the largest count of every source. With `narrow` the accumulator may have 32 bits.
    """
    exact = {name: coefficient for name, coefficient in row.items() if coefficient != 0}
    shift = _first_shift(exact, mantissa)
    if narrow:
        small = _fitted(exact, largest, mantissa, shift, LARGEST_32)
        if small is not None and lost(exact, _real(*small), largest) <= flint.fmpq(1, 4):
            return _row(target, *small, largest, keeps, 32)
    fitted = _fitted(exact, largest, mantissa, shift, LARGEST_64)
    return _row(target, *(fitted or ({name: nearest(x) for name, x in exact.items()}, 0)), largest, keeps, 64)


def _fitted(
    exact: Sum, largest: Mapping[str, int], mantissa: int, first_shift: int, most: int
) -> tuple[dict[str, int], int] | None:
    """Return coefficients and the largest shift with which their sum stays within `most`; None where none does."""
    for shift in range(first_shift, -1, -1):
        whole = {name: _rounded(x * power_of_two(shift), mantissa) for name, x in exact.items()}
        if sum(abs(k) * largest[name] for name, k in whole.items()) + (1 << shift) // 2 <= most:
            return whole, shift
    return None


def _real(whole: Mapping[str, int], shift: int) -> Sum:
    return {name: k / power_of_two(shift) for name, k in whole.items()}


def lost(exact: Sum, made: Sum, largest: Mapping[str, int]) -> Rational:
    """Return the largest change of a sum by rounded coefficients, counts."""
    names = {*exact, *made}
    return sum((abs(made.get(name, 0) - exact.get(name, 0)) * largest[name] for name in names), flint.fmpq(0))


def without_rounding(row: IntegerRow) -> Sum:
    """Return the coefficients of a row in rational numbers, counts per count."""
    out = _real({product.source: product.coefficient for product in row.products}, row.shift)
    if row.keeps:
        out[row.target] = out.get(row.target, flint.fmpq(0)) + 1
    return out


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
    """Return an integral's row, in counts per count: no increment is rounded away."""
    for shift in range(_first_shift(row, mantissa), -1, -1):
        products = {name: _rounded(x * power_of_two(shift), mantissa) for name, x in row.items()}
        gained = sum(abs(k) * largest[name] for name, k in products.items())
        if (limit << shift) + gained <= LARGEST_64:
            break
    return IntegerRow(
        target=target,
        products=tuple(Product(coefficient=k, source=name) for name, k in products.items() if k),
        shift=shift,
        keeps=True,
        accumulator=64,
        largest=(limit << shift) + gained,
    )
