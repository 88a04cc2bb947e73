"""How large the inputs of a controller become: from the stops, limits and rates that plant and job state."""

from __future__ import annotations

from collections.abc import Mapping

from platform_ctrl.arguments import positive
from platform_ctrl.description import OMEGA_NAMES, Platform
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.job import Job

# Beyond a stop, a limit or the operating range: noise, elasticity, offsets.
MARGIN = 0.1


def input_ranges(
    inputs: tuple[str, ...], job: Job, ranges: Mapping[str, float] | None = None, margin: float = MARGIN
) -> dict[str, float]:
    """Return the largest magnitude of every input.

    An angle reaches its stops, a torque that another controller sets its torquer's limit, Omega the operating range of
    the job; each with a margin.

    Parameters
    ----------
    inputs
        Names of pick-off angles, rates, or torques of other controllers.
    job
        The job, with its plant.
    ranges
        By name, in SI units: used as they are, without the margin.
    margin
        Share that is added to what plant and job state.

    Returns
    -------
    dict
        By name, rad, rad/s or N m.

    Raises
    ------
    InputError
        Neither the plant nor `ranges` says how large a signal may become.
    ArgumentError
        A range is not a positive number.

    References
    ----------
    See docs/fixed-point.md.
    """
    given, margin = dict(ranges or {}), positive("margin", margin, zero=True)
    known = _known(job.platform) | {
        name: float(rate) for name, rate in zip(OMEGA_NAMES, job.Omega, strict=True) if rate > 0.0
    }
    out = {}
    for name in inputs:
        if name in given:
            out[name] = positive(f"ranges[{name!r}]", given[name])
        elif name in known:
            out[name] = (1.0 + margin) * known[name]
        else:
            raise InputError(
                f"fixed point: no range is known for {name!r}; expected stops of its gimbal or a limit of its torquer "
                f"in the plant file; or give its largest magnitude (ranges; on the command line --range {name}=NUMBER)"
            )
    return out


def check_names(what: str, given: Mapping[str, float], known: tuple[str, ...]) -> None:
    """Refuse a name that nothing has.

    Raises
    ------
    ArgumentError
        Names it.
    """
    for name in given:
        if name not in known:
            raise ArgumentError(f"{what}: given {name!r}; expected one of {', '.join(known) or 'none'}")


def _known(platform: Platform) -> dict[str, float]:
    out = {
        gimbal.angle: max(abs(stop) for stop in gimbal.stops)
        for gimbal in platform.gimbals
        if gimbal.stops is not None and any(gimbal.stops)
    }
    limits = {torquer.name: torquer.limit for torquer in platform.torquers if torquer.limit}
    return out | limits
