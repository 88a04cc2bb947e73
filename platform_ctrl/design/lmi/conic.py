"""Solve a cvxpy problem, or one in cones, with Clarabel in a process that can be ended.

An interior-point step on a large problem takes minutes and reacts neither to a time limit nor to an interrupt. So the
matrices go through a pipe to a worker process, which starts at the first use, is used again, and ends with this one.
After the time limit it is killed; the next problem gets a new one.
"""

from __future__ import annotations

import atexit
import os
import threading
import warnings
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.common.processes import ProcessDied, ProcessTimeout, TaskProcess
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import InfeasibleError, TimeLimitError, UnscalableError

cp: Any = import_module("cvxpy")  # its annotations are incomplete

# Clarabel's cones in the order of the rows, with the arguments of each.
Cones = list[tuple[str, tuple[Any, ...]]]

# Time after the limit in which the solver may stop before it is killed, s.
GRACE = 0.25
# Starts of a worker for one problem.
ATTEMPTS = 2


@value
class Solver:
    """How the problems of one synthesis are solved."""

    # where, cure: method, and what to try next, for messages.
    where: str
    cure: str
    time_limit: float  # longest time of one solution, s, without the start of the solver
    P: Any  # attached to errors as the problem

    def solve(
        self, problem: Any, variables: tuple[Any, ...], step: str, tolerance: float = 1e-8, decompose: bool = True
    ) -> None:
        """Solve a `cvxpy.Problem`; afterwards its `variables` have finite values.

        A result that the solver calls inaccurate is accepted: callers evaluate every result again. `step` names the
        problem in messages, `tolerance` is that of gap and feasibility, and `decompose` says whether matrices with
        zeros may be decomposed, which makes small problems larger.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts={})
                answer = self._answer(_request(data, tolerance, decompose), step)
                problem.unpack_results(SimpleNamespace(**answer), chain, inverse)
            except (cp.SolverError, ArithmeticError, ValueError, np.linalg.LinAlgError):
                raise self._given_up(step) from None
        if not all(one.value is not None and np.all(np.isfinite(one.value)) for one in variables):
            raise self._given_up(step)

    def minimise(
        self, q: FloatArray, A: FloatArray, b: FloatArray, cones: Cones, step: str, tolerance: float
    ) -> FloatArray:
        """Return the x that minimises q'x with b − A x in the product of `cones`, Clarabel's names with their sizes."""
        data = {"q": q, "P": None, "A": A, "b": b, "cones": cones}
        x = np.array(self._answer(_plain(data, tolerance, decompose=False), step)["x"])
        if not np.all(np.isfinite(x)):
            raise self._given_up(step)
        return x

    def _answer(self, request: dict[str, Any], step: str) -> dict[str, Any]:
        """Return Clarabel's answer to a request; a typed error where it has none."""
        what = f"{self.where}: {step}"
        request["settings"]["time_limit"] = self.time_limit
        try:
            answer = _shared.solve(request, self.time_limit + GRACE)
            if answer["status"] == "MaxTime":
                raise ProcessTimeout
        except ProcessTimeout:
            raise TimeLimitError(
                f"{what}: the solver did not finish in {self.time_limit:.3g} s; give a larger time_limit", self.P
            ) from None
        except ProcessDied:
            raise UnscalableError(f"{what}: the solver's process died {ATTEMPTS} times; {self.cure}", self.P) from None
        status = answer["status"]
        if status in ("PrimalInfeasible", "AlmostPrimalInfeasible"):
            raise InfeasibleError(f"{what}: the inequalities are infeasible; {self.cure}", self.P)
        if status not in ("Solved", "AlmostSolved"):
            raise UnscalableError(f"{what}: the solver ended with {status!r}; {self.cure}", self.P)
        return answer

    def _given_up(self, step: str) -> UnscalableError:
        return UnscalableError(f"{self.where}: {step}: the solver gave up; {self.cure}", self.P)


class _Shared:
    """The worker of this process, and the lock that gives it to one thread at a time."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.worker: TaskProcess | None = None

    def solve(self, request: dict[str, Any], time_limit: float) -> dict[str, Any]:
        from platform_ctrl.common.clarabel_task import clarabel_solution

        with self.lock:
            for _ in range(ATTEMPTS):
                try:
                    kept, self.worker = self.worker or TaskProcess(clarabel_solution), None
                    answer: dict[str, Any] = kept.ask(request, time_limit)
                except (ProcessDied, OSError):
                    continue
                self.worker = kept
                return answer
        raise ProcessDied

    def end(self) -> None:
        if self.worker is not None:
            self.worker.end()
            self.worker = None

    def forget(self) -> None:
        # After a fork the worker belongs to the parent.
        self.__init__()  # type: ignore[misc]


_shared = _Shared()
atexit.register(_shared.end)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_shared.forget)


def _request(data: dict[str, Any], tolerance: float, decompose: bool) -> dict[str, Any]:
    """Return a problem of cvxpy as plain arrays."""
    dims = data["dims"]
    cones: Cones = []
    if dims.zero:
        cones.append(("ZeroConeT", (int(dims.zero),)))
    if dims.nonneg:
        cones.append(("NonnegativeConeT", (int(dims.nonneg),)))
    cones += [("SecondOrderConeT", (int(n),)) for n in dims.soc]
    cones += [("PSDTriangleConeT", (int(n),)) for n in dims.psd]
    return _plain(
        {"q": data["c"], "P": data.get("P"), "A": data["A"], "b": data["b"], "cones": cones}, tolerance, decompose
    )


def _plain(data: dict[str, Any], tolerance: float, decompose: bool) -> dict[str, Any]:
    from scipy.sparse import csc_matrix, triu

    A, size = csc_matrix(data["A"]), len(data["q"])
    P = csc_matrix(triu(data["P"])) if data["P"] is not None else csc_matrix((size, size))
    settings: dict[str, Any] = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
    return {
        "P": ((P.data, P.indices, P.indptr), P.shape),
        "q": np.asarray(data["q"], dtype=np.float64),
        "A": ((A.data, A.indices, A.indptr), A.shape),
        "b": np.asarray(data["b"], dtype=np.float64),
        "cones": data["cones"],
        "settings": settings | {"chordal_decomposition_enable": decompose},
    }


def solved(unknowns: StateArrays) -> StateArrays:
    """Return what the solver found for (transformed) controller matrices that are its unknowns."""
    A, B, C, D = (np.asarray(getattr(part, "value", part)) for part in unknowns[:4])
    return StateArrays(A, B, C, D)
