"""The command ``platform-ctrl``: exit codes, and errors in one line.

0: done, every requirement met. 1: done, a requirement not met; also when a method finds no controller, or a run cannot
be simulated. 2: the input is wrong. 130: interrupted. Large libraries are loaded only when a command needs them.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence

from platform_ctrl.cli import exits
from platform_ctrl.errors import PlatformCtrlError, began_with_interrupt

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (default: those of the process) and return its exit code."""
    if arguments is not None:
        code = _guarded(list(arguments))
        if code == exits.INTERRUPTED:
            print(exits.INTERRUPTED_LINE, file=sys.stderr, flush=True)
        return code
    from platform_ctrl.common.processes import collect_seldom

    collect_seldom()
    try:
        end = exits.end_of_process()
        with exits.interruptible() as check:
            code = _guarded(sys.argv[1:])
            check()
        if code == exits.INTERRUPTED:
            exits.exit_interrupted()
        end(code)
    except KeyboardInterrupt:
        exits.exit_interrupted()
    return code


def _guarded(arguments: list[str]) -> int:
    """Return the exit code, also where the output cannot be written or a library changes a Ctrl-C to its own error."""
    try:
        # The matrices are small: BLAS threads would spend their time waiting for each other.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        # Streams that the caller has closed are replaced; characters that a terminal cannot show are escaped.
        if sys.stdout is None or sys.stderr is None:
            nowhere = open(os.devnull, "w")  # noqa: SIM115 - open as long as the process
            sys.stdout, sys.stderr = sys.stdout or nowhere, sys.stderr or nowhere
        for stream in (sys.stdout, sys.stderr):
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="backslashreplace")
        code = _run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output has ended; what is left in the buffer must not raise when the process ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            raise
        # A full disk behind standard output; errors of files are messages of their own.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = exits.failed(f"standard output: {error.strerror or error}", 1)
    except BaseException as error:
        if not began_with_interrupt(error):
            raise
        code = exits.INTERRUPTED
    return code


def _run(arguments: list[str]) -> int:
    import typer

    from platform_ctrl.cli.commands import app

    command = typer.main.get_command(app)
    if not arguments or arguments[0] == "help":
        arguments = [*arguments[1:2], "--help"]
    try:
        return int(command.main(arguments, prog_name="platform-ctrl", standalone_mode=False) or 0)
    except typer.Abort:
        return exits.INTERRUPTED
    except PlatformCtrlError as error:
        if began_with_interrupt(error):
            return exits.INTERRUPTED
        return exits.reported(error)
    except Exception as error:
        # What typer raises for a wrong command line: its class has moved between modules, this method has not.
        if not hasattr(error, "format_message"):
            raise
        message: str = error.format_message()
        param, context = getattr(error, "param", None), getattr(error, "ctx", None)
        meaning = getattr(param, "help", None)
        if message.startswith("Missing") and meaning:
            message = f"{message.rstrip('.')}: {meaning}"
        return exits.failed(f"{message} (see {getattr(context, 'command_path', 'platform-ctrl')} --help)", 2)
