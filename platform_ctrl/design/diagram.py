"""A controller as a block diagram: named blocks in order of evaluation, joined by the names of their signals.

What a loop's design writes down once is flattened for the analysis, and written out block by block as code.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from platform_ctrl.design.blocks import Block
from platform_ctrl.frozen import FloatArray

Kind = Literal["mix", "integral", "lag", "lead", "notch", "low-pass"]


class Stage(NamedTuple):
    """A block of a diagram.

    Attributes
    ----------
    name
        What it is called.
    kind
        What it is.
    note
        What it is in continuous time, frequencies in Hz.
    block
        Sampled.
    inputs, outputs
        Names of its signals.
    """

    name: str
    kind: Kind
    note: str
    block: Block
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def flattened(stages: Sequence[Stage], inputs: Sequence[str], outputs: Sequence[str]) -> Block:
    """Return the diagram from `inputs` to `outputs` as one block; its states are those of the stages in their order."""
    n, m = sum(len(stage.block[0]) for stage in stages), len(inputs)
    rows: dict[str, FloatArray] = dict(zip(inputs, np.eye(m, n + m, n), strict=True))
    later = np.zeros((n, n + m))
    first = 0
    for stage in stages:
        a, b, c, d = stage.block
        last = first + len(a)
        taken = np.array([rows[name] for name in stage.inputs])
        shown = d @ taken
        if last > first:
            later[first:last] = b @ taken
            later[first:last, first:last] += a
            shown[:, first:last] += c
        rows.update(zip(stage.outputs, shown, strict=True))
        first = last
    given = np.array([rows[name] for name in outputs])
    return later[:, :n], later[:, n:], given[:, :n], given[:, n:]
