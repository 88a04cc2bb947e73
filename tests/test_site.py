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
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

from platform_ctrl.report import figures
from public_modules import described

pytest.importorskip("mkdocs", reason="the site is built with the extra docs")
ROOT = Path(__file__).parents[1]


class Page(HTMLParser):
    """What a page loads."""

    def __init__(self, path: Path) -> None:
        super().__init__(convert_charrefs=True)
        self.loaded: list[str] = []
        self.styles: list[str] = []
        self._style = False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.styles += [given["style"]] if "style" in given else []
        self._style = tag == "style"
        if tag == "link" and given.get("rel") not in ("canonical", "prev", "next"):
            self.loaded.append(given["href"])
        self.loaded += [given[name] for name in ("src", "data", "poster") if name in given and tag != "a"]
        self.loaded += [part.split()[0] for part in given.get("srcset", "").split(",") if part.strip()]
        if tag in ("image", "use") and ("href" in given or "xlink:href" in given):
            self.loaded.append(given.get("href") or given["xlink:href"])

    def handle_data(self, data: str) -> None:
        if self._style:
            self.styles.append(data)


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


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    # A server shows 404.html at any depth: its addresses begin at the server's root.
    return {path: Page(path) for path in sorted(site.rglob("*.html")) if path.name != "404.html"}


def inventory(site: Path) -> set[str]:
    """Return the names that the site's object inventory, for the links of other sites, has of our Python."""
    packed = (site / "objects.inv").read_bytes().split(b"\n", 4)[4]
    lines = zlib.decompress(packed).decode("utf-8").splitlines()
    return {line.split(" py:")[0] for line in lines if " py:" in line}


def outside(address: str) -> bool:
    return re.match(r"(?i)(https?:)?//", address.strip()) is not None


def addresses(css: str) -> Iterator[str]:
    yield from re.findall(r"url\(\s*['\"]?([^)'\"]+)", css)
    yield from re.findall(r"@import\s+['\"]([^'\"]+)", css)


def test_nothing_that_a_page_needs_comes_from_elsewhere(site: Path, pages: dict[Path, Page]) -> None:
    assert len(pages) > 40
    for path, page in pages.items():
        for address in [*page.loaded, *(found for style in page.styles for found in addresses(style))]:
            assert not outside(address), (path.name, address)
            if not address.startswith(("data:", "#")):
                assert (path.parent / address.partition("#")[0].partition("?")[0]).exists(), (path.name, address)
    for sheet in site.rglob("*.css"):
        assert not [found for found in addresses(sheet.read_text(encoding="utf-8")) if outside(found)], sheet.name
    for picture in site.rglob("*.svg"):
        text = picture.read_text(encoding="utf-8")
        loaded = re.findall(r"(?:xlink:)?href=\"([^\"#][^\"]*)", text) + list(addresses(text))
        assert not [found for found in loaded if outside(found)], picture.name


def test_every_public_name_is_in_the_reference(site: Path) -> None:
    reference = "".join(path.read_text(encoding="utf-8") for path in (site / "reference" / "python").glob("*.html"))
    listed = inventory(site)
    for path, item in described().items():
        entry = f"{item.__module__}.{item.__qualname__}"
        assert f"<code>{path.rpartition('.')[2]}</code>" in reference, path
        assert f'id="{entry}"' in reference, entry
        assert entry in listed, entry


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
    # What shows windows draws nothing; the axes of every shipped plant are drawn on the page of models.
    plots = set(figures.__all__) - {"show", "axes_picture"}
    assert len(plots) > 5
    assert not plots - drawn
