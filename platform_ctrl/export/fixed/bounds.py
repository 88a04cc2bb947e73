"""Largest magnitudes of all signals and states: l1 norms times the sizes of what drives them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from platform_ctrl.export.fixed.exact import ExactSystem, noise_of
from platform_ctrl.export.fixed.norms import Gains, enclosed, gains
from platform_ctrl.frozen import FloatArray, value

# Inflates what was computed from non-negative numbers.
_UP = 1.0 + 1e-10


@value
class Responses:
    """How much of what drives a system from outside, or is added to a row, shows in every signal and state.

    Attributes
    ----------
    system
        The system.
    norms
        From the free sources and the states' disturbances.
    to_states, to_signals : (n, p), (p, p)
        Magnitudes with which the signals' disturbances enter the states and the signals directly.
    """

    system: ExactSystem
    norms: Gains
    to_states: FloatArray
    to_signals: FloatArray

    def bounds(self, sizes: Mapping[str, float], noise: Mapping[str, float]) -> dict[str, float]:
        """Return upper bounds by signal and state.

        Parameters
        ----------
        sizes
            Largest magnitudes of the free sources; those not named are zero.
        noise
            Largest magnitudes of what is added to signals and states; the same.
        """
        free = np.array([sizes.get(name, 0.0) for name in self.system.free])
        added = np.array([noise.get(name, 0.0) for name in self.system.states])
        direct = np.array([noise.get(name, 0.0) for name in self.system.signals])
        inner = (added + self.to_states @ direct) * _UP
        states = (self.norms.states @ free + self.norms.noise_states @ inner) * _UP
        signals = (self.norms.signals @ free + self.norms.noise_signals @ inner + self.to_signals @ direct) * _UP
        return dict(zip((*self.system.states, *self.system.signals), map(float, (*states, *signals)), strict=True))


def responses(system: ExactSystem) -> Responses:
    """Return the norms of a system.

    Raises
    ------
    SlowError
        It does not settle within the time that is summed.
    """
    A, B, C, D = system.balls(system.free)
    _, to_states, _, to_signals = system.balls([noise_of(name) for name in system.signals])
    return Responses(
        system=system,
        norms=gains(A, B, C, D),
        to_states=enclosed(to_states).size,
        to_signals=enclosed(to_signals).size,
    )
