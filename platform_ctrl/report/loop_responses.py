"""What the plots of a loop show, computed once: responses on a grid that follows the poles, poles, root locus."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from platform_ctrl.analysis.feedback import gang
from platform_ctrl.analysis.frequency_grids import following_grid
from platform_ctrl.analysis.loop import Loop
from platform_ctrl.analysis.measuring import MetricRequest, Peak
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.analysis.norms import gains
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import continuous_poles
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.singular_values import largest_singular_values
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign, sampled_plant
from platform_ctrl.design.loop_signals import loop_signals
from platform_ctrl.job.job import LoopSpec
from platform_ctrl.mechanics.linearisation import LinearModel
from platform_ctrl.mechanics.outputs import observed
from platform_ctrl.mechanics.state_space import state_space
from platform_ctrl.plant.platform import OMEGA_NAMES


@value
class DesignResponses:
    """Responses of one design on the loop's nominal plant."""

    design: LoopDesign  # Which
    # (N,) each: By the keys of METRICS: the gain over frequency whose peak each metric is
    gains: Mapping[str, FloatArray]
    peaks: Mapping[str, float]  # By the same keys: the metrics themselves, over all frequencies
    smallest_sensitivity: FloatArray  # (N,), Smallest singular value of S at the input
    loop_gains: FloatArray  # (m, N), Singular values of the loop transfer at the input
    channels: ComplexArray  # (m, N), Loop transfer of each torquer with all others closed, 1/S_ii − 1
    controller_gain: FloatArray  # (N,), Largest singular value of the controller
    angle_per_rate: FloatArray  # (3, N), Norm of all angles per rate about each root axis
    # Closed loop with the nominal plant, with uncertain parameters and Omega, and with a fault; s-plane equivalents,
    # rad/s
    poles: ComplexArray
    varied_poles: ComplexArray
    fault_poles: ComplexArray


@value
class LoopResponses:
    """Responses of all designs of a loop, on one grid that includes the frequencies of their peaks."""

    frequency: FloatArray  # (N,), rad/s
    designs: tuple[DesignResponses, ...]  # In the job's order
    closed: str  # Name of the design that closes the loop
    # All designs of the page in their order, the same name once: the place is its colour; True: it closes a loop, and
    # its line is solid everywhere
    palette: Mapping[str, bool]
    open_angle_per_rate: FloatArray  # (3, N), open_angle_per_torque : (N,): The same disturbances without a controller
    open_angle_per_torque: FloatArray

    @property
    def closed_design(self) -> DesignResponses:
        """The responses of the design that closes the loop."""
        return next(one for one in self.designs if one.design.name == self.closed)


def palette_of(loops: Sequence[LoopOutcome]) -> dict[str, bool]:
    """Return the names of all designs, each with whether it closes one of the loops."""
    closed = {outcome.use for outcome in loops}
    return {design.name: design.name in closed for outcome in loops for design in outcome.designs}


def peak_metrics() -> dict[str, Peak]:
    """Return the metrics that are the peak of a gain over frequency, by their keys in `METRICS`."""
    return {
        kind: metric.measure
        for kind, metric in METRICS.items()
        if isinstance(metric.measure, Peak) and metric.measure.transfers
    }


def loop_responses(
    model: LinearModel, outcome: LoopOutcome, palette: Mapping[str, bool] | None = None
) -> LoopResponses | None:
    """Return the responses of all designs of `outcome`; None for a loop that is only checked in the coupled system.

    `palette` is that of all loops of the page; default: of this one.
    """
    of_designs = [(design, design.plants) for design in outcome.designs if design.plants is not None]
    if not of_designs:
        return None
    designs = [design for design, _ in of_designs]
    # A design may read what others do not, and have feedforward in its plants.
    nominal = {design.name: own.only([0]) for design, own in of_designs}
    plants = nominal[outcome.use] if outcome.use in nominal else nominal[designs[0].name]
    nyquist = np.pi / plants.period
    P = plants.of_torques()
    loops = {one.name: Loop(nominal[one.name], nominal[one.name].joined(one.controller)) for one in designs}
    for one in designs:
        assert one.measures is not None
        loops[one.name].poles = one.measures.poles[:1]
    poles = np.concatenate([np.linalg.eigvals(P.A), *(loop.poles[0] for loop in loops.values())])
    low = max(min(2e-3 * plants.nutation, 0.05 * nyquist), 1e-4 * nyquist)
    grid = following_grid(continuous_poles(poles, plants.period), low, 0.999 * nyquist)
    # Torquers without a limit have no share of it, and not every loop moves a line of sight.
    kinds = [
        kind
        for kind, peak in peak_metrics().items()
        if not (all(part.of_limit for part in peak.transfers) and np.isinf(plants.torque_limit).all())
        and (plants.sight or all(part.target != "sight" for part in peak.transfers))
    ]
    shown = {name: dict.fromkeys(kinds, loop) for name, loop in loops.items()}
    if plants.sight:
        # What friction brings of the platform's motion; without it a balanced gimbal transmits nothing.
        for one, own in of_designs:
            rubbing = own.only([_with_friction(own)])
            of_sight = Loop(rubbing, rubbing.joined(one.controller))
            shown[one.name] |= {kind: of_sight for kind in kinds if _is_of_sight(kind)}
    peaks = {
        name: {kind: METRICS[kind].measure.exact(loop, MetricRequest(kind=kind), 0) for kind, loop in of.items()}
        for name, of in shown.items()
    }
    at_peaks = np.concatenate([loop.peak_frequencies for of in shown.values() for loop in of.values()])
    frequency = np.union1d(grid, at_peaks[(at_peaks > grid[0]) & (at_peaks < grid[-1])])
    from_rate = {one.name: _reading_per_rate(model, outcome.spec, own, frequency) for one, own in of_designs}
    return LoopResponses(
        frequency=frequency,
        designs=tuple(
            _design_responses(one, loops[one.name], shown[one.name], peaks[one.name], frequency, from_rate[one.name])
            for one in designs
        ),
        closed=outcome.use,
        palette=palette or palette_of([outcome]),
        open_angle_per_rate=np.linalg.norm(from_rate.get(outcome.use, from_rate[designs[0].name]), axis=1).T,
        open_angle_per_torque=gains(P, frequency),
    )


def _is_of_sight(kind: str) -> bool:
    """Return whether a metric is the peak of a gain to the line of sight."""
    return any(part.target == "sight" for part in peak_metrics()[kind].transfers)


def _with_friction(plants: PlantSet) -> int:
    """Return the first plant with dry friction; without any the nominal one."""
    return plants.groups.index("friction") if "friction" in plants.groups else 0


def _design_responses(
    design: LoopDesign,
    loop: Loop,
    shown: Mapping[str, Loop],
    peaks: Mapping[str, float],
    frequency: FloatArray,
    from_rate: ComplexArray,
) -> DesignResponses:
    assert design.plants is not None
    responses = gang(sampled_plant(design.plants), design.own_controller, frequency)
    S_in, S_out, T_in = (np.moveaxis(H, -1, 0) for H in (responses.S_input, responses.S_output, responses.T_input))
    with np.errstate(all="ignore"):
        # L = S⁻¹ T: never the product of two integrators' infinities.
        loop_transfer = np.linalg.solve(S_in, T_in)
    assert design.measures is not None
    poles = continuous_poles(design.measures.poles, design.plants.period)
    faults = design.plants.of(("faults",))
    metrics = peak_metrics()
    return DesignResponses(
        design=design,
        gains={kind: of.gain_at(metrics[kind].transfers, frequency) for kind, of in shown.items()},
        peaks=peaks,
        smallest_sensitivity=_singular_values(S_in)[:, -1],
        loop_gains=_singular_values(np.asarray(loop_transfer, dtype=np.complex128)).T,
        channels=responses.channels,
        controller_gain=largest_singular_values(frequency_response(loop.controller, frequency, -3)),
        angle_per_rate=np.linalg.norm(S_out @ from_rate, axis=1).T,
        poles=poles[0],
        varied_poles=poles[1:][~faults[1:]].ravel(),
        fault_poles=poles[faults].ravel(),
    )


def _singular_values(responses: ComplexArray) -> FloatArray:
    """Return the singular values of square responses (N, m, m), (N, m); NaN where a response is not finite."""
    out = np.full(responses.shape[:2], np.nan)
    finite = np.all(np.isfinite(responses), axis=(1, 2))
    out[finite] = np.linalg.svd(responses[finite], compute_uv=False)
    return out


def _reading_per_rate(model: LinearModel, spec: LoopSpec, plants: PlantSet, frequency: FloatArray) -> ComplexArray:
    """Return the response of what a design reads to Omega while it does nothing, (N, readings, 3)."""
    # A tracking loop sets no torques: its gimbals are held by the loop that it commands.
    if plants.feedforward is not None or spec.kind == "tracking":
        fed = System(plants.A[0], plants.B_Omega[0], plants.C[0], plants.D_Omega[0], plants.period)
        return frequency_response(fed, frequency, -3)
    signals = loop_signals(model.platform, spec)
    if signals.held:
        signals = loop_signals(model.platform, dataclasses.replace(spec, sensors=plants.angles))
    system = state_space(model, gimbals=signals.gimbals, others="held" if signals.held else "coupled")
    shown = observed(system, model.platform, [sensor.name for sensor in signals.sensors], model.q0, model.Omega0)
    return frequency_response(System.of(shown[:, list(OMEGA_NAMES)], "gimbals"), frequency, -3)
