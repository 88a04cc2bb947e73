"""The line of sight's budget of a job: what each of its sources does to it with all loops closed.

The coupled linear model, sampled exactly, follows `analysis.jitter_budget`. The sources are those of ``[budget]`` and
the noise and quantisation of the sensors that the controllers read; dry friction is replaced by its describing function
at the rates that the budget itself finds, and by the noise of what is not in proportion to the rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from platform_ctrl.analysis.budget_integrals import BudgetResult, motion_transfer
from platform_ctrl.analysis.system import StateSpace
from platform_ctrl.common.values import replaced
from platform_ctrl.design.budget_friction import TOLERANCE, Balanced, balanced_at_trims, prepared
from platform_ctrl.design.budget_loop import BudgetLoop
from platform_ctrl.design.cases import at_angles
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.budget import BudgetSpec
from platform_ctrl.job.job import Job
from platform_ctrl.plant.sensors import LOS_ANGLES
from platform_ctrl.verification.budget_result import LineOfSightBudget, WindowBudget, assumption, judged

# Relative error of variances for one controller after the other.
_QUICK = 1e-4
# The fitted line's extent from end to end over its root mean square.
_EXTENT = math.sqrt(12.0)


def expect_budget(job: Job) -> BudgetSpec:
    """Return the budget of a job whose plant has a line of sight."""
    if job.budget is None:
        raise ArgumentError(
            f"job {job.name!r}: there is no [budget]; add one, with a [[budget.source]] for each thing that shakes the "
            "line of sight (platform-ctrl new NAME --kind camera-gimbal writes an example)"
        )
    if job.platform.line_of_sight is None:
        raise ArgumentError(
            f"platform {job.platform.name!r}: there is no [line_of_sight]; state what looks out in the plant"
        )
    return job.budget


def line_of_sight_budget(job: Job, controllers: Sequence[StateSpace]) -> LineOfSightBudget:
    """Return the budget of the line of sight with `controllers` closed around the coupled sampled model at rest.

    Parameters
    ----------
    job
        With a budget, and a plant with a line of sight.
    controllers
        u = K y in the order in which they are computed, with the job's sample period.

    Returns
    -------
    LineOfSightBudget
        By source and axis at zero gimbal angles, rad; limits are judged at the job's gimbal angles where it is worst.

    Raises
    ------
    ArgumentError
        The job has no budget or the plant no line of sight, a base rate acts on a platform that is free, the
        controllers do not fit the plant, or the loop is not stable.
    NotFoundError
        No rates were found that agree with the damping by dry friction at them.
    """
    return PreparedBudget(job, controllers).first


class PreparedBudget:
    """A job's budget, prepared for one controller after the other: some milliseconds each.

    Parameters
    ----------
    job
        With a budget, and a plant with a line of sight.
    controllers
        For which dry friction is balanced; u = K y in the order in which they are computed.
    like
        Of a plant that differs little: friction is taken from there instead, and only the gimbal angles count at which
        limits were decided there.

    Attributes
    ----------
    first
        The budget with `controllers`.

    Raises
    ------
    ArgumentError, NotFoundError
        As `line_of_sight_budget`.
    """

    def __init__(self, job: Job, controllers: Sequence[StateSpace], like: PreparedBudget | None = None) -> None:
        self._loop = loop = BudgetLoop(job, expect_budget(job), controllers)
        if like is None:
            self._balanced, tolerance = balanced_at_trims(loop), TOLERANCE
        else:
            self._balanced, tolerance = like.deciding, _QUICK
        self._prepared = [prepared(loop, one) for one in self._balanced]
        self.first, decided = self._found(controllers, range(len(self._balanced)), tolerance)
        self._decided = sorted({0, *decided})

    @property
    def deciding(self) -> list[Balanced]:
        """Zero gimbal angles, and those at which limits were worst."""
        return [self._balanced[k] for k in self._decided]

    def of(self, controllers: Sequence[StateSpace]) -> LineOfSightBudget:
        """Return the budget with other controllers of the same signals.

        Parameters
        ----------
        controllers
            u = K y in the order in which they are computed, with the job's sample period.

        Returns
        -------
        LineOfSightBudget
            With the friction of `first`, and limits at the gimbal angles that decided there.

        Raises
        ------
        ArgumentError
            The loop is not stable.
        """
        return self._found(controllers, self._decided, _QUICK)[0]

    def _found(
        self, controllers: Sequence[StateSpace], places: Sequence[int], tolerance: float
    ) -> tuple[LineOfSightBudget, list[int]]:
        """Return the budget at the first of some angles, and the place of those at which each limit is worst."""
        found: list[LineOfSightBudget] = []
        for k in places:
            apart, together = self._prepared[k]
            at = self._balanced[k]
            closed = self._loop.with_drives(self._loop.controllers_of(controllers, at.q), at.friction.fed)
            # Only the first is shown over frequency.
            of_all = together.of(closed, tolerance, over_frequency=not found)
            alone = of_all if apart is together else apart.of(closed, tolerance, over_frequency=not found)
            found.append(_result(self._loop, at, alone, of_all))
        worst = [max(range(len(found)), key=lambda k: found[k].results[j].ratio) for j in range(len(found[0].results))]
        results = tuple(found[k].results[j] for j, k in enumerate(worst))
        return replaced(found[0], {"results": results}), [places[k] for k in worst]


def _result(loop: BudgetLoop, at: Balanced, apart: BudgetResult, together: BudgetResult) -> LineOfSightBudget:
    """Return the result: sines of one source added up, and the limits judged."""
    budget = loop.budget
    names = [*loop.names, *(one.name for one in at.rest)]
    place = [*loop.rows, *range(len(budget.sources), len(names))]
    sums = np.zeros((len(names), len(apart.names)))
    sums[place, range(len(apart.names))] = 1.0
    rms = np.sqrt(sums @ apart.rms[:, :3] ** 2)
    windows = []
    for one in together.windows:
        smear, jitter = one.smear[:3], one.jitter[:3]
        windows.append(
            WindowBudget(
                exposure=one.exposure,
                displacement=one.displacement[:3],
                smear=_EXTENT * smear,
                jitter=jitter,
                about_mean=np.hypot(smear, jitter),
                contrast=np.array(
                    [motion_transfer(budget.spatial_frequencies, float(jitter[k]), float(smear[k])) for k in range(2)]
                ),
            )
        )
    at_q = at_angles(loop.job.platform, at.q)
    words = assumption(at.friction, at_q, budget.has_sines), budget.without_motors(loop.job.platform)
    linear = ", ".join(filter(None, words))
    return LineOfSightBudget(
        names=tuple(names),
        kinds=(*loop.kinds, *("friction" for _ in at.rest)),
        axes=LOS_ANGLES,
        rms=rms,
        total=together.total[:3],
        windows=tuple(windows),
        frequencies_hz=apart.edges / (2.0 * math.pi),
        cumulative=np.einsum("sg,gik->sik", sums, apart.cumulative[:, :3]),
        total_cumulative=np.array(
            [np.interp(apart.edges, together.edges, of_axis) for of_axis in together.total_cumulative[:3]]
        ),
        friction=at.friction,
        results=judged(budget, rms, together.total[:3], windows, linear, bool(at.friction.valid.all())),
    )
