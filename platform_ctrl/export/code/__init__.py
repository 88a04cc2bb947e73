"""Controllers as C99 source: one step of sections that are written out, without library, allocation or loop."""

from platform_ctrl.export.code.writing import Written, write_c

__all__ = ["Written", "write_c"]
