"""The other process: reads questions from standard input, answers them, writes the answers.

Questions are conic problems for Clarabel, unless an argument ``module:function`` names what answers them. It is run
from its source text and by itself imports nothing of the package, so that it starts fast and works from a zip file too.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import sys
import threading
import time
from importlib import import_module
from typing import Any


def solved(request: dict[str, Any]) -> dict[str, Any]:
    """Solve one problem: minimise ½ x'Px + q'x subject to b − A x in the product of `cones`; P is upper triangular."""
    import clarabel
    from scipy.sparse import csc_matrix

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name, setting in request["settings"].items():
        setattr(settings, name, setting)
    cones = [getattr(clarabel, kind)(*arguments) for kind, arguments in request["cones"]]
    P, A = (csc_matrix(parts, shape=shape) for parts, shape in (request["P"], request["A"]))
    solution = clarabel.DefaultSolver(P, request["q"], A, request["b"], cones, settings).solve()
    return {
        "status": str(solution.status),
        "x": list(solution.x),
        "z": list(solution.z),
        "obj_val": solution.obj_val,
        "iterations": solution.iterations,
        "solve_time": solution.solve_time,
    }


def serve() -> None:
    """Answer requests until standard input ends, which it also does when the parent is gone."""
    # An interrupt at the terminal is meant for the parent, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    # Nothing that a library prints may come between the answers.
    os.dup2(2, 1)
    sys.path[:] = pickle.load(sys.stdin.buffer)
    answered = solved
    # What answers is loaded before the first question comes.
    if len(sys.argv) > 1:
        module, _, function = sys.argv[1].partition(":")
        answered = getattr(import_module(module), function)
    else:
        import_module("clarabel")
        import_module("scipy.sparse")

    requests: queue.Queue[dict[str, Any]] = queue.Queue()

    def read() -> None:
        try:
            while True:
                requests.put(pickle.load(sys.stdin.buffer))
        except BaseException:
            os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    answer: dict[str, Any] = {"status": "ready"}
    while True:
        pickle.dump(answer, answers, pickle.HIGHEST_PROTOCOL)
        answers.flush()
        request = requests.get()
        # Waiting before the work stands for a solver that hangs.
        time.sleep(request.get("wait", 0.0))
        try:
            answer = answered(request)
        except BaseException as error:  # a panic of the solver is no Exception
            answer = {"status": "NumericalError", "error": f"{type(error).__name__}: {error}"}


if __name__ == "__main__":
    serve()
