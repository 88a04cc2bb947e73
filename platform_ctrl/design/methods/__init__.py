"""The design methods of the package, one file each; importing this registers them, so that jobs may name them.

`read_job` is `job.reading.read_job`, which knows no method by itself: whoever reads jobs takes it from here.
"""

from platform_ctrl.design.method import METHODS as METHODS
from platform_ctrl.design.methods.classical import Classical
from platform_ctrl.design.methods.hinf import MixedSensitivity
from platform_ctrl.design.methods.lmi import LMI
from platform_ctrl.design.methods.lqg import LQG
from platform_ctrl.design.methods.measured import MeasuredPID
from platform_ctrl.design.methods.pi import PI
from platform_ctrl.design.methods.platform_servo import PlatformServo
from platform_ctrl.design.methods.structured import Structured
from platform_ctrl.job.methods import register_method
from platform_ctrl.job.reading import read_job as read_job

for _method in (Classical, PI, MixedSensitivity, LQG, LMI, Structured, MeasuredPID, PlatformServo):
    register_method(_method)
