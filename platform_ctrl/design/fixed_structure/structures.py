"""Structures of controllers: what may be tuned, its names, units and starting values, and the matrices it makes.

Everything is continuous, in s; a sampled plant is taken to the w-plane, where s follows Tustin's rule. A controller
is u = K y (positive feedback).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.system import System
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, input_value, value
from platform_ctrl.errors import ArgumentError

Mask = NDArray[np.bool_]

# Imaginary step of a derivative: Im f(p + i h)/h is exact to rounding, f being analytic and h² lost beside p.
_IMAGINARY = 1e-30


@value
class Parameter:
    """One number that may be tuned.

    Attributes
    ----------
    name
        As in the result.
    start
        Where the search begins if nothing better is known, in the units of the parameter.
    size
        Its unit: a change by so much is large (by e where `positive`).
    positive
        Whether it is searched for by its logarithm.
    lower, upper
        Bounds, in the units of the parameter.
    fixed
        Whether it stays at `start`.
    """

    name: str
    start: float
    size: float
    positive: bool = False
    lower: float = -np.inf
    upper: float = np.inf
    fixed: bool = False


@value
class Units:
    """Typical sizes: of the gain from every y to every u, (nu, ny), of frequency, and of integral action, both rad/s.

    Without the last one it is that of frequency.
    """

    gain: FloatArray
    rate: float
    integral: float | None = None


@value
class Structure:
    """Base of all structures.

    Attributes
    ----------
    start
        Starting values by name of the parameter, in its unit (frequencies in rad/s).
    bounds
        (lower, upper) by name, in the same unit.
    fixed
        Values by name that are not tuned, in the same unit.

    References
    ----------
    P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006.

    See docs/methods/structured.md.
    """

    start: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the parameters of a controller with `nmeas` inputs and `ncon` outputs.

        Parameters
        ----------
        nmeas, ncon
            Number of measurements y and of controls u.
        units
            Sizes of y and u, and the range of frequencies: what starting values are made from.

        Returns
        -------
        tuple of Parameter
            In the order of p in `block`.

        Raises
        ------
        ArgumentError
            The structure does not fit so many signals.
        """
        raise NotImplementedError

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the controller for given values of the parameters.

        Parameters
        ----------
        p : (..., parameters)
            Values in the order of `parameters`, in their units; complex ones where derivatives are taken.
        nmeas, ncon
            Number of measurements y and of controls u.

        Returns
        -------
        System
            In continuous time, or in the w-plane of a sampled plant, with the leading axes of p.

        Raises
        ------
        ArgumentError
            The structure does not fit so many signals.
        """
        raise NotImplementedError

    def slopes(self, p: FloatArray, nmeas: int, ncon: int) -> FloatArray:
        """Return the derivatives of [A, B; C, D] with respect to p, (rows, columns, parameters)."""
        steps = p + 1j * _IMAGINARY * np.eye(len(p))
        change = joined(self.block(steps, nmeas, ncon)).imag / _IMAGINARY
        return np.ascontiguousarray(np.moveaxis(change, 0, -1))

    def order(self, nmeas: int, ncon: int) -> int:
        """Return the number of states.

        Parameters
        ----------
        nmeas, ncon
            Number of measurements y and of controls u.

        Returns
        -------
        int
            From 0 on.
        """
        units = Units(gain=np.ones((ncon, nmeas)), rate=1.0)
        p = np.array([one.start for one in self.parameters(nmeas, ncon, units)])
        return len(self.block(p, nmeas, ncon).A)

    def settled(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the `parameters` with what was given for them by name.

        Raises
        ------
        ArgumentError
            A name or a number that was given makes no sense.
        """
        kind, everything = type(self).__name__, self.parameters(nmeas, ncon, units)
        for what in ("start", "bounds", "fixed"):
            for name in getattr(self, what):
                known_name(f"{kind}: {what}", name, tuple(one.name for one in everything))
        return tuple(self._as_given(one, f"{kind}: {one.name}") for one in everything)

    def _as_given(self, one: Parameter, where: str) -> Parameter:
        low, high = _pair(self.bounds.get(one.name, (one.lower, one.upper)), where)
        if one.positive and low < 0.0:
            raise ArgumentError(f"{where}: bounds must not be negative, got {low:g} to {high:g}")
        number = self.fixed.get(one.name, one.start if one.fixed else self.start.get(one.name, one.start))
        if not np.isfinite(number) or (one.positive and not number > 0.0):
            raise ArgumentError(f"{where}: must be a {'positive' if one.positive else 'finite'} number, got {number!r}")
        fixed = one.fixed or one.name in self.fixed
        start = float(number if fixed else min(max(number, low), high))
        return replace(one, start=start, lower=low, upper=high, fixed=fixed)


def joined(system: System) -> FloatArray:
    """Return [A, B; C, D]."""
    A, B, C, D, _ = system
    return np.block([[A, B], [C, D]])


def zeros(p: FloatArray, *shape: int) -> FloatArray:
    """Return a matrix of zeros for every row of p, real or complex as p is."""
    return np.zeros((*p.shape[:-1], *shape), dtype=p.dtype)


def mask_of(name: str, given: ArrayLike | str, shape: tuple[int, int]) -> Mask:
    """Return a pattern: booleans (nu, ny), or the words "full", "diagonal", "cross" and "none"."""
    if isinstance(given, str):
        square = np.eye(*shape, dtype=bool)
        words = {
            "full": np.ones(shape, dtype=bool),
            "diagonal": square,
            "cross": ~square,
            "none": np.zeros(shape, bool),
        }
        if given not in words:
            raise ArgumentError(f"{name}: must be {', '.join(map(repr, words))} or booleans, got {given!r}")
        return words[given]
    out = np.asarray(given)
    if out.dtype != bool or out.shape != shape:
        raise ArgumentError(f"{name}: must be booleans of shape {shape}, (u, y), got {out.dtype} of shape {out.shape}")
    return out


def gains_of(name: str, mask: Mask, size: FloatArray) -> list[Parameter]:
    """Return the entries of a matrix of gains in `mask` as parameters, row by row."""
    places = np.argwhere(mask)
    return [Parameter(name=entry(name, mask.shape, i, j), start=0.0, size=float(size[i, j])) for i, j in places]


def entry(name: str, shape: tuple[int, ...], i: int, j: int) -> str:
    """Return the name of an entry of a matrix: with ten rows or columns, 111 would be 1, 11 or 11, 1."""
    return f"{name}{i + 1}{'_' if max(shape) > 9 else ''}{j + 1}"


def filled(mask: Mask, p: FloatArray) -> FloatArray:
    """Return the matrix whose entries in `mask` are p, row by row."""
    out = zeros(p, *mask.shape)
    out[..., mask] = p
    return out


@input_value
class Static(Structure):
    """A matrix of gains, u = K y, with parameters k11, k12, ...

    Attributes
    ----------
    pattern
        Which gains there are: "full", "diagonal", "cross" or booleans (nu, ny).
    start, bounds, fixed
        As in `Structure`.
    """

    pattern: ArrayLike | str = "full"

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the gains."""
        return tuple(gains_of("k", mask_of("Static: pattern", self.pattern, (ncon, nmeas)), units.gain))

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the static block."""
        D = filled(mask_of("Static: pattern", self.pattern, (ncon, nmeas)), p)
        return System(zeros(p, 0, 0), zeros(p, 0, nmeas), zeros(p, ncon, 0), D)


@input_value
class StateSpaceOrder(Structure):
    """A controller of fixed order with free matrices: an observer of that order, or any other dynamics.

    Parameters a11, ..., b11, ..., c11, ..., d11, ... in the order of [A_K, B_K; C_K, D_K].

    Attributes
    ----------
    states
        Its order.
    start, bounds, fixed
        As in `Structure`.

    References
    ----------
    P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006.

    J. V. Burke, D. Henrion, A. S. Lewis, M. L. Overton, IFAC ROCOND 2006.
    """

    states: int

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the entries, states in units in which they are as large as y and u."""
        k, rate = self.states, units.rate
        into, out = np.sqrt(units.gain.mean(axis=0)), np.sqrt(units.gain.mean(axis=1))[:, None]
        typical = float(np.sqrt(np.mean(units.gain**2)))
        sizes = {
            "a": np.full((k, k), rate),
            "b": np.ones((k, 1)) * rate * into / max(float(into.mean()), 1e-300),
            "c": np.ones((1, k)) * typical * out / max(float(out.mean()), 1e-300),
            "d": units.gain,
        }
        everything = [one for name, size in sizes.items() for one in gains_of(name, np.ones(size.shape, bool), size)]
        # Distinct stable modes to begin with.
        starts = {entry("a", (k, k), i, i): -rate * 2.0 ** (i - 0.5 * (k - 1)) for i in range(k)}
        return tuple(Parameter(name=one.name, start=starts.get(one.name, 0.0), size=one.size) for one in everything)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> System:
        """Return the matrices."""
        k = self.states
        shapes = ((k, k), (k, nmeas), (ncon, k), (ncon, nmeas))
        parts = np.split(p, np.cumsum([r * c for r, c in shapes[:3]]), axis=-1)
        A, B, C, D = (part.reshape(*p.shape[:-1], *shape) for part, shape in zip(parts, shapes, strict=True))
        return System(A, B, C, D)


class Parametrised:
    """The matrix M = [A_K, B_K; C_K, D_K] of a structure over its free numbers x.

    `names` are those of all parameters, the fixed ones among them. `start`, `lower` and `upper` (n,) are in search
    coordinates; those that are `positive` (n,) are logarithms, and M is affine in each of the others.
    """

    def __init__(self, structure: Structure, nmeas: int, ncon: int, units: Units) -> None:
        self.structure, self.nmeas, self.ncon = structure, nmeas, ncon
        everything = structure.settled(nmeas, ncon, units)
        self.names = tuple(one.name for one in everything)
        self._fixed = np.array([one.start if one.fixed else 0.0 for one in everything])
        self._free = np.array([k for k, one in enumerate(everything) if not one.fixed], dtype=np.intp)
        if not len(self._free):
            raise ArgumentError(f"{type(structure).__name__}: every parameter is fixed; leave at least one free")
        free = [everything[k] for k in self._free]
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
        out = self._fixed.copy()
        out[self._free] = np.where(self.positive, np.exp(np.where(self.positive, x, 0.0)), self._size * x)
        return out

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
        return np.asarray(slopes[..., self._free] * size)


def _pair(bounds: Any, where: str) -> tuple[float, float]:
    try:
        low, high = (float(x) for x in bounds)
    except (TypeError, ValueError):
        raise ArgumentError(f"{where}: bounds must be a pair (lower, upper), got {bounds!r}") from None
    if not low < high:
        raise ArgumentError(f"{where}: the lower bound must be below the upper one, got ({low:g}, {high:g})")
    return low, high
