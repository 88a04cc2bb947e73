"""From what a design wrote down to the sections of a scheme."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from platform_ctrl.design.diagram import Stage
from platform_ctrl.export.code.scheme import Row, Section, Term
from platform_ctrl.frozen import FloatArray

# What the coefficients of a block with one or two states are called.
_POLES = {1: (("pole",),), 2: (("a1", "a2"), ("shift", "none"))}
_SHOWN = {1: ("held",), 2: ("c1", "c2")}


def row(target: str, weights: FloatArray, sources: Sequence[str], names: Sequence[str] = ()) -> Row:
    """Return target = Σ weights sources, without what is zero.

    Parameters
    ----------
    target
        Name.
    weights : (k,)
        Coefficients, in the unit of the target per unit of the source.
    sources
        As many names.
    names
        What the coefficients are called; none: nothing.

    Returns
    -------
    Row
        With a term for every weight that is not zero.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    See docs/generated-code.md.
    """
    labels = names or [""] * len(sources)
    return Row(
        target=target,
        terms=tuple(
            Term(coefficient=float(x), source=source, name=label)
            for x, source, label in zip(weights, sources, labels, strict=True)
            if x != 0.0
        ),
    )


def sections_of(stages: Iterable[Stage]) -> tuple[Section, ...]:
    """Return the sections of a block diagram.

    Parameters
    ----------
    stages
        In order of evaluation; those with states have one input and one output.

    Returns
    -------
    tuple of Section
        One for each, the states named after their stages.

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    See docs/generated-code.md.
    """
    return tuple(_section(stage) for stage in stages)


def _section(stage: Stage) -> Section:
    A, B, C, D = stage.block
    n = len(A)
    states = [f"{stage.name}_x{k + 1}" if n > 1 else f"{stage.name}_x" for k in range(n)]
    sources = [*stage.inputs, *states]
    through = ("direct",) if n else [""] * len(stage.inputs)
    return Section(
        name=stage.name,
        kind=stage.kind,
        note=stage.note,
        signals=tuple(
            row(target, np.concatenate([D[k], C[k]]), sources, [*through, *_SHOWN.get(n, ())])
            for k, target in enumerate(stage.outputs)
        ),
        states=tuple(
            row(target, np.concatenate([B[k], A[k]]), sources, ["drive", *_POLES[n][k]])
            for k, target in enumerate(states)
        ),
    )
