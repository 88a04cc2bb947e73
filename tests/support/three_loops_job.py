"""A job of three loops of the three-gyro platform whose designs are fixed numbers, made in a moment."""

from campaign_runs import MANOEUVRES

JOB = (
    """
schema = 2
name = "three gyros, fixed numbers"
plant = "three_gyro_platform"
operation = { Omega = [0.0, 0.0, 0.0], seed = 7 }
sampling = { rate_hz = 2000, delay = 0.0005 }
coupled = { disk_margin = 0.2, coupling_cost = 0.05 }

[[loop]]
name = "caging 4-5-7"
kind = "caging"
gimbals = ["4", "5", "7"]
use = "classical"
limits = { bandwidth_hz = 15, disk_margin = 0.2 }
design = [{ name = "classical", method = "classical", crossover_hz = 30, integral_hz = 2 }]

[[loop]]
name = "caging 9-10"
kind = "caging"
gimbals = ["9", "10"]
use = "classical"
limits = { bandwidth_hz = 20, disk_margin = 0.4 }
design = [{ name = "classical", method = "classical", crossover_hz = 40, integral_hz = 2 }]

[[loop]]
name = "stabilisation"
kind = "stabilisation"
use = "servo"
design = [{ name = "servo", method = "platform-servo", crossover_hz = 4, filter_hz = 50 }]
"""
    + MANOEUVRES
)
