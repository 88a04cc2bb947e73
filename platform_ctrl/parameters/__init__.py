"""What may differ from run to run: the numbers of a run by their paths, what they may be, and how a run gets them."""

from platform_ctrl.parameters.known import Parameter, parameters
from platform_ctrl.parameters.misfit import misfits
from platform_ctrl.parameters.varied import varied_scenario

__all__ = ["Parameter", "misfits", "parameters", "varied_scenario"]
