"""The PID controllers u = K y with one gain matrix for each action, and the limits of their closed loops.

    K = Kp + Ki / s + Kd s / (filter_time s + 1)

Sampled by Tustin's rule, s = (2/T) (z − 1)/(z + 1); responses are then taken at z = exp(jωT), exactly. All channels
of one pick-off share their integrator and their filter.

A limit is the largest gain of a closed-loop response, at every frequency.
With Z = I − P K (at the angles) or I − K P (at the torques), S = Z⁻¹ and T = I − S,

    sensitivity peak       ‖S‖ ≤ m                 c = 0
    complementary sensitivity peak     ‖S − I‖ ≤ m             c = 1
    disk margin            ‖S − I/2‖ ≤ m = 1/α     c = 1/2

have one form: ‖S − c I‖ ≤ m exactly if the least singular value of Z + a I is at least r, with a = c/(m² − c²) and
r = m/(m² − c²): Z has to stay out of a ball. The other two compare Z with something known or linear in K:

    torque per noise       ‖K S‖ ≤ m               Z* Z ≥ K* K / m²
    angle per torque       ‖P S‖ ≤ m               Z* Z ≥ P* P / m²
    resonance damping ζ    the same, near a pole jν with residue R that the data do not resolve, m = ‖R‖/(ζ ν)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.feedback import sensitivities_of_plants
from platform_ctrl.analysis.sampling import from_w_plane
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import one_of, short
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.fixed_structure.pid import PID
from platform_ctrl.design.measured.contour import Contour
from platform_ctrl.errors import ArgumentError

Pattern = Literal["full", "diagonal", "cross-axis"]
# A number, or its value over frequencies in rad/s.
Bound = float | Callable[[FloatArray], FloatArray]

CENTRES = {"sensitivity_peak": 0.0, "complementary_sensitivity_peak": 1.0, "disk_margin": 0.5}
# Largest finite limit: its square must not overflow.
_LARGEST = 1e100
# Limits of P S.
OF_ANGLE = ("angle_per_torque", "resonance_damping")


def basis(s: ComplexArray, filter_time: float, period: float) -> ComplexArray:
    """Return the responses of the three actions at points s, complex (N, 3)."""
    p = s
    if period > 0.0:
        # Half the sample rate itself is infinity in Tustin's plane: kept a little below.
        half = 0.5 * s * period
        near = half.real + 1j * np.minimum(half.imag, 0.5 * np.pi * (1.0 - 1e-9))
        p = np.asarray(2.0 / period * np.tanh(near), dtype=np.complex128)
    return np.stack([np.ones_like(p), 1.0 / p, p / (filter_time * p + 1.0)], axis=-1)


def controller_response(gains: FloatArray, actions: ComplexArray) -> ComplexArray:
    """Return K, complex (N, n, n), from `gains` (3, n, n) and the responses of the actions (N, 3)."""
    return np.asarray(np.einsum("kb,bij->kij", actions, gains), dtype=np.complex128)


def realisation(gains: FloatArray, filter_time: float, period: float) -> System:
    """Return the controller's state-space arrays: two states for each pick-off."""
    n = gains.shape[-1]
    # The gains and the bandwidth of each pick-off's filter, as `PID` orders its parameters.
    parameters = np.append(gains, np.full(n, 1.0 / filter_time))
    K = PID(filter_order=1, filtered="derivative").block(parameters, n, n)
    return K if period == 0.0 else from_w_plane(K, period)


def masks(pattern: Pattern | ArrayLike, n: int) -> FloatArray:
    """Return which gains are free, (3, n, n) of zeros and ones.

    ``"cross-axis"`` is that of a caged gyro: integral action across, rate action along, proportional action in both.
    """
    eye, full = np.eye(n), np.ones((n, n))
    if isinstance(pattern, str):
        one_of("measured_pid: pattern", pattern, ("full", "diagonal", "cross-axis"))
        if pattern == "cross-axis" and n != 2:
            raise ArgumentError(f"measured_pid: pattern 'cross-axis' needs two angles, got {n}; give zeros and ones")
        chosen: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {
            "full": (full, full, full),
            "diagonal": (eye, eye, eye),
            "cross-axis": (full, full - eye, eye),
        }
        return np.array(chosen[pattern])
    given = np.asarray(pattern)
    if (
        given.shape not in ((n, n), (3, n, n))
        or given.dtype.kind not in "biuf"
        or not np.all((given == 0) | (given == 1))
    ):
        raise ArgumentError(
            "measured_pid: pattern must be 'full', 'diagonal', 'cross-axis', or zeros and ones of shape "
            f"({n}, {n}) or (3, {n}, {n}), got an array of shape {given.shape}"
        )
    out = np.broadcast_to(given.astype(np.float64), (3, n, n)).copy()
    random = out[1] * np.random.default_rng(0).uniform(1.0, 2.0, (n, n))
    if np.linalg.matrix_rank(random) < n:
        raise ArgumentError(
            "measured_pid: pattern makes the integral gain singular; free integral action on every angle"
        )
    return out


@value
class Limit:
    """One limit over the frequencies of one plant: m, (N,); 1/margin of disks; infinite where none applies."""

    name: str
    bound: FloatArray


def limits_along(path: Contour, requested: dict[str, Bound | None]) -> tuple[Limit, ...]:
    """Return the limits that are requested, along the contour of a plant."""
    out = []
    for name, m in requested.items():
        if m is None:
            continue
        bound = _bound(name, m, path.frequency)
        if name == "resonance_damping":
            near = path.residue > 0.0
            bound = np.where(near, path.residue / (bound * path.frequency), np.inf)
        if np.isfinite(bound).any():
            out.append(Limit(name=name, bound=bound))
    return tuple(out)


def _bound(name: str, requested: Bound, frequency: FloatArray) -> FloatArray:
    try:
        with np.errstate(all="ignore"):
            found = np.asarray(requested(frequency) if callable(requested) else requested)
        if np.iscomplexobj(found):
            raise TypeError
        m = np.broadcast_to(found.astype(np.float64), frequency.shape)
    except (TypeError, ValueError, ArithmeticError, LookupError):
        raise ArgumentError(
            f"measured_pid: {name} must be a number, or a function that returns one for each frequency in rad/s, got "
            f"{short(requested)}"
        ) from None
    least = 1.0 if name in ("sensitivity_peak", "complementary_sensitivity_peak") else 0.0
    most = {"disk_margin": 2.0, "resonance_damping": 1.0}.get(name, _LARGEST)
    if not np.all((m > least) & (m < most) | (m == np.inf) & (most == _LARGEST)):
        range_of = f"> {least:g}" if most == _LARGEST else f"between {least:g} and {most:g}"
        raise ArgumentError(f"measured_pid: {name} must be {range_of}, got {short(requested)}")
    if name == "sensitivity_peak" and not np.isfinite(m).any():
        raise ArgumentError(f"measured_pid: {name} must be finite: it keeps the loop stable")
    return np.asarray(1.0 / m if name == "disk_margin" else m)


def ratios(limit: Limit, P: ComplexArray, K: ComplexArray) -> FloatArray:
    """Return what is reached over the limit, (N,): at most 1 where it is kept."""
    eye = np.eye(P.shape[-1])
    S_output, S_input = sensitivities_of_plants(P, K)
    if limit.name in CENTRES:
        c = CENTRES[limit.name]
        reached = np.maximum(largest_singular_values(S_output - c * eye), largest_singular_values(S_input - c * eye))
    else:
        reached = largest_singular_values(P @ S_input if limit.name in OF_ANGLE else K @ S_output)
    return np.asarray(reached / limit.bound)
