"""Structures of controllers: what may be tuned, its names, units and starting values, and the matrices it makes.

Everything is continuous, in s; a sampled plant is taken to the w-plane, where s stands for Tustin's rule. A controller
is u = K y (positive feedback).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.values import FloatArray, input_value, value
from platform_ctrl.errors import ArgumentError

Mask = NDArray[np.bool_]

# Imaginary step of a derivative: Im f(p + i h)/h is exact to rounding, f being analytic and h² lost beside p.
_IMAGINARY = 1e-30
# Relative step of the differences that replace it where a function takes real numbers alone.
_STEP = 1e-5


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
    """

    name: str
    start: float
    size: float
    positive: bool = False
    lower: float = -np.inf
    upper: float = np.inf


@value
class Units:
    """Typical sizes: of the gain from every y to every u, (nu, ny), of frequency, and of integral action, both rad/s.

    Without the last one it is that of frequency.
    """

    gain: FloatArray
    rate: float
    integral: float | None = None


class Given(NamedTuple):
    """What a user gave for parameters by name: see `Structure`."""

    start: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    fixed: dict[str, float]
    tied: tuple[Sequence[str], ...]


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
    tied
        Groups of names that keep one value; a name with a leading minus keeps the opposite of it.

    References
    ----------
    P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006.

    See docs/structured.md.
    """

    start: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    tied: Sequence[Sequence[str]] = ()

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

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the controller for given values of the parameters.

        Parameters
        ----------
        p : (..., parameters)
            Values in the order of `parameters`, in their units; complex ones where derivatives are taken.
        nmeas, ncon
            Number of measurements y and of controls u.

        Returns
        -------
        StateArrays
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

    @property
    def free(self) -> bool:
        """Whether all of [A_K, B_K; C_K, D_K] is free: then very large gains need no bounds."""
        return False

    @property
    def given(self) -> Given:
        """Everything that was given by name, for its parts too."""
        return Given(dict(self.start), dict(self.bounds), dict(self.fixed), tuple(self.tied))

    @property
    def _plain(self) -> bool:
        return not any(self.given)


def joined(system: StateArrays) -> FloatArray:
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
            raise ArgumentError(f"{name}: given {given!r}; expected {', '.join(map(repr, words))} or booleans")
        return words[given]
    out = np.asarray(given)
    if out.dtype != bool or out.shape != shape:
        raise ArgumentError(
            f"{name}: given {out.dtype} of shape {out.shape}; expected booleans of shape {shape}, (u, y)"
        )
    return out


def gains_of(name: str, mask: Mask, size: FloatArray) -> list[Parameter]:
    """Return the entries of a matrix of gains in `mask` as parameters, row by row."""
    return [Parameter(name=f"{name}{i + 1}{j + 1}", start=0.0, size=float(size[i, j])) for i, j in np.argwhere(mask)]


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
    start, bounds, fixed, tied
        As in `Structure`.
    """

    pattern: ArrayLike | str = "full"

    @property
    def free(self) -> bool:
        """Whether no gain is bound in any way."""
        return self._plain and isinstance(self.pattern, str) and self.pattern == "full"

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the gains."""
        return tuple(gains_of("k", mask_of("Static: pattern", self.pattern, (ncon, nmeas)), units.gain))

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the static block."""
        D = filled(mask_of("Static: pattern", self.pattern, (ncon, nmeas)), p)
        return StateArrays(zeros(p, 0, 0), zeros(p, 0, nmeas), zeros(p, ncon, 0), D)


@input_value
class StateSpaceOrder(Structure):
    """A controller of fixed order with free matrices: an observer of that order, or any other dynamics.

    Parameters a11, ..., b11, ..., c11, ..., d11, ... in the order of [A_K, B_K; C_K, D_K].

    Attributes
    ----------
    states
        Its order.
    strictly_proper
        Whether D_K is zero.
    start, bounds, fixed, tied
        As in `Structure`.

    References
    ----------
    P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006.

    J. V. Burke, D. Henrion, A. S. Lewis, M. L. Overton, IFAC ROCOND 2006.
    """

    states: int
    strictly_proper: bool = False

    @property
    def free(self) -> bool:
        """Whether every entry is free."""
        return self._plain and not self.strictly_proper

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the entries, states in units in which they are as large as y and u."""
        k, rate = self.states, units.rate
        typical = float(np.sqrt(np.mean(units.gain**2)))
        into, out = np.sqrt(units.gain.mean(axis=0) / np.sqrt(typical)), np.sqrt(units.gain.mean(axis=1))
        into = into * np.sqrt(typical) / np.maximum(into.mean(), 1e-300)
        a, b = (
            np.full((k, k), rate),
            np.full((k, 1), rate) * np.ones((1, nmeas)) * into / max(float(into.mean()), 1e-300),
        )
        c = np.full((ncon, k), 1.0) * out[:, None] / max(float(out.mean()), 1e-300) * typical
        everything = [
            *gains_of("a", np.ones((k, k), dtype=bool), a),
            *gains_of("b", np.ones((k, nmeas), dtype=bool), b),
            *gains_of("c", np.ones((ncon, k), dtype=bool), c),
        ]
        if not self.strictly_proper:
            everything += gains_of("d", np.ones((ncon, nmeas), dtype=bool), units.gain)
        # Distinct stable modes to begin with.
        starts = {f"a{i + 1}{i + 1}": -rate * 2.0 ** (i - 0.5 * (k - 1)) for i in range(k)}
        return tuple(Parameter(name=one.name, start=starts.get(one.name, 0.0), size=one.size) for one in everything)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the matrices."""
        k = self.states
        if self.strictly_proper:
            p = np.concatenate([p, zeros(p, ncon * nmeas)], axis=-1)
        shapes = ((k, k), (k, nmeas), (ncon, k), (ncon, nmeas))
        parts = np.split(p, np.cumsum([r * c for r, c in shapes[:3]]), axis=-1)
        A, B, C, D = (part.reshape(*p.shape[:-1], *shape) for part, shape in zip(parts, shapes, strict=True))
        return StateArrays(A, B, C, D)

    def order(self, nmeas: int, ncon: int) -> int:
        """Return the number of states."""
        return self.states


@input_value
class Lead(Structure):
    """(s/zero + 1)/(s/pole + 1) on every signal; parameters zero1, pole1, ... with the block's name before them.

    Attributes
    ----------
    name
        Put before the names of the parameters, where there are several such blocks.
    start, bounds, fixed, tied
        As in `Structure`.
    """

    name: str = "lead"

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return corner frequencies, rad/s."""
        rate = units.rate
        return tuple(
            Parameter(
                name=f"{self.name}_{word}{j + 1}",
                start=start * rate,
                size=1.0,
                positive=True,
                lower=1e-4 * rate,
                upper=1e6 * rate,
            )
            for word, start in (("zero", 0.5), ("pole", 5.0))
            for j in range(nmeas)
        )

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the diagonal block."""
        zeros_at, poles_at = np.split(p, 2, axis=-1)
        pole, ratio = (number[..., None] * np.eye(nmeas) for number in (poles_at, poles_at / zeros_at))
        # (s/z + 1)/(s/q + 1) = q/z + q (1 − q/z)/(s + q)
        return StateArrays(-pole, pole, np.eye(nmeas) - ratio, ratio)


@input_value
class Notch(Structure):
    """(s² + 2 depth width f s + f²)/(s² + 2 width f s + f²) on every signal.

    Parameters notch_frequency1, ... (f, rad/s), notch_depth1, ..., notch_width1, ...

    Attributes
    ----------
    name
        Put before the names of the parameters in place of "notch".
    start, bounds, fixed, tied
        As in `Structure`.
    """

    name: str = "notch"

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return frequency, depth and width of every notch."""
        rate = units.rate
        ranges = (("frequency", rate, 1e-3 * rate, 1e4 * rate), ("depth", 0.7, 1e-2, 10.0), ("width", 0.3, 1e-2, 10.0))
        return tuple(
            Parameter(name=f"{self.name}_{word}{j + 1}", start=start, size=1.0, positive=True, lower=low, upper=high)
            for word, start, low, high in ranges
            for j in range(nmeas)
        )

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the diagonal block, two states a signal."""
        m = nmeas
        f, depth, width = np.split(p, 3, axis=-1)
        A, B, C, D = zeros(p, 2 * m, 2 * m), zeros(p, 2 * m, m), zeros(p, m, 2 * m), zeros(p, m, m)
        k = np.arange(m)
        first, second = 2 * k, 2 * k + 1
        # States in units of f: x1' = f x2, x2' = f (y − x1 − 2 width x2);  out = y + 2 width (depth − 1) x2.
        A[..., first, second], A[..., second, first], A[..., second, second] = f, -f, -2.0 * width * f
        B[..., second, k], C[..., k, second], D[..., k, k] = f, 2.0 * width * (depth - 1.0), 1.0
        return StateArrays(A, B, C, D)


@input_value
class Series(Structure):
    """Structures one after another; the first ones keep the number of signals, the last one makes u.

    Attributes
    ----------
    blocks
        From y to u, for example (Notch(), PID()).
    start, bounds, fixed, tied
        As in `Structure`; what stands here counts before what a block has.
    """

    blocks: Sequence[Structure]

    @property
    def given(self) -> Given:
        """Everything that was given by name here or in a block; what stands here counts."""
        start, bounds, fixed, tied = dict(self.start), dict(self.bounds), dict(self.fixed), tuple(self.tied)
        for one in self.blocks:
            inner = one.given
            start, bounds, fixed = inner.start | start, inner.bounds | bounds, inner.fixed | fixed
            tied += inner.tied
        return Given(start, bounds, fixed, tied)

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of all blocks."""
        if not self.blocks:
            raise ArgumentError("Series: given no blocks; expected at least one")
        out: list[Parameter] = []
        for k, one in enumerate(self.blocks):
            out += one.parameters(nmeas, ncon if k == len(self.blocks) - 1 else nmeas, units)
        names = [one.name for one in out]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ArgumentError(f"Series: two parameters are called {twice[0]!r}; expected blocks of different names")
        return tuple(out)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the blocks in series."""
        units = Units(gain=np.ones((ncon, nmeas)), rate=1.0)
        out = StateArrays(
            zeros(p, 0, 0), zeros(p, 0, nmeas), zeros(p, nmeas, 0), zeros(p, nmeas, nmeas) + np.eye(nmeas)
        )
        for k, one in enumerate(self.blocks):
            outputs = ncon if k == len(self.blocks) - 1 else nmeas
            count = len(one.parameters(nmeas, outputs, units))
            a, b, c, d, _ = one.block(p[..., :count], nmeas, outputs)
            A = np.block([[out.A, zeros(p, out.A.shape[-1], a.shape[-1])], [b @ out.C, a]])
            B, C = np.concatenate([out.B, b @ out.D], axis=-2), np.concatenate([d @ out.C, c], axis=-1)
            out, p = StateArrays(A, B, C, d @ out.D), p[..., count:]
        return out


@value
class Sampled(Structure):
    """A structure by Tustin's rule, in other directions: u = basisᵀ K basis y, states as the trapezium rule has them.

    Attributes
    ----------
    inner
        In the w-plane, in the directions that the rows of `basis` are.
    period
        s.
    basis : (n, n)
        Orthogonal.
    """

    inner: Structure
    period: float
    basis: FloatArray

    @property
    def given(self) -> Given:
        """Everything that was given for the structure inside."""
        return self.inner.given

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return those of the structure inside."""
        return self.inner.parameters(nmeas, ncon, units)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return the sampled block."""
        A, B, C, D, _ = self.inner.block(p, nmeas, ncon)
        half, eye = 0.5 * self.period, np.eye(A.shape[-1])
        inverse = np.linalg.inv(eye - half * A)
        into, out = inverse @ B @ self.basis, self.basis.T @ C
        direct = self.basis.T @ D @ self.basis + half * out @ into
        return StateArrays(inverse @ (eye + half * A), self.period * into, out @ inverse, direct, self.period)


@value
class Named(Structure):
    """A controller that a function builds from positive numbers with names, as the classical design does.

    Attributes
    ----------
    build
        Numbers by name → A, B, C, D; real numbers alone, smooth in them.
    values
        All numbers. What is not to be moved is held by `fixed`.
    largest
        Upper bounds of some.
    """

    build: Callable[[dict[str, float]], StateArrays]
    values: Mapping[str, float]
    largest: Mapping[str, float]

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return the numbers."""
        return tuple(
            Parameter(name=name, start=number, size=1.0, positive=True, lower=0.0, upper=self.largest.get(name, np.inf))
            for name, number in self.values.items()
        )

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> StateArrays:
        """Return what the function builds."""
        return self.build(dict(zip(self.values, map(float, p), strict=True)))

    def slopes(self, p: FloatArray, nmeas: int, ncon: int) -> FloatArray:
        """Return the derivatives by central differences: the function takes real numbers alone."""
        out = []
        for k, number in enumerate(p):
            high, low = (p.copy() for _ in range(2))
            high[k], low[k] = number * np.exp(_STEP), number * np.exp(-_STEP)
            change = joined(self.block(high, nmeas, ncon)) - joined(self.block(low, nmeas, ncon))
            out.append(change / (2.0 * _STEP * number))
        return np.stack(out, axis=-1)
