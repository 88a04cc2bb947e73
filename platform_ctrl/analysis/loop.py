"""The closed loops that one controller makes with every plant of a set, and their largest gains.

The largest gain over frequency is taken on the set's grid and at the closed-loop poles that are narrower than the
grid's spacing (`Loop.grid_peaks`): quick enough for a search. Over all frequencies it is a norm (`Loop.peak`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis import norms
from platform_ctrl.analysis import poles as pole
from platform_ctrl.analysis.between_samples import Disturbed
from platform_ctrl.analysis.feedback import commanded_loop, sensitivities_of_plants, with_error_alone
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import FrequencyAxis, largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, Index, System
from platform_ctrl.analysis.time_responses import step_responses
from platform_ctrl.analysis.transfers import SENSITIVITIES, UNDISTURBED, Parts, Responses, Transfer, maps_of
from platform_ctrl.common.values import FloatArray, replaced
from platform_ctrl.errors import ArgumentError

# Half-width of a resonance over the grid's spacing, up to which it may hide between two points of the grid.
_NARROW = 0.5
# Share of the slowest pole's frequency at which a response is at its limit for zero frequency.
_LIMIT = 1e-2
# Below this share of the sample rate a response of sampled plants is rounding.
_ROUNDING = 1e-8
# A gain that is larger by this factor at a tenth of that grows without bound towards zero.
_GROWING = 5.0
# Relative distance above a bandwidth at which S is seen to reach its level.
_ABOVE = 1e-7


Indices = NDArray[np.intp]


class Loop:
    """A controller closed around every plant of a set, each part computed when it is first needed.

    `controller` is u = K y, or u = K y + H r with as many inputs more as are kept: see `Loop.following`.
    """

    def __init__(self, plants: PlantSet, controller: System) -> None:
        self.plants = plants
        self.controller = plants.feedback(controller)
        self.two_degrees = None if self.controller is controller else controller
        self.m, self.p, self.kept = plants.B.shape[-1], plants.C.shape[-2], plants.kept
        self.period, self.slow = plants.period, plants.nutation / 10.0
        # By what they are of: exact values with their frequencies, rad/s, and levels that are shown not to be exceeded.
        self._exact: dict[Hashable, tuple[float, float]] = {}
        self._below: dict[Hashable, float] = {}
        self._alone: dict[Hashable, Loop] = {}
        self._steps: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._axis: dict[int, FrequencyAxis] = {}

    @cached_property
    def arrays(self) -> System:
        """Closed loops (N, ...): inputs torque disturbance, Omega, noise; outputs torques, angles, line of sight."""
        m, p = self.m, self.p
        whole = self.plants.whole.part(slice(p + len(self.plants.sight)), slice(None))
        closed = whole.feedback(self.controller, range(m), range(p))
        feedforward = self.plants.feedforward
        if feedforward is not None and feedforward.into == "torque":
            # The torque is what the controller sets and what feedforward adds, whose states are the plants' last.
            fed = feedforward.from_rate
            n, f = self.plants.A.shape[-1], len(fed.A)
            closed.C[..., :m, n - f : n] += fed.C
            closed.D[..., :m, m : m + 3] += fed.D
        return closed

    @cached_property
    def own_arrays(self) -> System:
        """Closed loops (N, ...) without Omega: inputs torque disturbance and noise; outputs torques and angles."""
        return self.plants.arrays.feedback(self.controller)

    @cached_property
    def drifts(self) -> tuple[pole.Drift, ...]:
        """Of each plant the closed loop without the equilibria that its sensors do not see, and these."""
        if not self.plants.drifting:
            return ()
        A, B, C, D, dt = self.own_arrays
        read = slice(self.m, None)
        every = range(len(A))
        return tuple(pole.unseen_equilibria(System(A[k], B[k], C[k, read], D[k, read], dt)) for k in every)

    @property
    def free_angles(self) -> tuple[str, ...]:
        """Names of the angles at which a loop is in balance wherever they are, with any of the plants."""
        if not self.drifts:
            return ()
        moved = np.max([np.abs(one.equilibria).max(axis=1, initial=0.0) for one in self.drifts], axis=0)
        return tuple(
            name for name, at in zip(self.plants.states, moved, strict=False) if at and name in self.plants.drifting
        )

    def settled(self, system: System) -> System:
        """Return one of the closed loops, or a part, without poles of equilibria that its response does not have."""
        return pole.without_drift(system) if self.plants.drifting else system

    @cached_property
    def following(self) -> System:
        """Closed loops (N, ...) from commands to what they command, at the samples, then at the instants between."""
        plants, m, p = self.plants, self.m, self.p
        seen = plants.whole.part([*range(p), *range(p + len(plants.sight), plants.whole.C.shape[-2])], slice(m))
        K = with_error_alone(self.controller, plants.commanded) if self.two_degrees is None else self.two_degrees
        rows = [m + p * j + i for j in range(1 + len(plants.between)) for i in range(self.kept)]
        return commanded_loop(seen, K, range(m), range(p)).part(rows, slice(m, None))

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles of the closed loops in z, (N, poles)."""
        return pole.poles(np.array([one.system.A for one in self.drifts]) if self.drifts else self.own_arrays.A)

    @cached_property
    def sight(self) -> Mapping[str, float]:
        """Values of limits on the line of sight by the budget, rad; none of an unstable loop."""
        budget = self.plants.sight_budget
        if budget is None:
            raise ArgumentError("line-of-sight jitter and smear: the plants are those of a job without a [budget]")
        return budget.exact(self.controller) if self.decay[0] > 0.0 else {}

    @cached_property
    def decay(self) -> FloatArray:
        """Decay rate of the slowest pole, 1/s, (N,)."""
        return np.asarray(-pole.spectral_abscissa(pole.continuous_poles(self.poles, self.plants.period)))

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

    @property
    def sensitivities(self) -> tuple[ComplexArray, ComplexArray]:
        """S at the plants' output, (N, F, kept, kept), of what the loop keeps alone, and at their input."""
        return self.S_output[..., : self.kept, : self.kept], self.S_input

    @cached_property
    def _sensitivities(self) -> tuple[ComplexArray, ComplexArray]:
        return sensitivities_of_plants(self.plants.response, self.K)

    def peak(self, parts: Parts, band: norms.Band, k: int) -> tuple[float, float]:
        """Return the largest gain of parts of plant `k`'s loop in a band, to 1e-9 from above, and its frequency, rad/s.

        Infinite of an unstable loop. Of continuous disturbances it is that of a grid, refined around its tops.
        """

        def found() -> tuple[float, float]:
            if not self.decay[k] > 0.0:
                return np.inf, 0.0
            if self._of_continuous(parts):
                return self._refined(parts, band, k)
            return max(norms.peak(part, band) for part in self.axes(parts, k))

        return self._once(("peak", parts, band, k), found)

    def bandwidth(self, k: int) -> float:
        """Return the frequency, rad/s, from below, up to which plant `k`'s sensitivities stay below 1/√2."""

        def found() -> tuple[float, float]:
            if not self.decay[k] > 0.0:
                return 0.0, 0.0
            at = min(map(norms.bandwidth_of_sensitivity, self.axes(SENSITIVITIES, k)))
            return (1.0 - norms.PEAK_TOLERANCE) * at, (1.0 + _ABOVE) * at

        return self._once(("bandwidth", k), found)[0]

    def controller_peak(self, lowest: float) -> float:
        """Return the largest gain of the controller from a frequency, rad/s, on, to 1e-9 from above."""
        return self._once(("controller", lowest), lambda: norms.peak(self.controller, (lowest, np.inf)))[0]

    def _once(self, of: Hashable, found: Callable[[], tuple[float, float]]) -> tuple[float, float]:
        if of not in self._exact:
            self._exact[of] = found()
        return self._exact[of]

    def below(self, parts: Parts, band: norms.Band, k: int, level: float) -> bool:
        """Return whether the gains of parts of plant `k`'s stable loop are shown not to exceed a level in a band."""
        of = (parts, band, k)
        if self._below.get(of, np.inf) <= level:
            return True
        if self._of_continuous(parts):
            exceeded = self._refined(parts, band, k)[0] > level
        else:
            exceeded = any(norms.exceeds(part, level, band) for part in self.axes(parts, k))
        if not exceeded:
            self._below[of] = level
        return not exceeded

    def steps(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Return times (N,), s, and the responses (p, N) of plant `k`'s stable loop to steps of its commands."""
        if k not in self._steps:
            loop = self.settled(self.following.at(k))
            self._steps[k] = step_responses(loop, float(self.decay[k]), self.plants.between)
        return self._steps[k]

    @property
    def peak_frequencies(self) -> FloatArray:
        """Frequencies, rad/s, at which the exact values computed so far are reached."""
        w = np.array([at for _, at in self._exact.values()])
        return np.unique(w[np.isfinite(w) & (w > 0.0)])

    def parts(self, parts: Parts, k: int) -> list[System]:
        """Return the systems of plant `k` whose gains count."""
        found = []
        for transfer in parts:
            if transfer.source == "command":
                loop = self.following.at(k).part(slice(self.kept), slice(None))
                found.append(loop._replace(C=-loop.C, D=transfer.direct * np.eye(self.kept) - loop.D))
                continue
            found += [self.own_arrays.at(k).part(*ends, transfer.direct) for ends in self._ends(transfer)]
        return [self.settled(one) for one in found]

    def axes(self, parts: Parts, k: int) -> list[FrequencyAxis]:
        """Return the same along the frequency axis; what does not depend on inputs and outputs is computed once."""
        if self.plants.drifting or any(one.source == "command" for one in parts):
            return [FrequencyAxis(one, self.poles[k]) for one in self.parts(parts, k)]
        if k not in self._axis:
            self._axis[k] = FrequencyAxis(self.own_arrays.at(k), self.poles[k])
        return [self._axis[k].part(*ends, one.direct) for one in parts for ends in self._ends(one)]

    def _ends(self, transfer: Transfer) -> list[tuple[Index, Index]]:
        """Return outputs and inputs, among those of `own_arrays`, of a part that is not from commands."""
        m = self.m
        if transfer.target == "helping":
            return [([m + i], [m + i]) for i in range(self.kept, self.p)]
        if self.between(transfer):
            raise TypeError("what continuous disturbances do is not rational in z: see `gain_at`")
        kept = slice(m, m + self.kept)
        rows = slice(m) if transfer.target == "torque" else kept
        return [(rows, slice(m) if transfer.source == "torque" else kept if rows is kept else slice(m, None))]

    def between(self, transfer: Transfer) -> bool:
        """Return whether a part is from a continuous disturbance: between samples, not rational in z."""
        if transfer.source == "torque" and transfer.target != "torque":
            # Commands of another loop in place of torques are sampled.
            return bool(self._disturbed.read.shape[-1] == 2 * self.m + 3)
        return transfer.source == "Omega"

    @cached_property
    def _disturbed(self) -> Disturbed:
        return self.plants.disturbed_on_grid()

    def _of_continuous(self, parts: Parts) -> bool:
        return any(self.between(one) for one in parts)

    def _refined(self, parts: Parts, band: norms.Band, k: int) -> tuple[float, float]:
        """Return the largest gain of parts from continuous disturbances, and its frequency, rad/s.

        Infinite where it grows without bound towards zero frequency.
        """
        grid, s = self.plants.frequency, pole.continuous_poles(self.poles[k], self.period)
        s = s[np.isfinite(s)]
        own = pole.resonances(s)
        slowest = np.abs(s[s != 0.0]).min(initial=grid[0])
        low = max(min(_LIMIT * float(slowest), grid[0]), _ROUNDING / self.period)
        w = np.concatenate([np.geomspace(low, grid[0], 20), grid, own[own >= low]])
        sampling = 2.0 * np.pi / self.period
        # A disturbance may be faster than what is sampled.
        w = np.concatenate([w, *(abs(n * sampling + sign * w) for n in (1, 2) for sign in (-1.0, 1.0))])
        edges = [edge for edge in band if 0.0 < edge < np.inf]
        w = np.unique(np.concatenate([w[(w >= band[0]) & (w <= band[1]) & (w >= low)], edges]))
        if band[0] == 0.0:
            slow, slower = self.gain_at(parts, w[0] * np.array([1.0, 0.1]), k)
            if slower > _GROWING * slow:
                return np.inf, 0.0
        return norms.refined_peak(lambda at: self.gain_at(parts, at, k), w)

    def gain_at(self, parts: Parts, frequency: FloatArray, k: int) -> FloatArray:
        """Return the largest gain (F,) of parts of the closed loop with plant `k` at any frequencies (F,), rad/s."""
        continuous = [one for one in parts if self.between(one)]
        sampled = tuple(one for one in parts if not self.between(one))
        found = [norms.gains(one, frequency) for one in self.parts(sampled, k)]
        if continuous:
            # Several gains are taken at the same frequencies.
            at = (k, frequency.tobytes())
            if at not in self._alone:
                controller = self.controller if self.two_degrees is None else self.two_degrees
                one_plant = replaced(self.plants.only([k]), {"disturbed": None})
                self._alone[at] = Loop(one_plant.on(frequency), controller)
            alone = self._alone[at]
            first = np.zeros(1, dtype=np.intp)
            found += [largest_singular_values(one[0]) for part in continuous for one in alone.responses(part, first)]
        return np.asarray(np.max(found, axis=0))

    def fed(self, frequency: FloatArray) -> ComplexArray:
        """Return the torques of feedforward per platform rate, (F, m, 3), at frequencies (F,), rad/s."""
        fed = self.plants.feedforward
        if fed is None or fed.into != "torque":
            return np.zeros((len(frequency), self.m, 3), dtype=np.complex128)
        return fed.response(frequency)

    def at(self, members: Indices, disturbed: bool, cut: slice = slice(None)) -> Responses:
        """Return what maps are made of, of some plants on a part of the grid, (k, F, ...)."""
        plants, w = self.plants, self.plants.frequency[cut]
        size = len(members), len(w), self.m
        return Responses(
            plants.response[members, cut],
            np.broadcast_to(self.K[cut], (*size, self.p)),
            self.S_output[members, cut],
            self.S_input[members, cut],
            np.broadcast_to(self.fed(w), (*size, 3)),
            *((one[members, cut] for one in self._disturbed) if disturbed else UNDISTURBED),
        )

    def responses(self, transfer: Transfer, members: Indices) -> list[ComplexArray]:
        """Return the responses of a part of some closed loops on the grid, (k, F, ...), which may be several."""
        plants, k = self.plants, self.kept
        if transfer.target == "sight" and not plants.sight:
            raise ArgumentError(
                "attenuation: the loop moves no line of sight; give the plant a [line_of_sight] that the loop turns"
            )
        if transfer.source == "command" and self.two_degrees is not None:
            H, S = frequency_response(self.two_degrees, plants.frequency, -3)[..., self.p :], self.S_output[members]
            return [transfer.direct * np.eye(k) - S[..., :k, :] @ plants.response[members] @ H]
        maps = maps_of(transfer, plants)
        at = self.at(members, any(one.disturbed for one in maps))
        if transfer.of_limit and not maps:  # no torquer has a limit
            return [np.zeros((*at.P.shape[:2], 1, 3), dtype=np.complex128)]
        return [one.response(at) for one in maps]

    def grid_peaks(self, parts: Parts, band: norms.Band, members: Indices) -> FloatArray:
        """Return the largest gain of the parts of some plants within `band`, (k,); infinite of an unstable loop."""
        grid = self.plants.frequency
        responses = [response for transfer in parts for response in self.responses(transfer, members)]
        inside = (grid >= band[0]) & (grid <= band[1])
        if not inside.any():
            # A band beside the grid, or between two of its points.
            inside[[np.abs(grid - edge).argmin() for edge in band if np.isfinite(edge)]] = True
        peaks: FloatArray = np.max([_highest(response[:, inside]) for response in responses], axis=0)
        for i, k in enumerate(members):
            w = self.narrow.get(int(k), np.zeros(0))
            w = w[(w >= band[0]) & (w <= band[1])]
            if not w.size:
                continue
            peaks[i] = max(peaks[i], float(self.gain_at(parts, w, int(k)).max()))
        return np.where(self.decay[members] > 0.0, peaks, np.inf)

    @cached_property
    def narrow(self) -> dict[int, FloatArray]:
        """Frequencies, rad/s, of resonances of stable loops that may hide between two points of the grid, by plant."""
        grid = self.plants.frequency
        s = pole.continuous_poles(self.poles, self.plants.period)
        centre = np.where(np.isfinite(s), s.imag, 0.0)
        place = np.clip(np.searchsorted(grid, centre), 1, len(grid) - 1)
        # Below the grid its first frequency is the spacing.
        spacing = np.where(centre < grid[0], centre, grid[place] - grid[place - 1])
        narrow = (centre > 0.0) & (-s.real < _NARROW * spacing) & (self.decay > 0.0)[:, None]
        return {int(k): np.unique(np.abs(s[k, narrow[k]].imag)) for k in np.flatnonzero(narrow.any(axis=1))}


def _highest(matrices: ComplexArray) -> FloatArray:
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
