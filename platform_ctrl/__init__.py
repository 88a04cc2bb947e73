"""Control loops of gimballed platforms with and without fast rotors: equations of motion, design, check, report.

The public names are listed in ``__init__.pyi``, once, for users, the type checker and the documentation: ``import
platform_ctrl`` loads none of the package's libraries, and the first use of a name loads the module that defines it.
"""

from platform_ctrl.common.lazy import lazy_names

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
