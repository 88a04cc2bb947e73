"""The records of which a `Platform` is made: the reference describes them, no public module lists them."""

from platform_ctrl.plant.force_elements import Cage, Erection, Friction, Spring, Unbalance
from platform_ctrl.plant.gimbals import Gimbal
from platform_ctrl.plant.platform import PickOff, RateSensor, Rotor, Torquer

__all__ = [
    "Cage",
    "Erection",
    "Friction",
    "Gimbal",
    "PickOff",
    "RateSensor",
    "Rotor",
    "Spring",
    "Torquer",
    "Unbalance",
]
