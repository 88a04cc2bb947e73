"""The command ``platform-ctrl``: exit codes, and errors in one line.

0: done, every requirement met. 1: done, a requirement not met; also when a method finds no controller, or a run cannot
be carried out. 2: the input is wrong. 130: interrupted. Nothing heavy is loaded before a command needs it.
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from platform_ctrl.errors import DesignError, OldKeyWarning, PlatformCtrlError, SimulationError

__all__ = ["main"]

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (default: those of the process) and return its exit code."""
    # Our matrices are small: BLAS threads spend their time waiting for each other, most of it on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if sys.stdout is None or sys.stderr is None:
        # Closed by whoever started us: what would go there goes nowhere, and libraries need not know.
        nowhere = open(os.devnull, "w")  # noqa: SIM115 - open as long as the process
        sys.stdout, sys.stderr = sys.stdout or nowhere, sys.stderr or nowhere
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a name that the terminal cannot show must not stop the work
            stream.reconfigure(errors="backslashreplace")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", OldKeyWarning)
            warnings.showwarning = _shown(warnings.showwarning)
            code = _run(list(sys.argv[1:] if arguments is None else arguments))
        sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read our output has gone; what is left in the buffer must not complain when the program ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            raise
        # A full disk behind standard output; files have their own errors, in one line each.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = _failed(f"standard output: {error.strerror or error}", 1)
    except BaseException as error:
        if not _began_with_interrupt(error):
            raise
        code = INTERRUPTED
    if code == INTERRUPTED:
        print("platform-ctrl: interrupted", file=sys.stderr, flush=True)
        if arguments is None:
            # A library that was interrupted while it was loaded may crash the interpreter's orderly end.
            os._exit(code)
    return code


def _shown(otherwise: Callable[..., None]) -> Callable[..., None]:
    """Return what shows a warning: one about a file's keys as one line, the others as before."""

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, OldKeyWarning):
            print(f"platform-ctrl: warning: {message}", file=sys.stderr)
        else:
            otherwise(message, category, *where, **more)

    return show


def _began_with_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: libraries that are interrupted may raise their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _run(arguments: list[str]) -> int:
    import typer

    from platform_ctrl.cli.commands import app

    command = typer.main.get_command(app)
    try:
        return int(command.main(_asked(arguments), prog_name="platform-ctrl", standalone_mode=False) or 0)
    except typer.Abort:
        return INTERRUPTED
    except PlatformCtrlError as error:
        if _began_with_interrupt(error):
            return INTERRUPTED
        return _failed(str(error), 1 if isinstance(error, DesignError | SimulationError) else 2)
    except Exception as error:
        # What typer raises for a wrong command line: its class has moved between modules, this method has not.
        if not hasattr(error, "format_message"):
            raise
        return _failed(_report_error(error), 2)


def _asked(arguments: list[str]) -> list[str]:
    """Return the arguments with ``help COMMAND`` as ``COMMAND --help``; without any, the help is asked for."""
    if not arguments or arguments[0] == "help":
        return [*arguments[1:2], "--help"]
    return arguments


def _report_error(error: Any) -> str:
    """Say what is wrong with a command line, what is expected where something is missing, and where help is."""
    message: str = error.format_message()
    param, context = getattr(error, "param", None), getattr(error, "ctx", None)
    wanted = getattr(param, "help", None)
    if message.startswith("Missing") and wanted:
        message = f"{message.rstrip('.')}: {wanted}"
    return f"{message} (see {getattr(context, 'command_path', 'platform-ctrl')} --help)"


def _failed(message: str, code: int) -> int:
    print(f"platform-ctrl: error: {' '.join(message.split())}", file=sys.stderr)
    return code
