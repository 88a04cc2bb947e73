"""What the figures of a loop show, worked out once: responses on a grid that follows the poles, poles, root locus."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray, StateArrays, state_arrays
from platform_ctrl.analysis.feedback import Gang, closed_loop, gang
from platform_ctrl.analysis.frequency_grids import following_grid
from platform_ctrl.analysis.loop_set import LoopSet
from platform_ctrl.analysis.measuring import MetricRequest
from platform_ctrl.analysis.metrics import exact_value
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.pole_branches import pole_branches, values_at_breakaways
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign, closed_loop_poles, sampled_plant
from platform_ctrl.design.plants import rows_of
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import OMEGA_NAMES

# Whose peaks are drawn however narrow they are.
_REJECTION = MetricRequest(kind="Omega rejection")
_PEAKS = (
    *(MetricRequest(kind=kind) for kind in ("disk margin", "sensitivity peak", "complementary sensitivity peak")),
    _REJECTION,
)
_SHARE = MetricRequest(kind="torque limit")


@value
class DesignResponses:
    """Responses of one design on the loop's nominal plant.

    Attributes
    ----------
    design
        Which.
    gang
        Sensitivities.
    sensitivity, complementary, balanced : (N,)
        Largest singular values of S, T and (S − T)/2, the larger of input and output.
    smallest_sensitivity : (N,)
        Smallest singular value of S at the input.
    loop_gains : (m, N)
        Singular values of the loop transfer at the input.
    channels : complex (m, N)
        Loop transfer of each torquer with all others closed, 1/S_ii − 1.
    controller_gain : (N,)
        Largest singular value of the controller.
    angle_per_rate : (3, N)
        Norm of all angles per rate about each root axis.
    rejection
        Largest norm of all angles per rate about any axis, held between samples, over all frequencies, rad per rad/s;
        infinite where the loop is unstable.
    angle_per_torque : (N,)
        Largest singular value from torque disturbance to angle.
    torque_share : (N,)
        Torque over its limit for a sinusoidal platform rate of the job's size, worst torquer; 0 without limits.
    poles, varied_poles, fault_poles
        Closed loop with the nominal plant, with uncertain parameters and Omega, and with a fault; s-plane equivalents,
        rad/s.
    """

    design: LoopDesign
    gang: Gang
    sensitivity: FloatArray
    complementary: FloatArray
    balanced: FloatArray
    smallest_sensitivity: FloatArray
    loop_gains: FloatArray
    channels: ComplexArray
    controller_gain: FloatArray
    angle_per_rate: FloatArray
    rejection: float
    angle_per_torque: FloatArray
    torque_share: FloatArray
    poles: ComplexArray
    varied_poles: ComplexArray
    fault_poles: ComplexArray


@value
class LoopResponses:
    """Responses of all designs of a loop, on one grid that has the frequencies of their peaks.

    Attributes
    ----------
    frequency : (N,)
        rad/s.
    designs
        In the job's order.
    closed
        Name of the one that is closed.
    open_angle_per_rate : (3, N), open_angle_per_torque : (N,)
        The same disturbances without a controller.
    """

    frequency: FloatArray
    designs: tuple[DesignResponses, ...]
    closed: str
    open_angle_per_rate: FloatArray
    open_angle_per_torque: FloatArray


@value
class RootLocus:
    """Closed-loop poles while every gain of the controller is multiplied by one factor.

    Attributes
    ----------
    gains : (G,)
        The factors.
    branches : complex (G, poles)
        s-plane equivalents, rad/s, each column one continuous branch.
    stable : (G,)
        Whether the closed loop is.
    """

    gains: FloatArray
    branches: ComplexArray
    stable: np.ndarray[tuple[int], np.dtype[np.bool_]]

    @property
    def stable_range(self) -> tuple[float, float] | None:
        """Lowest and highest factor of the stable range around 1, or None where the loop itself is unstable."""
        at = int(np.argmin(np.abs(self.gains - 1.0)))
        if not self.stable[at]:
            return None
        low = high = at
        while low > 0 and self.stable[low - 1]:
            low -= 1
        while high + 1 < len(self.gains) and self.stable[high + 1]:
            high += 1
        return float(self.gains[low]), float(self.gains[high])


def loop_responses(model: LinearModel, outcome: LoopOutcome) -> LoopResponses | None:
    """Return the responses of all designs of `outcome`; None for a loop that is judged in the coupled system alone."""
    designs = [design for design in outcome.designs if design.plants is not None]
    if not designs or designs[0].plants is None:
        return None
    plants = designs[0].plants
    plant = sampled_plant(plants)
    nyquist = np.pi / plants.period
    poles = {id(d): continuous_poles(closed_loop_poles(plants, d.controller), plants.period) for d in designs}
    plant_poles = continuous_poles(np.linalg.eigvals(plants.A[0]), plants.period)
    every = np.concatenate([plant_poles, *(poles[id(d)][0] for d in designs)])
    low = max(min(2e-3 * plants.nutation, 0.05 * nyquist), 1e-4 * nyquist)
    exact = [LoopSet(plants.only([0]), plants.joined(d.controller)) for d in designs]
    frequency = _with_peaks(following_grid(every, low, 0.999 * nyquist), exact)
    from_rate = _angle_per_rate(model, outcome.spec.gimbals, frequency)
    no_direct = np.zeros((len(plants.angles), 3))
    held = StateArrays(plants.A[0], plants.B_Omega[0], plants.C[0], no_direct, plants.period)
    rate_held = frequency_response(held, frequency, -3)
    open_torque = frequency_response(
        StateArrays(plants.A[0], plants.B[0], plants.C[0], plants.D[0], plants.period), frequency, -3
    )
    return LoopResponses(
        frequency=frequency,
        designs=tuple(
            _design_responses(
                d,
                plants,
                gang(plant, d.controller, frequency),
                from_rate,
                rate_held,
                poles[id(d)],
                exact_value(one, _REJECTION),
            )
            for d, one in zip(designs, exact, strict=True)
        ),
        closed=outcome.use,
        open_angle_per_rate=np.linalg.norm(from_rate, axis=1).T,
        open_angle_per_torque=largest_singular_values(open_torque),
    )


def _with_peaks(grid: FloatArray, loops: Sequence[LoopSet]) -> FloatArray:
    """Add the frequencies at which the loops' gains are largest: captions and markers tell of the peaks themselves."""
    for one in loops:
        for asked in _PEAKS if np.isinf(one.plants.torque_limit).all() else (*_PEAKS, _SHARE):
            exact_value(one, asked)
    peaks = np.concatenate([one.peak_frequencies for one in loops])
    return np.union1d(grid, peaks[(peaks > grid[0]) & (peaks < grid[-1])])


def _design_responses(
    design: LoopDesign,
    plants: PlantSet,
    responses: Gang,
    from_rate: ComplexArray,
    rate_held: ComplexArray,
    poles: ComplexArray,
    rejection: float,
) -> DesignResponses:
    S_in, T_in = _frequency_first(responses.S_input), _frequency_first(responses.T_input)
    S_out, T_out = _frequency_first(responses.S_output), _frequency_first(responses.T_output)
    own = np.moveaxis(np.diagonal(S_in, axis1=-2, axis2=-1), -1, 0)
    with np.errstate(all="ignore"):
        # L = S⁻¹ T: never the product of two integrators' infinities.
        loop = np.linalg.solve(S_in, T_in)
        channels = 1.0 / own - 1.0
    K = frequency_response(state_arrays(design.controller, design.name), responses.frequency, -3)
    share = K @ S_out @ rate_held * (plants.Omega / plants.torque_limit[:, None])
    faults = plants.of(("faults",))
    return DesignResponses(
        design=design,
        gang=responses,
        sensitivity=np.maximum(largest_singular_values(S_in), largest_singular_values(S_out)),
        complementary=np.maximum(largest_singular_values(T_in), largest_singular_values(T_out)),
        balanced=np.maximum(
            largest_singular_values(0.5 * (S_in - T_in)), largest_singular_values(0.5 * (S_out - T_out))
        ),
        smallest_sensitivity=np.asarray(np.linalg.svd(S_in, compute_uv=False)[:, -1], dtype=np.float64),
        loop_gains=np.asarray(np.linalg.svd(loop, compute_uv=False).T, dtype=np.float64),
        channels=channels,
        controller_gain=largest_singular_values(K),
        angle_per_rate=np.linalg.norm(S_out @ from_rate, axis=1).T,
        rejection=rejection,
        angle_per_torque=largest_singular_values(_frequency_first(responses.angle_per_torque)),
        torque_share=np.linalg.norm(share, axis=-1).max(axis=-1, initial=0.0),
        poles=poles[0],
        varied_poles=poles[1:][~faults[1:]].ravel(),
        fault_poles=poles[faults].ravel(),
    )


def _angle_per_rate(model: LinearModel, gimbals: tuple[str, ...], frequency: FloatArray) -> ComplexArray:
    """Return the response of the uncontrolled gimbals to Omega, continuous, (N, gimbals, 3)."""
    angles = [model.angle_names[k] for k in rows_of(model, gimbals)]
    system = state_space(model, gimbals=gimbals)[angles, list(OMEGA_NAMES)]
    return frequency_response(state_arrays(system, "gimbals"), frequency, -3)


def root_locus(design: LoopDesign, highest: float = 2.0, points: int = 161) -> RootLocus:
    """Return the poles of the nominal closed loop for controller gains 0 to `highest` times the designed ones."""
    if design.plants is None:
        raise ValueError(f"{design.loop}, {design.name}: no plants of its own, expected a design with plants")
    plants, K = design.plants, state_arrays(design.controller, design.name)

    def poles(gains: FloatArray) -> ComplexArray:
        factor = gains[:, None, None]
        P = (plants.A[0], plants.B[0], plants.C[0], plants.D[0])
        A = closed_loop(StateArrays(*P, K.dt), StateArrays(K.A, K.B, factor * K.C, factor * K.D, K.dt)).A
        return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)

    gains = np.linspace(0.0, highest, points)
    gains = np.union1d(gains, values_at_breakaways(gains, poles))
    z = pole_branches(poles(gains))
    return RootLocus(
        gains=gains,
        branches=continuous_poles(z, plants.period),
        stable=np.abs(z).max(axis=1) < 1.0,
    )


def _frequency_first(response: ComplexArray) -> ComplexArray:
    return np.moveaxis(response, -1, 0)
