"""A job of one loop that is designed in a moment, and the same with a slower controller."""

from __future__ import annotations

JOB = """
schema = 2
name = "gyro 9-10"
plant = "three_gyro_platform"
operation = { Omega = [0.0, 0.0, 0.0] }
sampling = { rate_hz = 2000, delay = 0.0005 }

[[loop]]
name = "caging 9-10"
kind = "caging"
gimbals = ["9", "10"]
use = "classical"
limits = { bandwidth_hz = 20, disk_margin = 0.4 }
design = [{ name = "classical", method = "classical", crossover_hz = 40, integral_hz = 2 }]
"""
SLOWER = JOB.replace("crossover_hz = 40", "crossover_hz = 35")
# More bandwidth asked than the controller has.
TOO_MUCH = JOB.replace("bandwidth_hz = 20", "bandwidth_hz = 35")
