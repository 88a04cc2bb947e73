"""Controllers that methods have made: read from a file, or designed in the background while the page is open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.sampled import from_w_plane, to_w_plane
from platform_ctrl.check.given import opened, read_controllers
from platform_ctrl.designer.bounded import Bounded
from platform_ctrl.designer.tasks import Made
from platform_ctrl.designer.values import Conditions
from platform_ctrl.errors import DesignError, PlatformCtrlError
from platform_ctrl.job import Job, LoopSpec

# Designs that are remembered for settings that a page may come back to.
_ROOM = 64


class Store:
    """Designs by loop, name and all that they depend on. It never answers with one for other conditions."""

    def __init__(self) -> None:
        self._made: Bounded[Made] = Bounded(_ROOM)
        self._given: dict[tuple[str, str, Conditions], Made] = {}

    def put(self, loop: str, design: str, conditions: Conditions, made: Made) -> None:
        """Keep a design until there is no room for it."""
        self._made.put((loop, design, conditions), made)

    def keep(self, loop: str, design: str, conditions: Conditions, made: Made) -> None:
        """Keep a design that was read from a file: no method makes just this one again."""
        self._given[loop, design, conditions] = made

    def found(self, loop: str, design: str, conditions: Conditions | None) -> Made | None:
        """Return the design for just these conditions, or None."""
        if conditions is None:
            return None
        return self._given.get((loop, design, conditions)) or self._made.found((loop, design, conditions))


def at_rate(K: StateArrays, period: float, design: str) -> StateArrays:
    """Return a controller at a sample period, s: by Tustin's rule where it was made for another one.

    Raises
    ------
    DesignError
        It cannot be carried over.
    """
    if abs(K.dt - period) <= 1e-12 * period:
        return K
    try:
        return StateArrays(*from_w_plane(*to_w_plane(*K[:4], K.dt), period), period)
    except PlatformCtrlError:
        raise DesignError(
            f"{design}: Tustin's rule carries it to no controller at {1.0 / period:.4g} Hz; move one of its numbers to "
            "design it anew"
        ) from None


def given_designs(path: Path, job: Job) -> list[tuple[str, str, str, Made]]:
    """Return loop, design, method and controller of each entry of a file that fits the job's caging loops.

    Raises
    ------
    InputError
        The file cannot be read, or its controllers do not fit the job.
    """
    out = []
    _, data = opened(path)
    for part in ("controllers", "alternatives"):
        read = read_controllers(path, job, part)
        entries: list[Any] = list(data.get(part, [])) if isinstance(data, dict) else []
        for K, entry in zip(read, entries, strict=True):
            spec = _loop_of(job, set(K.output_labels))
            if spec is None:
                continue
            angles = [job.platform.pickoff_on(name).name for name in spec.gimbals]
            torques = [job.platform.torquer_on(name).name for name in spec.gimbals]
            if set(K.input_labels) != set(angles):
                continue
            arrays = state_arrays(K, str(K.name))
            at = [list(K.input_labels).index(name) for name in angles]
            of = [list(K.output_labels).index(name) for name in torques]
            ordered = StateArrays(arrays.A, arrays.B[:, at], arrays.C[of], arrays.D[of][:, at], arrays.dt)
            options = entry.get("options")
            numbers = {
                str(name): float(x)
                for name, x in (options.items() if isinstance(options, dict) else ())
                if isinstance(x, int | float) and not isinstance(x, bool) and x > 0.0
            }
            design, method = entry.get("design"), entry.get("method")
            made = Made(controller=ordered, options=numbers, claims={})
            out.append((spec.name, design if isinstance(design, str) and design else "given", str(method), made))
    return out


def _loop_of(job: Job, outputs: set[str]) -> LoopSpec | None:
    for spec in job.loops:
        if spec.kind == "caging" and outputs == {job.platform.torquer_on(name).name for name in spec.gimbals}:
            return spec
    return None
