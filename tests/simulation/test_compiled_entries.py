"""What numba keeps on disk is used as long as the code is the same."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

KEPT = {
    "inner.py": (
        "from platform_ctrl.common.compiling import internal\n@internal\ndef inner(x):\n    return {factor} * x\n"
    ),
    "outer.py": (
        "from inner import inner\nfrom platform_ctrl.common.compiling import compiled\n"
        "@compiled\ndef outer(x):\n    return inner(x) + 1.0\n"
    ),
}
CALL = "from outer import outer; print(outer(1.0), *map(len, (outer.stats.cache_hits, outer.stats.cache_misses)))"


def test_what_is_kept_is_compiled_again_when_a_neighbouring_file_changes(tmp_path: Path) -> None:
    """Numba looks at the function's own file alone; that others count, too, goes through names that it may change."""
    found = []
    for factor in (2.0, 2.0, 30.0):
        for name, text in KEPT.items():
            written, path = text.format(factor=factor), tmp_path / name
            if not path.exists() or path.read_text(encoding="utf-8") != written:
                path.write_text(written, encoding="utf-8")
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        command = [sys.executable, "-c", CALL]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found.append(done.stdout.split())
    # The value, how often it was found in the cache, how often it was not.
    assert found == [["3.0", "0", "1"], ["3.0", "1", "0"], ["31.0", "0", "1"]]
