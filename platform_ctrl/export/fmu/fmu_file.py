"""The unit as a file: built by PythonFMU3, packed so that the same job gives the same bytes."""

from __future__ import annotations

import io
import json
import os
import re
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platform_ctrl import __version__
from platform_ctrl.common.arguments import known_name
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.json_text import write_json
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.errors import ArgumentError, InputError
from platform_ctrl.export.fmu.signals import commands_of, inputs_of, outputs_of, parameters_of, runs_of
from platform_ctrl.export.systems import write_controllers
from platform_ctrl.job.job import Job
from platform_ctrl.job.scenario import Mode
from platform_ctrl.job.writing import job_data
from platform_ctrl.plant.writing import plant_data, toml
from platform_ctrl.simulation.batch import merged_controller
from platform_ctrl.verification.controllers import read_controllers

if TYPE_CHECKING:
    import control


def page(job: Job, run: int, version: str, hashes: dict[str, str], commanded: Sequence[str]) -> str:
    """Return the documentation of a unit as HTML: what it needs, how it is stepped, its variables."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("platform_ctrl.export.fmu")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    groups = {"Parameters": parameters_of(job, run), "Inputs": inputs_of(job, commanded), "Outputs": outputs_of(job)}
    return environment.get_template("index.html.j2").render(
        job=job, runs=runs_of(job), version=version, groups=groups, hashes=hashes
    )


# The library ends the process if a module cannot be imported, but reports to the importer what an instance raises.
_SCRIPT = '''"""{title}: plant and sampled controllers. Written by platform_ctrl {version}."""

from pythonfmu3 import Fmi3Slave

try:
    from platform_ctrl.export.fmu.slave import PlatformSlave
except Exception as error:
    MISSING = (
        "this FMU needs the package platform_ctrl, version {version}, in the Python that runs it: "
        "pip install platform_ctrl (" + str(error) + ")"
    )

    def refuse(self, **kwargs):
        raise ImportError(MISSING)

    PlatformSlave = type("PlatformSlave", (Fmi3Slave,), {{"__init__": refuse, "do_step": refuse}})


class Unit(PlatformSlave, Fmi3Slave):
    pass
'''


@check_arguments
def write_fmu(
    job: Job,
    controllers: Sequence[control.StateSpace],
    path: str | os.PathLike[str],
    *,
    manoeuvre: str | None = None,
    result: str | os.PathLike[str] | None = None,
) -> Path:
    """Write plant and sampled controllers as a functional mock-up unit (FMI 3.0, co-simulation).

    The unit steps the kernel of `simulation.simulate`: the same manoeuvre gives the same numbers. It runs in a
    Python with `platform_ctrl` on the machine of the importing tool.

    Parameters
    ----------
    job
        Plant, sampling, manoeuvres, seed.
    controllers
        u = K y, sampled, in the order in which they are computed; those on the platform act in stabilised runs alone.
    path
        Of the file, ``.fmu``; its folder is there.
    manoeuvre
        Value that the parameter of this name begins with: a name from the job, ``"caged"`` or ``"stabilised"`` for a
        run that inputs alone move. None: the job's first manoeuvre; caged where it has none.
    result
        The ``result.json`` that the controllers come from: its SHA-256 is written into the unit.

    Returns
    -------
    Path
        Of the file. The same arguments give the same bytes.

    Raises
    ------
    ArgumentError
        There are no controllers, or they do not fit the plant; the manoeuvre is none of the job's.
    InputError
        PythonFMU3 is not installed, `result` cannot be read, or the file cannot be written there.

    References
    ----------
    Modelica Association, Functional Mock-up Interface Specification 3.0, 2022.

    See docs/fmu.md.
    """
    builder = _builder()
    if not controllers:
        raise ArgumentError("controllers: the list is empty; give at least one")
    modes: tuple[Mode, ...] = ("caged", "stabilised")
    for mode in modes:
        merged_controller(job.platform, controllers, job.sampling.period, mode)
    hashed = None if result is None else _hash_of(Path(result))
    with tempfile.TemporaryDirectory(prefix="platform_ctrl_") as made:
        folder = Path(made)
        contents = _contents(job, controllers, _place(job, manoeuvre), hashed, folder)
        identifier = str(contents["identifier"])
        script = folder / f"{identifier}.py"
        title = job.name.encode("ascii", "replace").decode().replace("\\", "/").replace('"', "'")
        script.write_text(_SCRIPT.format(title=title, version=__version__), encoding="ascii")
        resources = sorted(file for file in folder.iterdir() if file != script)
        built, documentation = folder / "built", folder / "documentation"
        documentation.mkdir()
        commanded = commands_of(job, controllers)
        documentation_page = page(job, contents["manoeuvre"], __version__, contents["sha256"], commanded)
        (documentation / "index.html").write_text(documentation_page, encoding="utf-8")
        builder.build_FMU(script, dest=built, project_files=resources, documentation_folder=documentation)
        return write_whole(path, _packed(next(built.glob("*.fmu"))))


def _builder() -> Any:
    """Return PythonFMU3's builder."""
    try:
        from pythonfmu3.builder import FmuBuilder
    except ImportError:
        raise InputError(
            "an FMU is built by PythonFMU3, which is not installed: pip install 'platform_ctrl[fmu]'"
        ) from None
    return FmuBuilder


def _place(job: Job, manoeuvre: str | None) -> int:
    if manoeuvre is None:
        return 3 if job.manoeuvres else 1
    if manoeuvre in ("caged", "stabilised") and manoeuvre not in runs_of(job):
        return 1 if manoeuvre == "caged" else 2
    return 1 + known_name("manoeuvre", manoeuvre, runs_of(job))


def _hash_of(result: Path) -> str:
    try:
        return sha256(result.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{result}: cannot be read: {error.strerror or error}") from None


def _contents(
    job: Job, controllers: Sequence[control.StateSpace], run: int, result: str | None, folder: Path
) -> dict[str, Any]:
    """Write the resources into a folder and return the description of the unit."""
    from platform_ctrl.export.fmu.slave import ABOUT, CONTROLLERS, JOB, PLANT

    (folder / JOB).write_text(toml(job_data(job)), encoding="utf-8")
    (folder / PLANT).write_text(toml(plant_data(job.platform)), encoding="utf-8")
    written = write_controllers(controllers, folder / CONTROLLERS, delay=job.sampling.delay)
    read_controllers(json.loads(written.read_bytes()), job)
    (folder / "requirements.txt").write_text(f"platform_ctrl=={__version__}\n", encoding="ascii")
    sums = {name: sha256((folder / name).read_bytes()).hexdigest() for name in (JOB, CONTROLLERS, PLANT)}
    whole = sha256(repr((sums, run, result, __version__)).encode()).hexdigest()
    slug = re.sub(r"\W+", "_", job.name.encode("ascii", "ignore").decode()).strip("_")[:40] or "unit"
    about = {
        "schema": 1,
        "name": job.name,
        # Units of different contents that run in one process must not share a module: its name is made of both.
        "identifier": f"{'' if slug[0].isalpha() else 'unit_'}{slug}_{whole[:12]}",
        "token": f"{{{uuid.UUID(whole[:32])}}}",
        "description": f"{job.platform.name}: the non-linear plant with its sampled controllers, "
        f"{1.0 / job.sampling.period:g} Hz" + ("" if result is None else f"; result.json SHA-256 {result}"),
        "platform_ctrl": __version__,
        "manoeuvre": run,
        "sha256": sums | ({} if result is None else {"result.json": result}),
    }
    write_json(about, folder / ABOUT)
    return about


def _packed(file: Path) -> bytes:
    """Return a built unit with its entries in order and without times."""
    out = io.BytesIO()
    with zipfile.ZipFile(file) as built, zipfile.ZipFile(out, "w") as packed:
        for name in sorted(built.namelist()):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.external_attr, entry.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
            packed.writestr(entry, built.read(name))
    return out.getvalue()
