"""Controllers as functions of search coordinates: logarithms of positive numbers, others in units of their size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.fixed_structure.structures import Given, Parameter, Structure, Units, joined
from platform_ctrl.errors import ArgumentError


class Parametrised:
    """The matrix M = [A_K, B_K; C_K, D_K] of a structure over its free numbers x.

    `names` are those of all parameters, the fixed ones among them. `start`, `lower` and `upper` (n,) are in search
    coordinates; those that are `positive` (n,) are logarithms, and M is affine in each of the others.
    """

    def __init__(self, structure: Structure, nmeas: int, ncon: int, units: Units) -> None:
        self.structure, self.nmeas, self.ncon = structure, nmeas, ncon
        given, kind = structure.given, type(structure).__name__
        everything = [_given(one, given, kind) for one in structure.parameters(nmeas, ncon, units)]
        self.names = tuple(one.name for one in everything)
        for what in ("start", "bounds", "fixed"):
            for name in getattr(given, what):
                known_name(f"{kind}: {what}", name, self.names)
        fixed = {self.names.index(name): float(number) for name, number in given.fixed.items()}
        spread, leaders = _ties(given.tied, everything, fixed, kind)
        self._base = np.array([fixed.get(k, 0.0) for k in range(len(everything))])
        self._spread = spread
        free = [everything[k] for k in leaders]
        self._size = np.array([one.size for one in free])
        self.positive = np.array([one.positive for one in free], dtype=bool)
        self.start = self._coordinates(np.array([one.start for one in free]))
        self.lower = self._coordinates(np.array([one.lower for one in free]))
        self.upper = self._coordinates(np.array([one.upper for one in free]))

    def _coordinates(self, numbers: FloatArray) -> FloatArray:
        out: FloatArray = numbers / self._size
        with np.errstate(invalid="ignore", divide="ignore"):
            out[self.positive] = np.log(np.maximum(numbers[self.positive], 0.0))
        return out

    def parameters(self, x: FloatArray) -> FloatArray:
        """Return all parameters at x."""
        free = np.where(self.positive, np.exp(np.where(self.positive, x, 0.0)), self._size * x)
        return np.asarray(self._base + self._spread @ free)

    def nearest(self, M: FloatArray) -> FloatArray:
        """Return the coordinates of M, in which the structure is affine, by least squares."""
        zero = np.zeros(len(self.start))
        found = np.linalg.lstsq(self.jacobian(zero).reshape(M.size, -1), (M - self.matrix(zero)).ravel(), rcond=None)[0]
        return np.clip(found, self.lower, self.upper)

    def named(self, x: FloatArray) -> dict[str, float]:
        """Return all parameters by name."""
        return dict(zip(self.names, map(float, self.parameters(x)), strict=True))

    def block(self, x: FloatArray) -> System:
        """Return A_K, B_K, C_K, D_K."""
        return self.structure.block(self.parameters(x), self.nmeas, self.ncon)

    def matrix(self, x: FloatArray) -> FloatArray:
        """Return M."""
        return joined(self.block(x))

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx, (rows, columns, n)."""
        slopes = self.structure.slopes(self.parameters(x), self.nmeas, self.ncon)
        size = np.where(self.positive, np.exp(np.where(self.positive, x, 0.0)), self._size)
        return (slopes @ self._spread) * size


def _given(one: Parameter, by_name: Given, kind: str) -> Parameter:
    """Return the parameter with what the user gave for it."""
    where = f"{kind}: {one.name}"
    low, high = _pair(by_name.bounds.get(one.name, (one.lower, one.upper)), where)
    if one.positive and low < 0.0:
        raise ArgumentError(f"{where}: bounds must not be negative, got {low:g} to {high:g}")
    given = by_name.fixed.get(one.name, by_name.start.get(one.name, one.start))
    if not np.isfinite(given) or (one.positive and not given > 0.0):
        raise ArgumentError(f"{where}: must be a {'positive' if one.positive else 'finite'} number, got {given!r}")
    return Parameter(
        name=one.name,
        start=float(min(max(given, low), high)),
        size=one.size,
        positive=one.positive,
        lower=low,
        upper=high,
    )


def _pair(bounds: Any, where: str) -> tuple[float, float]:
    try:
        low, high = (float(x) for x in bounds)
    except (TypeError, ValueError):
        raise ArgumentError(f"{where}: bounds must be a pair (lower, upper), got {bounds!r}") from None
    if not low < high:
        raise ArgumentError(f"{where}: the lower bound must be below the upper one, got ({low:g}, {high:g})")
    return low, high


def _ties(
    tied: Sequence[Sequence[str]], everything: Sequence[Parameter], fixed: Mapping[int, float], where: str
) -> tuple[FloatArray, list[int]]:
    """Return the matrix from free numbers to parameters, and the first parameter of each free number."""
    names = [one.name for one in everything]
    leader: dict[int, tuple[int, float]] = {}
    for group in tied:
        if isinstance(group, str) or len(group) < 2:
            raise ArgumentError(f"{where}: tied must consist of groups of at least two names, got {group!r}")
        first: tuple[int, float] | None = None
        for word in group:
            sign = -1.0 if word.startswith("-") else 1.0
            k = known_name(f"{where}: tied", word.removeprefix("-"), names)
            if k in leader or k in fixed:
                raise ArgumentError(f"{where}: tied: {names[k]!r} is tied or fixed already; give each name once")
            if sign < 0.0 and everything[k].positive:
                raise ArgumentError(f"{where}: tied: {word!r}: a positive number has no opposite")
            first = first or (k, sign)
            if everything[first[0]].positive != everything[k].positive:
                raise ArgumentError(f"{where}: tied: {names[first[0]]!r} and {names[k]!r} are of different kinds")
            leader[k] = (first[0], sign * first[1])
    leaders = [k for k in range(len(names)) if k not in fixed and leader.get(k, (k, 1.0))[0] == k]
    if not leaders:
        raise ArgumentError(f"{where}: every parameter is fixed; leave at least one free")
    spread = np.zeros((len(names), len(leaders)))
    for k in range(len(names)):
        if k not in fixed:
            at, sign = leader.get(k, (k, 1.0))
            spread[k, leaders.index(at)] = sign
    return spread, leaders
