"""Regression tests of control loops: what tests assert, and the pytest plugin that collects jobs.

With the package installed pytest loads `platform_ctrl.testing.plugin` by itself: the fixtures ``closed_loop`` and
``assert_baseline``, the marker ``platform_job``, the options ``--update-baselines``, ``--platform-jobs`` and
``--platform-plots``. Nothing heavy is loaded before a test asks for a job. See docs/regression-tests.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from platform_ctrl.testing.assertions import assert_baseline, assert_requirements

__all__ = ["assert_baseline", "assert_requirements"]


if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.assertions"), name)
