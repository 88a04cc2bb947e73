"""No true value is worse than the reported one: a search over jobs of one axis, held against an oracle of its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import differential_evolution

import platform_ctrl as pc
from one_axis import OneAxis, Truth
from platform_ctrl import design
from platform_ctrl.analysis.arrays import state_arrays
from platform_ctrl.analysis.loop_metrics import measured
from platform_ctrl.analysis.loop_set import LoopSet
from platform_ctrl.analysis.metrics import METRICS
from platform_ctrl.design.feedforward import design_plants
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job.requirements import of_readings, requirement

BAND_HZ, FROM_HZ = 8.0, 0.1
# Of these the true value is found by a grid, or of the reading's own signal.
KINDS = [
    kind
    for kind, metric in METRICS.items()
    if metric.of != "controller" and kind not in ("damping", "fastest pole", "H-infinity norm", "H2 norm")
]


def one_axis(numbers: np.ndarray) -> OneAxis:
    """Numbers from 0 to 1 as a job."""
    x = iter(np.clip(numbers, 0.0, 1.0))
    signed = lambda low, high, at: float(np.sign(at - 0.4) * low * (high / low) ** abs(2.0 * at - 1.0))  # noqa: E731
    return OneAxis(
        rate_hz=float(round(500.0 * 8.0 ** next(x))),
        delay=float(np.round(1.9 * next(x), 3)),
        lag=float(np.round(0.8 * next(x), 3)),
        stiffness=signed(1e-3, 1.0, next(x)),
        weight=signed(1e-5, 3e-2, next(x)),
        viscous=1e-4 * 300.0 ** next(x),
        bandwidth_hz=100.0 * 5.0 ** next(x),
        late=float(np.round(3.0 * next(x), 3)),
        crossover_hz=3.0 * 10.0 ** next(x),
        integral_hz=0.02 * 200.0 ** next(x),
        double_hz=0.0 if (at := next(x)) < 0.5 else 0.02 * 50.0 ** (2.0 * at - 1.0),
        fed=bool(next(x) > 0.5),
    )


COUNT = 12


def compared(one: OneAxis, kinds: list[str]) -> dict[str, tuple[float, float]]:
    """Return the true and the reported values of a job; none where its design is refused."""
    try:
        job = pc.read_job(one.job({}))
        spec = job.loops[0]
        plants = design_plants(job, spec, spec.designs[0])
        (outcome,) = design.loops(job)
    except (DesignError, PlatformCtrlError):
        return {}
    assert plants is not None
    K = outcome.closed.controller
    truth = Truth(one, state_arrays(K, "K"), plants.noise[0])
    true = truth.values(BAND_HZ, FROM_HZ)
    loops = LoopSet(plants, plants.joined(K))
    out = {}
    for kind in kinds:
        more = {"frequency": 2.0 * np.pi * BAND_HZ} if METRICS[kind].needs_frequency else {}
        more = {"frequency": 2.0 * np.pi * BAND_HZ, "lowest": 2.0 * np.pi * FROM_HZ} if kind == "torque limit" else more
        asked = requirement(kind, 1.0, **more)
        found = float(np.atleast_1d(METRICS[kind].in_unit(measured(loops, asked, exact=True)))[0])
        name = of_readings(METRICS[kind].name, "rate")
        if name in true:
            out[kind] = (true[name], found)
    return out


def worse(kind: str, true: float, reported: float) -> float:
    """Return by which factor the true value is worse than the reported one, 1 where it is as good."""
    if kind == "stability":
        return 1.0 + max(reported - true, 0.0) / max(abs(reported), 1.0)
    if METRICS[kind].decibels:
        return 10.0 ** ((reported - true) / 20.0)
    if np.isinf(true) or np.isinf(reported):
        return 1.0 if true == reported else np.inf
    size = max(abs(true), abs(reported))
    if size < 1e-3:
        return 1.0
    return reported / true if METRICS[kind].sense == "at least" else true / reported


def test_true_values_are_those_reported_on_jobs_of_every_kind() -> None:
    rng = np.random.default_rng(5)
    seen = 0
    for _ in range(24):
        one = one_axis(rng.uniform(size=COUNT))
        for kind, (true, reported) in compared(one, KINDS).items():
            seen += 1
            assert worse(kind, true, reported) <= 1.01, (one, kind, true, reported)
            assert worse(kind, reported, true) <= 1.02, (one, kind, true, reported)
    assert seen > 100


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_search_for_the_worst_finds_no_true_value_that_is_worse(kind: str) -> None:
    found: list[tuple[float, OneAxis, tuple[float, float]]] = []

    def score(numbers: np.ndarray) -> float:
        one = one_axis(numbers)
        pair = compared(one, [kind]).get(kind)
        if pair is None:
            return 0.0
        ratio = worse(kind, *pair)
        found.append((ratio, one, pair))
        return -min(ratio, 1e3)

    differential_evolution(score, [(0.0, 1.0)] * COUNT, popsize=4, maxiter=20, tol=0.0, seed=3, polish=False)
    assert len(found) > 300
    worst = max(found, key=lambda item: item[0])
    assert worst[0] <= 1.01, worst
