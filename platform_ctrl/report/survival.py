"""What is proved of the platform's rate, beside the manoeuvre that was simulated."""

from __future__ import annotations

from collections.abc import Sequence

from platform_ctrl.check.simulated import Run
from platform_ctrl.design.caging_claims import survived_name
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.report.quantities import plain


def survival(run: Run, loops: Sequence[LoopOutcome]) -> str:
    """Return a sentence: up to which Omega about the run's axis the closed loops keep off their limits; or nothing."""
    axis = run.manoeuvre.axis
    held, spread = (_least(loops, survived_name(axis, spread=over)) for over in (False, True))
    if run.manoeuvre.mode != "caged" or held is None:
        return ""
    varied = "" if spread is None else f", {plain(spread, 3, 'down')} over the parameter spread"
    return (
        f"Up to {plain(held, 3, 'down')} rad/s about this axis{varied}, torques and angles of the linear loops are "
        f"proved to keep within their limits, noise apart; this run goes to {plain(run.manoeuvre.rate, 3)}."
    )


def _least(loops: Sequence[LoopOutcome], name: str) -> float | None:
    found = [outcome.closed.claims[name] for outcome in loops if name in outcome.closed.claims]
    return min(found, default=None)
