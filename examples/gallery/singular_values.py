"""Singular values of a plant with three torquers.

From the torques of gimbals 4, 5 and 7 to their angles, with the rotors at full speed and at half of it: the heavier
line is the largest gain in any direction, the lighter ones those across it. The nutation, which nothing damps, runs out
of the panel; with the slower rotors it comes at half the frequency.
"""

import dataclasses

import platform_ctrl as pc
from platform_ctrl.report import figures

platform = pc.read_platform("three_gyro_platform")
plants = {}
for label, speed in {"full speed": 1.0, "half speed": 0.5}.items():
    rotors = tuple(
        dataclasses.replace(rotor, angular_momentum=speed * rotor.angular_momentum) for rotor in platform.rotors
    )
    model = pc.linearise(dataclasses.replace(platform, rotors=rotors))
    plants[label] = pc.state_space(model, gimbals=("4", "5", "7"))[["alpha4", "beta5", "beta7"], ["Q4", "Q5", "Q7"]]

figure = figures.singular_values(plants).figure
figure.savefig("singular_values.png", dpi=150)
