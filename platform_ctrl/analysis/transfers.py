"""What of a closed loop is measured: a part between places in it, or one between named signals, with weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from platform_ctrl.analysis.feedback import series
from platform_ctrl.analysis.system import System
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control


class Transfer(NamedTuple):
    """A part of the closed loop: from `source` to `target`, and `direct` times the identity.

    From torque to torque the closed loop is −T = S − I at the plants' input, from noise to angle at their output.
    With `of_limit` every torque is taken by itself, over its torquer's limit, for platform rates over the set's Omega.
    """

    source: Literal["torque", "Omega", "noise", "command"]
    target: Literal["torque", "angle", "sight"]
    direct: float = 0.0
    of_limit: bool = False


S_OUTPUT, S_INPUT = Transfer("noise", "angle", 1.0), Transfer("torque", "torque", 1.0)
FOLLOWING = Transfer("command", "angle", 1.0)  # from a command to its error
T_OUTPUT, T_INPUT = Transfer("noise", "angle"), Transfer("torque", "torque")
# (S − T)/2 = S − I/2
HALF_OUTPUT, HALF_INPUT = Transfer("noise", "angle", 0.5), Transfer("torque", "torque", 0.5)
ANGLE_PER_OMEGA, ANGLE_PER_TORQUE = Transfer("Omega", "angle"), Transfer("torque", "angle")
SIGHT_PER_OMEGA = Transfer("Omega", "sight")
TORQUE_SHARE = Transfer("Omega", "torque", of_limit=True)

Weight: TypeAlias = "float | FloatArray | control.StateSpace | None"


@value
class Channel:
    """From some inputs of a closed loop to some of its outputs, weighted: ``W_out G W_in``.

    Attributes
    ----------
    inputs, outputs
        Names of the signals, in the weights' order; none: all that the system has.
    input_weight, output_weight
        None, a number, one number for each signal (k,), a matrix (outputs × inputs of the weight), or a system:
        continuous for a continuous loop, with the loop's sample period for a sampled one. In the units that turn the
        signals into what counts.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    input_weight: Weight = None
    output_weight: Weight = None

    def of(self, system: System, inputs: Sequence[str], outputs: Sequence[str]) -> System:
        """Return the weighted part of a system (or a stack of them) whose signals are named.

        Parameters
        ----------
        system
            The closed loop; its arrays may carry batch axes.
        inputs, outputs
            Names of its signals, in its order.

        Returns
        -------
        System
            ``W_out G W_in`` from the channel's inputs to its outputs.

        Raises
        ------
        ArgumentError
            A name that the system does not have, or a weight that does not fit it.
        """
        columns = [known_name("inputs", name, inputs) for name in self.inputs] or list(range(len(inputs)))
        rows = [known_name("outputs", name, outputs) for name in self.outputs] or list(range(len(outputs)))
        out, dt = system.part(rows, columns), system.dt
        if self.input_weight is not None:
            weight = _weight(self.input_weight, len(columns), dt, "input_weight")
            if weight.D.shape[0] != len(columns):
                raise ArgumentError(f"input_weight: must have {len(columns)} outputs, got {weight.D.shape[0]}")
            out = series(weight, out)
        if self.output_weight is not None:
            weight = _weight(self.output_weight, len(rows), dt, "output_weight")
            if weight.D.shape[1] != len(rows):
                raise ArgumentError(f"output_weight: must have {len(rows)} inputs, got {weight.D.shape[1]}")
            out = series(out, weight)
        return out


def _weight(weight: Any, size: int, dt: float, where: str) -> System:
    """Return a weight on `size` signals as arrays, with no states where it is constant."""
    if hasattr(weight, "nstates"):
        own = System.of(weight, where)
        if weight.dt is not None and abs(own.dt - dt) > 1e-9 * max(own.dt, dt):
            raise ArgumentError(
                f"{where}: must have the loop's dt = {dt} s, got {own.dt} s; "
                'weight.sample(dt, method="bilinear") makes a sampled weight of a continuous one'
            )
        return own._replace(dt=dt)
    try:
        gain = np.asarray(weight, dtype=np.float64)
    except (TypeError, ValueError):
        gain = np.full((), np.nan)
    if gain.ndim < 2:
        gain = gain * np.eye(size) if gain.shape in ((), (size,)) else np.full((), np.nan)
    if gain.ndim != 2 or not np.all(np.isfinite(gain)):
        raise ArgumentError(
            f"{where}: must be a finite number, {size} numbers, a matrix or a control.StateSpace, "
            f"got {type(weight).__name__}"
        )
    rows, columns = gain.shape
    return System(np.zeros((0, 0)), np.zeros((0, columns)), np.zeros((rows, 0)), gain, dt)


# Where a peak is looked for: parts of the closed loop, or one between named signals.
Parts = tuple[Transfer, ...] | Channel
