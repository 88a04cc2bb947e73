"""The response to a step."""

from __future__ import annotations

from platform_ctrl.designer.pictures import Drawing
from platform_ctrl.designer.plots.panel import Panel, Theme
from platform_ctrl.designer.plots.sources import Sources
from platform_ctrl.designer.plots.time_response import TimePanel


class StepPanel:
    """Step response: a torque step to the angles, or to the attitude.

    Parameters
    ----------
    theme
        Colours.
    sources
        Where the data of all plots stand.
    """

    def __init__(self, theme: Theme, sources: Sources) -> None:
        self.panel = Panel("step", "Step response", theme)
        self.over_time = TimePanel(self.panel, "step", sources, theme)

    def show(self, picture: Drawing) -> None:
        """Follow a picture."""
        keys = self.over_time.show(picture, picture.step, "step")
        self.panel.say(picture.step.title)
        self.panel.keys(keys)
