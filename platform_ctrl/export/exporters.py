"""The registry of exporters: what ``platform-ctrl export`` can write, each with its option, its help and its function.

Nothing heavy is loaded before something is written. To add an exporter see docs/architecture.md, Recipes.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from platform_ctrl.errors import ArgumentError

if TYPE_CHECKING:
    import control

    from platform_ctrl.export.systems import SystemRecord
    from platform_ctrl.job.job import Job


@dataclass
class Export:
    """What is exported."""

    # job, job_file: The job, and the file that it was read from
    job: Job
    job_file: Path
    # controller_file, controller_sha256: Where its controllers come from, and the digest of that file; None where
    # nothing needs them
    controller_file: Path | None = None
    controller_sha256: str | None = None
    notes: list[str] = field(default_factory=list)  # Lines for the reader; writers append to it

    @cached_property
    def controllers(self) -> list[control.StateSpace]:
        """The job's controllers; none where there is no file of them."""
        from platform_ctrl.verification.controllers import read_controllers

        return [] if self.controller_file is None else read_controllers(self.controller_file, self.job)

    @property
    def systems(self) -> tuple[SystemRecord, ...]:
        """The controllers, then the linear models of the plant."""
        from platform_ctrl.export.job_systems import controller_systems, model_systems

        return controller_systems(self.job, self.controllers) + model_systems(self.job)


@dataclass(frozen=True)
class Setting:
    """An option of an exporter: a keyword of its function, ``--a-name`` on the command line."""

    name: str  # Keyword of the function; option, if given, is its name on the command line
    # metavar, help: For --help
    metavar: str
    help: str
    default: Any = None  # If it is not given
    choices: tuple[str, ...] = ()  # The words that are allowed; empty: anything
    kind: Any = str  # Type of the value; list[str] may be given more than once
    option: str = ""

    @property
    def flag(self) -> str:
        """The option on the command line."""
        return f"--{self.option or self.name.replace('_', '-')}"


@dataclass(frozen=True)
class Exporter:
    """One kind of file, or of folder with files, that a job can be written as."""

    name: str  # Of the option, without --; format in the JSON output
    # title, help: For messages and for --help
    title: str
    help: str
    # write(export, path, target, **settings): writes to path, which takes its place at target when all is written
    write: Callable[..., None]
    suffix: str = ""  # Of the file that is written; empty: a folder
    controllers: Literal["needed", "optional", "unused"] = "needed"  # Whether it needs the job's controllers
    settings: tuple[Setting, ...] = ()  # Its options

    @property
    def flag(self) -> str:
        """The option on the command line."""
        return f"--{self.name}"

    @property
    def flags(self) -> tuple[str, ...]:
        """Its option, and those of its settings."""
        return (self.flag, *(setting.flag for setting in self.settings))


_registered: dict[str, Exporter] = {}


def register(exporter: Exporter) -> Exporter:
    """Add an exporter to ``platform-ctrl export``, behind those that are there, and return it."""
    taken = {flag for other in _registered.values() for flag in other.flags}
    for flag in exporter.flags:
        if flag in taken:
            raise ArgumentError(f"exporter {exporter.name}: the option {flag} exists already; choose another name")
    _registered[exporter.name] = exporter
    return exporter


def unregister(name: str) -> None:
    """Remove an exporter."""
    del _registered[name]


def exporters() -> tuple[Exporter, ...]:
    """Return all exporters in the order in which the help lists them."""
    return tuple(_registered.values())


def _write_c(export: Export, path: Path, target: Path, **settings: Any) -> None:
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
        sha256=export.controller_sha256 or "",
        versions=versions if isinstance(versions, Mapping) else None,
        command=shlex.join([*words, *_as_typed(settings)]),
        **settings,
    )
    export.notes += written.notes


def _as_typed(settings: Mapping[str, Any]) -> list[str]:
    """Return the words of the command line for the settings of the C source."""
    return ["--number", settings["number"], "--anti-windup", settings["anti_windup"]]


def _without_drives(export: Export, target: Path) -> list[str]:
    """Return a note where a job's drives, which are not linear, are not in linear systems."""
    driven = ", ".join(drive.torquer for drive in export.job.drives)
    return [f"{target}: without the [[drive]] of {driven}, which is not linear; the C source has it"] if driven else []


def _write_mat(export: Export, path: Path, target: Path) -> None:
    from platform_ctrl.export.matlab import write_mat

    write_mat(export.systems, path)
    export.notes += _without_drives(export, target)


def _write_models(export: Export, path: Path, target: Path) -> None:
    from platform_ctrl.export.systems import write_systems

    write_systems(export.systems, path)
    export.notes += _without_drives(export, target)


def _write_csv(export: Export, path: Path, target: Path, *, form: Literal["complex", "polar"]) -> None:
    from platform_ctrl.export.job_systems import job_responses, write_responses

    for table in job_responses(export.job, export.controllers):
        name, count = re.sub(r"[^\w.+-]+", "_", table.name), 1
        while (path / f"{name}{f'_{count}' * (count > 1)}.csv").exists():
            count += 1
        write_responses(table.response, path / f"{name}{f'_{count}' * (count > 1)}.csv", form=form, notes=table.notes)


def _write_mjcf(export: Export, path: Path, target: Path, *, root: Literal["free", "prescribed", "fixed"]) -> None:
    from platform_ctrl.export.mujoco.mjcf_writer import write_mjcf

    export.notes += [f"{target}: {note}" for note in write_mjcf(export.job.platform, path, root=root)]


register(
    Exporter(
        name="c",
        title="C source",
        help="The controllers as C99 source, into this folder: a new or empty one, or one of an earlier export.",
        write=_write_c,
        settings=(
            Setting(
                "number",
                "TYPE",
                "Numbers of the C source: double or float.",
                default="double",
                choices=("double", "float"),
            ),
            Setting(
                "anti_windup",
                "KIND",
                "What a limited torque does to integrals in the C source: back-calculation or none.",
                default="back-calculation",
                choices=("back-calculation", "none"),
            ),
        ),
    )
)
register(
    Exporter(
        name="mat",
        title="MATLAB data",
        help="Controllers and linear models as MATLAB data, a struct for ss each.",
        write=_write_mat,
        suffix=".mat",
    )
)
register(
    Exporter(
        name="models",
        title="JSON",
        help="Controllers, where there are some, and linear models as JSON.",
        write=_write_models,
        suffix=".json",
        controllers="optional",
    )
)
register(
    Exporter(
        name="csv",
        title="responses",
        help="Frequency responses of plants, controllers and loops, a CSV file each, into this folder.",
        write=_write_csv,
        settings=(
            Setting(
                "form",
                "FORM",
                "Responses in CSV: complex (real and imaginary parts) or polar (magnitude and phase).",
                default="complex",
                choices=("complex", "polar"),
            ),
        ),
    )
)
register(
    Exporter(
        name="mjcf",
        title="MuJoCo model",
        help="The plant as a MuJoCo model.",
        write=_write_mjcf,
        suffix=".xml",
        controllers="unused",
        settings=(
            Setting(
                "root",
                "KIND",
                "Root of the MuJoCo model: free, prescribed (its angular acceleration is a control) or fixed.",
                default="free",
                choices=("free", "prescribed", "fixed"),
            ),
        ),
    )
)
