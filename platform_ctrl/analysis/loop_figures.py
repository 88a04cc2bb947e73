"""Figures of closed loops of a plant set, kind by kind: on the set's grid for a search, or exact for a verdict.

On the grid (`LoopFigures.figure`) a peak is seen at the set's frequencies and at the frequencies of closed-loop poles
that are narrower than the grid's spacing; what lies between is not. `LoopFigures.exact` takes the peak over all
frequencies, and `LoopFigures.within` shows that a plant is no worse than a figure, without working out its own.

Peaks are largest singular values of parts of the closed loop

    [d, Omega, n] → [u, y]        u = K (y + n),  y = P (u + d) + P_Omega Omega
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.bandwidth import LEVEL, bandwidth_of_response, bandwidth_of_sensitivity
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.feedback import closed_loop, sensitivities_of_plants
from platform_ctrl.analysis.norms import gains, noise_rms, resonances
from platform_ctrl.analysis.peaks import TOLERANCE, WHOLE, Band, exceeds, peak
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.common.values import FloatArray, value

# Figures that are the largest singular value over frequency.
PEAKS = frozenset(
    {
        "disk margin",
        "sensitivity peak",
        "complementary peak",
        "tracking",
        "Omega rejection",
        "torque rejection",
        "torque limit",
        "H-infinity norm",
    }
)
# Peaks that may be asked for up to a frequency only.
BANDED = frozenset({"tracking", "torque limit"})
# Figures of the controller alone: the same for every plant.
OF_CONTROLLER = frozenset({"controller poles", "controller gain"})
# Figures that a grid of frequencies may miss: a verdict takes their exact values.
GRIDDED = PEAKS | {"bandwidth", "controller gain"}
# Figures that are the worse the smaller they are.
_AT_LEAST = frozenset({"disk margin", "bandwidth"})
# Relative distance above a bandwidth.
_ABOVE = 1e-7
# Half-widths of a resonance up to which it may hide between two points of the grid, over their spacing.
_NARROW = 0.5


# A figure by what makes it: its kind, the edge of its band, the signals between which it is taken.
Key = tuple[str, float | None, Channel | None]


class Asked(Protocol):
    """What is asked for: a kind of figure with what it needs to be exact."""

    @property
    def kind(self) -> str:
        """Name of the figure."""

    @property
    def over(self) -> Sequence[str]:
        """Of which groups of plants."""

    @property
    def frequency(self) -> float | None:
        """Edge of a band, rad/s."""

    @property
    def channel(self) -> Channel | None:
        """Between which signals, for a norm."""


def key_of(asked: Asked) -> Key:
    """Return what a figure is of, whatever plants it is asked of."""
    return asked.kind, asked.frequency, asked.channel


@value
class Own:
    """A figure that is measured whatever is asked."""

    kind: str
    over: tuple[str, ...] = ()
    frequency: float | None = None
    channel: Channel | None = None


_BANDWIDTH = Own(kind="bandwidth")


class LoopFigures:
    """A controller closed around every plant of a set, each part worked out when it is first needed.

    Parameters
    ----------
    plants
        N plants with m torques and p angles.
    controller
        u = K y, same sample period.
    """

    def __init__(self, plants: PlantSet, controller: StateArrays) -> None:
        self.plants = plants
        self.controller = controller
        self.m, self.p = plants.B.shape[-1], plants.C.shape[-2]
        # Exact figures with their frequencies, rad/s, and figures that a plant is no worse than, by what they are of.
        self._exact: dict[tuple[Key, int], tuple[float, float]] = {}
        self._shown: dict[tuple[Key, int], float] = {}

    @cached_property
    def arrays(self) -> StateArrays:
        """Closed loops (N, ...): inputs torque disturbance, Omega, noise; outputs torques, angles, readings."""
        plants, m = self.plants, self.m
        B = np.concatenate([plants.B, plants.B_Omega], axis=-1)
        D = np.concatenate([plants.D, np.zeros((*plants.D.shape[:-1], 3))], axis=-1)
        A, B, C, D, _ = closed_loop(
            StateArrays(plants.A, B, plants.C, D, plants.period), self.controller, torques=range(m)
        )
        D_read = D[..., m:, :].copy()
        D_read[..., m + 3 :] += np.eye(self.p)
        C, D = np.concatenate([C, C[..., m:, :]], axis=-2), np.concatenate([D, D_read], axis=-2)
        return StateArrays(A, B, C, D, plants.period)

    @cached_property
    def own_arrays(self) -> StateArrays:
        """Closed loops (N, ...) without Omega: inputs torque disturbance and noise; outputs torques and angles."""
        plants = self.plants
        return closed_loop(StateArrays(plants.A, plants.B, plants.C, plants.D, plants.period), self.controller)

    @property
    def inputs(self) -> list[str]:
        """Names of the closed loops' inputs."""
        names = self.plants
        return [*names.torques, "Omega1", "Omega2", "Omega3", *(f"noise_{name}" for name in names.angles)]

    @property
    def outputs(self) -> list[str]:
        """Names of the closed loops' outputs; ``reading_`` is an angle with its noise: what the controller gets."""
        names = self.plants
        return [*names.torques, *names.angles, *(f"reading_{name}" for name in names.angles)]

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles of the closed loops in z, (N, poles)."""
        return poles(self.own_arrays.A)

    @cached_property
    def decay(self) -> FloatArray:
        """Decay of the slowest pole, 1/s, (N,)."""
        return np.asarray(-spectral_abscissa(continuous_poles(self.poles, self.plants.period)))

    @cached_property
    def K(self) -> ComplexArray:
        """Response of the controller on the set's grid."""
        return frequency_response(self.controller, self.plants.frequency, -3)

    @cached_property
    def S_output(self) -> ComplexArray:
        """Sensitivity at the plants' output, (N, F, p, p)."""
        return self._sensitivities[0]

    @cached_property
    def S_input(self) -> ComplexArray:
        """Sensitivity at the plants' input, (N, F, m, m)."""
        return self._sensitivities[1]

    @cached_property
    def _sensitivities(self) -> tuple[ComplexArray, ComplexArray]:
        return sensitivities_of_plants(self.plants.response, self.K)

    def only(self, chosen: Sequence[int]) -> LoopFigures:
        """Return the figures of some of the plants (indices): what is worked out here is taken over, none of it twice.

        Parameters
        ----------
        chosen
            Indices of plants.

        Returns
        -------
        LoopFigures
            Of `plants.only(chosen)`.

        Notes
        -----
        The argument is not judged: an index out of range is an `IndexError`.

        References
        ----------
        As the class.
        """
        index = np.asarray(chosen, dtype=np.intp)
        out = LoopFigures(self.plants.only(chosen), self.controller)
        out.K, out.poles, out.decay = self.K, self.poles[index], self.decay[index]
        out.S_output, out.S_input = self.S_output[index], self.S_input[index]
        out.arrays, out.own_arrays = _some(self.arrays, index), _some(self.own_arrays, index)
        return out

    def figure(self, asked: Asked) -> FloatArray:
        """Return a figure of every plant (N,), peaks on the grid; of the controller alone (1,)."""
        if asked.kind in PEAKS:
            return self._peak_figure(asked.kind, self._grid_peak(asked))
        return _PLAIN[asked.kind](self, asked)

    def exact(self, asked: Asked, k: int) -> float:
        """Return a figure of plant `k` over all frequencies, no better than it is: peaks as norms, to 1e-9."""
        place = (key_of(asked), k)
        if place not in self._exact:
            self._exact[place] = self._found(asked, k)
        return self._exact[place][0]

    @property
    def reached(self) -> FloatArray:
        """Frequencies, rad/s, at which the exact figures that were asked for are reached."""
        w = np.array([at for _, at in self._exact.values()])
        return np.unique(w[np.isfinite(w) & (w > 0.0)])

    def _found(self, asked: Asked, k: int) -> tuple[float, float]:
        if asked.kind == "controller gain":
            return peak(self.controller, (self.gain_from(asked), np.inf))
        stable = bool(self.decay[k] > 0.0)
        if asked.kind == "bandwidth":
            at = min(map(bandwidth_of_sensitivity, self._parts(asked, k))) if stable else 0.0
            # At a frequency just above it S is seen to be that large.
            return (1.0 - TOLERANCE) * at / (2.0 * np.pi), (1.0 + _ABOVE) * at
        found, at = max(peak(part, _band(asked)) for part in self._parts(asked, k)) if stable else (np.inf, 0.0)
        return float(self._peak_figure(asked.kind, np.array([found]))[0]), at

    def worst(self, asked: Asked, figures: FloatArray, chosen: NDArray[np.bool_]) -> FloatArray:
        """Return figures on the grid with the worst of the `chosen` plants (N,) exact: none of these is worse.

        The plant that is worst on the grid gets its exact figure. Every other one is shown to be no worse, or gets its
        own.
        """
        out = figures.copy()
        if asked.kind in OF_CONTROLLER:
            out[0] = self.exact(asked, 0)
            return out
        if not np.all(self.decay[chosen] > 0.0):
            # Nothing is worse than a loop that is not stable.
            return out
        at_least = asked.kind in _AT_LEAST
        order = np.flatnonzero(chosen)
        level: float | None = None
        for k in map(int, order[np.argsort(figures[order] if at_least else -figures[order], kind="stable")]):
            if level is None or not self.within(asked, k, level):
                out[k] = self.exact(asked, k)
                level = out[k] if level is None else (min if at_least else max)(level, out[k])
        return out

    def within(self, asked: Asked, k: int, figure: float) -> bool:
        """Return whether the figure of a stable plant `k` is no worse than `figure`, over all frequencies."""
        at_least, place = asked.kind in _AT_LEAST, (key_of(asked), k)
        if at_least and figure <= 0.0:
            return True
        shown = self._shown.get(place)
        if shown is not None and (shown >= figure if at_least else shown <= figure):
            return True
        level, band = figure, _band(asked)
        if asked.kind == "disk margin":
            level = 1.0 / figure
        elif asked.kind == "bandwidth":
            level, band = LEVEL, (0.0, 2.0 * np.pi * figure)
        s = continuous_poles(self.poles[k], self.plants.period)
        if any(exceeds(part, level, s, band) for part in self._parts(asked, k)):
            return False
        self._shown[place] = figure
        return True

    def gain_from(self, asked: Asked) -> float:
        """Return the frequency, rad/s, from which on the controller's gain is asked for."""
        return self.plants.nutation / 10.0 if asked.frequency is None else asked.frequency

    def grid_bandwidth(self, k: int) -> float:
        """Return the bandwidth of plant `k` on the grid, rad/s; 0 where the loop is not stable."""
        if not self.decay[k] > 0.0:
            return 0.0
        frequency = self.plants.frequency
        found = min(float(bandwidth_of_response(frequency, S[k])) for S in (self.S_output, self.S_input))
        w = self._narrow.get(k, np.zeros(0))
        high = [w[gains(part, w) >= LEVEL] for part in self._parts(_BANDWIDTH, k)] if w.size else []
        return min([found, *(float(part.min(initial=np.inf)) for part in high)])

    def _peak_figure(self, kind: str, peak: FloatArray) -> FloatArray:
        if kind != "disk margin":
            return peak
        with np.errstate(divide="ignore"):
            return np.where(np.isfinite(peak), 1.0 / peak, 0.0)

    def _grid_peak(self, asked: Asked) -> FloatArray:
        if asked.kind == "H-infinity norm":
            part = self._part(asked)
            responses = [frequency_response(part, self.plants.frequency, -3)]
        else:
            responses = _RESPONSES[asked.kind](self)
        grid, band = self.plants.frequency, _band(asked)
        inside = grid <= max(band[1], grid[0])
        peaks = np.max([highest(response[:, inside]) for response in responses], axis=0)
        for k, w in self._narrow.items():
            w = w[w <= band[1]]
            peaks[k] = max([peaks[k], *(gains(part, w).max(initial=0.0) for part in self._parts(asked, k))])
        return np.where(self.decay > 0.0, peaks, np.inf)

    @cached_property
    def _narrow(self) -> dict[int, FloatArray]:
        """Frequencies, rad/s, of resonances of stable loops that may hide between two points of the grid, by plant."""
        grid = self.plants.frequency
        s = continuous_poles(self.poles, self.plants.period)
        centre = np.where(np.isfinite(s), s.imag, 0.0)
        place = np.clip(np.searchsorted(grid, centre), 1, len(grid) - 1)
        # Below the grid its first frequency is the spacing.
        spacing = np.where(centre < grid[0], centre, grid[place] - grid[place - 1])
        narrow = (centre > 0.0) & (-s.real < _NARROW * spacing) & (self.decay > 0.0)[:, None]
        return {int(k): np.unique(np.abs(s[k, narrow[k]].imag)) for k in np.flatnonzero(narrow.any(axis=1))}

    def _part(self, asked: Asked) -> StateArrays:
        return (asked.channel or Channel()).of(self.arrays, self.inputs, self.outputs)

    def _parts(self, asked: Asked, k: int) -> list[StateArrays]:
        """Return the systems whose norms make the figure of plant `k`."""
        A, B, C, D, dt = self._part(asked) if asked.kind == "H-infinity norm" else self.arrays
        A, B, C, D = (item[k] for item in (A, B, C, D))
        m, p = self.m, self.p
        d, rate, n = slice(0, m), slice(m, m + 3), slice(m + 3, m + 3 + p)
        u, y = slice(0, m), slice(m, m + p)

        def part(inputs: slice, outputs: slice, direct: float = 0.0) -> StateArrays:
            there = D[outputs, inputs]
            return StateArrays(A, B[:, inputs], C[outputs], there + direct * np.eye(*there.shape), dt)

        # From d to u and from n to y the closed loop is -T = S - I.
        match asked.kind:
            case "H-infinity norm":
                return [StateArrays(A, B, C, D, dt)]
            case "disk margin":
                return [part(d, u, 0.5), part(n, y, 0.5)]
            case "sensitivity peak" | "bandwidth":
                return [part(d, u, 1.0), part(n, y, 1.0)]
            case "complementary peak":
                return [part(d, u), part(n, y)]
            case "tracking":
                return [part(n, y, 1.0)]
            case "Omega rejection":
                return [part(rate, y)]
            case "torque rejection":
                return [part(d, y)]
        share = self.plants.Omega / self.plants.torque_limit[:, None]
        rows = [part(rate, slice(j, j + 1)) for j in range(m)]
        return [one._replace(B=one.B * s, D=one.D * s) for one, s in zip(rows, share, strict=True)]


def _some(stack: StateArrays, index: NDArray[np.intp]) -> StateArrays:
    A, B, C, D, dt = stack
    return StateArrays(A[index], B[index], C[index], D[index], dt)


def highest(matrices: ComplexArray) -> FloatArray:
    """Return the largest singular value over the frequencies of each plant, (N,) of (N, F, p, m).

    No singular value is larger than the root of the sum of squares: where that is below the value at one frequency,
    the singular values need not be known.
    """
    N, F = matrices.shape[:2]
    if not F:
        return np.zeros(N)
    size = np.linalg.norm(matrices, axis=(-2, -1))
    size = np.where(np.isfinite(size), size, np.inf)
    out = largest_singular_values(matrices[np.arange(N), np.argmax(size, axis=1)])
    plants, places = np.nonzero(size > out[:, None])
    np.maximum.at(out, plants, largest_singular_values(matrices[plants, places]))
    return out


def fastest(poles: ComplexArray, period: float) -> FloatArray:
    """Return the largest magnitude of the poles, rad/s, (...); of a sampled system in the w-plane.

    There a pole is w = (2/T) (z - 1)/(z + 1): a delay (z = 0) counts 2/T, and a pole that rings at the Nyquist
    frequency (z near -1) is as fast as can be.
    """
    size = np.abs(poles)
    if period > 0.0:
        with np.errstate(divide="ignore"):
            size = 2.0 / period * np.abs(poles - 1.0) / np.abs(poles + 1.0)
    out: FloatArray = size.max(axis=-1, initial=0.0)
    return out


def h2_norms(system: StateArrays) -> FloatArray:
    """Return the H2 norms of a stack of sampled systems; infinite where one is not stable."""
    rms = noise_rms(system, np.ones(system.B.shape[-1]), allow_unstable=True)
    with np.errstate(over="ignore"):
        return np.asarray(np.sqrt(np.sum(rms * rms, axis=-1)), dtype=np.float64)


def _band(asked: Asked) -> Band:
    return (0.0, asked.frequency) if asked.kind in BANDED and asked.frequency is not None else WHOLE


def _torque_noise(loops: LoopFigures, asked: Asked) -> FloatArray:
    A, B, C, D, dt = loops.own_arrays
    m = loops.m
    noise_to_torque = StateArrays(A, B[..., m:], C[..., :m, :], D[..., :m, m:], dt)
    rms = noise_rms(noise_to_torque, loops.plants.noise, allow_unstable=True)
    out: FloatArray = rms.max(axis=-1, initial=0.0)
    return out


def _bandwidth(loops: LoopFigures, asked: Asked) -> FloatArray:
    return np.array([loops.grid_bandwidth(k) for k in range(len(loops.plants.labels))]) / (2.0 * np.pi)


def _controller_gain(loops: LoopFigures, asked: Asked) -> FloatArray:
    K, start = loops.controller, loops.gain_from(asked)
    own = resonances(continuous_poles(poles(K.A), K.dt))
    w = np.concatenate([loops.plants.frequency, own, [start, np.pi / K.dt]])
    return np.array([gains(K, w[(w >= start) & (w <= np.pi / K.dt)]).max(initial=0.0)])


# Figures that need no search for a peak.
_PLAIN: dict[str, Callable[[LoopFigures, Asked], FloatArray]] = {
    "stability": lambda loops, asked: loops.decay,
    "damping": lambda loops, asked: minimum_damping(loops.poles, loops.plants.nutation / 10.0, loops.plants.period),
    "fastest pole": lambda loops, asked: fastest(loops.poles, loops.plants.period),
    "bandwidth": _bandwidth,
    "torque noise": _torque_noise,
    "H2 norm": lambda loops, asked: h2_norms(loops._part(asked)),
    "controller poles": lambda loops, asked: fastest(poles(loops.controller.A), loops.plants.period)[None],
    "controller gain": _controller_gain,
}


def _torque_shares(loops: LoopFigures) -> list[ComplexArray]:
    share = loops.plants.Omega / loops.plants.torque_limit[:, None]
    torque = loops.K @ loops.S_output @ loops.plants.Omega_response * share
    return [torque[..., j : j + 1, :] for j in range(loops.m)]


# Responses on the grid whose largest singular value makes a figure.
_RESPONSES: dict[str, Callable[[LoopFigures], list[ComplexArray]]] = {
    "disk margin": lambda loops: [loops.S_output - 0.5 * np.eye(loops.p), loops.S_input - 0.5 * np.eye(loops.m)],
    "sensitivity peak": lambda loops: [loops.S_output, loops.S_input],
    "complementary peak": lambda loops: [loops.S_output - np.eye(loops.p), loops.S_input - np.eye(loops.m)],
    "tracking": lambda loops: [loops.S_output],
    "Omega rejection": lambda loops: [loops.S_output @ loops.plants.Omega_response],
    "torque rejection": lambda loops: [loops.S_output @ loops.plants.response],
    "torque limit": _torque_shares,
}
