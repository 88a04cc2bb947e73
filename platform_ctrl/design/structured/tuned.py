"""From free numbers x to the matrix of a structure: units, logarithms, bounds, fixed and tied parameters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from platform_ctrl.arguments import known_name, short
from platform_ctrl.design.structured.structures import Parameter, Series, Structure, Units
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray

# Step of the difference that gives second derivatives of the matrix, in units of x.
_STEP = 1e-5


class Tuned:
    """A structure as a function of x: one number for every parameter, or group of tied ones, that is not fixed.

    Raises
    ------
    ArgumentError
        A start, bound, fixed value or tie that makes no sense.
    """

    def __init__(self, structure: Structure, nmeas: int, ncon: int, units: Units) -> None:
        self.structure, self.nmeas, self.ncon = structure, nmeas, ncon
        parameters = structure.parameters(nmeas, ncon, units)
        names = [one.name for one in parameters]
        start, bounds, fixed, tied = _given(structure)
        for kind, given in (("start", start), ("bounds", bounds), ("fixed", fixed)):
            for name in given:
                known_name(f"structure, {kind}", name, names)
        self.parameters = tuple(_with(one, start, bounds, fixed) for one in parameters)
        leader = list(range(len(names)))
        sign = np.ones(len(names))
        for group in tied:
            members = [(known_name("structure, tied", name.lstrip("-"), names), -1.0 if name[0] == "-" else 1.0) for name in group]
            first, first_sign = members[0]
            for k, own in members:
                leader[k], sign[k] = first, own * first_sign
                if own * first_sign < 0.0 and self.parameters[k].positive:
                    raise ArgumentError(f"structure, tied: {names[k]!r} is positive; expected it without a minus")
        free = [k for k in range(len(names)) if leader[k] == k and names[k] not in fixed]
        self.free = free
        self._place = np.array([free.index(leader[k]) if leader[k] in free else -1 for k in range(len(names))])
        self._sign = sign
        self._held = np.array([one.start for one in self.parameters])
        for k, head in enumerate(leader):
            if head != k and self._place[k] < 0:
                self._held[k] = sign[k] * self._held[head]
        self._positive = np.array([one.positive for one in self.parameters])
        self._size = np.array([self.parameters[head].size for head in leader])
        heads = [self.parameters[k] for k in free]
        self.lower = np.array([_into(one, one.lower) for one in heads])
        self.upper = np.array([_into(one, one.upper) for one in heads])
        self.logarithmic = np.array([one.positive for one in heads], dtype=np.bool_)
        self.start = np.array([_into(one, one.start) for one in heads])

    def values(self, x: FloatArray) -> FloatArray:
        """Return the values of all parameters."""
        given = np.append(x, 0.0)[self._place]
        moved = np.where(self._positive, np.exp(np.clip(given, -300.0, 300.0)), self._sign * self._size * given)
        return np.where(self._place >= 0, moved, self._held)

    def _slopes(self, p: FloatArray) -> FloatArray:
        """Return dp/dx, (parameters, n)."""
        out = np.zeros((len(p), len(self.free)))
        moved = np.flatnonzero(self._place >= 0)
        out[moved, self._place[moved]] = np.where(self._positive, p, self._sign * self._size)[moved]
        return out

    def matrix(self, x: FloatArray) -> FloatArray:
        """Return M = [A_K, B_K; C_K, D_K]."""
        return self.structure.block(self.values(x), self.nmeas, self.ncon).joined.at

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return dM/dx, (rows, columns, n)."""
        p = self.values(x)
        return np.asarray(self.structure.block(p, self.nmeas, self.ncon).joined.slope @ self._slopes(p))

    def bend(self, x: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the Hessian of sum(weight * M), (n, n), by differences of the exact gradient."""

        def gradient(y: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("ij,ijx->x", weight, self.jacobian(y)))

        H = np.zeros((len(x), len(x)))
        for k in range(len(x)):
            step = np.zeros(len(x))
            step[k] = _STEP
            H[k] = (gradient(x + step) - gradient(x - step)) / (2.0 * _STEP)
        return 0.5 * (H + H.T)

    def limits(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nothing: the bounds say it all."""
        return np.zeros(0), np.zeros((0, len(x)))

    def named(self, x: FloatArray) -> dict[str, float]:
        """Return all parameters by name."""
        return {one.name: float(p) for one, p in zip(self.parameters, self.values(x), strict=True)}


def _into(one: Parameter, p: float) -> float:
    if one.positive:
        return float(np.log(p)) if p > 0.0 else -np.inf
    return p / one.size


def _with(
    one: Parameter,
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    fixed: Mapping[str, float],
) -> Parameter:
    """Return the parameter with what was given for it."""
    try:
        low, high = (float(b) for b in bounds.get(one.name, (one.lower, one.upper)))
        begin = float(fixed.get(one.name, start.get(one.name, np.clip(one.start, low, high))))
    except (TypeError, ValueError):
        raise ArgumentError(
            f"structure: start, bounds or fixed value of {one.name!r} given as {short((start, bounds, fixed))}; "
            "expected a number, or two numbers (lower, upper)"
        ) from None
    if not low <= begin <= high and one.name not in fixed:
        raise ArgumentError(f"structure: {one.name} starts at {begin:g}; expected it within its bounds {low:g} to {high:g}")
    if one.positive and not begin > 0.0:
        raise ArgumentError(f"structure: {one.name} = {begin:g}; expected a number > 0")
    if not np.isfinite(begin):
        raise ArgumentError(f"structure: {one.name} = {begin}; expected a finite number")
    size = abs(begin) if begin != 0.0 and one.name in start and not one.positive else one.size
    return Parameter(name=one.name, start=begin, size=size, positive=one.positive, lower=low, upper=high)


def _given(
    structure: Structure,
) -> tuple[dict[str, float], dict[str, tuple[float, float]], dict[str, float], list[tuple[str, ...]]]:
    """Return what was given for a structure and all its parts."""
    start, bounds, fixed = dict(structure.start), dict(structure.bounds), dict(structure.fixed)
    tied = [tuple(group) for group in structure.tied]
    if isinstance(structure, Series):
        for part in structure.blocks:
            a, b, c, d = _given(part)
            start, bounds, fixed, tied = a | start, b | bounds, c | fixed, d + tied
    return start, bounds, fixed, tied
