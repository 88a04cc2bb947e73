"""Control loops of gimballed platforms with fast rotors: equations of motion, design, check, report.

The public names are loaded on first use: ``import platform_ctrl`` itself loads nothing else. `state_space`,
`precession`, `parameter_varying` and `terms` are functions as well as the modules that hold them;
``platform_ctrl.state_space`` is always the function.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from platform_ctrl import (
        analysis,
        baselines,
        campaign,
        certificates,
        check,
        design,
        export,
        report,
        requirements,
        simulation,
    )
    from platform_ctrl.description import Gimbal, PickOff, Platform, RateSensor, Rotor, Torquer
    from platform_ctrl.errors import PlatformCtrlError
    from platform_ctrl.force_elements import Cage, Erection, Friction, Spring, Unbalance
    from platform_ctrl.job import Job
    from platform_ctrl.linearisation import LinearModel, linearise
    from platform_ctrl.mechanics import (
        element_forces,
        forward_dynamics,
        inverse_dynamics,
        matrices,
        rotor_momenta,
        with_free_rotors,
        with_regulated_rotors,
        with_rotors_as_gimbals,
    )
    from platform_ctrl.parameter_varying import ParameterVaryingModel, parameter_varying
    from platform_ctrl.precession import Precession, precession
    from platform_ctrl.reading import read_job, read_platform
    from platform_ctrl.state_space import state_space, subsystems
    from platform_ctrl.symbolic import equations
    from platform_ctrl.terms import TermTable, terms

__version__ = "0.1.0"

__all__ = [
    "Cage",
    "Erection",
    "Friction",
    "Gimbal",
    "Job",
    "LinearModel",
    "ParameterVaryingModel",
    "PickOff",
    "Platform",
    "PlatformCtrlError",
    "Precession",
    "RateSensor",
    "Rotor",
    "Spring",
    "TermTable",
    "Torquer",
    "Unbalance",
    "analysis",
    "baselines",
    "campaign",
    "certificates",
    "check",
    "design",
    "element_forces",
    "equations",
    "export",
    "forward_dynamics",
    "inverse_dynamics",
    "linearise",
    "matrices",
    "parameter_varying",
    "precession",
    "read_job",
    "read_platform",
    "report",
    "requirements",
    "rotor_momenta",
    "simulation",
    "state_space",
    "subsystems",
    "terms",
    "with_free_rotors",
    "with_regulated_rotors",
    "with_rotors_as_gimbals",
]

_SUBMODULES = frozenset(
    {
        "analysis",
        "baselines",
        "campaign",
        "certificates",
        "check",
        "design",
        "export",
        "report",
        "requirements",
        "simulation",
    }
)

_HOME = {
    "Cage": "force_elements",
    "Erection": "force_elements",
    "Friction": "force_elements",
    "Gimbal": "description",
    "Job": "job",
    "LinearModel": "linearisation",
    "ParameterVaryingModel": "parameter_varying",
    "PickOff": "description",
    "Platform": "description",
    "PlatformCtrlError": "errors",
    "Precession": "precession",
    "RateSensor": "description",
    "Rotor": "description",
    "Spring": "force_elements",
    "TermTable": "terms",
    "Torquer": "description",
    "Unbalance": "force_elements",
    "element_forces": "mechanics",
    "equations": "symbolic",
    "forward_dynamics": "mechanics",
    "inverse_dynamics": "mechanics",
    "linearise": "linearisation",
    "matrices": "mechanics",
    "parameter_varying": "parameter_varying",
    "precession": "precession",
    "read_job": "reading",
    "read_platform": "reading",
    "rotor_momenta": "mechanics",
    "state_space": "state_space",
    "subsystems": "state_space",
    "terms": "terms",
    "with_free_rotors": "mechanics",
    "with_regulated_rotors": "mechanics",
    "with_rotors_as_gimbals": "mechanics",
}


if not TYPE_CHECKING:  # a type checker that saw it would take every misspelt name for granted

    def __getattr__(name: str) -> object:
        if name in _SUBMODULES:
            return import_module(f"{__name__}.{name}")
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name, obj=sys.modules[__name__])
        found = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """Whoever imports a submodule, the import system stores it here: a public function of that name stays on top."""

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and _HOME.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
