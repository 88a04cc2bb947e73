"""``python -m platform_ctrl`` is the command ``platform-ctrl``."""

import sys

from platform_ctrl.cli import main

sys.exit(main())
