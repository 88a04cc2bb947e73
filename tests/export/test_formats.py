"""Controllers, models and responses to JSON, MATLAB and CSV, and back."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import scipy.io

from given_controllers import outcomes
from one_gyro_job import JOB
from platform_ctrl import analysis, design, export, read_job
from platform_ctrl.cli import main
from platform_ctrl.errors import InputError
from platform_ctrl.export import write_controllers

K = "caging_9_10_classical"


@pytest.fixture(scope="module")
def job() -> Any:
    return read_job(tomllib.loads(JOB))


@pytest.fixture(scope="module")
def controllers(job: Any) -> list[control.StateSpace]:
    return [outcome.closed.controller for outcome in design.loops(job)]


@pytest.fixture(scope="module")
def folder(job: Any, controllers: list[control.StateSpace], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command writes of models and responses."""
    made = tmp_path_factory.mktemp("formats")
    (made / "job.toml").write_text(JOB)
    write_controllers(controllers, made / "k.json", delay=job.sampling.delay)
    command = ["export", str(made / "job.toml"), "--controllers", str(made / "k.json"), "-q"]
    assert main([*command, "--models", str(made / "m.json"), "--csv", str(made / "r")]) == 0
    return made


@pytest.fixture(scope="module")
def systems(folder: Path) -> list[control.StateSpace]:
    return [*export.read_systems(folder / "m.json"), static()]


def same(one: control.StateSpace, other: control.StateSpace) -> bool:
    labels = ("input_labels", "output_labels", "state_labels")
    return (
        all(np.array_equal(getattr(one, name), getattr(other, name)) for name in "ABCD")
        and all(getattr(one, name) == getattr(other, name) for name in labels)
        and one.dt == other.dt
    )


def static(name: str = "gain") -> control.StateSpace:
    return control.ss([], [], [], [[2.0, 0.0]], 0.01, inputs=["a", "b"], outputs=["c"], name=name)


def test_json_keeps_every_bit_name_and_unit(
    job: Any, folder: Path, controllers: list[control.StateSpace], systems: list[control.StateSpace], tmp_path: Path
) -> None:
    path = export.write_systems(systems, tmp_path / "models.json", platform=job.platform)
    back = export.read_systems(path)
    assert [one.name for one in back[:3]] == ["caging 9-10, classical", "plant", "plant with free root"]
    assert all(map(same, systems, back))
    assert all(np.array_equal(getattr(back[0], name), getattr(controllers[0], name)) for name in "ABCD")
    assert back[1].input_labels[:2] == ["Q4", "Q5"]
    assert path.read_bytes() == export.write_systems(back, tmp_path / "again.json", platform=job.platform).read_bytes()
    K, *_ = json.loads((folder / "m.json").read_text())["systems"]
    assert (K["output_units"], K["delay"]) == (["N m", "N m"], 0.0005)


def test_controllers_leave_in_the_form_that_check_reads(
    job: Any, controllers: list[control.StateSpace], tmp_path: Path
) -> None:
    path = write_controllers(controllers, tmp_path / "k.json", delay=job.sampling.delay)
    [outcome] = outcomes(job, json.loads(path.read_text()))
    back = outcome.closed.controller
    assert all(np.array_equal(getattr(back, name), getattr(controllers[0], name)) for name in "ABCD")
    [system] = export.read_systems(path)
    assert (system.dt, system.input_labels) == (0.0005, ["alpha9", "beta10"])


def test_json_that_makes_no_sense_is_one_line(systems: list[control.StateSpace], tmp_path: Path) -> None:
    good = json.loads(export.write_systems(systems[:1], tmp_path / "m.json").read_text())

    def refused(**changes: Any) -> str:
        entry = good["systems"][0] | changes
        file = tmp_path / "bad.json"
        file.write_text(json.dumps({"schema": 1, "systems": [{k: v for k, v in entry.items() if v != "gone"}]}))
        with pytest.raises(InputError) as caught:
            export.read_systems(file)
        assert "\n" not in str(caught.value)
        return re.sub(r"^systems 1[^:]*: ", "", str(caught.value).removeprefix(f"{file}: "))

    assert refused(A="gone") == 'the key "A" is missing; it must be a matrix as a list of rows'
    assert refused(B=[[1.0, 2.0]]).startswith("B must be 4 x 2")
    assert refused(D=[[1.0, None], [0.0, 0.0]]).startswith(
        "D must be 2 x 2 (by inputs, outputs and A), row 1 element 2, None,"
    )
    assert refused(inputs=["a"]).startswith("B must be 4 x 1")
    assert refused(outputs=["a", "a"]).endswith('("a" is listed twice; leave one of them out)')
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(InputError, match="must be a table"):
        export.read_systems(tmp_path / "list.json")


def test_mat_keeps_every_bit_and_name(systems: list[control.StateSpace], tmp_path: Path) -> None:
    path = export.write_mat(systems, tmp_path / "s.mat")
    back = export.read_mat(path)
    assert [one.name for one in back] == [K, "plant", "plant_with_free_root", "plant_caging_9_10", "gain"]
    assert all(map(same, systems, back))
    first = path.read_bytes()
    assert export.write_mat(systems, path).read_bytes() == first
    assert len(export.read_mat(export.write_mat([static(name="1 x"), static(name="1-x"), static(name="–")], path))) == 3
    assert len(export.read_mat(export.write_mat([static(name=name) for name in ("a_3", "a", "a")], path))) == 3


def test_mat_that_is_no_plain_linear_system_is_refused_in_one_line(tmp_path: Path) -> None:
    def refused(content: Any) -> str:
        file = tmp_path / "bad.mat"
        if isinstance(content, dict):
            scipy.io.savemat(file, content)
        else:
            file.write_bytes(content)
        with pytest.raises(InputError) as caught:
            export.read_mat(file)
        assert "\n" not in str(caught.value)
        return str(caught.value).removeprefix(f"{file}: ")

    matrices = {"A": -1.0, "B": 1.0, "C": 1.0, "D": 0.0}
    assert refused({"x": 1.0}).startswith("holds no structs; save structs")
    assert refused({"s": matrices | {"A": "text"}}).startswith("s: A must be 1 x 1 (square)")
    assert refused({"s": matrices | {"A": np.nan}}).startswith(
        "s: A must be 1 x 1 (square), row 1 element 1, nan, is not finite"
    )
    for more in ({"InputName": 3.0}, {"OutputDelay": 2.0}, {"Ts": [1.0, 2.0]}):
        assert refused({"s": matrices | more}).startswith("s: is not one plain linear system; save")
    assert refused(b"\x89HDF\r\n").startswith("cannot be read")
    with pytest.raises(InputError, match="cannot be read"):
        export.read_mat(tmp_path / "missing.mat")


def test_responses_are_read_by_read_measurement_and_as_columns_below_comments(
    job: Any, controllers: list[control.StateSpace], folder: Path, tmp_path: Path
) -> None:
    names = ["plant_caging_9-10", "controller_caging_9-10", "loop_caging_9-10_at_Q9", "loop_caging_9-10_at_Q10"]
    assert sorted(path.stem for path in (folder / "r").glob("*.csv")) == sorted(names)
    [K], w = controllers, np.geomspace(1.0, 6000.0, 50)
    response = control.FRD(analysis.frequency_response(K, w), w, K.dt, inputs=K.input_labels, outputs=K.output_labels)
    for form, parts in (("complex", ("re", "im")), ("polar", ("magnitude", "phase_deg"))):
        path = export.write_responses(response, tmp_path / "r.csv", form=form, notes=("of K",))  # type: ignore[arg-type]
        back = design.read_measurement(path, period=job.sampling.period)
        assert np.allclose(back.frdata, response.frdata, rtol=1e-13)
        assert (back.input_labels, back.output_labels) == (K.input_labels, K.output_labels)
        head, *rows = csv.reader(line for line in path.read_text().splitlines() if not line.startswith("#"))
        assert head[:3] == ["frequency_hz", *(f"Q9/alpha9 {part}" for part in parts)]
        assert len(rows) == len(back.omega)


def test_the_loop_of_a_torquer_is_the_return_ratio(job: Any, folder: Path) -> None:
    """L = -K P where the other torquer's loop is closed by hand."""
    names = ("plant_caging_9-10", "controller_caging_9-10", "loop_caging_9-10_at_Q9")
    plant, K, L = (design.read_measurement(folder / "r" / f"{one}.csv", period=0.0005) for one in names)
    P, G = (np.moveaxis(np.asarray(one.frdata), -1, 0) for one in (plant, K))
    KP = -G @ P  # u = K y: the sign of the loop as it is drawn
    schur = KP[:, 0, 0] - KP[:, 0, 1] * KP[:, 1, 0] / (1.0 + KP[:, 1, 1])
    assert np.allclose(L.frdata[0, 0], schur, rtol=1e-6)
