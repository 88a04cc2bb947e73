"""Errors of a controller in single precision: what rounded coefficients do to its response and its poles."""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.values import value
from platform_ctrl.errors import UnscalableError
from platform_ctrl.export.c99.scheme import Scheme, arrays

# Change of the response or shift of a pole, relative to its distance from z = 1, that causes a note, and an error.
NOTED, _REFUSED = 1e-3, 1e-2
# A pole this little outside the unit circle lies on it.
_ON_CIRCLE = 1e-6


@value
class FloatError:
    """The errors of a controller in single precision (Higham, Accuracy and Stability of Numerical Algorithms)."""

    response: float  # Largest relative change of the frequency response by rounded coefficients
    pole: float  # Largest shift of a pole by them, relative to its distance from z = 1


def _in_float(scheme: Scheme) -> StateArrays:
    """Return the controller with coefficients in single precision; raise where a number does not fit."""
    least, most = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
    rows = [row for section in scheme.sections for row in (*section.signals, *section.states)]
    numbers = [(row.target, term.coefficient) for row in (*rows, *scheme.excess) for term in row.terms]
    limits = zip(scheme.outputs, scheme.torque_limits, strict=True)
    for what, x in [*numbers, *((f"limit of {name}", limit) for name, limit in limits if np.isfinite(limit))]:
        if not abs(x) <= most:
            raise UnscalableError(
                f"{scheme.name}: {what}: {x:.3g} does not fit a float, which ends at {most:.3g}; use double", scheme
            )
    # Numbers below the smallest normal one become zero; the response shows whether it matters.
    return arrays(scheme, lambda x: float(np.float32(x)) if abs(x) >= least else 0.0)


def float_error(scheme: Scheme) -> FloatError:
    """Return the errors of a controller in single precision; raise where they are too large."""
    response, pole = _moved(arrays(scheme), _in_float(scheme))
    if not max(response, pole) <= _REFUSED:
        raise UnscalableError(
            f"{scheme.name}: in single precision a pole moves by {pole:.2g} of its distance from z = 1 and the "
            f"response changes by {response:.2g}, but {_REFUSED:g} is allowed; use double",
            scheme,
        )
    return FloatError(response=response, pole=pole)


def _moved(K: StateArrays, rounded: StateArrays) -> tuple[float, float]:
    """Return the largest relative changes of the response and of the poles."""
    from scipy.optimize import linear_sum_assignment

    # A resonance changes most at its frequency, which a grid misses where it is narrow. The response of an undamped one
    # is not compared there.
    z = np.concatenate([np.linalg.eigvals(item.A) for item in (K, rounded)])
    own = np.abs(np.angle(z[1.0 - np.abs(z) > _ON_CIRCLE]))
    angles = np.concatenate([np.geomspace(1e-5, np.pi, 300), own])
    frequency = np.unique(angles[angles >= 1e-5]) / K.dt
    one, other = (frequency_response(StateArrays(*item[:4], K.dt), frequency, -3) for item in (K, rounded))
    size = np.linalg.norm(one, axis=(1, 2))
    # Gains far below the median are not compared.
    size = np.maximum(size, 1e-3 * np.median(size))
    response = np.linalg.norm(other - one, axis=(1, 2)) / np.where(size > 0.0, size, 1.0)
    if not len(K.A):
        return float(response.max(initial=0.0)), 0.0
    before, after = np.linalg.eigvals(K.A), np.linalg.eigvals(rounded.A)
    away = np.abs(before[:, None] - after[None, :])
    rows, columns = linear_sum_assignment(away)
    # The rounding of the eigenvalues themselves is no shift.
    distance = np.maximum(np.abs(before - 1.0), 1e-7)
    shift = away[rows, columns] / distance[rows]
    return float(response.max(initial=0.0)), float(shift.max(initial=0.0))
