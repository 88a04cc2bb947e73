"""Export: controllers and plants as C, MJCF, MATLAB data, JSON and CSV.

`exporters` has the forms that ``platform-ctrl export`` writes; ``__init__.pyi`` lists the names, loaded on first use.
"""

from platform_ctrl.common.lazy import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
