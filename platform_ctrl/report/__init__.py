"""What a job came to, for people: the page with its figures, the same as PDF, and the terminal's tables.

Matplotlib is loaded with the first figure, not with this package; ``__init__.pyi`` lists the names.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
