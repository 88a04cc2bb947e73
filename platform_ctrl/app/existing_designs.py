"""Designs that exist already, in a file beside the job: which loop each of them belongs to, and its feedback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from platform_ctrl.analysis.feedback import feedback_part
from platform_ctrl.analysis.plant_set import COMMAND
from platform_ctrl.analysis.system import System
from platform_ctrl.design.feedforward import rate_feedforward
from platform_ctrl.design.loop_signals import loop_signals
from platform_ctrl.design.method import Designed
from platform_ctrl.job.job import DesignSpec, Job, LoopSpec
from platform_ctrl.plant.source import read_json
from platform_ctrl.verification.controllers import read_controllers


def existing_designs(path: Path, job: Job) -> list[tuple[str, str, str, Designed]]:
    """Return loop, design, method and controller of each entry of a file that fits the job's caging loops."""
    out = []
    _, data = read_json(path, "a JSON file with controllers")
    for part in ("controllers", "alternatives"):
        read = read_controllers(path, job, part)
        entries: list[Any] = list(data.get(part, [])) if isinstance(data, dict) else []
        for K, entry in zip(read, entries, strict=True):
            loops = (one for one in job.loops if one.has_plants)
            spec = next(
                (one for one in loops if set(K.output_labels) == set(loop_names(job, one, one.closed)[1])), None
            )
            if spec is None:
                continue
            design = next((one for one in spec.designs if one.name == entry.get("design")), spec.closed)
            readings, torques = loop_names(job, spec, design)
            arrays = System.of(K, str(K.name))
            names = list(K.input_labels)
            if design.feedforward is not None and set(design.feedforward.sensors) <= set(names):
                fed = rate_feedforward(job, spec.read_by(design), design)
                n = len(arrays.A) - len(fed.path.A)
                arrays = arrays._replace(A=arrays.A[:n, :n], B=arrays.B[:n], C=arrays.C[:, :n])
                names = [name for name in names if name not in fed.sensors or name in readings]
            own = {name for name in names if name.removesuffix(COMMAND) not in readings or name in readings}
            if own != set(readings):
                continue
            at = [list(K.input_labels).index(name) for name in readings]
            of = [list(K.output_labels).index(name) for name in torques]
            ordered = feedback_part(arrays._replace(C=arrays.C[of], D=arrays.D[of]), at)
            options = entry.get("options")
            numbers = {
                str(name): float(x)
                for name, x in (options.items() if isinstance(options, dict) else ())
                if isinstance(x, int | float) and not isinstance(x, bool) and x > 0.0
            }
            made = Designed(controller=ordered, options=numbers, claims={})
            out.append((spec.name, str(entry.get("design") or "given"), str(entry.get("method")), made))
    return out


def loop_names(job: Job, spec: LoopSpec, design: DesignSpec) -> tuple[list[str], list[str]]:
    """Return the names of what a design of a loop reads and sets; a tracking loop sets commands of the loop inside."""
    if spec.around is not None:
        inner = next(one for one in job.loops if one.name == spec.around)
        commands = inner.read_by(inner.closed).sensors
        return list(spec.read_by(design).sensors), [f"{name}{COMMAND}" for name in commands]
    signals = loop_signals(job.platform, spec.read_by(design))
    return [one.name for one in signals.sensors], [one.name for one in signals.torquers]
