"""What a step of a scheme costs: always the same operations, counted."""

from __future__ import annotations

import numpy as np

from platform_ctrl.export.code.scheme import Scheme, acting_excess
from platform_ctrl.frozen import value


@value
class Cost:
    """Operations of one step.

    Attributes
    ----------
    multiplications, additions, comparisons
        Counts; subtractions count as additions, comparisons are the most that there can be.

    References
    ----------
    See docs/generated-code.md.
    """

    multiplications: int
    additions: int
    comparisons: int


def cost_of(scheme: Scheme) -> Cost:
    """Return what a step of a scheme costs, limits and anti-windup included.

    Parameters
    ----------
    scheme
        The scheme.

    Returns
    -------
    Cost
        Counts of one step.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    See docs/generated-code.md.
    """
    rows = [row for section in scheme.sections for row in (*section.signals, *section.states)]
    limited = int(np.isfinite(scheme.torque_limits).sum())
    back = acting_excess(scheme)
    cut = {term.source for row in back for term in row.terms}
    return Cost(
        multiplications=sum(abs(term.coefficient) != 1.0 for row in (*rows, *back) for term in row.terms),
        additions=sum(max(len(row.terms) - 1, 0) for row in rows) + sum(len(row.terms) for row in back) + len(cut),
        # Two for each number that has to be finite; two to limit and two to tell.
        comparisons=2 * (len(scheme.inputs) + len(scheme.states) + len(scheme.outputs)) + 4 * limited,
    )
