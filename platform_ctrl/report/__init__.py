"""Reports of results: the page of a job with its plots, the terminal's tables, and plots for scripts.

Matplotlib is loaded with the first figure, not with this package; ``__init__.pyi`` lists the names.
"""

from platform_ctrl.common.lazy import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
