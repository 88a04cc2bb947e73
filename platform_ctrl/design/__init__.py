"""Loop design: full order, fixed structure, matrix inequalities, measured responses, torque limits, and jobs.

``__init__.pyi`` lists the names, loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
