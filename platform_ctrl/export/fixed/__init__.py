"""Controllers in integers, with the proof that nothing overflows."""

from platform_ctrl.export.fixed.emission import Unit, header, source
from platform_ctrl.export.fixed.job_emission import job_header, job_source
from platform_ctrl.export.fixed.lowering import fixed_point
from platform_ctrl.export.fixed.model import Machine
from platform_ctrl.export.fixed.ranges import input_ranges
from platform_ctrl.export.fixed.values import FixedPoint, FixedSection, Format, IntegerRow, Product

__all__ = [
    "FixedPoint",
    "FixedSection",
    "Format",
    "IntegerRow",
    "Machine",
    "Product",
    "Unit",
    "fixed_point",
    "header",
    "input_ranges",
    "job_header",
    "job_source",
    "source",
]
