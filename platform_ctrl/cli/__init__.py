"""The command ``platform-ctrl``: exit codes, and errors in one line.

0: done, every requirement met. 1: done, a requirement not met; also when a method finds no controller, or a run cannot
be carried out. 2: the input is wrong. 130: interrupted. Nothing heavy is loaded before a command needs it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from platform_ctrl.errors import DesignError, PlatformCtrlError, SimulationError

__all__ = ["main"]

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (default: those of the process) and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a name that the terminal cannot show must not stop the work
            stream.reconfigure(errors="backslashreplace")
    try:
        code = _run(list(sys.argv[1:] if arguments is None else arguments))
        sys.stdout.flush()
    except KeyboardInterrupt:
        code = INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; what is left in the buffer must not complain when the program ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    if code == INTERRUPTED:
        print("platform-ctrl: interrupted", file=sys.stderr)
    return code


def _run(arguments: list[str]) -> int:
    import typer

    from platform_ctrl.cli.commands import app

    command = typer.main.get_command(app)
    try:
        return int(command.main(arguments or ["--help"], prog_name="platform-ctrl", standalone_mode=False) or 0)
    except typer.Abort:
        return INTERRUPTED
    except (DesignError, SimulationError) as error:
        return _failed(str(error), 1)
    except PlatformCtrlError as error:
        return _failed(str(error), 2)
    except Exception as error:
        # What typer raises for a wrong command line: its class has moved between modules, this method has not.
        if not hasattr(error, "format_message"):
            raise
        return _failed(f"{error.format_message()} (see platform-ctrl --help)", 2)


def _failed(message: str, code: int) -> int:
    print(f"platform-ctrl: error: {' '.join(message.split())}", file=sys.stderr)
    return code
