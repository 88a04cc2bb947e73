"""Why something failed that does not end the rest: in one line, unless it was Ctrl-C."""

from __future__ import annotations

from platform_ctrl.errors import PlatformCtrlError


def began_with_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error: libraries that are interrupted may raise their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def reason(error: BaseException) -> str:
    """Return what is wrong as one line: the message of an error of this package, with its kind of any other."""
    kind = "" if isinstance(error, PlatformCtrlError) else f"{type(error).__name__}: "
    return f"{kind}{' '.join(str(error).split())}".removesuffix(": ")
