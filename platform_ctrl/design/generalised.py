"""The weighted plant of a loop for scripts, and the way back from a controller that was found for it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from platform_ctrl.analysis.sampling import from_w_plane
from platform_ctrl.analysis.system import System
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import completed, remeasured
from platform_ctrl.design.partition import Channels
from platform_ctrl.design.riccati.weighted_loop import WeightedPlant, default_weights, signal_names, weighted_plant
from platform_ctrl.errors import ArgumentError, DesignError

if TYPE_CHECKING:
    from control import StateSpace

# Methods whose options are these weights.
WEIGHTED = ("hinf", "lmi")


def generalised_plant(loop: LoopOutcome, **weights: float) -> StateSpace:
    """Weighted plant of a loop of a job, for `control.hinfsyn` or a convex problem of your own.

    ::

        n ──────────────►(+)──► W_e ──► error, and measured
                          ▲
        d ──►(+)──► P ────┴───► W_t ──► angle
              ▲
        u ────┴───► W_u ──────────────► torque

    P is the exactly sampled nominal plant with delay and torquer lag, in the w-plane, w = (2/T) (z − 1)/(z + 1): the
    plant is continuous, its norms and stability are those of the sampled loop. Its channels are the gyroscopic pairs
    and inertial directions of the loop. W_e = 1/M + ω_e/s is in the path to the controller.

    Parameters
    ----------
    loop
        From `loops`, with at least one design.
    weights
        Options of the method ``hinf`` (``bandwidth_hz``, ``sensitivity_peak``, ...); those not given are those of the
        closed design where it has them, else by rules of thumb.

    Returns
    -------
    control.StateSpace
        Inputs w = [n, d] and u, outputs z = [error, angle, torque] and y = measured, with a number for each channel;
        dimensionless, angles in rad, torques in units of h ω_nutation or J ω_nutation². There are as many measurements
        and controls as channels.

    Raises
    ------
    ArgumentError
        A loop without plants of its own, or an unknown weight.

    See Also
    --------
    with_controller : the loop closed by what was found.

    Examples
    --------
    >>> loop = platform_ctrl.design.loops(job)[0]  # doctest: +SKIP
    >>> K, _, gamma, _ = control.hinfsyn(generalised_plant(loop), 2, 2)  # doctest: +SKIP
    >>> with_controller(loop, K).closed.results  # doctest: +SKIP
    """
    weighted, _ = _weighted(loop, weights)
    return weighted.arrays.to_control(*signal_names(weighted.size))


def with_controller(loop: LoopOutcome, controller: StateSpace, *, name: str = "given", **weights: float) -> LoopOutcome:
    """Close a loop of a job with a controller that was found outside, and measure it as every other design.

    Parameters
    ----------
    loop
        From `loops`.
    controller
        u = K y (positive feedback): a continuous one belongs to `generalised_plant`, W_e is put before it and it is
        sampled; a sampled one leads from the loop's readings to its torques, and is taken as it is.
    name
        Of the new design.
    weights
        As of `generalised_plant`.

    Returns
    -------
    LoopOutcome
        With the new design closed, its limits judged in ``closed.results``; `verification.check_job` takes it.

    Raises
    ------
    ArgumentError
        The controller does not fit.
    """
    plants = loop.closed.plants
    if plants is None:
        raise ArgumentError(f"with_controller: the loop {loop.spec.name!r} has no plants of its own; give another")
    if controller.dt:
        given = controller
    else:
        (weighted, channel), K = _weighted(loop, weights), System.of(controller, "controller")
        if K.D.shape != (weighted.size, weighted.size):
            raise ArgumentError(
                f"controller: must have {weighted.size} inputs and outputs, as the generalised plant has "
                f"{weighted.size} measurements and controls, got {K.D.shape[1]} and {K.D.shape[0]}"
            )
        sampled = weighted.at_gimbals(from_w_plane(weighted.weight().series(K), plants.period), channel)
        if channel.sense is not None:
            sampled = sampled._replace(B=sampled.B @ channel.sense, D=sampled.D @ channel.sense)
        given = sampled.to_control(plants.angles, plants.torques)
    made = remeasured(loop.spec, name, given, plants)
    kept = tuple(one for one in loop.designs if one.name != name)
    return replace(loop, designs=(*kept, replace(made, directions=loop.closed.directions)), use=name)


def _weighted(loop: LoopOutcome, weights: dict[str, float]) -> tuple[WeightedPlant, Channels]:
    closed = loop.closed
    plants, channel = closed.plants, closed.directions
    if plants is None or channel is None:
        raise ArgumentError(f"generalised_plant: the loop {loop.spec.name!r} has no plants of its own; give another")
    own = plants.regular() if channel.sense is None else plants.in_directions(channel.sense).regular()
    rules = default_weights(channel, own.nutation)
    options = rules | {key: x for key, x in closed.options.items() if key in rules and closed.method in WEIGHTED}
    try:
        return weighted_plant(completed("generalised_plant", weights, options), channel, own), channel
    except DesignError as error:
        raise ArgumentError(str(error)) from None
