"""On a terminal and elsewhere: colours, what moves while work is done, and Ctrl-C at any moment."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import platform_ctrl as pc
from platform_ctrl.cli import main, terminal
from platform_ctrl.cli.atomic_output import written_together
from platform_ctrl.common.files import replaced_file, write_whole
from platform_ctrl.errors import InputError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="terminals as POSIX has them")

# Ctrl-C reaches whoever the terminal belongs to.
OWN_TERMINAL = (
    "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
    "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
)


def environment(**more: str) -> dict[str, str]:
    kept = {name: item for name, item in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR", "COLUMNS")}
    return kept | {"PYTHONPATH": str(Path(pc.__file__).parents[1]), "TERM": "xterm", "COLUMNS": "120"} | more


class Terminal:
    """A command on a terminal of its own: what it shows so far, and how it ended."""

    def __init__(self, *arguments: str, cwd: Path, **more: str) -> None:
        import pty

        self._parent, child = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-c", OWN_TERMINAL, "-m", "platform_ctrl", *arguments],
            stdin=child,
            stdout=child,
            stderr=child,
            cwd=cwd,
            env=environment(**more),
            start_new_session=True,
        )
        os.close(child)
        self.shown = ""

    def until(self, words: str) -> Terminal:
        """Wait until this stands on the screen."""
        while words not in self.shown:
            assert self._more(), f"{words!r} did not come: {self.shown!r}"
        return self

    def type(self, keys: bytes) -> Terminal:
        os.write(self._parent, keys)
        return self

    def end(self) -> int:
        """Wait for the end and return the exit code."""
        while self._more():
            pass
        os.close(self._parent)
        return self.process.wait(timeout=30)

    def _more(self) -> bool:
        ready, _, _ = select.select([self._parent], [], [], 60.0)
        assert ready, f"nothing for a minute after {self.shown!r}"
        try:
            got = os.read(self._parent, 1 << 16).decode("utf-8", "replace")
        except OSError:  # closed by the other side
            return False
        self.shown += got
        return bool(got)


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("terminal")
    assert main(["new", "gyro", "-o", str(folder)]) == 0
    with pytest.MonkeyPatch.context() as patch:  # the figures are seconds of work
        patch.setattr("platform_ctrl.report.page.job_page.prepared", lambda result, **about: result)
        patch.setattr("platform_ctrl.report.write_page", lambda result, path: path.touch())
        assert main(["design", str(folder / "gyro.toml"), "-o", str(folder / "out"), "-q"]) == 0
    return folder


SIMULATE = ("simulate", "gyro.toml", "--manoeuvre", "turn")
GREEN = "\x1b[32m"


def test_a_terminal_gets_colours_and_something_that_moves(there: Path) -> None:
    shown = Terminal(*SIMULATE, cwd=there).until("reading gyro.toml").until("met")
    assert shown.end() == 0
    assert GREEN in shown.shown
    assert "0:00:0" in shown.shown  # the time beside the line


def test_a_pipe_gets_lines_without_colours_unless_they_are_forced(
    there: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(there)
    monkeypatch.setenv("COLUMNS", "120")
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)

    def piped() -> str:
        assert main(SIMULATE) == 0
        out, err = capsys.readouterr()
        assert err == "simulated run: turn\ncontrollers: out/result.json\n"
        return out

    plain = piped()
    assert "\x1b" not in plain
    monkeypatch.setenv("FORCE_COLOR", "1")
    forced = piped()
    assert GREEN in forced
    assert _without_colours(forced) == plain
    monkeypatch.setenv("NO_COLOR", "1")
    assert GREEN not in piped()


def _without_colours(text: str) -> str:
    return re.sub(r"\x1b\[[\d;]*m", "", text)


def test_ctrl_c_leaves_what_was_there(there: Path) -> None:
    out = there / "out"
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    shown = Terminal("design", "gyro.toml", cwd=there).until("reading")
    assert shown.type(b"\x03").end() == 130
    assert _without_colours(shown.shown).splitlines()[-1].endswith("platform-ctrl: interrupted")
    assert "Traceback" not in shown.shown
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before


SETTING = """
import os, signal, sys
from platform_ctrl.cli import main
from platform_ctrl.report.page import job_page

def interrupted(*arguments):
    os.kill(os.getpid(), signal.SIGINT)
    return made(*arguments)

made, job_page.html = job_page.html, interrupted
sys.argv = ["platform-ctrl", "design", "gyro.toml"]
sys.exit(main())
"""


def test_ctrl_c_while_the_report_is_set_leaves_the_result_and_nothing_half_written(there: Path) -> None:
    out = there / "out"
    (out / "result.json").unlink()
    (out / "report.html").write_text("before", encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-c", SETTING], cwd=there, env=environment(), capture_output=True, text=True, check=False
    )
    assert ended.returncode == 130
    assert ended.stderr.splitlines()[-1].endswith("platform-ctrl: interrupted")
    assert "Traceback" not in ended.stderr
    assert json.loads((out / "result.json").read_text(encoding="utf-8"))["passed"] is True
    assert sorted(path.name for path in out.iterdir() if path.is_file()) == ["report.html", "result.json"]
    assert (out / "report.html").read_text(encoding="utf-8") == "before"


ENDING = """
import atexit, sys, time
from platform_ctrl.cli import main
sys.argv = ["platform-ctrl", "--version"]
code = main()
atexit.register(lambda: (print("ending", flush=True), time.sleep(60.0)))
sys.exit(code)
"""


def test_ctrl_c_at_the_end_of_the_process_is_an_interrupt_too() -> None:
    with subprocess.Popen([sys.executable, "-c", ENDING], stdout=subprocess.PIPE, env=environment()) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"platform-ctrl ")
        assert process.stdout.readline() == b"ending\n"
        process.send_signal(signal.SIGINT)
    assert process.returncode == 130


def test_files_appear_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "one").write_text("old")

    def write(fail: type[BaseException] | None) -> None:
        with written_together(tmp_path) as folder:
            (folder / "one").write_text("new")
            (folder / "two").write_text("new")
            if fail is not None:
                raise fail

    for failure, told in ((KeyboardInterrupt, KeyboardInterrupt), (OSError, InputError)):
        with pytest.raises(told):
            write(failure)
        assert [path.name for path in tmp_path.iterdir()] == ["one"]
        assert (tmp_path / "one").read_text() == "old"
    write(None)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"one": "new", "two": "new"}


def test_an_interrupt_while_files_move_waits_until_they_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved = os.replace

    def interrupted(old: Path, new: Path) -> None:
        signal.raise_signal(signal.SIGINT)
        moved(old, new)

    monkeypatch.setattr(os, "replace", interrupted)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), written_together(tmp_path) as folder:  # noqa: PT012
        (folder / "one").write_text("new")
        (folder / "two").write_text("new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "two"]
    assert signal.getsignal(signal.SIGINT) is before


def test_files_that_have_moved_go_back_when_another_cannot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "one").write_text("old")
    moved, count = os.replace, 0

    def stopped(old: Path, new: Path) -> None:
        nonlocal count
        count += 1
        if count == 3:
            raise KeyboardInterrupt
        moved(old, new)

    monkeypatch.setattr(os, "replace", stopped)
    with pytest.raises(KeyboardInterrupt), written_together(tmp_path) as folder:  # noqa: PT012
        (folder / "one").write_text("new")
        (folder / "two").write_text("new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"one": "old"}


def test_what_killed_runs_left_goes_and_what_a_process_writes_stays(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    left = [tmp_path / ".unfinished-a1b2c3d4", tmp_path / f".unfinished-{int(ended.stdout)}-x1"]
    for folder in left:
        folder.mkdir()
        (folder / "report.html").write_text("half")
    (tmp_path / ".unfinished-link").symlink_to(tmp_path.parent)
    (tmp_path / "else.tmp").write_text("not ours")
    with written_together(tmp_path) as at_work, replaced_file(tmp_path / "result.json") as file:
        file.write_bytes(b"whole")
        (at_work / "two").write_text("new")
        write_whole(tmp_path / "result.json", "of another process")
        with written_together(tmp_path):
            assert at_work.is_dir()
    assert not any(path.exists() for path in left)
    assert sorted(path.name for path in tmp_path.iterdir() if not path.is_symlink()) == [
        *("else.tmp", "result.json", "two")
    ]
    assert tmp_path.parent.is_dir()
    assert (tmp_path / "result.json").read_text() == "whole"


def test_no_link_that_somebody_planted_is_written_through(tmp_path: Path) -> None:
    """Neither at the name with the number of the process, which could be guessed, nor at the target."""
    precious = tmp_path / "precious"
    precious.write_text("mine")
    names = [f".result.json.{os.getpid()}.tmp", "result.json", f".unfinished-{os.getpid()}"]
    for name in names:
        (tmp_path / name).symlink_to(precious)
    write_whole(tmp_path / "result.json", "{}")
    assert precious.read_text() == "mine"
    assert (tmp_path / "result.json").read_text() == "{}"
    assert not (tmp_path / "result.json").is_symlink()


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_a_new_file_has_the_mode_of_any_other(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    write_whole(tmp_path / "whole", "")
    assert (tmp_path / "whole").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_what_is_no_file_is_never_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: cannot be written: it is no regular file"):
        write_whole(tmp_path / "pipe", "text")
    assert (tmp_path / "pipe").is_fifo()


def test_the_first_run_says_that_its_kernel_is_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("platform_ctrl.simulation.compilation.is_compiled", lambda: False)
    with terminal.progress(False, "reading") as say:
        say("simulated run: turn")
    first, *_ = capsys.readouterr().err.splitlines()
    assert first == "simulated run: turn (its kernel is compiled first, once: half a minute)"
