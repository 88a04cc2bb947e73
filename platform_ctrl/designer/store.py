"""Controllers that methods have made: read from a file, or designed in the background while the page is open."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.sampled import from_w_plane, to_w_plane
from platform_ctrl.check.given import opened, read_controllers
from platform_ctrl.designer.bounded import Bounded
from platform_ctrl.designer.tasks import Made
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job import Job, LoopSpec

# Designs that are remembered for settings that a page may come back to.
_ROOM = 32


class Store:
    """Designs by loop, name and all that they depend on."""

    def __init__(self) -> None:
        self._made: Bounded[Made] = Bounded(_ROOM)
        self._latest: Bounded[tuple[Hashable, Made]] = Bounded(200)

    def put(self, loop: str, design: str, key: Hashable, made: Made) -> None:
        """Keep a design."""
        self._made.put((loop, design, key), made)
        self._latest.put((loop, design), (key, made))

    def has(self, loop: str, design: str, key: Hashable) -> bool:
        """Return whether there is a design for just these settings."""
        return self._made.found((loop, design, key)) is not None

    def any(self, loop: str, design: str) -> bool:
        """Return whether there is a design for any settings."""
        return self._latest.found((loop, design)) is not None

    def made_of(self, loop: str, design: str, options: Hashable) -> bool:
        """Return whether the latest design was made of these options, whatever the plant."""
        latest = self._latest.found((loop, design))
        return latest is not None and isinstance(latest[0], tuple) and latest[0][0] == options

    def found(self, loop: str, design: str, key: Hashable, period: float) -> tuple[StateArrays, str] | None:
        """Return the controller of a design and a line about it, the latest one where there is none for these settings.

        One of another sample rate is carried over by Tustin's rule.
        """
        made = self._made.found((loop, design, key))
        if made is not None:
            return made.controller, ""
        latest = self._latest.found((loop, design))
        if latest is None:
            return None
        K = latest[1].controller
        note = f"{design}: was made for other settings; design it anew to follow"
        if abs(K.dt - period) > 1e-12 * period:
            try:
                K = StateArrays(*from_w_plane(*to_w_plane(*K[:4], K.dt), period), period)
            except PlatformCtrlError:
                return None
            note = f"{design}: was made for another sample rate and carried over by Tustin's rule; design it anew"
        return K, note


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
