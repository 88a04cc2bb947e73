"""Several controllers as one: in the order of their list, a later one may take an earlier one's torque as its input."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_arrays, state_space
from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control


def joined(
    controllers: Sequence[control.StateSpace], inputs: Sequence[str], outputs: Sequence[str]
) -> control.StateSpace:
    """Return one controller from `inputs` (pick-offs) to `outputs` (torquers).

    Parameters
    ----------
    controllers
        Same sample period. Inputs: names among `inputs`, or outputs of a controller earlier in the list (that step's
        value). Outputs: no name twice.
    inputs, outputs
        Signals of the result; an output that no controller sets is zero.

    Raises
    ------
    ArgumentError
        Unknown input, an output set twice, or different sample periods.
    """
    if not controllers:
        raise ArgumentError("controllers: given none; expected at least one")
    parts = [state_arrays(K, f"controller {k + 1}") for k, K in enumerate(controllers)]
    n = sum(len(K.A) for K in parts)
    A, B = np.zeros((n, n)), np.zeros((n, len(inputs)))
    # Every signal as a row over [x, y]: the pick-offs first, then what each controller adds.
    rows = {name: np.eye(n + len(inputs))[n + k] for k, name in enumerate(inputs)}
    at = 0
    for K, system in zip(parts, controllers, strict=True):
        if abs(K.dt - parts[0].dt) > 1e-9 * parts[0].dt:
            raise ArgumentError(f"controllers: sample periods {parts[0].dt:g} s and {K.dt:g} s; expected the same")
        unknown = [name for name in system.input_labels if name not in rows]
        if unknown:
            raise ArgumentError(
                f"controller {system.name!r}: input {unknown[0]!r} is no pick-off and no output of a controller before it; "
                f"expected one of {', '.join(rows)}"
            )
        twice = [name for name in system.output_labels if name in rows]
        if twice:
            raise ArgumentError(f"controller {system.name!r}: output {twice[0]!r} is set already; expected each signal once")
        seen = np.array([rows[name] for name in system.input_labels]).reshape(len(system.input_labels), n + len(inputs))
        own = slice(at, at + len(K.A))
        change = K.B @ seen
        A[own] += change[:, :n]
        B[own] += change[:, n:]
        A[own, own] += K.A
        set_rows = K.D @ seen
        set_rows[:, own] += K.C
        rows |= dict(zip(system.output_labels, set_rows, strict=True))
        at = own.stop
    nothing = np.zeros(n + len(inputs))
    final = np.array([rows.get(name, nothing) for name in outputs])
    return state_space(StateArrays(A, B, final[:, :n], final[:, n:], parts[0].dt), inputs, outputs, name="all loops")
