"""Errors of a controller in single precision: poles, response, outputs, and inputs that integrals lose.

Every row of a scheme is a sum of a few products, so its rounding is at most (terms + 1) u Σ |coefficient source|, u =
2^-24, to first order. These errors run through the controller like inputs: the sum of the magnitudes of their impulse
responses bounds what they do to the outputs.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import UnscalableError
from platform_ctrl.export.c99.scheme import Scheme, arrays, matrix, multiplied_out, noise_of, rows_of
from platform_ctrl.export.c99.windup import integrating

# Unit roundoff of float.
_U = 2.0**-24
# Change of the response or shift of a pole, relative to its distance from z = 1, that causes a note, and an error.
NOTED, _REFUSED = 1e-3, 1e-2
# A pole this little outside the unit circle lies on it.
_ON_CIRCLE = 1e-6
# Longest response that is summed, samples.
_LONGEST = 20000


@value
class FloatError:
    """The errors of a controller in single precision (Higham, Accuracy and Stability of Numerical Algorithms)."""

    response: float  # Largest relative change of the frequency response by rounded coefficients
    pole: float  # Largest shift of a pole by them, relative to its distance from z = 1
    # (p,): Largest difference of the outputs after steps samples from equal states, in their units, while no limit acts
    # and the integrals contribute no more than the limits; inf where the controller is unstable by itself
    bound: FloatArray
    steps: int  # Number of samples
    unseen: FloatArray  # (m,): Magnitude of a constant input that the integrals may lose, in its unit; zero: none


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


def float_error(scheme: Scheme, ranges: Mapping[str, float], steps: int | None = None) -> FloatError:
    """Return the errors of a controller in single precision."""
    K = arrays(scheme)
    rounded = _in_float(scheme)
    count = max(1, round(1.0 / scheme.period)) if steps is None else steps
    inputs = np.array([ranges[name] for name in scheme.inputs])
    response, pole = _moved(K, rounded)
    if not max(response, pole) <= _REFUSED:
        raise UnscalableError(
            f"{scheme.name}: in single precision a pole moves by {pole:.2g} of its distance from z = 1 and the "
            f"response changes by {response:.2g}, but {_REFUSED:g} is allowed; use double",
            scheme,
        )
    states, lasting = _state_magnitudes(scheme, K, inputs)
    into, through, errors = _roundings(scheme, inputs, states)
    stable = not len(K.A) or np.abs(np.linalg.eigvals(K.A)).max() < 1.0 + _ON_CIRCLE
    return FloatError(
        response=response,
        pole=pole,
        bound=_grown(K, into, through, count) @ errors if stable else np.full(len(K.C), np.inf),
        steps=count,
        unseen=_unseen(scheme, K, lasting),
    )


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


def _state_magnitudes(scheme: Scheme, K: StateArrays, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest magnitudes of the states, and the share of the integrals in them."""
    n = len(K.A)
    V, _ = integrating(K)
    limits = np.array(scheme.torque_limits)
    limits = np.where(np.isfinite(limits), limits, np.abs(K.D) @ inputs)
    lasting = np.abs(V) @ (np.abs(np.linalg.pinv(K.C @ V)) @ limits) if V.shape[1] else np.zeros(n)
    # Projection away from the integrals: the rest is stable.
    P = np.eye(n)
    if V.shape[1]:
        W = _left(K)
        P = P - V @ np.linalg.solve(W @ V, W)
    x, total = P @ K.B, np.zeros(K.B.shape)
    for _ in range(_LONGEST):
        total += np.abs(x)
        if np.all(np.abs(x) <= 1e-9 * total.max(initial=0.0)):
            break
        x = P @ (K.A @ x)
    return total @ inputs + lasting, lasting


def _roundings(scheme: Scheme, inputs: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how the rounding of each input and row acts on states and outputs, and its largest magnitude."""
    shown, following = multiplied_out(rows_of(scheme.sections), scheme.inputs, scheme.states, 1.0)
    for name in scheme.states:
        following[name][noise_of(name)] = 1.0
    magnitudes = dict(zip((*scheme.states, *scheme.inputs), (*states, *inputs), strict=True))
    sources, errors = [*scheme.inputs], [*(_U * inputs)]
    for section in scheme.sections:
        for row in (*section.signals, *section.states):
            terms = [abs(term.coefficient) * magnitudes[term.source] for term in row.terms]
            sources.append(noise_of(row.target))
            errors.append((len(terms) + 1) * _U * sum(terms))
            if row in section.signals:
                magnitudes[row.target] = sum(terms)
    into, through = matrix(following, scheme.states, sources), matrix(shown, scheme.outputs, sources)
    return into, through, np.array(errors)


def _grown(K: StateArrays, into: FloatArray, through: FloatArray, steps: int) -> FloatArray:
    """Return the sum of the magnitudes of the impulse responses over `steps` samples."""
    total = np.abs(through)
    x = into
    for _ in range(steps - 1):
        total = total + np.abs(K.C @ x)
        x = K.A @ x
    return total


def _unseen(scheme: Scheme, K: StateArrays, lasting: FloatArray) -> FloatArray:
    """Return the constant inputs that are lost in the last digit of integrating states."""
    V, _ = integrating(K)
    out = np.zeros(len(scheme.inputs))
    if not V.shape[1]:
        return out
    size = np.abs(V).max(axis=1)
    for k in np.flatnonzero((size > 1e-9 * size.max()) & (np.abs(np.diag(K.A) - 1.0) < 1e-6)):
        # A filter before the integral passes constants.
        drive = np.abs(_constant_gain(K, int(k)))
        lost = _U * lasting[k] / np.maximum(drive, 1e-300)
        out = np.maximum(out, np.where(drive > 1e-9 * drive.max(initial=0.0), lost, 0.0))
    return out


def _constant_gain(K: StateArrays, k: int) -> FloatArray:
    """Return what a constant input adds to state `k` in a sample when all other states have settled."""
    V, _ = integrating(K)
    W = _left(K)
    along: FloatArray = (V @ np.linalg.solve(W @ V, W @ K.B))[k]
    return along


def _left(K: StateArrays) -> FloatArray:
    """Return W with W A = Λ W of the integrating states, (k, n)."""
    return integrating(StateArrays(K.A.T, K.C.T, K.B.T, K.D.T, K.dt))[0].T
