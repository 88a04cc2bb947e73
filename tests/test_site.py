"""The documentation site: built strictly, read without network, with every public name and every plot."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import zlib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

from platform_ctrl.report import figures
from public_modules import described, names, public

pytest.importorskip("mkdocs", reason="the site is built with the extra docs")
ROOT = Path(__file__).parents[1]


class Page(HTMLParser):
    """What a page loads, where it leads, and what can be led to."""

    def __init__(self, path: Path) -> None:
        super().__init__(convert_charrefs=True)
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.styles: list[str] = []
        self._style = False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        self.styles += [given["style"]] if "style" in given else []
        self._style = tag == "style"
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") not in ("canonical", "prev", "next"):
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


def test_every_link_within_the_site_leads_somewhere(site: Path, pages: dict[Path, Page]) -> None:
    known = {path.resolve(): page for path, page in pages.items()}
    for path, page in pages.items():
        for link in page.links:
            if outside(link) or link.startswith(("mailto:", "javascript:")):
                continue
            target, _, anchor = link.partition("#")
            found = (path.parent / target).resolve() if target else path.resolve()
            assert found.exists(), (path.name, link)
            if anchor and found in known:
                assert anchor in known[found].anchors, (path.name, link)


def test_every_page_is_reached_from_the_first(site: Path, pages: dict[Path, Page]) -> None:
    known = {path.resolve(): page for path, page in pages.items()}
    reached, waiting = set(), [(site / "index.html").resolve()]
    while waiting:
        path = waiting.pop()
        if path in known and path not in reached:
            reached.add(path)
            links = [link.partition("#")[0] for link in known[path].links if not outside(link)]
            waiting += [(path.parent / link).resolve() for link in links if link.endswith(".html")]
    assert not set(known) - reached


def test_every_page_of_docs_is_in_the_site(site: Path) -> None:
    for path in (ROOT / "docs").rglob("*.md"):
        assert (site / path.relative_to(ROOT / "docs").with_suffix(".html")).exists(), path.name


def test_every_public_name_is_in_the_reference(site: Path) -> None:
    reference = "".join(path.read_text(encoding="utf-8") for path in (site / "reference").glob("*.html"))
    listed = inventory(site)
    for path, item in described().items():
        entry = f"{item.__module__}.{item.__qualname__}"
        assert f"<code>{path.rpartition('.')[2]}</code>" in reference, path
        assert f'id="{entry}"' in reference, entry
        assert entry in listed, entry


def test_at_most_150_names_are_public() -> None:
    assert len(public()) <= 150


def test_names_that_a_docstring_lists_together_have_each_their_own_type(site: Path) -> None:
    page = (site / "reference" / "requirements.html").read_text(encoding="utf-8")
    entry = page[page.index('id="platform_ctrl.job.judging.CheckResult"') :].split("<h3")[0]
    rows = [re.sub(r"<[^>]*>|\s", "", row).strip() for row in entry.split('<tr class="doc-section-item">')]
    assert {row[:10] for row in rows} >= {"valuefloat", "limitfloat", "unitstrAsm", "senseSense"}


def test_every_package_that_has_public_names_is_asked_for() -> None:
    found = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for path in (ROOT / "platform_ctrl").rglob("__init__.py")
        if "__all__" in path.read_text(encoding="utf-8")
    }
    assert found - {"platform_ctrl.cli"} <= set(names.MODULES)


def test_every_plot_for_scripts_is_in_the_gallery(site: Path) -> None:
    page = (site / "gallery.html").read_text(encoding="utf-8")
    scripts = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "examples" / "gallery").glob("*.py")}
    drawn = set()
    for name, text in scripts.items():
        assert f'id="{name}"' in page
        for theme in ("light", "dark"):
            picture = site / "pictures" / "gallery" / f"{name}-{theme}.svg"
            assert len(picture.read_bytes()) > 2000
            assert page.count(f'src="pictures/gallery/{picture.name}"') == 2  # in the overview and above its code
        drawn |= {node.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)}
    plots = set(figures.__all__) - {"show"}  # which draws nothing
    assert len(plots) > 5
    assert not plots - drawn


def test_pictures_have_the_colours_of_their_theme(site: Path) -> None:
    light = (site / "pictures" / "gallery" / "root_locus-light.svg").read_text(encoding="utf-8")
    dark = (site / "pictures" / "gallery" / "root_locus-dark.svg").read_text(encoding="utf-8")
    ink = re.compile(r"--ink: ?(#[0-9a-f]{6})")
    assert int(ink.findall(light)[0][1:3], 16) < 0x60 < 0xA0 < int(ink.findall(dark)[0][1:3], 16)
    assert light.count("var(--ink") == dark.count("var(--ink") > 0


def test_the_site_is_light_and_dark(site: Path) -> None:
    page = (site / "index.html").read_text(encoding="utf-8")
    schemes = set(re.findall(r'data-md-color-scheme="(\w+)"', page))
    assert {"default", "slate"} <= schemes
    assert "(prefers-color-scheme: dark)" in page
    sheet = (site / "assets" / "site.css").read_text(encoding="utf-8")
    assert '[data-md-color-scheme="slate"]' in sheet
    assert '[data-md-color-scheme="default"]' in sheet


def test_formulas_are_mathml_and_none_is_left_in_tex(site: Path) -> None:
    page = (site / "corrected-paper.html").read_text(encoding="utf-8")
    assert page.count("<math") > 50
    article = page[page.index("<article") : page.index("</article")]
    assert "$" not in article
    assert not re.search(r"\\(?:frac|dot|mathbf|begin)", article)


def test_the_search_has_its_index_as_a_script_too(site: Path) -> None:
    assert (site / "search" / "search_index.js").read_text(encoding="utf-8").startswith("var __index = ")
    assert "linearise" in (site / "search" / "search_index.json").read_text(encoding="utf-8")
    page = (site / "index.html").read_text(encoding="utf-8")
    # A page from the disk may start no worker: the stand-in is there before the script that would start it.
    assert page.index("assets/iframe-worker.js") < page.index("assets/javascripts/bundle")
    [worker] = (site / "assets" / "javascripts" / "workers").glob("search*.js")
    assert "IFrameWorker" in worker.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("address", ["index.html?q=nutation", "reference/design.html?q=nutation"])
def test_the_search_finds_from_the_disk(site: Path, tmp_path: Path, address: str) -> None:
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium here")
    quiet = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}", "--virtual-time-budget=9000"]
    done = subprocess.run(
        [browser, *quiet, "--dump-dom", f"{site.as_uri()}/{address}"], capture_output=True, text=True, timeout=120
    )
    assert re.search(r"[1-9]\d* matching documents", done.stdout)
