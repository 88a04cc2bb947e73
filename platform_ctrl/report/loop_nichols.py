"""Gain over phase of a loop's channels, with the region that the disk margin keeps free."""

from __future__ import annotations

from matplotlib.figure import Figure

from platform_ctrl.job import LoopSpec
from platform_ctrl.report.loop_responses import LoopResponses
from platform_ctrl.report.plots.nichols import nichols

# No loop has a larger disk margin.
_MOST = 2.0


def nichols_figure(responses: LoopResponses, spec: LoopSpec, torques: tuple[str, ...]) -> Figure:
    """Nichols plot of the closed design: the loop that each torquer closes while all the others stay closed."""
    import control

    closed = next(one for one in responses.designs if one.design.name == responses.closed)
    loops = {
        name: control.FrequencyResponseData(channel[None, None, :], responses.frequency)
        for name, channel in zip(torques, closed.channels, strict=True)
    }
    asked = spec.limits.disk_margin
    figure = nichols(loops, disk_margins=() if asked is None or asked >= _MOST else (asked,)).figure
    assert isinstance(figure, Figure)
    return figure
