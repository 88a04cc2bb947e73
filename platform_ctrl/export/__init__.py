"""The way out: controllers and plants as C, FMU, MJCF, MATLAB data, JSON and CSV."""

from __future__ import annotations

from platform_ctrl.export.c99.writing import Written, write_c
from platform_ctrl.export.fmu.writing import write_fmu
from platform_ctrl.export.job_systems import ResponseTable, controller_systems, job_responses, model_systems
from platform_ctrl.export.json_systems import read_systems, write_controllers, write_systems
from platform_ctrl.export.linear_system import LinearSystem, linear_system
from platform_ctrl.export.matlab import read_mat, write_mat
from platform_ctrl.export.mujoco.reading import read_mjcf
from platform_ctrl.export.mujoco.writing import write_mjcf
from platform_ctrl.export.responses import response_data, write_responses

__all__ = [
    "LinearSystem",
    "ResponseTable",
    "Written",
    "controller_systems",
    "job_responses",
    "linear_system",
    "model_systems",
    "read_mat",
    "read_mjcf",
    "read_systems",
    "response_data",
    "write_c",
    "write_controllers",
    "write_fmu",
    "write_mat",
    "write_mjcf",
    "write_responses",
    "write_systems",
]
