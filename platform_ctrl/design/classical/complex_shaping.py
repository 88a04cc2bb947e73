"""Loop shaping of a symmetric gyro in complex coordinates, seen in the two-sided Nyquist plot.

The cross-axis loop is one complex controller, u = K z with

    K(s) = i h ωc (1 + ωi/s) N(s) − J d (s + ωz)/(s/ωr + 1)

and N = (s − iωn + depth w)/(s − iωn + w) a notch on one side only: nutation turns one way, so nothing has to be taken
out, nor phase lost, at the other. The real controller has the blocks [[k_r, −k_i], [k_i, k_r]].

With one complex channel stability is a matter of one curve, L = −K P over all frequencies from −∞ to ∞, and its turns
round −1. The real loop's unstructured disk margin is that of this curve.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, named_system, state_arrays
from platform_ctrl.analysis.feedback import closed_loop
from platform_ctrl.analysis.norms import peak
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.classical.complex_coordinates import ComplexSystem, complex_response, transfer
from platform_ctrl.errors import ArgumentError, NotStabilisableError
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control

# Poles with a real part below this share of the fastest one's size lie on the axis.
_ON_AXIS = 1e-7
# Radius of half circles round them, over the distance to the next pole.
_ARC_RADIUS = 1e-3
# A step of the curve turns by less than this about −1, rad; a contour is refined so often for it.
_LARGEST_TURN = 0.5
_REFINEMENTS = 40
_CURVE_POINTS = 1500


@value
class TwoSidedNyquist:
    """The loop transfer of a complex loop over positive and negative frequencies.

    Attributes
    ----------
    frequency : (N,)
        Where L is given, rad/s, rising from negative to positive.
    loop_transfer : complex (N,)
        L = −K P, dimensionless; S = 1/(1 + L).
    encirclements
        Turns round −1, counted anticlockwise as the frequency rises; poles on the axis are passed on the right.
    open_unstable, closed_unstable
        Number of unstable poles without and with the loop; closed = open − encirclements.
    disk_margin
        1/max |(S − T)/2|, dimensionless; 0 where the loop is unstable. Over all frequencies; with a dead time, which no
        finite number of states has, the highest points of `frequency` refined between their neighbours.
    margin_frequency
        Where that is, rad/s, with its sign.
    crossings : (k,)
        Frequencies with |L| = 1, rad/s.
    phase_margins : (k,)
        Phase of L there, from −1: positive where L lags less than half a turn, rad.
    """

    frequency: FloatArray
    loop_transfer: ComplexArray
    encirclements: int
    open_unstable: int
    closed_unstable: int
    disk_margin: float
    margin_frequency: float
    crossings: FloatArray
    phase_margins: FloatArray


@value
class ComplexLoop:
    """A complex controller with what it does.

    Attributes
    ----------
    plant, controller
        In complex coordinates.
    real_controller
        u = K y (positive feedback) of the two gimbals, in SI units.
    nyquist
        Its loop transfer, with margins.
    """

    plant: ComplexSystem
    controller: ComplexSystem
    real_controller: control.StateSpace
    nyquist: TwoSidedNyquist

    @property
    def real_plant(self) -> control.StateSpace:
        """The plant in SI units, from torques and Omega1 to Omega3 to angles; a continuous one without dead time.

        ``control.interconnect([loop.real_plant, loop.real_controller], inputs=["Omega1", "Omega2", "Omega3"],
        outputs=...)`` closes the loop by the signals' names.
        """
        acting = self.plant.real_system()
        A, B, C, D, dt = state_arrays(acting, "real_plant")
        arrays = StateArrays(A, np.hstack([B, self.plant.rate_input]), C, np.hstack([D, np.zeros((2, 3))]), dt)
        return named_system(arrays, [*acting.input_labels, *OMEGA_NAMES], acting.output_labels, acting.state_labels)


@check_arguments
def complex_loop(  # noqa: PLR0913 - options by keyword
    plant: ComplexSystem,
    *,
    crossover_hz: float,
    integral_hz: float,
    damping_hz: float,
    lead_hz: float,
    rolloff_hz: float,
    notch_hz: float | None = None,
    notch_depth: float = 0.5,
    notch_width: float = 0.3,
) -> ComplexLoop:
    """Return the cross-axis PI with a direct-axis lead for a symmetric gyro, as one complex loop.

    Parameters
    ----------
    plant
        From `complex_plant`; continuous ones give a continuous controller, sampled ones one by Tustin's rule.
    crossover_hz, integral_hz
        ωc and ωi of the PI across, Hz.
    damping_hz, lead_hz, rolloff_hz
        d, ωz and ωr of the lead along, Hz.
    notch_hz
        ωn of the one-sided notch, Hz, with its sign: that of nutation is the sign of L/J. Default none.
    notch_depth, notch_width
        Gain at its centre, dimensionless; width w as a ratio to |ωn|.

    Returns
    -------
    ComplexLoop
        With its two-sided Nyquist curve and margins.

    Raises
    ------
    ArgumentError
        A number makes no sense.
    NotStabilisableError
        The loop is not stable; what it does is attached.
    """
    numbers = {"crossover_hz": crossover_hz, "integral_hz": integral_hz, "damping_hz": damping_hz, "lead_hz": lead_hz}
    numbers |= {"rolloff_hz": rolloff_hz, "notch_depth": notch_depth, "notch_width": notch_width}
    rad = {name: 2.0 * np.pi * positive(f"complex_loop: {name}", x) for name, x in numbers.items()}
    J, h = plant.inertia, plant.momentum
    if not J > 0.0:
        raise ArgumentError("complex_loop: the plant has no inertia; make it with complex_plant")
    cross = _block(rad["integral_hz"], 1.0, 0.0, plant.dt)
    if notch_hz is not None:
        centre = 2.0 * np.pi * notch_hz
        if not np.isfinite(centre) or centre == 0.0 or (plant.dt and abs(centre) >= np.pi / plant.dt):
            raise ArgumentError(
                f"complex_loop: notch_hz must be between 0 and half the sample rate, of either sign, got {notch_hz!r}"
            )
        width = notch_width * abs(centre)
        if plant.dt:
            # Tustin's rule bends frequencies: prewarped at the centre.
            bend = 2.0 / plant.dt * np.tan(0.5 * centre * plant.dt) / centre
            centre, width = centre * bend, width * bend
        cross = _series(cross, _block(notch_depth * width - 1j * centre, 1.0, width - 1j * centre, plant.dt))
    lead = _block(rad["lead_hz"], 1.0 / rad["rolloff_hz"], 1.0, plant.dt)
    A, B, C, D = _sum(_scaled(1j * h * rad["crossover_hz"], cross), _scaled(-J * rad["damping_hz"], lead))
    controller = ComplexSystem(
        A=A,
        B=B,
        C=C,
        D=D,
        dt=plant.dt,
        delay=0.0,
        inputs=plant.outputs,
        outputs=plant.inputs,
        input_scale=plant.output_scale,
        output_scale=plant.input_scale,
    )
    curve = two_sided_nyquist(plant, controller)
    if curve.closed_unstable:
        raise NotStabilisableError(
            f"complex_loop: the closed loop has {curve.closed_unstable} unstable poles; try a lower crossover_hz, or "
            "another damping_hz",
            curve,
        )
    return ComplexLoop(plant=plant, controller=controller, real_controller=controller.real_system(), nyquist=curve)


@check_arguments
def two_sided_nyquist(
    plant: ComplexSystem, controller: ComplexSystem, frequency: ArrayLike | None = None
) -> TwoSidedNyquist:
    """Return the loop transfer over positive and negative frequencies, with encirclements and margins.

    u = K z, plant and controller with the same `dt`. `frequency` (N,), rad/s, rises; by default it is logarithmic on
    both sides, denser at poles. Counts and margins do not depend on it.
    """
    if plant.dt != controller.dt:
        raise ArgumentError(
            f"two_sided_nyquist: the controller must have dt = {plant.dt:g} s as the plant, got {controller.dt:g} s"
        )
    poles = np.concatenate([np.linalg.eigvals(item.A) for item in (plant, controller)])
    s = continuous_poles(poles, plant.dt)
    s = s[np.isfinite(s)]
    dense = _frequencies(s, plant)
    shown = dense if frequency is None else np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    if shown.ndim != 1 or not np.all(np.isfinite(shown)) or not np.all(np.diff(shown) > 0.0):
        raise ArgumentError("two_sided_nyquist: frequency must be a rising vector of finite numbers in rad/s")

    def loop(at: ComplexArray) -> ComplexArray:
        return np.asarray(-transfer(plant, at) * transfer(controller, at), dtype=np.complex128)

    size = float(np.abs(s).max(initial=1.0))
    unstable = int(np.sum(s.real > _ON_AXIS * size))
    turns = _turns(loop, _contour(dense, s))
    closed = unstable - turns
    margin, at = _disk_margin(plant, controller, loop) if plant.delay == 0.0 else _grid_margin(loop, dense)
    crossings = _crossings(loop, dense)
    return TwoSidedNyquist(
        frequency=shown,
        loop_transfer=np.asarray(-complex_response(plant, shown) * complex_response(controller, shown)),
        encirclements=turns,
        open_unstable=unstable,
        closed_unstable=closed,
        disk_margin=margin if closed == 0 else 0.0,
        margin_frequency=at,
        crossings=crossings,
        phase_margins=np.angle(-loop(np.asarray(1j * crossings, dtype=np.complex128))),
    )


def _frequencies(s: ComplexArray, plant: ComplexSystem) -> FloatArray:
    """Signed frequencies, logarithmic on both sides of 0 and of every pole's, without the poles themselves."""
    sizes = np.abs(s)[np.abs(s) > _ON_AXIS * np.abs(s).max(initial=1.0)]
    top = np.pi / plant.dt if plant.dt else 1e3 * float(sizes.max(initial=1.0))
    steps = np.geomspace(1e-3 * min(float(sizes.min(initial=1.0)), top), 2.0 * top, _CURVE_POINTS // 2)
    near = np.geomspace(1e-4, 1.0, 60) * float(sizes.max(initial=1.0))
    w = np.concatenate([steps, -steps, [-top, top], *(x + sign * near for x in s.imag for sign in (-1.0, 1.0))])
    w = np.unique(w[np.abs(w) <= top])
    return np.asarray(w[np.abs(1j * w[:, None] - s).min(axis=-1) > 1e-9 * top])


def _contour(frequency: FloatArray, s: ComplexArray) -> ComplexArray:
    """Points along the axis from below to above, on half circles to the right of poles that lie on it."""
    size = float(np.abs(s).max(initial=1.0))
    w = np.sort(s.imag[np.abs(s.real) <= _ON_AXIS * size])
    poles = w[np.diff(w, prepend=-np.inf) > _ON_AXIS * size]
    path = np.asarray(1j * frequency, dtype=np.complex128)
    for pole in poles:
        others = np.abs(s - 1j * pole)
        radius = _ARC_RADIUS * float(others[others > _ON_AXIS * size].min(initial=size))
        arc = 1j * pole + radius * np.exp(1j * np.linspace(-0.5 * np.pi, 0.5 * np.pi, 41))
        path = np.concatenate([path[path.imag < pole - radius], arc, path[path.imag > pole + radius]])
    return path


def _turns(loop: Callable[[ComplexArray], ComplexArray], path: ComplexArray) -> int:
    """Turns of 1 + L round 0 along the path, which is made finer where the curve turns fast."""
    F = 1.0 + loop(path)
    for _ in range(_REFINEMENTS):
        wide = np.flatnonzero(np.abs(np.angle(F[1:] / F[:-1])) > _LARGEST_TURN)
        if wide.size == 0:
            break
        middle = 0.5 * (path[wide] + path[wide + 1])
        path, F = np.insert(path, wide + 1, middle), np.insert(F, wide + 1, 1.0 + loop(middle))
    return round(float(np.angle(F[1:] / F[:-1]).sum()) / (2.0 * np.pi))


def _disk_margin(
    plant: ComplexSystem, controller: ComplexSystem, loop: Callable[[ComplexArray], ComplexArray]
) -> tuple[float, float]:
    """Return 1/max |S − 1/2| over all frequencies and where it is reached, rad/s.

    Real and imaginary parts are a real loop, whose norm is the larger one of both signs of the frequency.
    """
    P, K = plant.real_arrays(), controller.real_arrays()
    A, B, C, D, _ = closed_loop(P, K)
    # From noise at the pick-offs to the angles the closed loop is −T = S − 1.
    norm, w = peak(StateArrays(A, B[:, 2:], C[2:], D[2:, 2:] + 0.5 * np.eye(2), plant.dt))
    if not np.isfinite(w):
        return 1.0 / norm, w
    both = np.abs(1.0 / (1.0 + loop(1j * np.array([-w, w]))) - 0.5)
    return 1.0 / norm, float(w if both[1] >= both[0] else -w)


def _grid_margin(loop: Callable[[ComplexArray], ComplexArray], w: FloatArray) -> tuple[float, float]:
    """Return 1/max |S − 1/2| of a loop with dead time: the highest points of a grid, refined between neighbours."""
    from scipy.optimize import minimize_scalar

    def size(frequency: FloatArray) -> FloatArray:
        L = loop(np.asarray(1j * np.atleast_1d(frequency), dtype=np.complex128))
        return np.abs(1.0 / (1.0 + L) - 0.5)

    sizes = size(w)
    best, at = 0.0, 0.0
    for k in np.argsort(-sizes)[:3]:
        low, high = w[max(k - 1, 0)], w[min(k + 1, len(w) - 1)]
        found = minimize_scalar(
            lambda x: -float(size(x)[0]),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-10 * abs(high - low)},
        )
        for value_there, where in ((-float(found.fun), float(found.x)), (float(sizes[k]), float(w[k]))):
            if value_there > best:
                best, at = value_there, where
    return 1.0 / best, at


def _crossings(loop: Callable[[ComplexArray], ComplexArray], w: FloatArray) -> FloatArray:
    from scipy.optimize import brentq

    def height(frequency: float) -> float:
        return float(np.log(np.abs(loop(np.array([1j * frequency]))[0])))

    heights = np.log(np.abs(loop(np.asarray(1j * w, dtype=np.complex128))))
    changes = np.flatnonzero(np.sign(heights[1:]) != np.sign(heights[:-1]))
    return np.array([brentq(height, w[k], w[k + 1], rtol=1e-12) for k in changes])


Parts = tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]


def _block(b0: complex, a1: complex, a0: complex, dt: float) -> Parts:
    """(s + b0)/(a1 s + a0), by Tustin's rule where there is a sample period."""
    b1: complex = 1.0
    if dt:
        two = 2.0 / dt
        b1, b0, a1, a0 = b1 * two + b0, b0 - b1 * two, a1 * two + a0, a0 - a1 * two
    pole, direct = -a0 / a1, b1 / a1
    numbers = (pole, 1.0, b0 / a1 + direct * pole, direct)
    A, B, C, D = (np.array([[x]], dtype=np.complex128) for x in numbers)
    return A, B, C, D


def _scaled(factor: complex, parts: Parts) -> Parts:
    A, B, C, D = parts
    return A, B, np.asarray(factor * C), np.asarray(factor * D)


def _series(first: Parts, second: Parts) -> Parts:
    (A, B, C, D), (a, b, c, d) = first, second
    whole = np.block([[A, np.zeros((len(A), len(a)))], [b @ C, a]])
    return whole, np.vstack([B, b @ D]), np.hstack([d @ C, c]), d @ D


def _sum(one: Parts, two: Parts) -> Parts:
    corner = np.zeros((len(one[0]), len(two[0])))
    A = np.block([[one[0], corner], [corner.T, two[0]]])
    return A, np.vstack([one[1], two[1]]), np.hstack([one[2], two[2]]), one[3] + two[3]
