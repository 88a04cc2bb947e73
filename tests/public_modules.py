"""The modules that users import from: what their names are documented by, and where the site has them."""

from __future__ import annotations

# Behind platform_ctrl; a module without `__all__` is public with all that it defines.
MODULES = (
    "",
    "analysis",
    "baselines",
    "campaign",
    "certificates",
    "check",
    "description",
    "design",
    "design.measured",
    "errors",
    "export",
    "force_elements",
    "job",
    "linearisation",
    "mechanics",
    "parameter_varying",
    "parameters",
    "precession",
    "reading",
    "report",
    "report.figures",
    "requirements",
    "scenario",
    "simulation",
    "state_space",
    "symbolic",
    "terms",
    "testing",
    "variation",
)
