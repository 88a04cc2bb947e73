"""A continuous plant behind a sampler and a hold: responses at a frequency and at all its images, without averaging.

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
are multiples of ω_s/N apart; of a sequence of samples N of them differ. With their components stacked, K and M are
matrices from all N of y to all N of u, P_d is diagonal, and all else is as above, with images at ω + n ω_s/N, the n-th
of which belongs to component n mod N (Bittanti and Colaneri, Periodic Systems, 2009, ch. 2). N = 1 is the usual loop.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, scaled, system_arrays
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.lifting import SampledPlant, lifted_plant
from platform_ctrl.analysis.periodic import lifted
from platform_ctrl.analysis.poles import poles
from platform_ctrl.analysis.resolvent import TOLERATED
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import late_outputs, sampled, split_delay, with_lag
from platform_ctrl.common.arguments import not_negative, whole
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

# Error of plant responses, relative: what feedback cancels costs digits in proportion to its gain.
_PLANT_TOLERANCE = 1e-13
# A pole this near to the unit circle counts as one on it; a direction is not seen below this share of the matrix.
_BOUNDARY, _UNSEEN = 1e-10, 1e-11
# Remainders of sums over all images below this share of the whole are rounding.
_ROUNDING = 1e-13


@value
class HybridPlant:
    """A continuous plant, inputs [u, w] and outputs [y, z], and what stands between y and u beside the controller."""

    # Continuous arrays; inputs: m controls u, then k disturbances w; outputs: p measured y, then q performance outputs
    # z, in SI units. y may have a direct path from w.
    plant: StateArrays
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
    # Samples after which the controller repeats itself. Of more than one it is `lifted`: its inputs and outputs are
    # those of all samples of a cycle.
    cycle: int = 1

    def __post_init__(self) -> None:
        """Judge sizes; give every control a lag, every measured output a delay."""
        arrays = system_arrays("hybrid plant", *self.plant)
        if arrays.dt != 0.0 or arrays.A.ndim != 2:
            raise ArgumentError("hybrid plant: it must be one continuous system; sampling is part of the analysis")
        outputs, inputs = arrays.D.shape
        whole("hybrid plant: controls", self.controls, 1, inputs)
        whole("hybrid plant: measured", self.measured, 1, outputs)
        split_delay("hybrid plant", self.period, self.delay, self.controls)
        whole("hybrid plant: cycle", self.cycle, 1)
        delays = self.reading_delay or (0,) * self.measured
        integrated = self.integrated or (False,) * (outputs - self.measured)
        for name, given, size in (
            ("reading_delay", delays, self.measured),
            ("integrated", integrated, outputs - self.measured),
        ):
            if len(given) != size:
                raise ArgumentError(f"hybrid plant: {name} must be {size} values, got {len(given)}")
        for one in delays:
            whole("hybrid plant: reading_delay", one, 0)
        object.__setattr__(self, "plant", arrays)
        object.__setattr__(self, "lag", not_negative("hybrid plant: lag", self.lag, self.controls))
        object.__setattr__(self, "reading_delay", tuple(delays))
        object.__setattr__(self, "integrated", tuple(bool(one) for one in integrated))

    @property
    def sample_frequency(self) -> float:
        """ω_s = 2 π/T, rad/s."""
        return 2.0 * math.pi / self.period

    @property
    def turn(self) -> float:
        """ω_s/N: the distance of the frequencies that the controller takes for one, rad/s."""
        return self.sample_frequency / self.cycle

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
    """What of a `HybridPlant` does not depend on the controller, computed once."""

    def __init__(self, plant: HybridPlant) -> None:
        self.plant = plant
        m, p = plant.controls, plant.measured
        lags = np.concatenate([plant.lag, np.zeros(plant.disturbances)])
        self._continuous = with_lag(plant.plant, lags)
        A, B, C, D, _ = self._continuous
        self.sampled = sampled(StateArrays(A, B[:, :m], C[:p], D[:p, :m]), plant.period, plant.delay)
        period, parts, part = split_delay("hybrid plant", plant.period, plant.delay, m)
        n = len(A)
        self._lifted = [
            lifted_plant(
                SampledPlant(
                    A,
                    np.zeros((n, 0)),
                    B[:, :m],
                    C[row : row + 1],
                    np.zeros((0, n)),
                    np.zeros((1, 0)),
                    D[row : row + 1, :m],
                    np.zeros((0, m)),
                    period,
                    parts,
                    part,
                ),
                math.inf,
            )
            for row in range(p, len(C))
        ]

    def family(self, omega: FloatArray, images: FloatArray) -> Family:
        """Return the responses at frequencies (N,), rad/s, of any sign but not zero, and at images n (F,)."""
        plant = self.plant
        m, p, T = plant.controls, plant.measured, plant.period
        w = omega[:, None] + images * plant.turn
        flat, place = np.unique(np.abs(w), return_inverse=True)
        P = frequency_response(self._continuous, flat, -3, _PLANT_TOLERANCE)[place.reshape(w.shape)]
        P = np.where((w < 0.0)[..., None, None], P.conj(), P)
        z = P[:, :, p:]
        with np.errstate(divide="ignore", invalid="ignore"):
            once = np.where(np.array(plant.integrated), -1j * (1.0 / w)[..., None], 1.0)[..., None]
        hold = np.exp(-1j * w * (0.5 * T + plant.delay)) * np.sinc(w * (0.5 * T / np.pi))
        return Family(
            w, z[..., :m] * hold[..., None, None], z[..., m:], once, P[:, :, :p, m:], self._sampled_response(omega)
        )

    def _components(self, omega: FloatArray) -> FloatArray:
        """Return the frequencies (N, R) of the components, between −ω_s/2 and ω_s/2 for ω below ω_s/(2R)."""
        R = self.plant.cycle
        return omega[:, None] + ((np.arange(R) + R // 2) % R - R // 2) * self.plant.turn

    def _sampled_response(self, omega: FloatArray) -> ComplexArray:
        return _signed_response(self.sampled, self._components(omega), _PLANT_TOLERANCE)

    def all_images(self, omega: FloatArray) -> ComplexArray:
        """Return Σ L' L over all images n of each component, L the row `held` of an output before integration.

        (N, R, q, m, m). By Parseval's theorem over one period: exact, from the Gramian of the lifted plant.
        """
        R, m, q = self.plant.cycle, self.plant.controls, len(self._lifted)
        out = np.zeros((len(omega), R, q, m, m), dtype=np.complex128)
        for i, one in enumerate(self._lifted):
            if len(one.C):
                E = _signed_response(one, self._components(omega))
                out[:, :, i] = np.swapaxes(E.conj(), -1, -2) @ E / self.plant.period
        return out

    def of_component(self, component: int, last: int) -> slice:
        """Return the places, among images from −`last` to `last`, of those that belong to a component."""
        return slice((component + last) % self.plant.cycle, None, self.plant.cycle)

    def remaining_images(self, omega: FloatArray, held: ComplexArray) -> ComplexArray:
        """Return Σ L' L over all images that `held` (N, F, q, m) of outputs before integration leaves out.

        (N, R, q, m, m); the images are those from −(F − 1)/2 to (F − 1)/2.
        """
        every = self.all_images(omega)
        rest = every.copy()
        for r in range(self.plant.cycle):
            own = held[:, self.of_component(r, held.shape[1] // 2)]
            rest[:, r] -= np.einsum("nfqr,nfqs->nqrs", own.conj(), own)
        size = np.einsum("ncqrr->ncq", every).real
        rounding = np.einsum("ncqrr->ncq", rest).real <= _ROUNDING * size
        rest[rounding] = 0.0
        return rest

    def modulator(self, controller: StateArrays, omega: FloatArray, P: ComplexArray) -> ComplexArray:
        """Return M = K (I − P_d K)⁻¹ (N, R, m, R, p) at frequencies of any sign; K with the reading delays."""
        w = self._components(omega)
        late = np.exp(-1j * self.plant.period * w[:, :, None] * np.array(self.plant.reading_delay, dtype=np.float64))
        if self.plant.cycle > 1:
            return _of_cycle(controller, self.plant.period, omega, P, late)
        K, P = _signed_response(controller, omega) * late, P[:, 0]
        if self.plant.measured == 1:
            M = K / (1.0 - P @ K)
        else:
            loop = np.eye(self.plant.measured) - P @ K
            M = np.linalg.solve(loop.swapaxes(-1, -2), K.swapaxes(-1, -2)).swapaxes(-1, -2)
        return np.asarray(M[:, None, :, None])

    def closed_poles(self, controller: StateArrays) -> ComplexArray:
        """Return the poles z of the loop; refuse a controller that does not fit or does not stabilise.

        A pole on the unit circle or outside counts if it can be excited and seen: the angle of a gimbal whose inertial
        rate is held, and that nothing else depends on, does not.
        """
        plant = self.plant
        controller = system_arrays("controller", *controller)
        R, (outputs, inputs) = plant.cycle, controller.D.shape
        period = R * plant.period
        if (outputs, inputs) != (R * plant.controls, R * plant.measured) or not math.isclose(
            controller.dt, period, rel_tol=1e-9
        ):
            raise ArgumentError(
                f"controller: must have {R * plant.measured} inputs, {R * plant.controls} outputs and "
                f"dt = {period:g} s, got {inputs}, {outputs} and {controller.dt:g}"
            )
        A, B, C, *_ = closed_loop(lifted([late_outputs(self.sampled, plant.reading_delay)] * R), controller)
        # Equilibria that neither sensors nor outputs see; the torques that hold them against springs do.
        C = C[R * plant.controls :]
        z = poles(A)
        for one in z[np.abs(z) >= 1.0 - _BOUNDARY]:
            if self._counts(A, B, C, complex(one)):
                raise ArgumentError(
                    f"the sampled loop must be stable, it has a pole at |z| = {abs(one):.6g}; "
                    "check the controller against the plant"
                )
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
    out: FloatArray = columns / np.where(size > 0.0, size, 1.0)
    return out


def _signed_response(system: StateArrays, omega: FloatArray, tolerance: float = TOLERATED) -> ComplexArray:
    """Return the response (..., p, m) at frequencies (...) of any sign, rad/s."""
    found = frequency_response(system, np.abs(omega).ravel(), -3, tolerance).reshape(*omega.shape, *system.D.shape)
    out: ComplexArray = np.where((omega < 0.0)[..., None, None], found.conj(), found)
    return out


def _of_cycle(
    controller: StateArrays, period: float, omega: FloatArray, P: ComplexArray, late: ComplexArray
) -> ComplexArray:
    """Return M of a lifted controller, P_d (N, R, p, m) and the phases of reading delays (N, R, p).

    An integrator of a slow loop makes some directions of K infinite at zero and not others: K stays state equations.
    """
    N, R, p, m = P.shape
    A, B, C = scaled(*controller[:3])
    n = len(A)
    # From the samples of a cycle to components exp(jω_r t), and back.
    phase = np.exp(1j * period * omega[:, None] * np.arange(R))
    to_samples, to_components = phase[:, :, None], phase.conj()[:, :, None]
    B = R * np.fft.ifft(B.reshape(n, R, p) * to_samples[:, None], axis=2) * late[:, None]
    C = np.fft.fft(C.reshape(R, m, n) * to_components[..., None], axis=1).reshape(N, R * m, n) / R
    D = controller.D.reshape(R, m, R, p) * to_components[..., None, None] * to_samples[:, None, None]
    D = np.fft.ifft(np.fft.fft(D, axis=1), axis=3) * late[:, None, None]
    # Controls with the loop closed by D alone, then states with the loop closed.
    through = (np.moveaxis(D.reshape(N, R * m, R, p), 2, 1) @ P).swapaxes(1, 2).reshape(N, R * m, R * m)
    D = D.reshape(N, R * m, R * p)
    direct = np.linalg.solve(np.eye(R * m) - through, np.concatenate([C, D], axis=-1))
    driven = (B.swapaxes(1, 2) @ P).swapaxes(1, 2).reshape(N, n, R * m) @ direct
    z = np.exp(1j * R * period * omega)[:, None, None]
    x = np.linalg.solve(z * np.eye(n) - A - driven[..., :n], B.reshape(N, n, R * p) + driven[..., n:])
    return np.asarray((direct[..., :n] @ x + direct[..., n:]).reshape(N, R, m, R, p))
