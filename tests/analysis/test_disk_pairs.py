"""Every pair of gain and phase that is printed of a disk margin, held against loops that are closed with it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import platform_ctrl as pc
from one_gyro_job import JOB
from platform_ctrl import analysis
from platform_ctrl.analysis.margins import disk_phase, disk_to_gain_phase
from platform_ctrl.common.values import FloatArray
from platform_ctrl.job.quantities import disk_words
from random_loops import stable_loop

ROOT = Path(__file__).parents[2]
PAIR = r"(?:×|x) ([\d.]+) with (?:phase )?(?:±|\+-)([\d.]+)"
ALONE = r"(?:×|x) ([\d.]+) to ([\d.]+) alone, (?:phase )?(?:±|\+-)([\d.]+)"


@pytest.fixture(scope="module")
def channels():
    """The two channels of docs/start/first-loop.md, each with the other closed: loop transfer and disk margin."""
    job, by_hand = tomllib.loads(JOB), {"damping_hz": 43.4, "damping2_hz": 53.0, "lead_hz": 7}
    job["loop"][0]["design"][0] |= by_hand
    loop = pc.design.loops(job)[0].closed
    L = analysis.loop_transfer(loop.plant, loop.controller)
    margins = analysis.loop_margins(loop.plant, loop.controller)
    out = {}
    for i, other in ((0, 1), (1, 0)):
        assert not np.any(L.D)
        A = L.A - L.B[:, [other]] @ L.C[[other]]
        out[margins.channels[i]] = ((A, L.B[:, [i]], L.C[[i]], L.D[[i]][:, [i]]), float(margins.alpha[i]))
    return out


def radius(loop, factor: complex) -> float:
    """Largest |z| of the loop closed with its gain times a complex factor."""
    A, B, C, D = loop
    return float(np.abs(np.linalg.eigvals(A - factor / (1.0 + factor * D[0, 0]) * (B @ C))).max())


def turned(gain: float, degrees: float) -> list[complex]:
    return [gain * np.exp(1j * sign * np.radians(degrees)) for sign in (-1.0, 1.0)]


def edge(alpha: float, skew: float, gains: FloatArray) -> np.ndarray:
    """Factors on the edge of the disk."""
    phase = disk_phase(gains, alpha, skew)
    return np.concatenate([gains * np.exp(1j * phase), gains * np.exp(-1j * phase)])


@pytest.mark.parametrize("skew", [0.0, 0.5, -0.7])
@pytest.mark.parametrize("seed", range(4))
def test_every_pair_inside_is_stable_and_the_worst_on_the_edge_is_not(seed: int, skew: float) -> None:
    loop = stable_loop(seed, 1, 4, 0.01)
    matrices = (loop.A, loop.B, loop.C, loop.D)
    found = analysis.disk_margin(loop, skew)
    assert found.alpha > 0.0
    worst = complex(found.perturbation[0])
    assert disk_phase(abs(worst), found.alpha, skew) == pytest.approx(abs(np.angle(worst)), abs=1e-6)
    assert radius(matrices, worst) == pytest.approx(1.0, abs=1e-6)
    low, high, _ = disk_to_gain_phase(0.999 * found.alpha, skew)
    inside = edge(0.999 * found.alpha, skew, np.geomspace(max(low, 1e-6), min(high, 1e6), 101))
    assert max(radius(matrices, f) for f in inside) < 1.0


def test_the_gain_and_the_phase_that_a_disk_allows_alone_are_too_much_together(channels) -> None:
    for loop, alpha in channels.values():
        low, high, phase = disk_to_gain_phase(alpha)

        def least(log_gain: float, sign: float, loop=loop, alpha=alpha) -> float:
            gain = np.exp(log_gain)
            return -radius(loop, gain * np.exp(1j * sign * float(disk_phase(gain, alpha))))

        ends = (np.log(low) + 1e-9, np.log(high) - 1e-9)
        reached = [-minimize_scalar(least, bounds=ends, args=(sign,), method="bounded").fun for sign in (-1.0, 1.0)]
        assert max(reached) == pytest.approx(1.0, abs=1e-6)
        together = [radius(loop, end * np.exp(1j * sign * phase)) for end in (low, high) for sign in (-1.0, 1.0)]
        assert max(together) > 1.005
    [loop, alpha] = channels["Q9"]
    _, high, phase = disk_to_gain_phase(alpha)
    assert radius(loop, high * np.exp(-1j * phase)) == pytest.approx(1.040, abs=5e-4)


def inside(text: str, alpha: float) -> int:
    """Assert that all that a text allows lies inside the disk, close to its edge; return how many pairs there were."""
    text = " ".join(text.replace("\n", " ").replace("#", " ").split())
    pairs = [(float(a), float(b)) for a, b in re.findall(PAIR, text)]
    for low, high, phase in re.findall(ALONE, text):
        pairs += [(float(low), 0.0), (float(high), 0.0), (1.0, float(phase))]
    for gain, degrees in pairs:
        for factor in turned(gain, degrees):
            size = abs((factor - 1.0) / (factor + 1.0)) / (alpha / 2.0)
            assert 0.95 < size <= 1.0 + 1e-12, (gain, degrees)
    return len(pairs)


@pytest.mark.parametrize("alpha", [0.05, 0.4, 0.5, 0.81, 1.0 / 3.0, 1.5, 1.9])
def test_what_a_report_says_of_a_disk_margin_lies_inside_its_disk(alpha: float) -> None:
    assert inside(disk_words(alpha), alpha) == 4


def test_what_the_page_on_requirements_says_lies_inside_the_disk() -> None:
    assert inside((ROOT / "docs" / "methods" / "requirements.md").read_text(encoding="utf-8"), 0.5) == 4
