"""The one exception tree: whoever catches `PlatformCtrlError` catches everything raised on purpose."""

from __future__ import annotations


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
    """No controller was found, or the one found does not do what the method claims.

    Attributes
    ----------
    problem
        What was being solved, so that it can be looked at or solved another way.
    """

    def __init__(self, message: str, problem: object = None) -> None:
        super().__init__(message)
        self.problem = problem


class SimulationError(PlatformCtrlError):
    """A simulated run could not be carried out (it diverged, or its set-up is inconsistent)."""
