"""What numba keeps on disk is used as long as the code is the same."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numba
import pytest

KEPT = {
    "inner_part.py": (
        "from platform_ctrl.common.compiling import internal\n@internal\ndef inner(x):\n    return {factor} * x\n"
    ),
    "outer_part.py": (
        "from inner_part import inner\nfrom platform_ctrl.common.compiling import compiled\n"
        "@compiled\ndef outer(x):\n    return inner(x) + 1.0\n"
    ),
}


def test_what_is_kept_is_compiled_again_when_a_neighbouring_file_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba looks at the function's own file alone; that others count, too, goes through names that it may change."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    found = []
    for factor in (2.0, 2.0, 30.0):
        for name, text in KEPT.items():
            written, path = text.format(factor=factor), tmp_path / name
            if not path.exists() or path.read_text(encoding="utf-8") != written:
                path.write_text(written, encoding="utf-8")
            sys.modules.pop(path.stem, None)
        importlib.invalidate_caches()
        outer = importlib.import_module("outer_part").outer
        value, stats = outer(1.0), outer.stats
        found.append([value, len(stats.cache_hits), len(stats.cache_misses)])
    # The value, how often it was found in the cache, how often it was not.
    assert found == [[3.0, 0, 1], [3.0, 1, 0], [31.0, 0, 1]]
