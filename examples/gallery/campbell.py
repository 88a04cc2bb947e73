"""Campbell diagram of a gyro on springs.

The two oscillations of the gimbals part as the rotor speeds up: nutation rises, precession falls. Dashed are once and
twice the rotor's speed; at the diamonds its unbalance, or its bearings, would excite a mode during run-up.
"""

import dataclasses

import platform_ctrl as pc
from platform_ctrl.plant.force_elements import Spring
from platform_ctrl.report import figures

gyro = pc.read_platform("gimballed_gyro")
springs = tuple(Spring(gimbal=name, stiffness=200.0) for name in gyro.gimbal_names)

figure = figures.campbell(dataclasses.replace(gyro, springs=springs))
figure.savefig("campbell.png", dpi=150)
