"""Structures of controllers: what may be tuned, its names, units and starting values, and the matrices it makes.

Everything is continuous, in s; for a sampled plant it stands in the w-plane, which is Tustin's rule for s. A controller
is u = K y with no hidden sign.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from platform_ctrl.common.values import FloatArray, input_value, value
from platform_ctrl.errors import ArgumentError


class Sloped(NamedTuple):
    """A matrix (r, c) and its derivatives (r, c, n)."""

    at: FloatArray
    slope: FloatArray

    def __matmul__(self, other: Sloped) -> Sloped:
        slope = np.einsum("ijx,jk->ikx", self.slope, other.at) + np.einsum("ij,jkx->ikx", self.at, other.slope)
        return Sloped(self.at @ other.at, slope)

    def widened(self, before: int, after: int) -> Sloped:
        """Return the same matrix among more parameters."""
        return Sloped(self.at, np.pad(self.slope, ((0, 0), (0, 0), (before, after))))


def constant(matrix: FloatArray, parameters: int) -> Sloped:
    """Return a matrix that depends on none of so many parameters."""
    return Sloped(np.asarray(matrix, dtype=np.float64), np.zeros((*np.shape(matrix), parameters)))


def tiled(rows: Sequence[Sequence[Sloped]]) -> Sloped:
    """Return the matrix made of blocks."""
    return Sloped(
        np.block([[block.at for block in row] for row in rows]),
        np.concatenate([np.concatenate([block.slope for block in row], axis=1) for row in rows], axis=0),
    )


class SlopedBlock(NamedTuple):
    """A, B, C, D of a block."""

    A: Sloped
    B: Sloped
    C: Sloped
    D: Sloped

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A.at)

    @property
    def joined(self) -> Sloped:
        """The matrix [A, B; C, D]."""
        return tiled([[self.A, self.B], [self.C, self.D]])


def in_series(first: SlopedBlock, second: SlopedBlock) -> SlopedBlock:
    """Return `second` after `first`; the parameters of `first` stand first."""
    n1, n2 = first.D.slope.shape[2], second.D.slope.shape[2]
    a, b, c, d = (m.widened(0, n2) for m in first)
    A, B, C, D = (m.widened(n1, 0) for m in second)
    zero = constant(np.zeros((first.order, second.order)), n1 + n2)
    return SlopedBlock(tiled([[a, zero], [B @ c, A]]), tiled([[b], [B @ d]]), tiled([[D @ c, C]]), D @ d)


Mask = NDArray[np.bool_]


@value
class Parameter:
    """One number that may be tuned.

    Attributes
    ----------
    name
        As in the result.
    start
        Where the search begins if nothing better is known.
    size
        Its unit: a change by so much is large (by e where `positive`).
    positive
        Whether it is searched for by its logarithm.
    lower, upper
        Bounds.
    """

    name: str
    start: float
    size: float
    positive: bool = False
    lower: float = -np.inf
    upper: float = np.inf


@value
class Units:
    """Typical sizes: of the gain from every y to every u, (nu, ny), and of frequency, rad/s."""

    gain: FloatArray
    rate: float


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

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> SlopedBlock:
        """Return the controller for given values of the parameters, with its derivatives.

        Parameters
        ----------
        p : (parameters,)
            Values in the order of `parameters`, in their units.
        nmeas, ncon
            Number of measurements y and of controls u.

        Returns
        -------
        SlopedBlock
            In continuous time, or in the w-plane of a sampled plant.

        Raises
        ------
        ArgumentError
            The structure does not fit so many signals.
        """
        raise NotImplementedError

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
        return self.block(p, nmeas, ncon).order

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


def _mask(name: str, given: ArrayLike | str, shape: tuple[int, int]) -> Mask:
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


def _gains(name: str, mask: Mask, size: FloatArray) -> list[Parameter]:
    return [Parameter(name=f"{name}{i + 1}{j + 1}", start=0.0, size=float(size[i, j])) for i, j in np.argwhere(mask)]


def _filled(mask: Mask, p: FloatArray, first: int, total: int) -> Sloped:
    """Return the matrix whose entries in `mask` are p[first:], row by row."""
    out = constant(np.zeros(mask.shape), total)
    for k, (i, j) in enumerate(np.argwhere(mask), start=first):
        out.at[i, j] = p[k]
        out.slope[i, j, k] = 1.0
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
        return tuple(_gains("k", _mask("Static: pattern", self.pattern, (ncon, nmeas)), units.gain))

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> SlopedBlock:
        """Return the static block."""
        n = len(p)
        D = _filled(_mask("Static: pattern", self.pattern, (ncon, nmeas)), p, 0, n)
        return SlopedBlock(
            constant(np.zeros((0, 0)), n), constant(np.zeros((0, nmeas)), n), constant(np.zeros((ncon, 0)), n), D
        )


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
            *_gains("a", np.ones((k, k), dtype=bool), a),
            *_gains("b", np.ones((k, nmeas), dtype=bool), b),
            *_gains("c", np.ones((ncon, k), dtype=bool), c),
        ]
        if not self.strictly_proper:
            everything += _gains("d", np.ones((ncon, nmeas), dtype=bool), units.gain)
        # Distinct stable modes to begin with.
        starts = {f"a{i + 1}{i + 1}": -rate * 2.0 ** (i - 0.5 * (k - 1)) for i in range(k)}
        return tuple(Parameter(name=one.name, start=starts.get(one.name, 0.0), size=one.size) for one in everything)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> SlopedBlock:
        """Return the matrices."""
        n, k = len(p), self.states
        at = 0
        parts = []
        for rows, columns in ((k, k), (k, nmeas), (ncon, k), (ncon, nmeas)):
            if at >= n and rows * columns:
                parts.append(constant(np.zeros((rows, columns)), n))
                continue
            parts.append(_filled(np.ones((rows, columns), dtype=bool), p, at, n))
            at += rows * columns
        return SlopedBlock(*parts)

    def order(self, nmeas: int, ncon: int) -> int:
        """Return the number of states."""
        return self.states


@input_value
class PID(Structure):
    """Proportional, integral and derivative gains between all or some axes, behind a low-pass on every measurement.

    u = (K_P + K_I/s + K_D s) F(s) y with F = diag(filters), of first order ω/(s + ω) or of second order
    ω²/(s² + 2 ζ ω s + ω²). Parameters kp11, ..., ki11, ..., kd11, ... (torquer, pick-off), filter1, ... (ω, rad/s) and
    for the second order damping1, ... (ζ).

    Attributes
    ----------
    P, I, D
        Which gains there are: "full", "diagonal", "cross", "none" or booleans (nu, ny).
    filter_order
        0 (only without D), 1 or 2.
    filtered
        Whether F stands before everything, or before the derivative alone: u = (K_P + K_I/s + K_D s F(s)) y.
    filter_zero
        Whether a second-order F before everything has a zero, too: F = (s/z + 1) ω²/(s² + 2 ζ ω s + ω²), with
        parameters zero1, ... (z, rad/s). In a sampled controller z = 2/period, held by `fixed`, is a filter that does
        not wait a sample; left free it is a lead.
    seen_through : (gains, rates), optional
        The measurement is already gain + rate/s (rate in 1/s) times the signal that the PID is meant for, channel by
        channel, each (ny,), as in a mixed-sensitivity plant whose weight on the error stands before the controller: its
        pole is the PID's integrator, its zero becomes a fixed pole of the controller.
    start, bounds, fixed, tied
        As in `Structure`.
    """

    P: ArrayLike | str = "full"
    I: ArrayLike | str = "full"  # noqa: E741
    D: ArrayLike | str = "full"
    filter_order: Literal[0, 1, 2] = 2
    filtered: Literal["everything", "derivative"] = "everything"
    filter_zero: bool = False
    seen_through: tuple[ArrayLike, ArrayLike] | None = None

    def _masks(self, nmeas: int, ncon: int) -> tuple[Mask, Mask, Mask]:
        shape = (ncon, nmeas)
        masks = _mask("PID: P", self.P, shape), _mask("PID: I", self.I, shape), _mask("PID: D", self.D, shape)
        if self.filter_order not in (0, 1, 2):
            raise ArgumentError(f"PID: filter_order = {self.filter_order!r}; expected 0, 1 or 2")
        if self.filter_order == 0 and (np.any(masks[2]) or self.seen_through is not None):
            raise ArgumentError('PID: filter_order = 0 with a derivative; expected 1 or 2, or D="none"')
        if self.filter_zero and (self.filter_order != 2 or self.filtered != "everything"):
            raise ArgumentError("PID: filter_zero without a filter of second order before everything; expected one")
        return masks

    def parameters(self, nmeas: int, ncon: int, units: Units) -> tuple[Parameter, ...]:
        """Return gains and filters."""
        P, integral, D = self._masks(nmeas, ncon)
        gain, rate = units.gain, units.rate
        if self.seen_through is not None:
            gain = gain * np.asarray(self.seen_through[0], dtype=np.float64)
        out = [*_gains("kp", P, gain), *_gains("ki", integral, gain * rate), *_gains("kd", D, gain / rate)]
        if self.filter_order:
            out += [
                Parameter(
                    name=f"filter{j + 1}",
                    start=5.0 * rate,
                    size=1.0,
                    positive=True,
                    lower=1e-3 * rate,
                    upper=1e5 * rate,
                )
                for j in range(nmeas)
            ]
        if self.filter_order == 2:
            out += [
                Parameter(name=f"damping{j + 1}", start=0.7, size=1.0, positive=True, lower=0.02, upper=50.0)
                for j in range(nmeas)
            ]
        if self.filter_zero:
            out += [
                Parameter(
                    name=f"zero{j + 1}", start=2.0 * rate, size=1.0, positive=True, lower=1e-3 * rate, upper=1e5 * rate
                )
                for j in range(nmeas)
            ]
        return tuple(out)

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> SlopedBlock:
        """Return one chain of states for every measurement, and the gains that read them."""
        P, integral, D = self._masks(nmeas, ncon)
        n = len(p)
        counts = np.cumsum([P.sum(), integral.sum(), D.sum()])
        firsts = (0, *counts[:2])
        gains = [_filled(mask, p, int(first), n) for mask, first in zip((P, integral, D), firsts, strict=True)]
        frequency, damping = int(counts[2]), int(counts[2]) + nmeas
        chains = [
            self._chain(p, j, (frequency + j, damping + j, damping + nmeas + j), bool(integral[:, j].any()))
            for j in range(nmeas)
        ]
        A = constant(np.zeros((sum(len(c[0].at) for c in chains),) * 2), n)
        size = len(A.at)
        B, rows = constant(np.zeros((size, nmeas)), n), constant(np.zeros((3 * nmeas, size)), n)
        direct = constant(np.zeros((3 * nmeas, nmeas)), n)
        at = 0
        for j, (a, b, c, d) in enumerate(chains):
            here = slice(at, at + len(a.at))
            at += len(a.at)
            for whole, part, i, k in (
                (A, a, here, here),
                (B, b, here, slice(j, j + 1)),
                (rows, c, slice(j, 3 * nmeas, nmeas), here),
                (direct, d, slice(j, 3 * nmeas, nmeas), slice(j, j + 1)),
            ):
                whole.at[i, k] = part.at
                whole.slope[i, k] = part.slope
        together = Sloped(np.hstack([g.at for g in gains]), np.concatenate([g.slope for g in gains], axis=1))
        return SlopedBlock(A, B, together @ rows, together @ direct)

    def _chain(
        self, p: FloatArray, j: int, places_in_p: tuple[int, int, int], integral: bool
    ) -> tuple[Sloped, Sloped, Sloped, Sloped]:
        """Return the states behind measurement j and the rows [proportional, integral, derivative] that read them."""
        n = len(p)
        frequency, damping, zero = places_in_p
        degree = self.filter_order
        through = None
        if self.seen_through is not None:
            through = tuple(float(np.asarray(item, dtype=np.float64)[j]) for item in self.seen_through)
        states = degree + (1 if through or integral else 0)
        A, B = constant(np.zeros((states, states)), n), constant(np.zeros((states, 1)), n)
        C, D = constant(np.zeros((3, states)), n), constant(np.zeros((3, 1)), n)
        w = float(p[frequency]) if degree else 0.0
        # The filter's states come first, what stands before or behind it last.
        # Its input is y, or q = y/(gain s + rate) with q' = (y - rate q)/gain: then everything is one integral further.
        last = states - 1
        shift = 0
        if through:
            gain, rate = through
            A.at[last, last], B.at[last, 0] = -rate / gain, 1.0 / gain
            shift = 1
        if degree == 0:
            D.at[0, 0] = 1.0
            if integral:
                B.at[last, 0], C.at[1, last] = 1.0, 1.0
            return A, B, C, D

        def fed(row: int, factor: float, slope: dict[int, float], into_A: Sloped, into_B: Sloped) -> None:
            """Add factor times the filter's input to a row."""
            target, column = (into_A, last) if through else (into_B, 0)
            target.at[row, column] += factor
            for k, one in slope.items():
                target.slope[row, column, k] += one

        if degree == 1:
            A.at[0, 0], A.slope[0, 0, frequency] = -w, -1.0
            fed(0, w, {frequency: 1.0}, A, B)
        else:
            z = float(p[damping])
            A.at[0, 1] = 1.0
            A.at[1, 0], A.slope[1, 0, frequency] = -w * w, -2.0 * w
            A.at[1, 1] = -2.0 * z * w
            A.slope[1, 1, frequency], A.slope[1, 1, damping] = -2.0 * z, -2.0 * w
            fed(1, w * w, {frequency: 2.0 * w}, A, B)
        # Rows of C, D: filtered signal x, its first and its second derivative; x stands for P, or for I when shifted.
        places = (1, 0, 2) if shift else (0, 2, None)
        C.at[places[0], 0] = 1.0
        first = constant(np.zeros((1, states)), n), constant(np.zeros((1, 1)), n)
        if degree == 2:
            first[0].at[0, 1] = 1.0
        else:
            first[0].at[0], first[0].slope[0] = A.at[0], A.slope[0]
            first[1].at[0], first[1].slope[0] = B.at[0], B.slope[0]
        C.at[places[1]], C.slope[places[1]] = first[0].at[0], first[0].slope[0]
        D.at[places[1]], D.slope[places[1]] = first[1].at[0], first[1].slope[0]
        if places[2] is not None:
            second = first[0] @ A, first[0] @ B
            C.at[places[2]], C.slope[places[2]] = second[0].at[0], second[0].slope[0]
            D.at[places[2]], D.slope[places[2]] = second[1].at[0], second[1].slope[0]
        elif integral:
            A.at[last, 0], C.at[1, last] = 1.0, 1.0
        if self.filtered == "derivative":
            self._unfilter(A, B, C, D, through, integral)
        if self.filter_zero:
            return A, B, *_with_zero(A, B, C, float(p[zero]), zero)
        return A, B, C, D

    @staticmethod
    def _unfilter(
        A: Sloped, B: Sloped, C: Sloped, D: Sloped, through: tuple[float, ...] | None, integral: bool
    ) -> None:
        """Let the rows of P and I read the measurement itself."""
        last = len(A.at) - 1
        for m in (C, D):
            m.at[:2], m.slope[:2] = 0.0, 0.0
        if through:
            gain, rate = through
            C.at[0, last], D.at[0, 0], C.at[1, last] = -rate / gain, 1.0 / gain, 1.0
            return
        D.at[0, 0] = 1.0
        if integral:
            A.at[last], A.slope[last] = 0.0, 0.0
            B.at[last, 0], C.at[1, last] = 1.0, 1.0


def _with_zero(A: Sloped, B: Sloped, C: Sloped, z: float, place: int) -> tuple[Sloped, Sloped]:
    """Return C and D of the rows (s/z + 1) C (sI − A)⁻¹ B; z is parameter number `place`."""
    CA, CB = C @ A, C @ B
    at, slope = C.at + CA.at / z, C.slope + CA.slope / z
    slope[:, :, place] -= CA.at / z**2
    direct = CB.slope / z
    direct[:, :, place] -= CB.at / z**2
    return Sloped(at, slope), Sloped(CB.at / z, direct)


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

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> SlopedBlock:
        """Return the diagonal block."""
        n = len(p)
        zero, pole = p[:nmeas], p[nmeas:]
        A, B, C, D = (constant(np.zeros((nmeas, nmeas)), n) for _ in range(4))
        for j in range(nmeas):
            z, q = float(zero[j]), float(pole[j])
            # (s/z + 1)/(s/q + 1) = q/z + q (1 − q/z)/(s + q)
            A.at[j, j], A.slope[j, j, nmeas + j] = -q, -1.0
            B.at[j, j], B.slope[j, j, nmeas + j] = q, 1.0
            C.at[j, j] = 1.0 - q / z
            C.slope[j, j, j], C.slope[j, j, nmeas + j] = q / z**2, -1.0 / z
            D.at[j, j] = q / z
            D.slope[j, j, j], D.slope[j, j, nmeas + j] = -q / z**2, 1.0 / z
        return SlopedBlock(A, B, C, D)


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

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> SlopedBlock:
        """Return the diagonal block, two states a signal."""
        n, m = len(p), nmeas
        A, B = constant(np.zeros((2 * m, 2 * m)), n), constant(np.zeros((2 * m, m)), n)
        C, D = constant(np.zeros((m, 2 * m)), n), constant(np.eye(m), n)
        for j in range(m):
            f, depth, width = (float(p[k * m + j]) for k in range(3))
            i = 2 * j
            # States in units of f: x1' = f x2, x2' = f (y − x1 − 2 width x2);  out = y + 2 width (depth − 1) x2.
            A.at[i, i + 1], A.slope[i, i + 1, j] = f, 1.0
            A.at[i + 1, i], A.slope[i + 1, i, j] = -f, -1.0
            A.at[i + 1, i + 1] = -2.0 * width * f
            A.slope[i + 1, i + 1, j], A.slope[i + 1, i + 1, 2 * m + j] = -2.0 * width, -2.0 * f
            B.at[i + 1, j], B.slope[i + 1, j, j] = f, 1.0
            C.at[j, i + 1] = 2.0 * width * (depth - 1.0)
            C.slope[j, i + 1, m + j], C.slope[j, i + 1, 2 * m + j] = 2.0 * width, 2.0 * (depth - 1.0)
        return SlopedBlock(A, B, C, D)


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

    def block(self, p: FloatArray, nmeas: int, ncon: int) -> SlopedBlock:
        """Return the blocks in series."""
        units = Units(gain=np.ones((ncon, nmeas)), rate=1.0)
        made: SlopedBlock | None = None
        at = 0
        for k, one in enumerate(self.blocks):
            outputs = ncon if k == len(self.blocks) - 1 else nmeas
            count = len(one.parameters(nmeas, outputs, units))
            part = one.block(p[at : at + count], nmeas, outputs)
            at += count
            made = part if made is None else in_series(made, part)
        assert made is not None
        return made
