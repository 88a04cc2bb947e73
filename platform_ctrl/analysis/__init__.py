"""What design and check both measure with: responses, sampling, closed loops, poles, norms, margins."""

from __future__ import annotations

from platform_ctrl.analysis.feedback import (
    Gang,
    closed_loop,
    closed_loop_arrays,
    gang,
    loop_transfer,
    sensitivities,
    series_arrays,
)
from platform_ctrl.analysis.response import (
    frequency_response,
    frequency_response_arrays,
    response_arrays,
    time_response,
)
from platform_ctrl.analysis.sampled import (
    bilinear_to_continuous,
    bilinear_to_discrete,
    sampled,
    sampled_arrays,
)

__all__ = [
    "Gang",
    "bilinear_to_continuous",
    "bilinear_to_discrete",
    "closed_loop",
    "closed_loop_arrays",
    "frequency_response",
    "frequency_response_arrays",
    "gang",
    "loop_transfer",
    "response_arrays",
    "sampled",
    "sampled_arrays",
    "sensitivities",
    "series_arrays",
    "time_response",
]
