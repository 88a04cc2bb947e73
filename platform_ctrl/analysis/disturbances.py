"""What shakes a sampled loop: spectra, sines, noise of samples. Frequencies in rad/s, densities one-sided per hertz."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.common.arguments import complex_numbers, positive, real_numbers
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError


@value
class Spectrum:
    """A one-sided power spectral density: its integral over frequency in hertz is the variance."""

    # (n,): frequencies, rad/s, >= 0, rising: where the density changes its law. It is zero below the first and above
    # the last.
    knots: FloatArray
    # (n,) or callable: in the square of the signal's unit per Hz. Numbers: the values at the knots, > 0, joined by
    # straight lines in double-logarithmic scales. Or a function of frequencies (N,), rad/s, that returns densities
    # (N,), smooth between the knots.
    density: FloatArray | Callable[[FloatArray], FloatArray]

    def __post_init__(self) -> None:
        """Judge the table."""
        knots = real_numbers("spectrum: knots", self.knots)
        if knots.ndim != 1 or len(knots) < 2 or not np.isfinite(knots).all() or knots[0] < 0.0:
            raise ArgumentError("spectrum: knots must be at least two finite frequencies >= 0, in rad/s")
        if not np.all(np.diff(knots) > 0.0):
            raise ArgumentError("spectrum: knots must rise from one to the next; sort the table")
        object.__setattr__(self, "knots", knots)
        if callable(self.density):
            return
        density = real_numbers("spectrum: density", self.density)
        if density.shape != knots.shape or not (np.isfinite(density).all() and np.all(density > 0.0)):
            raise ArgumentError(f"spectrum: density must be {len(knots)} finite numbers > 0, one for each knot")
        if knots[0] == 0.0:
            raise ArgumentError("spectrum: a table must begin above 0 rad/s: it is interpolated in logarithms")
        object.__setattr__(self, "density", density)

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the density at frequencies of any shape, rad/s, of any sign."""
        w = np.abs(frequency)
        out = np.zeros(w.shape)
        inside = (w >= self.knots[0]) & (w <= self.knots[-1])
        if callable(self.density):
            out[inside] = self.density(w[inside])
        else:
            out[inside] = np.exp(np.interp(np.log(w[inside]), np.log(self.knots), np.log(self.density)))
        return out


@value
class RandomDisturbance:
    """A stationary random disturbance on one input or, correlated, on several."""

    name: str  # of the source
    inputs: tuple[int, ...]  # indices among the disturbance inputs
    spectra: tuple[Spectrum, ...]  # one for each of them
    # complex (n, n): Hermitian, positive semidefinite, ones on the diagonal: the cross spectral density of inputs i and
    # j is coherence[i, j] √(S_i S_j). Default: uncorrelated.
    coherence: ComplexArray | None = None

    def __post_init__(self) -> None:
        """Judge sizes and the coherence."""
        n = len(self.inputs)
        if len(self.spectra) != n or n == 0:
            raise ArgumentError(f"source {self.name}: there must be one spectrum for each of its inputs")
        if self.coherence is None:
            return
        given = complex_numbers(f"source {self.name}: coherence", self.coherence)
        if (
            given.shape != (n, n)
            or not np.allclose(given, given.conj().T, rtol=0.0, atol=1e-12)
            or not np.allclose(np.diag(given), 1.0, rtol=0.0, atol=1e-12)
            or np.linalg.eigvalsh(given)[0] < -1e-10
        ):
            raise ArgumentError(
                f"source {self.name}: coherence must be {n} x {n}, Hermitian, positive semidefinite, with ones on the "
                "diagonal"
            )
        object.__setattr__(self, "coherence", given)

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

    def __post_init__(self) -> None:
        """Judge sizes."""
        positive(f"source {self.name}: frequency", self.frequency)
        for name in ("amplitude", "phase"):
            given = getattr(self, name)
            if given is not None:
                array = real_numbers(f"source {self.name}: {name}", given)
                if array.shape != (len(self.inputs),) or not np.isfinite(array).all():
                    raise ArgumentError(f"source {self.name}: {name} must be {len(self.inputs)} finite numbers")
                object.__setattr__(self, name, array)

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

    def __post_init__(self) -> None:
        """Judge the rms."""
        positive(f"source {self.name}: rms", self.rms, zero=True)


Disturbance = RandomDisturbance | SineDisturbance | SampleNoise
