"""One simulated run over time, with its limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from platform_ctrl.arguments import known_name, positive
from platform_ctrl.check import Run
from platform_ctrl.description import ROOT_TORQUE_NAMES, Platform, Torquer
from platform_ctrl.errors import ArgumentError
from platform_ctrl.report.quantities import root_series, signal_series
from platform_ctrl.report.run_figures import trajectory_figure
from platform_ctrl.report.style import standalone
from platform_ctrl.signatures import check_arguments, short
from platform_ctrl.simulation import Trajectory

_LIMITS = ("angle", "attitude", "torque_share")


@standalone
@check_arguments
def time_run(
    run: Run | Trajectory, platform: Platform | None = None, *, limits: Mapping[str, float] | None = None
) -> Figure:
    """Gimbal angles, torques, platform rate and attitude of a simulated run over time, beyond their limits shaded.

    A run that diverged is drawn up to a red line at its end. Where a limit lies far beyond the trace it stands in the
    panel's title instead of flattening it.

    Parameters
    ----------
    run
        A manoeuvre that was checked (`check.Run`, with its limits), or a `simulation.Trajectory`.
    platform
        The plant that was run: tells the torquers' limits. None: they are not drawn.
    limits
        ``angle``, ``attitude``, rad, ``torque_share``, a share: at most; default those of the manoeuvre, none of a
        trajectory.

    Returns
    -------
    matplotlib.figure.Figure
        Panels above each other, over time in s.

    Raises
    ------
    ArgumentError
        Something else than a run, another platform than the run's, or a limit that does not exist.

    References
    ----------
    See docs/simulation.md.
    """
    if not isinstance(run, Run | Trajectory):
        raise ArgumentError(f"time_run: given {short(run)}; expected a check.Run or a simulation.Trajectory")
    recorded = run.trajectory if isinstance(run, Run) else run
    if limits is None:
        asked = dict(run.manoeuvre.limits) if isinstance(run, Run) else {}
    else:
        if not isinstance(limits, Mapping):
            raise ArgumentError(
                f"time_run: limits: given {short(limits)}; expected a mapping such as {{'angle': 0.01}}"
            )
        for name in limits:
            known_name("time_run: limits", name, _LIMITS)
        asked = {name: positive(f"time_run: limits: {name}", limit) for name, limit in limits.items()}
    names = recorded.torquer_names
    if platform is None:
        torquers = [Torquer(name=name, **_place(name)) for name in names]
        series = _series(recorded)
    else:
        torquers = list(platform.torquers)
        series = signal_series(platform)
        own = tuple(torquer.name for torquer in torquers)
        if own != names or platform.angle_names != recorded.angle_names:
            raise ArgumentError(
                f"time_run: platform {platform.name!r} has torquers {', '.join(own)}, the run {', '.join(names)}; "
                "expected the platform that was run"
            )
    duration = run.manoeuvre.duration if isinstance(run, Run) else math.nan
    if not duration > 0.0:
        duration = float(recorded.t[-1]) if recorded.t.size > 1 else recorded.period
    unknown = {} if platform is not None else {"unlimited": "give the platform to see the torquers' limits"}
    return trajectory_figure(recorded, torquers, series, asked, duration, **unknown)


def _series(run: Trajectory) -> Mapping[str, int]:
    """Return the colours of a run's signals where the platform is not known: torquers in the order of the gimbals."""
    out = {name: k for k, name in enumerate(run.angle_names)}
    gimbals = [name for name in run.torquer_names if name not in ROOT_TORQUE_NAMES]
    roots = {name: root_series(axis) for axis, name in enumerate(ROOT_TORQUE_NAMES, 1)}
    return out | roots | {name: k for k, name in enumerate(gimbals)}


def _place(name: str) -> dict[str, Any]:
    """Return where a torquer acts, by its name: M1, M2, M3 on the root."""
    if name in ROOT_TORQUE_NAMES:
        return {"root_axis": 1 + ROOT_TORQUE_NAMES.index(name)}
    return {"gimbal": name}
