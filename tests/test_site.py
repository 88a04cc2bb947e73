"""The documentation site: built strictly, read without network, with every public name and every plot."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from platform_ctrl.report import figures
from public_modules import described

pytest.importorskip("mkdocs", reason="the site is built with the extra docs")
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site as CI does, and not with --quiet: it also hides warnings from --strict."""
    folder = tmp_path_factory.mktemp("site")
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": path, "NO_MKDOCS_2_WARNING": "true", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_pictures_of_the_app_and_the_report_are_of_what_they_show() -> None:
    """Digests of what decides how they look, and of what was drawn: where they differ the pictures are old."""
    pytest.importorskip("PIL")
    spec = importlib.util.spec_from_file_location("draw_designer", ROOT / "docs" / "draw_designer.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    drawn = json.loads((ROOT / "docs" / "assets" / "pictures.json").read_text(encoding="utf-8"))
    old = [name for name, digest in script.digests().items() if drawn.get(name) != digest]
    assert not old, f"docs/assets: the pictures of {', '.join(old)} are old; run python docs/draw_designer.py"


def inventory(site: Path) -> set[str]:
    """Return the names that the site's object inventory, for the links of other sites, has of our Python."""
    packed = (site / "objects.inv").read_bytes().split(b"\n", 4)[4]
    lines = zlib.decompress(packed).decode("utf-8").splitlines()
    return {line.split(" py:")[0] for line in lines if " py:" in line}


@pytest.mark.slow
def test_nothing_that_a_page_needs_comes_from_elsewhere(site: Path) -> None:
    loads = re.compile(
        r"<(?:script|img|iframe|source|video|object|image|use)\b[^>]*?(?:src|data|href)=\"(?:https?:)?//[^\"]*"
        r"|<link\b(?![^>]*rel=\"(?:canonical|prev|next)\")[^>]*href=\"(?:https?:)?//[^\"]*"
        r"|(?:url\(|@import )\s*['\"]?(?:https?:)?//[^)'\"]*"
    )
    files = [path for pattern in ("*.html", "*.css", "*.svg") for path in site.rglob(pattern)]
    assert len(files) > 100
    for path in files:
        assert loads.findall(path.read_text(encoding="utf-8")) == [], path.name


@pytest.mark.slow
def test_every_public_name_is_in_the_reference(site: Path) -> None:
    reference = "".join(path.read_text(encoding="utf-8") for path in (site / "reference" / "python").glob("*.html"))
    listed = inventory(site)
    for path, item in described().items():
        entry = f"{item.__module__}.{item.__qualname__}"
        assert f"<code>{path.rpartition('.')[2]}</code>" in reference, path
        assert f'id="{entry}"' in reference, entry
        assert entry in listed, entry


@pytest.mark.slow
def test_every_plot_for_scripts_is_in_the_gallery(site: Path) -> None:
    page = (site / "start" / "gallery.html").read_text(encoding="utf-8")
    scripts = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "examples" / "gallery").glob("*.py")}
    drawn = set()
    for name, text in scripts.items():
        assert f'id="{name}"' in page
        for theme in ("light", "dark"):
            picture = site / "pictures" / "gallery" / f"{name}-{theme}.svg"
            assert len(picture.read_bytes()) > 2000
            assert page.count(f'src="../pictures/gallery/{picture.name}"') == 2  # in the overview and above its code
        drawn |= {node.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)}
    # The axes of every shipped plant are drawn on the page of models.
    plots = set(figures.__all__) - {"axes_picture"}
    assert len(plots) > 5
    assert not plots - drawn
