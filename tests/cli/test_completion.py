"""Completion: what Tab offers, in the shells' own protocols and in a real bash; quick, and silent on errors."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import platform_ctrl as pc
from platform_ctrl.cli.commands import app
from platform_ctrl.plant.source import platform_source, shipped_models

JOB = """
schema = 2
name = "job"
plant = "gimballed_gyro"
[[loop]]
name = "caging"
[[manoeuvre]]
name = "turn"
mode = "caged"
duration = 1.0
[[manoeuvre]]
name = "1 rad/s about axis 2"
mode = "stabilised"
duration = 2.0
"""


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a job, a plant, another TOML file, a result, a campaign, and a folder below with a job."""
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    (tmp_path / "plant.toml").write_text(platform_source("rate_gyro"), encoding="utf-8")
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "root"\n', encoding="utf-8")
    (tmp_path / "broken.toml").write_text("[[loop]]\nname = ", encoding="utf-8")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").write_text('{"schema": 1, "controllers": []}', encoding="utf-8")
    (tmp_path / "night").mkdir()
    (tmp_path / "night" / "campaign.json").write_text("{}", encoding="utf-8")
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / "other.toml").write_text(JOB, encoding="utf-8")
    (tmp_path / "jobs" / ".hidden.toml").write_text(JOB, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def offered(monkeypatch: pytest.MonkeyPatch, *words: str, shell: str = "bash") -> list[str]:
    """Return what Tab behind the last of the words gives: the protocol of the shell, in this process."""
    from typer.testing import CliRunner

    line = " ".join(["platform-ctrl", *words])
    asked = {
        "_PLATFORM_CTRL_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": "\n".join(["platform-ctrl", *words]),
        "COMP_CWORD": str(len(words)),
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        "_TYPER_COMPLETE_WORD_TO_COMPLETE": words[-1],
    }
    for name, item in asked.items():
        monkeypatch.setenv(name, item)
    done = CliRunner().invoke(app, [], prog_name="platform-ctrl")
    assert done.exit_code == 0, done.output
    return done.output.splitlines() if done.output.strip() else []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["si"], ["simulate"]),
        (["design", "--j"], ["--json"]),
        (["design", ""], ["broken.toml", "job.toml", "jobs/other.toml"]),
        (["design", "jobs/"], ["jobs/other.toml"]),
        (["design", "jobs/o"], ["jobs/other.toml"]),
        (["equations", "gy"], ["gyro_horizon"]),
        (["equations", "pl"], ["plant.toml"]),
        (["equations", "plant.toml", "--format", ""], ["text", "latex", "json"]),
        (["equations", "plant.toml", "--order", "e"], ["exact"]),
        (["simulate", "job.toml", "--manoeuvre", "t"], ["turn"]),
        (["simulate", "--manoeuvre", ""], []),
        (["simulate", "none.toml", "--manoeuvre", ""], []),
        (["simulate", "broken.toml", "--manoeuvre", ""], []),
        (["simulate", "job.toml", "-o", ""], ["night"]),
        (["check", "job.toml", "--controllers", ""], ["out/result.json"]),
        (["design", "job.toml", "--campaign", "n"], ["night"]),
        (["campaign", "job.toml", "--sampling", "so"], ["sobol"]),
        (["design", "nowhere/x"], []),
        (["design", "job.toml", "-o", "ou"], []),
    ],
    ids=" ".join,
)
def test_tab_offers_what_fits(
    words: list[str], expected: list[str], there: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert offered(monkeypatch, *words) == expected


def test_plants_are_the_shipped_ones_and_files(there: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert offered(monkeypatch, "equations", "") == [*shipped_models(), "plant.toml"]


@pytest.mark.parametrize(
    ("shell", "expected"),
    [
        ("bash", [r"1\ rad/s\ about\ axis\ 2"]),
        ("zsh", ["""_arguments '*: :(("1 rad/s about axis 2":"stabilised, 2.0 s"))'"""]),
        ("fish", ["1 rad/s about axis 2\tstabilised, 2.0 s"]),
        ("powershell", ["'1 rad/s about axis 2':::stabilised, 2.0 s"]),
    ],
)
def test_names_with_spaces_are_quoted_as_the_shell_wants_it(
    shell: str, expected: list[str], there: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert offered(monkeypatch, "simulate", "job.toml", "--manoeuvre", "1", shell=shell) == expected


def test_a_name_with_spaces_can_be_typed_on(there: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert offered(monkeypatch, "simulate", "job.toml", "--manoeuvre", r"1\ rad/s\ ab") == [r"1\ rad/s\ about\ axis\ 2"]


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(Path(pc.__file__).parents[1])}


def test_completion_loads_nothing_heavy(there: Path) -> None:
    code = (
        "import sys, atexit; from platform_ctrl.cli import main;"
        "atexit.register(lambda: print(*sys.modules, file=sys.stderr)); sys.exit(main([]))"
    )
    asked = {
        "_PLATFORM_CTRL_COMPLETE": "complete_bash",
        "COMP_WORDS": "platform-ctrl\nequations\nth",
        "COMP_CWORD": "2",
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment() | asked, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["three_gyro_platform"]
    loaded = {name.partition(".")[0] for name in done.stderr.split()}
    heavy = {"control", "cvxpy", "jinja2", "matplotlib", "numba", "numpy", "scipy", "sympy"}
    assert loaded & heavy == set()


@pytest.fixture
def bash(there: Path) -> list[str]:
    """A bash in which the program is on the path and its completion has been set up as the program prints it."""
    shell = shutil.which("bash")
    if shell is None or os.name != "posix":
        pytest.skip("needs bash")
    program = there / "bin" / "platform-ctrl"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m platform_ctrl "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return [shell, "--norc", "--noprofile"]


def in_bash(bash: list[str], script: str) -> str:
    path = {"PATH": f"{Path.cwd() / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}"}
    set_up = 'eval "$(_PLATFORM_CTRL_COMPLETE=source_bash platform-ctrl)"\n'
    done = subprocess.run(
        [*bash, "-c", set_up + script], env=environment() | path, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout


def test_bash_fills_in_the_word(bash: list[str]) -> None:
    script = """
    COMP_WORDS=(platform-ctrl simulate job.toml --manoeuvre '1\\ rad/s\\ ab')
    COMP_CWORD=4
    _platform_ctrl_completion platform-ctrl
    printf '%s\\n' "${COMPREPLY[@]}"
    complete -p platform-ctrl
    """
    first, second = in_bash(bash, script).splitlines()
    assert first == r"1\ rad/s\ about\ axis\ 2"
    assert second == "complete -o default -F _platform_ctrl_completion platform-ctrl"


def test_tab_in_an_interactive_bash_completes_the_line(bash: list[str], there: Path) -> None:
    pty = pytest.importorskip("pty")
    parent, child = pty.openpty()
    path = {"PATH": f"{there / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}", "TERM": "dumb", "PS1": "$ "}
    process = subprocess.Popen(
        [*bash, "-i"], stdin=child, stdout=child, stderr=child, env=environment() | path, close_fds=True
    )
    os.close(child)
    try:
        os.write(parent, b'eval "$(_PLATFORM_CTRL_COMPLETE=source_bash platform-ctrl)"\n')
        os.write(parent, b"echo platform-ctrl\n")
        read_until(parent, b"\nplatform-ctrl")
        os.write(parent, b"platform-ctrl simulate jo\t")
        line = read_until(parent, b"b")  # job.toml and jobs/other.toml have this in common
        os.write(parent, b".\t")
        line += read_until(parent, b"toml ")
        os.write(parent, b"--man\t")
        line += read_until(parent, b"manoeuvre ")
        os.write(parent, b"t\t")
        line += read_until(parent, b"turn ")
        assert line.replace(b"\x07", b"").endswith(b"platform-ctrl simulate job.toml --manoeuvre turn ")
    finally:
        process.kill()
        process.wait()
        os.close(parent)


def read_until(terminal: int, words: bytes) -> bytes:
    seen = b""
    while words not in seen:
        ready, _, _ = select.select([terminal], [], [], 20.0)
        assert ready, f"{words!r} did not come after {seen!r}"
        seen += os.read(terminal, 1024)
    return seen
