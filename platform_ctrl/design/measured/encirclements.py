"""Stability from responses alone: the generalised Nyquist criterion, with what the data must show to decide it.

With Z = I − P K the closed loop has as many unstable poles as the plant, less half a turn of det Z over positive
frequencies for each. Poles on the axis count as stable: the contour passes them on the right (see `contour`).

- Between two points the phase is the sum of those of the eigenvalues of Z_k⁻¹ Z_{k+1}.
- Below the lowest frequency P K has to be large: there det Z = det(−P) det K det(I − (P K)⁻¹), the first like a power
of s,
  the second known, the third as good as 1. Above the highest P K has to be small.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.design.measured.contour import Contour
from platform_ctrl.errors import NotCertifiedError
from platform_ctrl.frozen import FloatArray

# An eigenvalue that turns by more than this between two frequencies was not followed, rad.
_LARGEST_TURN = np.radians(140.0)
# How far the slope of |det P| at the lowest frequencies may lie from a whole number, and its phase from a real one,
# rad.
_SLOPE_TOLERANCE = 0.3
_PHASE_TOLERANCE = np.radians(60.0)
# Points between 0 and the lowest frequency at which the controller alone is followed, and how far down.
_POINTS, _DEPTH = 400, 1e-8
# Points with a larger real part over the imaginary one lie on half circles, not on the axis.
_OFF_AXIS = 1e-12
_HZ = 1.0 / (2.0 * np.pi)

# The controller's response at points s.
Controller = Callable[[ComplexArray], ComplexArray]


def unstable_poles(plant: Contour, controller: Controller, unstable: int = 0, integrators: int | None = None) -> int:
    """Return the number of unstable poles of the closed loop u = K y, y = P u.

    Parameters
    ----------
    plant
        Its response along the contour.
    controller
        K at points s, N of them: complex (N, n, n). It integrates in every channel; its own poles are not unstable.
    unstable
        Number of unstable poles of the plant.
    integrators
        Number of its poles at s = 0 (z = 1); default read from the slope of det P at the lowest frequencies.

    Raises
    ------
    NotCertifiedError
        The data do not decide it; the message says what is missing.
    """
    frequency, P = plant.frequency, plant.P
    L = P @ controller(plant.s)
    _judge_ends(frequency, L)
    _judge_resonances(plant, L)
    turned = _below(frequency, P, L, controller, integrators)
    turned += _between(frequency, np.asarray(np.eye(P.shape[-1]) - L, dtype=np.complex128))
    turned -= float(np.angle(1.0 - np.linalg.eigvals(L[-1])).sum())
    return unstable - round(turned / np.pi)


def _judge_ends(frequency: FloatArray, L: ComplexArray) -> None:
    low, high = np.linalg.svd(L[0], compute_uv=False)[-1], np.abs(np.linalg.eigvals(L[-1])).max()
    if not low > 1.0:
        raise NotCertifiedError(
            f"stability from data: at the lowest frequency, {frequency[0] * _HZ:.3g} Hz, the least gain of P K is "
            f"{low:.2g}; "
            "expected more than 1; measure lower frequencies, or ask for a faster loop"
        )
    if not high < 1.0:
        raise NotCertifiedError(
            f"stability from data: at the highest frequency, {frequency[-1] * _HZ:.3g} Hz, the gain of P K is "
            f"{high:.2g}; "
            "expected less than 1; measure higher frequencies, or bound torque_per_noise"
        )


def _judge_resonances(plant: Contour, L: ComplexArray) -> None:
    """The pole of the closed loop must not hide between the half circle and the axis."""
    k = np.flatnonzero(plant.s.real > _OFF_AXIS * plant.frequency)
    weak = np.abs(np.linalg.eigvals(L[k])).max(axis=-1, initial=0.0) < 1.0
    if weak.any():
        raise NotCertifiedError(
            f"stability from data: the loop hardly moves the resonance at {plant.frequency[k[weak][0]] * _HZ:.4g} "
            f"Hz; expected P K "
            "above 1 next to its pole; measure more frequencies there, or ask for resonance_damping"
        )


def plant_integrators(frequency: FloatArray, P: ComplexArray) -> int:
    """Return the number of poles at s = 0 that det P shows at its lowest frequencies.

    Raises
    ------
    NotCertifiedError
        Its slope is not that of a power of s.
    """
    near = max(3, int(np.searchsorted(frequency, 2.0 * frequency[0])))
    w, size = np.log(frequency[:near]), np.log(np.abs(np.linalg.det(P[:near])))
    slope = -float(np.polyfit(w, size, 1)[0])
    if abs(slope - round(slope)) > _SLOPE_TOLERANCE or round(slope) < 0:
        raise NotCertifiedError(
            f"stability from data: below {frequency[near - 1] * _HZ:.3g} Hz det P falls like frequency to the "
            f"{slope:.2f}; "
            "expected a whole number; measure lower frequencies, or give integrators"
        )
    return round(slope)


def _below(
    frequency: FloatArray, P: ComplexArray, L: ComplexArray, controller: Controller, integrators: int | None
) -> float:
    """Phase of s^k det Z from 0 to the lowest frequency, less the k quarter turns of s^k over all frequencies."""
    n, w0 = P.shape[-1], frequency[0]
    k = plant_integrators(frequency, P) if integrators is None else integrators
    at_rest = np.linalg.det(-P[0]) * (1j) ** k
    of_plant = float(np.angle(at_rest**2)) / 2.0
    if abs(of_plant) > _PHASE_TOLERANCE:
        raise NotCertifiedError(
            f"stability from data: at {w0 * _HZ:.3g} Hz the phase of s^{k} det P is {np.degrees(of_plant):.0f}° off "
            f"0 or 180°; "
            "expected the plant at rest; measure lower frequencies, or give integrators"
        )
    down = w0 * np.geomspace(_DEPTH, 1.0, _POINTS)
    K = np.asarray(controller(np.asarray(1j * down, dtype=np.complex128)) * down[:, None, None], dtype=np.complex128)
    start = np.linalg.det(1j * K[0])
    of_controller = float(np.angle(start**2)) / 2.0
    of_controller += float(_steps(K).sum())
    of_rest = float(np.angle(1.0 - np.linalg.eigvals(np.linalg.inv(L[0]))).sum())
    return float(of_plant + of_controller + of_rest - 0.5 * np.pi * (k + n))


def _steps(Z: ComplexArray) -> FloatArray:
    """Phases of the eigenvalues of Z_k⁻¹ Z_{k+1}, (N − 1, n)."""
    out: FloatArray = np.angle(np.linalg.eigvals(np.linalg.solve(Z[:-1], Z[1:])))
    return out


def _between(frequency: FloatArray, Z: ComplexArray) -> float:
    turns = _steps(Z)
    widest = np.abs(turns).max(axis=-1)
    k = int(widest.argmax())
    if widest[k] > _LARGEST_TURN:
        raise NotCertifiedError(
            f"stability from data: between {frequency[k] * _HZ:.4g} and {frequency[k + 1] * _HZ:.4g} Hz the phase of "
            f"I − P K "
            f"jumps by {np.degrees(widest[k]):.0f}°; expected less than {np.degrees(_LARGEST_TURN):.0f}°; measure more "
            "frequencies there"
        )
    return float(turns.sum())
