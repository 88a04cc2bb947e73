"""Loops whose controllers are not all computed at every sample: linear and periodic, over a whole period as one system.

With N samples to a period the inputs and outputs of these samples are stacked (lifting), which keeps energies: the
norm of the stacked system is the largest ratio of the energies of the periodic one (Khargonekar, Poolla and Tannenbaum,
IEEE Trans. Automatic Control 30, 1985). A channel's disk margin is that against perturbations that may change with
time. Of a loop that does not, it is the usual one: its norm is the same with and without lifting.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays
from platform_ctrl.analysis.drift import unseen_equilibria, without_drift
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.margins import DiskMargin, no_margin
from platform_ctrl.analysis.mu import search_grid
from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.analysis.poles import continuous_poles, poles, spectral_abscissa
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.common.values import FloatArray


def lifted(systems: Sequence[StateArrays]) -> StateArrays:
    """Return N systems that take turns, sample by sample, as one of N samples: their inputs and outputs are stacked."""
    N, n, (p, m) = len(systems), len(systems[0].A), systems[0].D.shape
    state, driven = np.eye(n), np.zeros((n, N * m))
    C, D = np.zeros((N * p, n)), np.zeros((N * p, N * m))
    for k, one in enumerate(systems):
        rows, columns = slice(k * p, (k + 1) * p), slice(k * m, (k + 1) * m)
        C[rows], D[rows] = one.C @ state, one.C @ driven
        D[rows, columns] += one.D
        state, driven = one.A @ state, one.A @ driven
        driven[:, columns] += one.B
    return StateArrays(state, driven, C, D, N * systems[0].dt)


class PeriodicLoop:
    """A sampled plant closed by a controller whose matrices take turns: u = K y, `at` and `seen` what it uses of it.

    All repeats after `period`, s; `poles` (n,) are those of the transition over it, in z.
    """

    def __init__(
        self, plant: StateArrays, by_sample: Sequence[StateArrays], at: Sequence[int], seen: Sequence[int]
    ) -> None:
        m = len(at)
        own = plant.part(seen, at)
        # From disturbances of the torques, then noise of what is measured, to the torques, then to what is measured.
        closed = {id(K): closed_loop(own, K) for K in by_sample}
        self._loops = [closed[id(K)] for K in by_sample]
        self.samples, self.channels = len(by_sample), m
        self.period = self.samples * plant.dt
        # Without the equilibria that no sensor sees.
        self.drift = unseen_equilibria(self._lifted(range(m, m + len(seen)), []))
        self.poles: ComplexArray = poles(self.drift.system.A)

    def _lifted(self, outputs: Sequence[int], inputs: Sequence[int]) -> StateArrays:
        return lifted([loop.part(outputs, inputs) for loop in self._loops])

    def _disk(self, channels: Sequence[int]) -> StateArrays:
        """Return S − I/2 at the torques of some channels, lifted."""
        A, B, C, D, dt = self._lifted(channels, channels)
        return without_drift(StateArrays(A, B, C, D + 0.5 * np.eye(len(D)), dt))

    @property
    def decay(self) -> float:
        """The minimum decay rate, 1/s."""
        return -float(spectral_abscissa(continuous_poles(self.poles, self.period)))

    def loop_margins(self) -> FloatArray:
        """Return the disk margin of each channel, all others closed, (m,); 0 if the loop is not stable."""
        if not self.decay > 0.0:
            return np.zeros(self.channels)
        norms = [hinf_norm(self._disk([k]), allow_unstable=True)[0] for k in range(self.channels)]
        return np.array([1.0 / norm if norm > 0.0 else math.inf for norm in norms])

    def disk_margin(self) -> DiskMargin:
        """Return the disk margin of all channels at once, guaranteed by one scaling of each channel."""
        from scipy.linalg import matrix_balance

        disk, s = self._disk(range(self.channels)), continuous_poles(self.poles, self.period)
        if not self.decay > 0.0:
            return no_margin(0.0, np.zeros(0), s, disk)
        grid = search_grid(disk, s)
        response = frequency_response(disk, grid, -3)
        # Of every pair of channels the largest gain, in any order of the samples.
        N, m = self.samples, self.channels
        blocks = response.reshape(-1, N, m, N, m).transpose(0, 2, 4, 1, 3)
        sizes = largest_singular_values(blocks.reshape(-1, N, N)).reshape(-1, m, m)
        _, (scaling, _) = matrix_balance(sizes.max(axis=0), permute=False, separate=True)
        d = np.tile(scaling, N)
        A, B, C, D, dt = disk
        norm, frequency = hinf_norm(StateArrays(A, B * d, C / d[:, None], D * d / d[:, None], dt), allow_unstable=True)
        gains = largest_singular_values(response * d / d[:, None])
        alone = sizes[:, range(m), range(m)].max(axis=1)
        plain = float(largest_singular_values(response).max())
        return DiskMargin(
            lower=1.0 / norm,
            upper=1.0 / min(float(alone.max()), norm),
            unstructured=1.0 / max(norm, plain),
            frequency=frequency,
            proved=True,
            skew=0.0,
            reason="",
            perturbation=np.full(m, np.inf + 0j),
            dt=dt,
            frequencies=grid,
            lower_response=1.0 / gains,
            upper_response=1.0 / alone,
            unstructured_response=1.0 / np.maximum(gains, largest_singular_values(response)),
        )

    def noise_to_torque(self) -> list[StateArrays]:
        """Return for each channel the lifted system from the noise of what is measured to its torque."""
        inputs = range(self.channels, self._loops[0].B.shape[1])
        return [self._lifted([k], inputs) for k in range(self.channels)]
