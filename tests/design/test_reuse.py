"""Designs that are taken up instead of being made again: only where nothing has changed, and only what is proved."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuzz_files import HERE
from one_change import Place, leaves, mutated
from platform_ctrl.common.processes import PROCESSES, SecondProcess, Task
from platform_ctrl.common.store import Store, array_of, array_text, key_of
from platform_ctrl.design import loops
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.design.reuse import design_job, design_key
from platform_ctrl.job.job import Job
from platform_ctrl.job.reading import read_job

# What no design may depend on: not in the reduced job.
REMOVED = {"name", "plant", "coupled", "manoeuvres", "fault_events", "campaign", "budget"}

JOB: dict[str, Any] = {
    "schema": 2,
    "name": "two gimbals",
    "plant": "three_gyro_platform",
    "operation": {"Omega": [0.0, 0.0, 0.0]},
    "sampling": {"rate_hz": 2000, "delay": 0.0005},
    "loop": [
        {
            "name": "caging 9-10",
            "kind": "caging",
            "gimbals": ["9", "10"],
            "use": "classical",
            "limits": {"bandwidth_hz": 20, "disk_margin": 0.4},
            "design": [
                {"name": "classical", "method": "classical", "crossover_hz": 40, "integral_hz": 2},
                {"name": "softer", "method": "classical", "crossover_hz": 35, "integral_hz": 2},
            ],
        }
    ],
}


def keys(job: Job, of_all: bool = True) -> dict[tuple[int, int], str]:
    """Return the keys of all designs, or of the first one alone, by loop and design."""
    return {
        (i, k): design_key(design_job(job, spec, design), 0.5)
        for i, spec in enumerate(job.loops)
        for k, design in enumerate(spec.designs)
        if of_all or i == k == 0
    }


def expected(job: Job, path: Place) -> set[tuple[int, int]]:
    """Return the designs that a change at a place of the job concerns, by loop and design."""
    everything = {(i, k) for i, spec in enumerate(job.loops) for k in range(len(spec.designs))}
    if path[0] in REMOVED:
        return set()
    if path[0] != "loops":
        return everything
    loop, name = int(path[1]), path[2]
    spec = job.loops[loop]
    # What a rate loop turns, reads and sets, and its closed design, make the plants of the tracking loop around it.
    around = {(i, k) for i, k in everything if job.loops[i].around == spec.name}
    used = {(loop, k) for k, design in enumerate(spec.designs) if design.name == spec.use}
    if name == "designs":
        own = {(loop, int(path[3]))}
        return own | around if own == used else own
    if name == "use":
        return used | around
    own = {(i, k) for i, k in everything if i == loop}
    if name in ("gimbals", "torquers"):
        # What a loop turns is not passive in the plants of the others.
        return everything
    return own if name in ("limits", "soft") else own | around


def test_each_value_of_a_job_and_its_plant_is_in_the_key_of_the_designs_that_it_concerns() -> None:
    job = read_job(HERE / "every_job_key.toml")
    before = keys(job)
    assert len(set(before.values())) == len(before)
    seen = set()
    for path, _ in leaves(job):
        # What concerns more than one loop is in the same reduced job of each.
        after = keys(mutated(job, path), path[0] == "loops")
        moved = {place for place in after if after[place] != before[place]}
        assert moved == expected(job, path) & set(after), path
        seen.add(path[0])
    assert seen >= {"platform", "sampling", "uncertainty", "faults", "Omega", "angles", "seed", "loops", *REMOVED}


def test_a_value_of_an_unknown_kind_has_no_key() -> None:
    with pytest.raises(TypeError):
        key_of({"x": object()})
    assert key_of(1.0) != key_of(1) != key_of(True) != key_of("1")
    assert key_of(("a", "b")) != key_of(("ab",)) != key_of(("a",), ("b",))
    assert key_of(0.0) != key_of(-0.0)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[LoopOutcome, dict[str, bytes]]:
    """Return a designed loop and the files that were kept of it."""
    store = Store(tmp_path_factory.mktemp("kept") / "reuse")
    [made] = loops(JOB, store=store)
    assert store.taken == []
    return made, {file.name: file.read_bytes() for file in store.folder.iterdir()}


def filled(folder: Path, files: Mapping[str, bytes], *, fresh: bool = False) -> Store:
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return Store(folder, fresh=fresh)


def expect_same(one: LoopDesign, two: LoopDesign) -> None:
    """Compare two designs; the last digits of two searches may differ by how numbers lie in memory."""
    for name in "ABCD":
        assert getattr(one.controller, name) == pytest.approx(getattr(two.controller, name), rel=1e-9, abs=1e-12)
    assert list(one.controller.input_labels) == list(two.controller.input_labels)
    assert one.options == pytest.approx(two.options, rel=1e-9)
    assert one.claims == pytest.approx(two.claims, rel=1e-9)
    assert [result.value for result in one.results] == pytest.approx([result.value for result in two.results], rel=1e-9)


def test_what_is_taken_up_is_what_was_made(kept: tuple[LoopOutcome, dict[str, bytes]], tmp_path: Path) -> None:
    made, files = kept
    store = filled(tmp_path / "reuse", files)
    lines: list[str] = []
    [taken] = loops(JOB | {"name": "another title"}, lines.append, store)
    assert store.taken == [("caging 9-10", "classical"), ("caging 9-10", "softer")]
    assert any("unchanged" in line for line in lines)
    for one, two in zip(made.designs, taken.designs, strict=True):
        expect_same(one, two)
        # What a search has found is taken up to the last bit.
        assert one.claims == two.claims
        assert one.options == two.options
        for name in "ABCD":
            assert np.array_equal(getattr(one.controller, name), getattr(two.controller, name))


def test_a_change_of_one_design_makes_that_one_anew(kept: tuple[LoopOutcome, dict[str, bytes]], tmp_path: Path) -> None:
    _, files = kept
    first, softer = JOB["loop"][0]["design"]
    job = JOB | {"loop": [JOB["loop"][0] | {"design": [first, softer | {"crossover_hz": 36}]}]}
    store = filled(tmp_path / "reuse", files)
    [found] = loops(job, store=store)
    assert store.taken == [("caging 9-10", "classical")]
    assert found.designs[1].options["crossover_hz"] == 36


def test_fresh_takes_nothing_up(kept: tuple[LoopOutcome, dict[str, bytes]], tmp_path: Path) -> None:
    made, files = kept
    store = filled(tmp_path / "reuse", files, fresh=True)
    [found] = loops(JOB, store=store)
    assert store.taken == []
    expect_same(made.closed, found.closed)


@pytest.mark.parametrize(
    "text", [b"", b"{", b"[]", b"null", b"\xff\x00", b'{"key": 1}', b"[" * 100_000, b'{"key": NaN, "content": []}']
)
def test_a_file_of_another_kind_counts_as_not_found(text: bytes, tmp_path: Path) -> None:
    store = filled(tmp_path / "reuse", {"a.json": text})
    assert store.find("a") is None
    store.keep("a", {"x": [1.5, None, "text"]})
    assert store.find("a") == {"x": [1.5, None, "text"]}


def test_a_damaged_file_and_one_under_another_name_count_as_not_found(tmp_path: Path) -> None:
    store = Store(tmp_path / "reuse")
    store.keep("a", {"x": 1.5})
    text = (store.folder / "a.json").read_bytes()
    (store.folder / "b.json").write_bytes(text)
    (store.folder / "a.json").write_bytes(text.replace(b"1.5", b"2.5"))
    assert store.find("a") is None
    assert store.find("b") is None


def test_what_was_used_least_recently_goes_first(tmp_path: Path) -> None:
    store = Store(tmp_path / "reuse", most_bytes=3500)
    for k, name in enumerate("abc"):
        store.keep(name, "x" * 1000)
        file = store.folder / f"{name}.json"
        past = 1_000_000_000 + k
        os.utime(file, (past, past))
    assert store.find("a") is not None  # used now
    store.keep("d", "x" * 1000)
    assert sorted(file.stem for file in store.folder.iterdir()) == ["a", "c", "d"]


def test_a_folder_that_cannot_be_made_keeps_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    store = Store(tmp_path / "file" / "reuse")
    store.keep("a", 1)
    assert store.find("a") is None


def test_arrays_are_kept_to_the_last_bit() -> None:
    for array in (np.zeros((0, 3)), np.array([[np.pi, -0.0], [5e-324, np.inf]]), np.array(2.5)):
        found = array_of(json.loads(json.dumps(array_text(array))))
        assert found is not None
        assert found.shape == array.shape
        assert found.tobytes() == array.tobytes()


def test_two_processes_make_the_designs_of_one(
    kept: tuple[LoopOutcome, dict[str, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, _ = kept
    monkeypatch.setenv(PROCESSES, "2")
    store = Store(tmp_path / "reuse")
    with SecondProcess() as beside:
        for again in (False, True):
            [found] = loops(JOB, store=store, beside=beside)
            assert len(store.taken) == (2 if again else 0)
            for one, two in zip(made.designs, found.designs, strict=True):
                expect_same(one, two)


def test_a_design_and_its_problem_go_to_another_process(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[Task] = []

    def alone(self: SecondProcess, tasks: list[Task], begun: Callable[[int], None], long: list[int]) -> list[Any]:
        there: list[Task] = pickle.loads(pickle.dumps(tasks))
        sent.extend(there)
        return [pickle.loads(pickle.dumps(function(*arguments))) for function, arguments in there]

    monkeypatch.setattr(SecondProcess, "results", alone)
    with SecondProcess() as beside:
        [found] = loops(JOB, print, beside=beside)
    assert [one.name for one in found.designs] == ["classical", "softer"]
    assert len(sent) == 2
