"""Linear systems, as design and check both measure them: responses, sampling, closed loops, poles, norms, margins.

Functions of systems take a `control.StateSpace` or a `control.TransferFunction`; inside the package also `System`,
which may have leading batch axes in the functions that a tuner calls. Systems are continuous (dt = 0) or discrete
(dt > 0).
"""

from __future__ import annotations

from platform_ctrl.analysis.feedback import closed_loop, loop_transfer
from platform_ctrl.analysis.margins import disk_margin, loop_margins
from platform_ctrl.analysis.norms import bandwidth, h2_norm, hinf_norm
from platform_ctrl.analysis.poles import damping
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.sampling import sampled
from platform_ctrl.analysis.time_responses import time_response

__all__ = [
    "bandwidth",
    "closed_loop",
    "damping",
    "disk_margin",
    "frequency_response",
    "h2_norm",
    "hinf_norm",
    "loop_margins",
    "loop_transfer",
    "sampled",
    "time_response",
]
