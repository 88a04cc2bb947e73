"""The classical loop of one gyro from two numbers: the crossover, and the margin that it has to keep.

The crossover sets the cross-axis gain, and with it the PI. The direct-axis lead has to damp nutation, which the cross
gain destabilises: too little leaves nutation undamped, too much is limited by the delay, so the margin has a maximum
over the lead's strength. The weakest lead that reaches the margin gives the least torque noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, named_system, selected, state_arrays
from platform_ctrl.analysis.certificates import Certificate
from platform_ctrl.analysis.certificates.plant_set import margin_certificates
from platform_ctrl.analysis.feedback import At, closed_loop_with_sensitivity
from platform_ctrl.analysis.norms import hinf_norm
from platform_ctrl.analysis.poles import poles, spectral_radius
from platform_ctrl.analysis.sampling import sampled
from platform_ctrl.common.arguments import positive
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import value
from platform_ctrl.design.classical.caging import classical_controller, starting_values
from platform_ctrl.design.partition import Channels, channels
from platform_ctrl.design.plants import held_rate
from platform_ctrl.errors import ArgumentError, DesignError, InfeasibleError
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.state_space import state_space, whole_subsystems
from platform_ctrl.plant.platform import OMEGA_NAMES

if TYPE_CHECKING:
    import control

# Strengths of the lead that are tried, as shares of the nutation frequency, and refinements of that grid.
_STRENGTHS = np.geomspace(0.02, 20.0, 40)
_REFINEMENTS = 4
# The two axes differ by 10 % either way, as the method's own starting values do.
_RATIOS = (0.9, 1.1)
_TOLERANCE = 1e-4


@value
class CrossoverDesign:
    """A classical loop from crossover and margin.

    Attributes
    ----------
    plant
        The pair, sampled, from its torques and Omega1 to Omega3, rad/s, held between the samples, to its angles.
    controller
        u = K y (positive feedback), sampled; inputs are the pair's angles, outputs its torques.
        ``control.interconnect([plant, controller], inputs=["Omega1", "Omega2", "Omega3"], outputs=...)`` closes the
        loop by the signals' names.
    options
        Complete options of the method ``classical`` in a job file, in its units.
    disk_margin
        1/‖(S − T)/2‖ of the sampled loop, dimensionless, the smaller of input and output.
    """

    plant: control.StateSpace
    controller: control.StateSpace
    options: dict[str, float]
    disk_margin: float

    @property
    def certificates(self) -> tuple[Certificate, Certificate, Certificate]:
        """Proofs of stability, and of (S − T)/2 at torques and pick-offs: the larger norm is 1/disk margin.

        Made at each use; a `NotCertifiedError` where one is not found.
        """
        acting = selected(self.plant, self.controller.input_labels, self.controller.output_labels)
        return margin_certificates(state_arrays(acting, "plant"), state_arrays(self.controller, "controller"))


@check_arguments
def from_crossover_and_margin(
    model: LinearModel,
    gimbals: Sequence[str],
    *,
    crossover_hz: float,
    disk_margin: float | None = None,
    phase_margin_deg: float | None = None,
    period: float,
    delay: float = 0.0,
    **options: float,
) -> CrossoverDesign:
    """Return the cross-axis PI with the weakest direct-axis lead that reaches a margin, for one pair of gimbals.

    Parameters
    ----------
    model
        From `linearise`.
    gimbals
        The two gimbals of one gyro, a subsystem; each has a torquer and a pick-off.
    crossover_hz
        Of the cross-axis gain, Hz.
    disk_margin
        Required disk margin, dimensionless, 0 to 2; or
    phase_margin_deg
        required phase margin in all channels at once, in degrees instead of rad: the disk margin 2 tan(phase/2).
    period, delay
        Of the controller, s; the torquers' lags come from the plant.
    **options
        Others of the method ``classical`` (see the job file), in its units: ``integral_hz``, ``lead_hz``,
        ``notch_depth``, ...

    Returns
    -------
    CrossoverDesign
        The sampled controller, its numbers and its margin.

    Raises
    ------
    ArgumentError
        The gimbals are no pair, or a number makes no sense.
    InfeasibleError
        No strength of the lead reaches the margin; the message says what is the most.
    MechanicsError
        The mass matrix is singular at the trim (gimbal lock).

    References
    ----------
    See docs/classical.md.

    P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020.
    """
    wanted = _wanted(disk_margin, phase_margin_deg)
    given = {"crossover_hz": positive("crossover_hz", crossover_hz), **options}
    if twice := sorted({"damping_hz", "damping2_hz"} & set(options)):
        raise ArgumentError(f"{twice[0]}: follows from the margin; leave it out")
    period, delay = positive("period", period), positive("delay", delay, zero=True)
    plant, channel, nutation = _pair(model, gimbals, period, delay)
    try:
        start = starting_values(given, channel, nutation, period)
    except DesignError as error:
        raise ArgumentError(str(error)) from None
    nutation_hz = nutation / (2.0 * np.pi)

    def with_lead(strength: float) -> dict[str, float]:
        names = ("damping_hz", "damping2_hz")
        return start | {name: ratio * strength * nutation_hz for name, ratio in zip(names, _RATIOS, strict=True)}

    def controller(strength: float) -> control.StateSpace:
        K = classical_controller(with_lead(strength), channel, period)
        return named_system(K, plant.output_labels, plant.input_labels[:2], name=f"cross-axis, {crossover_hz:g} Hz")

    def margin(strength: float) -> float:
        return _disk_margin(plant, controller(strength))

    strengths, margins = _STRENGTHS, np.array([margin(x) for x in _STRENGTHS])
    for _ in range(_REFINEMENTS):
        best = int(margins.argmax())
        if margins[best] >= wanted:
            break
        strengths = np.geomspace(strengths[max(best - 1, 0)], strengths[min(best + 1, len(strengths) - 1)], 9)
        margins = np.array([margin(x) for x in strengths])
    best = int(margins.argmax())
    if margins[best] < wanted:
        raise InfeasibleError(
            f"crossover {crossover_hz:g} Hz: the largest disk margin is {margins[best]:.3g}, with a lead of "
            f"{strengths[best] * nutation_hz:.3g} Hz, less than {wanted:.3g}; try a lower crossover, a shorter delay, "
            "or another lead_hz",
            plant,
        )
    first = int(np.argmax(margins >= wanted))
    weak, strong = (strengths[first - 1] if first else 0.5 * strengths[0]), strengths[first]
    while strong / weak > 1.0 + _TOLERANCE:
        middle = float(np.sqrt(weak * strong))
        weak, strong = (weak, middle) if margin(middle) >= wanted else (middle, strong)
    return CrossoverDesign(
        plant=plant,
        controller=controller(float(strong)),
        options=with_lead(float(strong)),
        disk_margin=margin(float(strong)),
    )


def _disk_margin(plant: control.StateSpace, controller: control.StateSpace) -> float:
    """Return 1/‖(S − T)/2‖, the smaller of input and output; 0 where the loop is unstable."""
    norms = []
    sides: tuple[At, ...] = ("input", "output")
    for at in sides:
        A, B, C, D, dt = closed_loop_with_sensitivity(plant, controller, at)
        if not spectral_radius(poles(A)) < 1.0:
            return 0.0
        norms.append(hinf_norm(StateArrays(A, B, C, D - 0.5 * np.eye(len(D)), dt), allow_unstable=True)[0])
    return 1.0 / max(norms)


def _wanted(disk_margin: float | None, phase_margin_deg: float | None) -> float:
    if (disk_margin is None) == (phase_margin_deg is None):
        raise ArgumentError("margin: give either disk_margin or phase_margin_deg")
    if phase_margin_deg is not None:
        phase = positive("phase_margin_deg", phase_margin_deg)
        if phase >= 90.0:
            raise ArgumentError(f"phase_margin_deg: must be below 90, where the disk margin is 2, got {phase:g}")
        return float(2.0 * np.tan(0.5 * np.radians(phase)))
    assert disk_margin is not None
    alpha = positive("disk_margin", disk_margin)
    if alpha >= 2.0:
        raise ArgumentError(f"disk_margin: must be below 2, got {alpha:g}")
    return alpha


def _pair(
    model: LinearModel, gimbals: Sequence[str], period: float, delay: float
) -> tuple[control.StateSpace, Channels, float]:
    """The sampled plant of one gyro, its channel, and its nutation frequency in rad/s."""
    rows = whole_subsystems(model, gimbals)
    if len(rows) != 2 or len((channel := channels(model, rows)).momenta) != 1:
        raise ArgumentError(f"gimbals: must be the two coupled gimbals of one gyro, got {tuple(gimbals)}")
    names = [model.gimbal_names[k] for k in rows]
    torquers = [model.platform.torquer_on(name) for name in names]
    angles = [model.platform.pickoff_on(name).name for name in names]
    system = state_space(model, gimbals=names)
    nutation = float(np.abs(np.linalg.eigvals(system.A)).max())
    acting = sampled(selected(system, angles, [t.name for t in torquers]), period, delay, [t.lag for t in torquers])
    A, B, C, D, _ = state_arrays(acting, "plant")
    rate = held_rate(system.A, selected(system, angles, OMEGA_NAMES).B, period, len(A))
    arrays = StateArrays(A, np.hstack([B, rate]), C, np.hstack([D, np.zeros((2, 3))]), period)
    plant = named_system(arrays, [*acting.input_labels, *OMEGA_NAMES], angles, acting.state_labels)
    return plant, channel, nutation
