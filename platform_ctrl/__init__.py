"""Control loops of gimballed platforms with and without fast rotors: equations of motion, design, check, report.

The public names are listed in ``__init__.pyi``, once, for the type checker and for the lazy loader: ``import
platform_ctrl`` loads none of the package's modules, and the first use of a name loads the module that defines it.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
