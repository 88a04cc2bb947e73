"""Export: controllers and plants as C, MJCF, MATLAB data, JSON and CSV.

`exporters` lists what ``platform-ctrl export`` writes; ``__init__.pyi`` lists the names, loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
