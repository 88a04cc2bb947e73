"""The gimbal tree of a plant file.

What turns in what: Magnus's platform with three gyros, drawn from its plant file. Orange arrows are the axes of the
gimbals with the sense of their angles, blue arrows the spin of the rotors; signs say what acts and measures.
"""

import platform_ctrl as pc
from platform_ctrl.report import figures

figure = figures.gimbal_tree(pc.read_platform("three_gyro_platform"))
figure.savefig("gimbal_tree.png", dpi=150)
