"""What design and check both measure with: responses, sampling, closed loops, poles, norms, margins.

Functions of systems take a `control.StateSpace`, a `control.TransferFunction` or `StateArrays`; the latter may have
leading batch axes in the functions that a tuner calls. Systems are continuous (dt = 0) or discrete (dt > 0).
"""

from __future__ import annotations

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.bandwidth import bandwidth
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.disks import disk_phase, disk_to_gain_phase
from platform_ctrl.analysis.feedback import (
    Gang,
    closed_loop,
    gang,
    loop_transfer,
    sensitivity_functions,
)
from platform_ctrl.analysis.interconnection import interconnect_controllers
from platform_ctrl.analysis.intersample import intersample_h2, intersample_norm
from platform_ctrl.analysis.loop_metrics import LoopMetrics, measure
from platform_ctrl.analysis.margins import (
    DiskMargin,
    LoopMargins,
    disk_margin,
    loop_margins,
)
from platform_ctrl.analysis.norms import h2_norm, hinf_norm, noise_rms
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import (
    Damping,
    continuous_poles,
    damping,
    damping_ratio,
    is_stable,
    minimum_damping,
    poles,
    spectral_abscissa,
    spectral_radius,
)
from platform_ctrl.analysis.response import frequency_response, response_at
from platform_ctrl.analysis.sampled import bilinear_to_continuous, bilinear_to_discrete, sampled
from platform_ctrl.analysis.time_response import time_response

__all__ = [
    "Channel",
    "Damping",
    "DiskMargin",
    "Gang",
    "LoopMargins",
    "LoopMetrics",
    "PlantSet",
    "StateArrays",
    "bandwidth",
    "bilinear_to_continuous",
    "bilinear_to_discrete",
    "closed_loop",
    "continuous_poles",
    "damping",
    "damping_ratio",
    "disk_margin",
    "disk_phase",
    "disk_to_gain_phase",
    "frequency_response",
    "gang",
    "h2_norm",
    "hinf_norm",
    "interconnect_controllers",
    "intersample_h2",
    "intersample_norm",
    "is_stable",
    "loop_margins",
    "loop_transfer",
    "measure",
    "minimum_damping",
    "noise_rms",
    "poles",
    "response_at",
    "sampled",
    "sensitivity_functions",
    "spectral_abscissa",
    "spectral_radius",
    "time_response",
]
