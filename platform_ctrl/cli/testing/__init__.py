"""Regression tests of control loops: what tests assert, and the pytest plugin that collects jobs.

With the package installed pytest loads `platform_ctrl.cli.testing.plugin` by itself: the fixtures ``closed_loop`` and
``assert_baseline``, the marker ``platform_job``, the options ``--update-baselines``, ``--platform-jobs`` and
``--platform-plots``. Nothing heavy is loaded before a test uses a job. See docs/regression-tests.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
