"""Where two branches of a root locus leave the real axis, or come to it, between two gains."""

from __future__ import annotations

import numpy as np

from platform_ctrl.analysis.arrays import ComplexArray
from platform_ctrl.frozen import FloatArray

# Points that are put between the two gains, closer where the poles move fastest.
_POINTS = 9
_REAL = 1e-9


def rounded(gains: FloatArray, branches: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Return gains and branches with more points where a pair of poles turns from complex to real or back.

    The two poles of a pair are m ± √d, and m and d go smoothly with the gain while the poles themselves do not: between
    the two gains m and d are taken to be linear. All other branches are straight there.

    Parameters
    ----------
    gains : (G,)
        Rising.
    branches : complex (G, n)
        Each column one continuous branch.

    Returns
    -------
    (H,), complex (H, n)
        H ≥ G.
    """
    if len(gains) < 2 or branches.shape[1] < 2:
        return gains, branches
    # A pole that is infinitely fast turns nowhere.
    fine = np.isfinite(branches)
    real = ~fine | (np.abs(branches.imag) <= _REAL * (np.abs(branches) + 1.0))
    turns = np.flatnonzero((real[1:] != real[:-1]).any(axis=1))
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, _POINTS + 1) / (_POINTS + 1))
    at, more_gains, more = [], [], []
    for k in turns:
        start, end = branches[k], branches[k + 1]
        changed = np.flatnonzero((real[k] != real[k + 1]) & fine[k] & fine[k + 1])
        where = share
        pairs = []
        for i in changed:
            ends = start if not real[k, i] else end
            j = next((j for j in changed if j > i and abs(ends[j] - ends[i].conjugate()) <= 1e-6 * abs(ends[i])), None)
            if j is not None:
                m0, m1 = 0.5 * (start[i] + start[j]).real, 0.5 * (end[i] + end[j]).real
                d0, d1 = (0.25 * ((s[i] - s[j]) ** 2).real for s in (start, end))
                pairs.append((i, j, m0, m1, d0, d1))
                # The turn itself is one of the points.
                where = np.union1d(where, [d0 / (d0 - d1)] if d0 * d1 < 0.0 else [])
        with np.errstate(invalid="ignore"):
            points = start + where[:, None] * (end - start)
        for i, j, m0, m1, d0, d1 in pairs:
            root = np.sqrt((d0 + where * (d1 - d0)).astype(np.complex128))
            # Which of the two goes up, or to the right, is as at the ends.
            up = np.sign(((start if not real[k, i] else end)[i]).imag)
            right = np.sign(((end if real[k + 1, i] else start)[i] - (end if real[k + 1, i] else start)[j]).real)
            sign = np.where(np.abs(root.imag) > 0.0, up, right)
            middle = m0 + where * (m1 - m0)
            points[:, i], points[:, j] = middle + sign * root, middle - sign * root
        at.append(np.full(len(where), k + 1))
        more_gains.append(gains[k] + where * (gains[k + 1] - gains[k]))
        more.append(points)
    if not at:
        return gains, branches
    places = np.concatenate(at)
    return np.insert(gains, places, np.concatenate(more_gains)), np.insert(
        branches, places, np.concatenate(more), axis=0
    )
