"""The forms that ``platform-ctrl export`` writes, each with its function; nothing heavy is loaded before that."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from platform_ctrl.common.text import unused

if TYPE_CHECKING:
    import control

    from platform_ctrl.export.job_systems import ResponseTable
    from platform_ctrl.export.systems import ExportedSystem
    from platform_ctrl.job.job import Job

NUMBERS: tuple[Literal["double", "float"], ...] = ("double", "float")
RESPONSES: tuple[Literal["complex", "polar"], ...] = ("complex", "polar")
ROOTS: tuple[Literal["free", "prescribed", "fixed"], ...] = ("free", "prescribed", "fixed")


@dataclass
class Export:
    """What is exported, and how."""

    # job, job_file: The job, and the file that it was read from
    job: Job
    job_file: Path
    # controller_file, controller_sha256: Where its controllers come from, and the digest of that file; None where
    # nothing needs them
    controller_file: Path | None = None
    controller_sha256: str | None = None
    number: Literal["double", "float"] = "double"  # Of the C source
    responses: Literal["complex", "polar"] = "complex"  # How frequency responses are written
    root: Literal["free", "prescribed", "fixed"] = "free"  # Of the MuJoCo model
    notes: list[str] = field(default_factory=list)  # Lines for the reader; writers append to it

    @cached_property
    def controllers(self) -> list[control.StateSpace]:
        """The job's controllers; none where there is no file of them."""
        from platform_ctrl.verification.controllers import read_controllers

        return [] if self.controller_file is None else read_controllers(self.controller_file, self.job)

    def systems(self, target: Path) -> list[ExportedSystem]:
        """Return the controllers, then the linear models of the plant, for a file; note what these leave out."""
        from platform_ctrl.export.job_systems import model_systems
        from platform_ctrl.export.systems import ExportedSystem

        driven = ", ".join(drive.torquer for drive in self.job.drives)
        if driven:
            self.notes.append(f"{target}: without the [[drive]] of {driven}, which is not linear; the C source has it")
        if turned := ", ".join(name for law in self.job.resolvers for name in law.names):
            self.notes.append(f"{target}: {turned} are turned by measured angles; the C source does that")
        note = "controller, positive feedback u = +K y; u acts the delay after the sample and is held"
        own = [ExportedSystem(K, self.job.sampling.delay, note) for K in self.controllers]
        return [*own, *model_systems(self.job)]


@dataclass(frozen=True)
class Form:
    """A kind of file, or of folder with files, that a job can be written as."""

    name: str  # Of the option, without --; format in the JSON output
    title: str  # For messages
    # write(export, path, target): writes to path, which takes its place at target when all is written
    write: Callable[[Export, Path, Path], None]
    folder: bool = False  # Whether it is a folder
    controllers: Literal["needed", "optional", "unused"] = "needed"  # Whether it needs the job's controllers

    @property
    def flag(self) -> str:
        """The option on the command line."""
        return f"--{self.name}"


def _write_c(export: Export, path: Path, target: Path) -> None:
    from platform_ctrl.export.c99.c_files import write_c
    from platform_ctrl.plant.source import read_json
    from platform_ctrl.verification.controllers import read_controllers

    file = cast(Path, export.controller_file)
    read_controllers(file, export.job)  # checked as a file, before its entries are taken
    data: Any = read_json(file, "a JSON file with controllers")[1]
    versions = data.get("versions")
    words = ["platform-ctrl", "export", str(export.job_file), "--controllers", str(file), "--c", str(target)]
    written = write_c(
        export.job,
        data["controllers"],
        path,
        number=export.number,
        sha256=export.controller_sha256 or "",
        versions=versions if isinstance(versions, Mapping) else None,
        command=shlex.join([*words, "--number", export.number]),
    )
    export.notes += written.notes


def _write_mat(export: Export, path: Path, target: Path) -> None:
    from platform_ctrl.export.systems import write_mat

    write_mat([one.system for one in export.systems(target)], path)


def _write_models(export: Export, path: Path, target: Path) -> None:
    from platform_ctrl.export.systems import signal_units, write_entries

    write_entries(export.systems(target), path, signal_units(export.job.platform, export.job.units))


def _write_csv(export: Export, path: Path, target: Path) -> None:
    from platform_ctrl.export.job_systems import job_responses, write_responses

    names: dict[str, ResponseTable] = {}
    for table in job_responses(export.job, export.controllers):
        names[unused(re.sub(r"[^\w.+-]+", "_", table.name), names)] = table
    for name, table in names.items():
        write_responses(table.response, path / f"{name}.csv", form=export.responses, notes=table.notes)


def _write_mjcf(export: Export, path: Path, target: Path) -> None:
    from platform_ctrl.export.mujoco.mjcf_writer import write_mjcf

    export.notes += [f"{target}: {note}" for note in write_mjcf(export.job.platform, path, root=export.root)]


FORMS = (
    Form("c", "C source", _write_c, folder=True),
    Form("mat", "MATLAB data", _write_mat),
    Form("models", "JSON", _write_models, controllers="optional"),
    Form("csv", "responses", _write_csv, folder=True),
    Form("mjcf", "MuJoCo model", _write_mjcf, controllers="unused"),
)
