"""What design and check both measure with: responses, sampling, closed loops, poles, norms, margins.

Everything takes continuous (dt = 0) and discrete (dt > 0) systems. Functions whose names end in ``_arrays`` (and
those that take poles or responses) work on plain arrays with leading batch axes: they are what a tuner calls.
"""

from __future__ import annotations

from platform_ctrl.analysis.arrays import StateArrays, named_system, state_arrays
from platform_ctrl.analysis.bandwidth import bandwidth, bandwidth_of_response
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.feedback import (
    Gang,
    closed_loop,
    closed_loop_arrays,
    gang,
    loop_transfer,
    sensitivity_functions,
    series_arrays,
)
from platform_ctrl.analysis.interconnection import interconnect_controllers
from platform_ctrl.analysis.intersample import intersample_h2, intersample_norm
from platform_ctrl.analysis.loop_measures import LoopMeasures, exact_measures, measure
from platform_ctrl.analysis.margins import (
    DiskMargin,
    LoopMargins,
    disk_margin,
    disk_phase,
    disk_to_gain_phase,
    loop_margins,
)
from platform_ctrl.analysis.norms import h2_norm, hinf_norm, hinf_norm_arrays, noise_rms, noise_rms_arrays
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.analysis.poles import (
    Damping,
    continuous_poles,
    damping,
    damping_ratio,
    is_stable,
    minimum_damping,
    pole_arrays,
    poles,
    spectral_abscissa,
    spectral_radius,
)
from platform_ctrl.analysis.response import frequency_response, frequency_response_arrays, response_arrays
from platform_ctrl.analysis.sampled import bilinear_to_continuous, bilinear_to_discrete, sampled, sampled_arrays
from platform_ctrl.analysis.time_response import time_response

__all__ = [
    "Channel",
    "Damping",
    "DiskMargin",
    "Gang",
    "LoopMargins",
    "LoopMeasures",
    "PlantSet",
    "StateArrays",
    "bandwidth",
    "bandwidth_of_response",
    "bilinear_to_continuous",
    "bilinear_to_discrete",
    "closed_loop",
    "closed_loop_arrays",
    "continuous_poles",
    "damping",
    "damping_ratio",
    "disk_margin",
    "disk_phase",
    "disk_to_gain_phase",
    "exact_measures",
    "frequency_response",
    "frequency_response_arrays",
    "gang",
    "h2_norm",
    "hinf_norm",
    "hinf_norm_arrays",
    "interconnect_controllers",
    "intersample_h2",
    "intersample_norm",
    "is_stable",
    "loop_margins",
    "loop_transfer",
    "measure",
    "minimum_damping",
    "named_system",
    "noise_rms",
    "noise_rms_arrays",
    "pole_arrays",
    "poles",
    "response_arrays",
    "sampled",
    "sampled_arrays",
    "sensitivity_functions",
    "series_arrays",
    "spectral_abscissa",
    "spectral_radius",
    "state_arrays",
    "time_response",
]
