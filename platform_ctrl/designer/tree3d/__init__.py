"""The gimbal tree in 3-D, turning with a simulated run: what the page's own script draws, and what it is told."""

from __future__ import annotations

from platform_ctrl.designer.tree3d.view import TreeView

__all__ = ["TreeView"]
