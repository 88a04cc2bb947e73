"""Every pair of gain and phase that is printed of a disk margin, held against loops that are closed with it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from platform_ctrl import analysis
from random_loops import stable_loop

ROOT = Path(__file__).parents[2]
PAIR = r"(?:×|x) ([\d.]+) with (?:phase )?(?:±|\+-)([\d.]+)"
ALONE = r"(?:×|x) ([\d.]+) to ([\d.]+) alone, (?:phase )?(?:±|\+-)([\d.]+)"


def radius(loop, factor: complex) -> float:
    """Largest |z| of the loop closed with its gain times a complex factor."""
    A, B, C, D = loop
    return float(np.abs(np.linalg.eigvals(A - factor / (1.0 + factor * D[0, 0]) * (B @ C))).max())


def turned(gain: float, degrees: float) -> list[complex]:
    return [gain * np.exp(1j * sign * np.radians(degrees)) for sign in (-1.0, 1.0)]


def edge(alpha: float, skew: float) -> np.ndarray:
    """Factors on the edge of the disk, |f - 1| = alpha/2 |1 - skew + (1 + skew) f|."""
    half = 0.5 * alpha * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False))
    return (1.0 + half * (1.0 - skew)) / (1.0 - half * (1.0 + skew))


@pytest.mark.parametrize("skew", [0.0, 0.5, -0.7])
@pytest.mark.parametrize("seed", range(4))
def test_every_pair_inside_is_stable_and_the_worst_on_the_edge_is_not(seed: int, skew: float) -> None:
    loop = stable_loop(seed, 1, 4, 0.01)
    matrices = (loop.A, loop.B, loop.C, loop.D)
    found = analysis.disk_margin(loop, skew)
    assert found.alpha > 0.0
    worst = complex(found.perturbation[0])
    assert radius(matrices, worst) == pytest.approx(1.0, abs=1e-6)
    assert max(radius(matrices, f) for f in edge(0.999 * found.alpha, skew)) < 1.0


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


def test_what_the_page_on_requirements_says_lies_inside_the_disk() -> None:
    assert inside((ROOT / "docs" / "methods" / "requirements.md").read_text(encoding="utf-8"), 0.5) == 4
