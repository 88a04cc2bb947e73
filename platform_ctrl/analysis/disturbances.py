"""What shakes a sampled loop: spectra, sines, noise of samples. Frequencies in rad/s, densities one-sided per hertz."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from platform_ctrl.analysis.system import ComplexArray
from platform_ctrl.common.values import FloatArray, value


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
