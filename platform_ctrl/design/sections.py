"""Sections of a controller: blocks with a meaning and named signals, which generated code keeps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from platform_ctrl.analysis.system import System
from platform_ctrl.common.values import FloatArray


class Section(NamedTuple):
    """A block: name, kind (lead, notch, ...), meaning in continuous time (frequencies in Hz), sampled, signal names."""

    name: str
    kind: str
    note: str
    block: System
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def states(self) -> list[str]:
        """Names of its states."""
        n = len(self.block.A)
        return [f"{self.name}_x{k + 1}" if n > 1 else f"{self.name}_x" for k in range(n)]

    def record(self) -> dict[str, Any]:
        """Return the section in the types of result.json."""
        matrices = dict(zip("ABCD", self.block[:4], strict=True))
        signals = {"inputs": list(self.inputs), "outputs": list(self.outputs)}
        return {"name": self.name, "kind": self.kind, "note": self.note, **matrices, **signals}


def flattened(sections: Sequence[Section], inputs: Sequence[str], outputs: Sequence[str]) -> System:
    """Return the sections from `inputs` to `outputs` as one system; its states are theirs in their order."""
    n, m = sum(len(section.block.A) for section in sections), len(inputs)
    rows: dict[str, FloatArray] = dict(zip(inputs, np.eye(m, n + m, n), strict=True))
    later = np.zeros((n, n + m))
    first = 0
    for section in sections:
        a, b, c, d, _ = section.block
        last = first + len(a)
        taken = np.array([rows[name] for name in section.inputs])
        shown = d @ taken
        if last > first:
            later[first:last] = b @ taken
            later[first:last, first:last] += a
            shown[:, first:last] += c
        rows.update(zip(section.outputs, shown, strict=True))
        first = last
    given = np.array([rows[name] for name in outputs])
    period = max(section.block.dt for section in sections)
    return System(later[:, :n], later[:, n:], given[:, :n], given[:, n:], period)
