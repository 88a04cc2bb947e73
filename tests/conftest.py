"""Shared by all tests."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import settings

# Before numpy is loaded: on small matrices BLAS threads spend their time waiting for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The tests themselves use all cores: a second process of each command would only start and wait.

# A shell lets what it starts in the background ignore Ctrl-C, and children inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A change is judged by the same cases everywhere; new ones are sought by `pytest --hypothesis-profile=others`.
settings.register_profile("same", derandomize=True)
settings.register_profile("others", derandomize=False, print_blob=True)
settings.load_profile("same")

# Files under which coverage learns less than two points in a hundred more, with half of the time of all; chosen by the
# lines that each file reaches (coverage's contexts) for its time. Without them: `pytest --cov` says 92 instead of 91 %.
UNTRACED = frozenset(
    """
    analysis/classical_margins analysis/frequency_response analysis/hinf_norm analysis/jitter_budget analysis/margins
    analysis/norms analysis/plant_set app/budget app/commanded app/core app/core_sliders app/designs
    app/designs_side_by_side app/messages app/plots app/session
    campaign/statistics cli/check cli/help cli/new cli/requirement_lines cli/serve_command
    design/caging_claims design/full_order_loops design/lmi design/lower_bounds design/rate_loops
    design/riccati design/sampled_hinf design/structured_caging design/tracking_methods docs export/code_any
    export/fixed frozen mechanics/forces mechanics/identities mechanics/linearisation_paper
    mechanics/oracle_mujoco mechanics/oracle_pinocchio mechanics/parameter_varying mechanics/reference
    mechanics/rotors mechanics/state_space mechanics/symbolic mechanics/the_paper models/examples models/paper
    plant/degenerate_platforms registered report/axes_picture report/first_screen
    report/plots_loci report/report report/summary shipped_jobs simulation/accuracy
    simulation/batch simulation/drives simulation/forces simulation/kernel simulation/packing
    simulation/parts simulation/plant simulation/rotors_and_base simulation/servo_rotors simulation/stops site
    verification/changes verification/coupled verification/exact_verdicts
    """.split()  # noqa: SIM905
)


def pytest_collection_finish(session: pytest.Session) -> None:
    """What is loaded by now stays to the end: to look through it for garbage again and again takes time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def _compile_kernel() -> None:
    from platform_ctrl import read_platform, simulation
    from platform_ctrl.simulation.batch import compile_kernel

    compile_kernel()
    simulation.rollout(read_platform("rate_gyro"), q=[[0.0]], velocity=[[0.0] * 4], step=1e-4, steps=1)


def _compile_analysis() -> None:
    import control
    import numpy as np

    from platform_ctrl import analysis

    loop = control.ss(-np.diag([1.0, 2.0]), np.eye(2), [[1.0, 0.2], [0.1, 1.0]], 0)
    analysis.disk_margin(loop)
    analysis.time_response(loop, np.linspace(0.0, 1.0, 50), np.ones((2, 50)))
    almost_undamped = control.ss([[0.0, 1.0], [-1.0, -1e-12]], [[0.0], [1.0]], [[1.0, 0.0]], 0)
    analysis.frequency_response(almost_undamped, [1.0])


def pytest_xdist_auto_num_workers() -> int:
    """One process more than there are processors: some tests wait, for a browser or another process."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Let one worker of a fresh checkout compile what all of them load; the others compile the kernels meanwhile."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None:
        return (yield)
    number = int(worker["workerid"].removeprefix("gw"))
    first = FileLock(Path(session.config.getoption("basetemp")).parent / "collection.lock")
    if number == 0:
        with first:
            return (yield)
    (_compile_kernel, _compile_analysis)[number % 2]()
    with first:
        pass
    return (yield)


@pytest.fixture(scope="module", autouse=True)
def traced_where_it_counts(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let coverage follow what reaches lines that no cheaper test does; tracing takes a third of a test's time."""
    file = request.path.relative_to(Path(__file__).parent).with_suffix("").as_posix()
    if file.replace("test_", "", 1) not in UNTRACED:
        yield
        return
    # pytest-cov's marker no_cover comes to nothing in the processes of pytest-xdist.
    tracer, of_threads = sys.gettrace(), threading.gettrace()
    sys.settrace(None)
    threading.settrace(None)  # type: ignore[arg-type]
    yield
    sys.settrace(tracer)
    threading.settrace(of_threads)  # type: ignore[arg-type]
