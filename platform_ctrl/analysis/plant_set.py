"""Several sampled plants at once, and what a controller makes of them: the figures that requirements ask for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.bandwidth import bandwidth_of_response
from platform_ctrl.analysis.feedback import closed_loop_arrays, sensitivities
from platform_ctrl.analysis.norms import noise_rms_arrays
from platform_ctrl.analysis.poles import continuous_poles, minimum_damping, pole_arrays, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response_arrays
from platform_ctrl.frozen import FloatArray, value

# What a plant of a set stands for: the nominal one; other parameters; another platform rate; a part that fails.
Group = Literal["nominal", "spread", "Omega", "faults"]


@value
class PlantSet:
    """Sampled plants of one loop: the nominal one first, then those that it has to stand.

    Attributes
    ----------
    A, B, C, D : (N, ...)
        Stacked arrays, torques → angles.
    period
        s.
    labels, groups
        What each plant is, and what it stands for: ``"nominal"``, ``"spread"``, ``"Omega"`` or ``"faults"``.
    torques, angles
        Signal names.
    B_Omega : (N, n, 3)
        Input of the platform's rate, held between samples and not delayed.
    Omega : (3,)
        Largest platform rate about each axis, rad/s.
    torque_limit : (m,)
        N m; infinite for a torquer without a limit.
    nutation
        Nutation frequency of the nominal plant: its fastest open-loop motion without torquers, rad/s. Where it
        hardly moves by itself, the frequency that stands in for it.
    noise : (p,)
        Rms of one sample of each pick-off, rad.
    frequency : (F,)
        rad/s, up to the Nyquist frequency.
    response : complex (N, F, p, m)
        Of the plants on `frequency`, torques → angles.
    Omega_response : complex (N, F, p, 3)
        Of the plants on `frequency`, platform rate → angles.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    period: float
    labels: tuple[str, ...]
    groups: tuple[Group, ...]
    torques: tuple[str, ...]
    angles: tuple[str, ...]
    B_Omega: FloatArray
    Omega: FloatArray
    torque_limit: FloatArray
    nutation: float
    noise: FloatArray
    frequency: FloatArray
    response: ComplexArray
    Omega_response: ComplexArray

    def only(self, chosen: Sequence[int]) -> PlantSet:
        """Return the set of the `chosen` plants (indices)."""
        index = np.asarray(chosen, dtype=np.intp)
        return dataclasses.replace(
            self,
            A=self.A[index],
            B=self.B[index],
            C=self.C[index],
            D=self.D[index],
            labels=tuple(self.labels[k] for k in index),
            groups=tuple(self.groups[k] for k in index),
            B_Omega=self.B_Omega[index],
            response=self.response[index],
            Omega_response=self.Omega_response[index],
        )


@value
class LoopMeasures:
    """What a controller does to a plant set.

    Attributes
    ----------
    bandwidth
        Nominal: lowest frequency at which the largest singular value of S, at the input or the output, reaches
        1/sqrt(2), rad/s.
    disk_margin : (N,)
        1/‖(S − T)/2‖, all channels at once, the smaller of input and output; 0 where the loop is unstable.
    damping : (N,)
        Smallest damping ratio of the closed-loop poles above a tenth of the nutation frequency.
    decay : (N,)
        Decay rate of the slowest closed-loop pole, 1/s; negative where the loop is unstable.
    torque_noise : (m,)
        Nominal rms of the torques from pick-off noise, N m; infinite where the loop is unstable.
    groups
        What each plant stands for, as in `PlantSet`.
    """

    bandwidth: float
    disk_margin: FloatArray
    damping: FloatArray
    decay: FloatArray
    torque_noise: FloatArray
    groups: tuple[Group, ...]

    def of(self, groups: Sequence[Group]) -> FloatArray:
        """Return which plants belong to `groups`, truth values (N,)."""
        return np.array([group in groups for group in self.groups], dtype=np.bool_)


def tuning_grid(nutation: float, period: float) -> FloatArray:
    """Return frequencies, rad/s, dense where margins are lost: between a sixth and about twice the nutation."""
    nyquist = np.pi / period
    edges = np.clip([nutation / 150.0, nutation / 6.0, 2.2 * nutation, 0.999 * nyquist], None, 0.999 * nyquist)
    counts = (15, 60, 15)
    parts = [
        np.geomspace(low, high, k, endpoint=False)
        for low, high, k in zip(edges, edges[1:], counts, strict=False)
        if high > low
    ]
    return np.append(np.concatenate(parts), 0.999 * nyquist)


def plant_set(
    plants: StateArrays,
    labels: tuple[str, ...],
    torques: tuple[str, ...],
    angles: tuple[str, ...],
    nutation: float,
    noise: FloatArray,
    *,
    groups: tuple[Group, ...] | None = None,
    B_Omega: FloatArray | None = None,
    Omega: FloatArray | None = None,
    torque_limit: FloatArray | None = None,
) -> PlantSet:
    """Return the set, its responses worked out once on `tuning_grid`.

    Without `groups` the first plant is the nominal one and the others are its spread; without the rest the platform
    does not turn and the torquers have no limits.
    """
    grid = tuning_grid(nutation, plants.dt)
    others: tuple[Group, ...] = ("spread",) * (len(labels) - 1)
    B_Omega = np.zeros((*plants.A.shape[:-1], 3)) if B_Omega is None else B_Omega
    D_Omega = np.zeros((*plants.D.shape[:-1], 3))
    return PlantSet(
        A=plants.A,
        B=plants.B,
        C=plants.C,
        D=plants.D,
        period=plants.dt,
        labels=labels,
        groups=("nominal", *others) if groups is None else groups,
        torques=torques,
        angles=angles,
        B_Omega=B_Omega,
        Omega=np.zeros(3) if Omega is None else Omega,
        torque_limit=np.full(len(torques), np.inf) if torque_limit is None else torque_limit,
        nutation=nutation,
        noise=noise,
        frequency=grid,
        response=frequency_response_arrays(*plants, grid),
        Omega_response=frequency_response_arrays(plants.A, B_Omega, plants.C, D_Omega, plants.dt, grid),
    )


def measure(plants: PlantSet, controller: StateArrays) -> LoopMeasures:
    """Measure `controller` (u = K y, same period) on every plant, on the set's frequency grid.

    Margins between grid points are missed: certify with the norms of the closed loop.
    """
    K = frequency_response_arrays(*controller, plants.frequency)
    p, m = plants.C.shape[-2], plants.B.shape[-1]
    S_output, _ = sensitivities(-plants.response @ K)
    # At the input S = I + K S_output P: one inverse serves both.
    S_input = np.asarray(np.eye(m) + K @ S_output @ plants.response, dtype=np.complex128)
    peak = np.maximum(_largest(S_output - 0.5 * np.eye(p)), _largest(S_input - 0.5 * np.eye(m)))
    A, B, C, D = closed_loop_arrays(plants.A, plants.B, plants.C, plants.D, *controller[:4])
    poles = pole_arrays(A)
    decay = -spectral_abscissa(continuous_poles(poles, plants.period))
    torque_noise = noise_rms_arrays(A[0], B[0][:, m:], C[0][:m], D[0][:m, m:], plants.noise)
    return LoopMeasures(
        bandwidth=float(min(bandwidth_of_response(plants.frequency, S[0]) for S in (S_output, S_input))),
        disk_margin=np.where(decay > 0.0, 1.0 / peak.max(axis=-1), 0.0),
        damping=minimum_damping(poles, plants.nutation / 10.0, plants.period),
        decay=decay,
        torque_noise=torque_noise,
        groups=plants.groups,
    )


def _largest(matrices: ComplexArray) -> FloatArray:
    """Largest singular values, (...): from the Hermitian square, which is faster in batches."""
    square = matrices.conj().swapaxes(-1, -2) @ matrices
    out: FloatArray = np.sqrt(np.linalg.eigvalsh(square)[..., -1])
    return out
