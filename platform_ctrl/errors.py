"""The one exception tree: whoever catches `PlatformCtrlError` catches everything raised on purpose."""

from __future__ import annotations

__all__ = [
    "ArgumentError",
    "DesignError",
    "IllPosedError",
    "InfeasibleError",
    "InputError",
    "MechanicsError",
    "NotCertifiedError",
    "NotFoundError",
    "NotStabilisableError",
    "PlatformCtrlError",
    "SimulationError",
    "TimeLimitError",
    "UnscalableError",
]


class PlatformCtrlError(Exception):
    """Base of every error that this package raises on purpose.

    The message is one line: where, what was given, what was expected, what to try.
    """


class InputError(PlatformCtrlError, ValueError):
    """A plant file, job file, controller file or command line that does not make sense."""


class ArgumentError(PlatformCtrlError, ValueError):
    """An argument of a Python call: wrong shape, not finite, or a name that does not exist."""


class MechanicsError(PlatformCtrlError):
    """The equations of motion cannot be solved at this state (a singular mass matrix)."""


class DesignError(PlatformCtrlError):
    """No controller was found, or the one found does not do what the method claims; its kinds say which.

    Attributes
    ----------
    problem
        What was being solved, so that it can be looked at or solved another way.
    """

    def __init__(self, message: str, problem: object = None) -> None:
        super().__init__(message)
        self.problem = problem


class InfeasibleError(DesignError):
    """No controller of the given kind meets the requirements."""


class NotFoundError(DesignError):
    """A search from many starts found no controller that meets the requirements; one may exist nevertheless.

    Attributes
    ----------
    problem
        What was being solved.
    nearest
        The controller that came nearest, u = K y; None where there is none.
    """

    def __init__(self, message: str, problem: object = None, nearest: object = None) -> None:
        super().__init__(message, problem)
        self.nearest = nearest


class IllPosedError(DesignError):
    """An assumption of the method does not hold for this problem; the message names it and the signal."""


class NotStabilisableError(DesignError):
    """No controller stabilises the plant: no control moves a mode, or no measurement sees it; the message names it."""


class UnscalableError(DesignError):
    """No units were found in which the problem can be solved in floating point."""


class TimeLimitError(DesignError):
    """The time allowed was over; the solver was ended."""


class NotCertifiedError(DesignError):
    """A controller was found, but its actual closed loop does not do what was promised."""


class SimulationError(PlatformCtrlError):
    """A simulated run could not be carried out (it diverged, or its set-up is inconsistent)."""


def began_with_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error: libraries that are interrupted may raise their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def reason(error: BaseException) -> str:
    """Return an error as one line: the message of an error of this package, with its kind of any other."""
    kind = "" if isinstance(error, PlatformCtrlError) else f"{type(error).__name__}: "
    return f"{kind}{' '.join(str(error).split())}".removesuffix(": ")
