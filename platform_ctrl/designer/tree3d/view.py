"""The view as the page holds it: a place for the page's own script to draw in, and the data that it draws."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from bokeh.models.sources import ColumnDataSource
from bokeh.models.widgets import Div

from platform_ctrl.description import Platform
from platform_ctrl.designer.tree3d.scene import scene
from platform_ctrl.simulation import Trajectory

# Samples that a run is shown with: more are thinned out, every second, third, ... one kept.
SAMPLES = 4000


class TreeView:
    """The gimbal tree of a platform in 3-D, turning with a run once there is one.

    The template has to load ``/tree3d/tree.js`` as a module.

    Parameters
    ----------
    platform
        The platform.

    Attributes
    ----------
    layout
        What the document takes: fills its box; named ``tree``.

    References
    ----------
    See docs/designer.md.
    """

    def __init__(self, platform: Platform) -> None:
        self._source = ColumnDataSource(data={"t": np.zeros(0)})
        self.layout = Div(
            text="<gimbal-tree></gimbal-tree>",
            name="tree",
            tags=[self._source, _text(platform)],
            disable_math=True,
            sizing_mode="stretch_both",
            styles={"position": "relative"},
        )

    def stage(self, platform: Platform) -> None:
        """Show another platform; the run is dropped.

        Parameters
        ----------
        platform
            The platform: with other spins, or another altogether.

        References
        ----------
        See docs/designer.md.
        """
        text = _text(platform)
        if text != self.layout.tags[1]:
            self._source.data = {"t": np.zeros(0)}
            self.layout.tags = [self._source, text]

    def show(self, trajectory: Trajectory) -> None:
        """Turn with a run; the one before it is dropped.

        Parameters
        ----------
        trajectory
            The run; of the platform that is shown.

        References
        ----------
        See docs/designer.md.
        """
        self._source.data = columns(trajectory)


def columns(trajectory: Trajectory) -> dict[str, Any]:
    """Return what the script needs of a run: every angle, the attitude, and how far servo rotors have turned.

    Parameters
    ----------
    trajectory
        The run.

    Returns
    -------
    dict
        Columns ``t``, s; ``q 0``, ``q 1``, ...: gimbal angles in the plant's order, rad; ``w``, ``x``, ``y``, ``z``:
        attitude as a quaternion; and ``turned`` + name of each servo rotor, rad. At most `SAMPLES` rows.

    References
    ----------
    See docs/designer.md.
    """
    rows = slice(None, None, max(1, -(-len(trajectory.t) // SAMPLES)))
    out: dict[str, Any] = {"t": trajectory.t[rows]}
    out |= {f"q {k}": trajectory.q[rows, k] for k in range(trajectory.q.shape[1])}
    out |= {name: trajectory.attitude[rows, k] for k, name in enumerate("wxyz")}
    if len(trajectory.rotor_names) and len(trajectory.t):
        middle = 0.5 * (trajectory.rotor_spin[1:] + trajectory.rotor_spin[:-1]) * np.diff(trajectory.t)[:, None]
        turned = np.concatenate([np.zeros((1, middle.shape[1])), np.cumsum(middle, axis=0)])
        out |= {f"turned {name}": turned[rows, k] for k, name in enumerate(trajectory.rotor_names)}
    return {name: np.ascontiguousarray(column) for name, column in out.items()}


def _text(platform: Platform) -> str:
    return json.dumps(scene(platform).data(), separators=(",", ":"))
