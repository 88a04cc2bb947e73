"""A continuous plant behind a sampler and a hold: responses at a frequency and at all its images, without averaging.

Disturbances are spectra, sines and noise of samples: frequencies in rad/s, densities one-sided per hertz.

::

        w(t) ──►┌───┐──► z(t)
                │ P │
    u(t) ──────►└───┘──► y(t) ──► sampler, period T ──► reading delay ──► K ──► hold ──► delay ──► lag ──► u(t)

A component of w at a frequency ω acts on z at ω and at ω + n ω_s, ω_s = 2 π/T, because the sampler takes all these
frequencies for one. With H the hold with its delay and P_d the exactly sampled plant,

    z(ω) = [P_zw(jω) + P_zu(jω) H(jω) M(ω) P_yw(jω)] w,        z(ω + n ω_s) = P_zu H(j(ω + n ω_s)) M(ω) P_yw(jω) w,

where M = K (I − P_d K)⁻¹ at exp(jωT) (Åström and Wittenmark, Computer-Controlled Systems, 1997, ch. 7; Chen and
Francis, Optimal Sampled-Data Control Systems, 1995, ch. 3).

A controller of loops at several rates repeats itself after a cycle of N samples only. It takes frequencies for one that
are multiples of ω_s/N apart; of a sequence of samples N of them differ. All is as above with images at ω + n ω_s/N, the
n-th of which belongs to component n mod N (Bittanti and Colaneri, Periodic Systems, 2009, ch. 2).

The loops at every sample treat each component by itself. Those at every n-th sample read the sum of all components that
n samples take for one, and hold what they set: each component has its share of that. So M from all N of y to all N of u
is diagonal but for a matrix of as low a rank as there are signals that are held, and is nowhere formed:

    u_r = own_r y_r + held_r Σ heard_s y_s        over all components s.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.interconnection import Modulator, MultiRate, at_several_rates
from platform_ctrl.analysis.periodic import pruned
from platform_ctrl.analysis.poles import over_a_cycle, poles
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import energy_rows, late_outputs, sampled, with_lag
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import not_negative
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

MOST_OF_SOURCES = 1_000  # images on each side that sources may need
# A pole this near to the unit circle counts as one on it; a direction is not seen below this share of the matrix.
_BOUNDARY, _UNSEEN = 1e-10, 1e-11
# Remainders of sums over all images below this share of the whole are rounding.
_ROUNDING = 1e-13


@value
class Density:
    """A one-sided power spectral density: its integral over frequency in hertz is the variance."""

    # (n,): frequencies, rad/s, >= 0, rising: where the density changes its law. It is zero below the first and above
    # the last.
    knots: FloatArray
    # In the square of the signal's unit per Hz, of frequencies (N,), rad/s; smooth between the knots.
    density: Callable[[FloatArray], FloatArray]

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the density at frequencies of any shape, rad/s, of any sign."""
        w = np.abs(frequency)
        out = np.zeros(w.shape)
        inside = (w >= self.knots[0]) & (w <= self.knots[-1])
        out[inside] = self.density(w[inside])
        return out


@value
class RandomDisturbance:
    """A stationary random disturbance on one input or, correlated, on several."""

    name: str  # of the source
    inputs: tuple[int, ...]  # indices among the disturbance inputs
    spectra: tuple[Density, ...]  # one for each of them
    # complex (n, n): Hermitian, positive semidefinite, ones on the diagonal: the cross spectral density of inputs i and
    # j is coherence[i, j] √(S_i S_j). Default: uncorrelated.
    coherence: ComplexArray | None = None

    def columns(self, frequency: FloatArray, inputs: int) -> ComplexArray:
        """Return F (..., inputs, n), F F' the cross spectral density at frequencies (...) with their signs."""
        n = len(self.inputs)
        root = np.sqrt(np.stack([one.at(frequency) for one in self.spectra], axis=-1))
        factor = np.eye(n, dtype=np.complex128)
        if self.coherence is not None:
            values, vectors = np.linalg.eigh(self.coherence)
            factor = vectors * np.sqrt(np.maximum(values, 0.0))
        signed = np.where((frequency < 0.0)[..., None, None], factor.conj(), factor)
        out = np.zeros((*frequency.shape, inputs, n), dtype=np.complex128)
        for i, at in enumerate(self.inputs):
            out[..., at, :] += root[..., i, None] * signed[..., i, :]
        return out


@value
class SineDisturbance:
    """A sine amplitude · sin(frequency · t + phase) on one or several inputs."""

    name: str  # of the source
    inputs: tuple[int, ...]  # indices among the disturbance inputs
    frequency: float  # rad/s, > 0
    amplitude: FloatArray  # (n,): of each input, in its unit
    # (n,), optional: rad. Sines of one frequency whose phases are given add as they come; without a phase a sine is
    # independent of all others, and its inputs are in phase.
    phase: FloatArray | None = None

    def vector(self, inputs: int) -> ComplexArray:
        """Return the complex amplitude of every disturbance input (inputs,)."""
        out = np.zeros(inputs, dtype=np.complex128)
        phase = np.zeros(len(self.inputs)) if self.phase is None else self.phase
        np.add.at(out, list(self.inputs), self.amplitude * np.exp(1j * phase))
        return out


@value
class SampleNoise:
    """White noise that every sample of a measured output adds: of the sensor, its quantisation (step/√12), its bits."""

    name: str  # of the source
    measured: int  # index of the measured output
    rms: float  # standard deviation of a sample, in the output's unit


Disturbance = RandomDisturbance | SineDisturbance | SampleNoise


@value
class HybridPlant:
    """A continuous plant, inputs [u, w] and outputs [y, z], with samplers, delays and lags between y and u."""

    # Continuous arrays; inputs: m controls u, then k disturbances w; outputs: p measured y, then q performance outputs
    # z, in SI units. y may have a direct path from w.
    plant: System
    # controls, measured: m and p.
    controls: int
    measured: int
    period: float  # sample period, s
    delay: float = 0.0  # from the sample to the time at which the hold's output acts, s; any number >= 0
    # (m,): time constant of the first-order lag behind each hold, s; 0 for none.
    lag: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(()))
    reading_delay: tuple[int, ...] = ()  # (p,): whole periods by which each measured output arrives late
    # (q,): whether the performance output's integral is meant: an angle, of which the plant has the rate. So the pole
    # at zero of an inertial angle never enters the loop.
    integrated: tuple[bool, ...] = ()
    cycle: int = 1  # samples after which the controller repeats itself
    # (n, k), optional: what the integral of each disturbance does to the states besides. Not states, whose poles at
    # zero no controller could move.
    of_integral: FloatArray | None = None

    def __post_init__(self) -> None:
        """Give every control a lag, every measured output a delay."""
        object.__setattr__(self, "lag", not_negative("hybrid plant: lag", self.lag, self.controls))
        object.__setattr__(self, "reading_delay", self.reading_delay or (0,) * self.measured)
        object.__setattr__(self, "integrated", self.integrated or (False,) * self.outputs)

    @property
    def sample_frequency(self) -> float:
        """ω_s = 2 π/T, rad/s."""
        return 2.0 * math.pi / self.period

    @property
    def turn(self) -> float:
        """ω_s/N: the distance of the frequencies that the controller takes for one, rad/s."""
        return self.sample_frequency / self.cycle

    @property
    def highest(self) -> float:
        """Frequency, rad/s, up to which sources may reach."""
        return MOST_OF_SOURCES * self.turn

    @property
    def disturbances(self) -> int:
        """k: the number of disturbance inputs."""
        return int(self.plant.D.shape[1]) - self.controls

    @property
    def outputs(self) -> int:
        """q: the number of performance outputs."""
        return int(self.plant.D.shape[0]) - self.measured


class Family(NamedTuple):
    """Responses at N frequencies ω and at their F images, for a cycle of R samples."""

    frequency: FloatArray  # (N, F): with its sign, rad/s
    held: ComplexArray  # complex (N, F, q, m): from the control of a sample to z before integration: P_zu H
    direct: ComplexArray  # complex (N, F, q, k): from w to z before integration
    integral: ComplexArray  # complex (N, F, q, 1): 1/(jω) where z is integrated, 1 elsewhere
    measured: ComplexArray  # complex (N, F, p, k): from w to y
    sampled: ComplexArray  # complex (N, R, p, m): P_d of each component


class OpenLoop:
    """The part of a `HybridPlant` that does not depend on the controller, computed once."""

    def __init__(self, plant: HybridPlant) -> None:
        self.plant = plant
        m, p = plant.controls, plant.measured
        lags = np.concatenate([plant.lag, np.zeros(plant.disturbances)])
        self._continuous = with_lag(plant.plant, lags)
        self._integral: System | None = None
        if plant.of_integral is not None:
            A, _, C, D, _ = plant.plant
            self._integral = System(A, plant.of_integral, C, 0.0 * D[:, plant.controls :])
        self.size = self._continuous.D.size
        A, B, C, D, _ = self._continuous
        self.sampled = sampled(System(A, B[:, :m], C[:p], D[:p, :m]), plant.period, plant.delay)
        rows = energy_rows(System(A, B[:, :m], C[p:], D[p:, :m]), plant.period, plant.delay)
        self._ends = np.cumsum([0, *(len(one) for one in rows)])
        every = np.vstack([np.zeros((0, len(self.sampled.A) + m)), *rows])
        own = len(self.sampled.A)
        self._images = self.sampled._replace(C=every[:, :own], D=every[:, own:])

    def family(self, omega: FloatArray, images: NDArray[np.intp]) -> Family:
        """Return the responses at frequencies (N,), rad/s, of any sign but not zero, and at images n (F,)."""
        plant = self.plant
        m, p, T = plant.controls, plant.measured, plant.period
        w = omega[:, None] + images * plant.turn
        P = _signed_response(self._continuous, w)
        with np.errstate(divide="ignore", invalid="ignore"):
            once = np.where(np.array(plant.integrated), -1j * (1.0 / w)[..., None], 1.0)[..., None]
            if self._integral is not None:
                P[..., m:] += _signed_response(self._integral, w) / (1j * w)[..., None, None]
        z = P[:, :, p:]
        hold = np.exp(-1j * w * (0.5 * T + plant.delay)) * np.sinc(w * (0.5 * T / np.pi))
        sampled_response = _signed_response(self.sampled, self._components(omega))
        return Family(w, z[..., :m] * hold[..., None, None], z[..., m:], once, P[:, :, :p, m:], sampled_response)

    def _components(self, omega: FloatArray) -> FloatArray:
        """Return the components (N, R) between −ω_s/2 and ω_s/2, for ω below ω_s/(2R)."""
        R = self.plant.cycle
        return omega[:, None] + ((np.arange(R) + R // 2) % R - R // 2) * self.plant.turn

    def _all_images(self, omega: FloatArray) -> ComplexArray:
        """Return Σ L' L over all images n of each component, L the row `held` of an output before integration.

        (N, R, q, m, m). By Parseval's theorem over one period: exact, from the Gramian of the lifted plant.
        """
        m, w = self.plant.controls, self._components(omega)
        out = np.zeros((*w.shape, self.plant.outputs, m, m), dtype=np.complex128)
        every = _signed_response(self._images, w)
        for i, (first, last) in enumerate(pairwise(self._ends)):
            E = every[:, :, first:last]
            out[:, :, i] = np.swapaxes(E.conj(), -1, -2) @ E / self.plant.period
        return out

    def remaining_images(self, omega: FloatArray, held: ComplexArray) -> ComplexArray:
        """Return Σ L' L over all images that `held` (N, F, q, m) of outputs before integration leaves out.

        (N, R, q, m, m); the images are those from −(F − 1)/2 to (F − 1)/2.
        """
        every, R, F = self._all_images(omega), self.plant.cycle, held.shape[1]
        component = (np.arange(F) - F // 2) % R
        order = np.argsort(component, kind="stable")
        own = held[:, order]
        power = own.conj()[..., :, None] * own[..., None, :]
        rest = every - np.add.reduceat(power, np.searchsorted(component[order], np.arange(R)), axis=1)
        size = np.einsum("ncqrr->ncq", every).real
        rounding = np.einsum("ncqrr->ncq", rest).real <= _ROUNDING * size
        rest[rounding] = 0.0
        return rest

    def modulator(self, controller: MultiRate, omega: FloatArray, P: ComplexArray) -> Modulator:
        """Return M = K (I − P_d K)⁻¹ at frequencies of any sign, with the reading delays; P is P_d (N, R, p, m)."""
        w, (m, p) = self._components(omega), (self.plant.controls, self.plant.measured)
        late = np.exp(-1j * self.plant.period * w[:, :, None] * np.array(self.plant.reading_delay, dtype=np.float64))
        if self.plant.cycle > 1:
            return at_several_rates(controller, self.plant.cycle, w, P, late)
        K, P = _signed_response(controller.fast, omega) * late, P[:, 0]
        loop = np.eye(p) - P @ K
        M = np.linalg.solve(loop.swapaxes(-1, -2), K.swapaxes(-1, -2)).swapaxes(-1, -2)
        N = len(omega)
        none = np.zeros((N, 1, m, 0), dtype=np.complex128), np.zeros((N, 1, 0, p), dtype=np.complex128)
        return Modulator(M[:, None].astype(np.complex128), *none, np.zeros((1, 0), dtype=np.intp))

    def _closed(self, controller: MultiRate) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the transition of the loop over a cycle, how it is driven, and what is measured at its samples."""
        plant = self.plant
        fast = controller.fast
        if plant.cycle % controller.cycle:
            raise ArgumentError(
                f"controller: repeats after {controller.cycle} samples, the plant's cycle is {plant.cycle}"
            )
        sampled_plant = late_outputs(self.sampled, plant.reading_delay)
        if plant.cycle == 1:
            A, B, C, *_ = sampled_plant.feedback(fast)
            return A, B, C[plant.controls :]
        loops: dict[tuple[bool, ...], System] = {}
        cycle, m = [], plant.controls
        for k in range(plant.cycle):
            due = tuple(k % n == 0 for n in controller.every)
            if due not in loops:
                one = sampled_plant.feedback(controller.at(k))
                # Readings before their delay: of a delayed reading only the used part is a state.
                torques = one.C[:m]
                measured = self.sampled.D @ torques
                measured[:, : len(self.sampled.A)] += self.sampled.C
                C = np.vstack([torques, measured])
                loops[due] = System(one.A, one.B, C, np.zeros((len(C), one.B.shape[1])), one.dt)
            cycle.append(loops[due])
        A, B, C, *_ = over_a_cycle(pruned(cycle))
        return A, B, C.reshape(plant.cycle, -1, A.shape[1])[:, m:].reshape(-1, A.shape[1])

    def closed_poles(self, controller: System | MultiRate) -> ComplexArray:
        """Return the poles z of the loop; refuse a controller that does not fit or does not stabilise.

        A pole on the unit circle or outside counts if it can be excited and seen: the angle of a gimbal whose inertial
        rate is held, and that nothing else depends on, does not.
        """
        A, B, C = self._closed(MultiRate(controller) if isinstance(controller, System) else controller)
        # Equilibria that neither sensors nor outputs see do not count; the torques that hold them would show them.
        z = poles(A)
        for one in z[np.abs(z) >= 1.0 - _BOUNDARY]:
            if self._counts(A, B, C, complex(one)):
                words = f"the sampled loop must be stable, it has a pole at |z| = {abs(one):.6g}"
                raise ArgumentError(f"{words}; check the controller against the plant")
        return z

    def _counts(self, A: FloatArray, B: FloatArray, C: FloatArray, z: complex) -> bool:
        """Return whether a pole is seen from y or z and reached from u or w."""
        n = len(A)
        continuous, m, p = self._continuous, self.plant.controls, self.plant.measured
        states = len(continuous.A)
        seen = np.zeros((self.plant.outputs, n))
        seen[:, :states] = continuous.C[p:]
        reached = np.zeros((n, self.plant.disturbances))
        reached[:states] = continuous.B[:, m:]
        pencil = z * np.eye(n) - A
        for matrix in (
            np.vstack([pencil, _unit(C.T).T, _unit(seen.T).T]),
            np.hstack([pencil, _unit(B), _unit(reached)]).T,
        ):
            values = np.linalg.svd(matrix, compute_uv=False)
            if values[-1] <= _UNSEEN * values[0]:
                return False
        return True


def _unit(columns: FloatArray) -> FloatArray:
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(columns / np.where(size > 0.0, size, 1.0))


def _signed_response(system: System, omega: FloatArray) -> ComplexArray:
    """Return the response (..., p, m) at frequencies (...) of any sign, rad/s."""
    w, place = np.unique(np.abs(omega), return_inverse=True)
    found = frequency_response(system, w, -3)[place.reshape(omega.shape)]
    return np.asarray(np.where((omega < 0.0)[..., None, None], found.conj(), found))
