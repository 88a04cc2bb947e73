"""Region of gain and phase that is safe.

Whatever gain and phase change together within a region leaves the loop stable. The dotted curve says which changes make
it unstable, at which frequency: the region of its own disk margin touches it.
"""

import control

import platform_ctrl as pc
from platform_ctrl.report import figures

# One axis of a platform: inertia, lag of the torquer, PD with integral action; torque = K(angle) has a minus in it.
s = control.tf("s")
plant = control.ss(1.0 / (1.8 * s**2) / (0.002 * s + 1.0))
controller = control.ss(-(2000.0 + 90.0 * s + 8000.0 / s) / (0.003 * s + 1.0))
loop = pc.analysis.loop_transfer(plant, controller)

figure = figures.disk_margin_region({"loop": loop, "required": 0.5}).figure
figure.savefig("disk_margin_region.png", dpi=150)
