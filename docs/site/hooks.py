"""What MkDocs does besides: pictures out of code, pages out of scripts, links to files of the repository."""

from __future__ import annotations

import ast
import json
import posixpath
import re
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

import formulas
import gallery
import names
import pictures as drawn
import tables
from blocks import pictures
from mkdocs.structure.files import File, Files

ROOT = drawn.ROOT
# Files beside docs/ that pages lead to: each has a page under the same path.
SHOWN = {
    "examples": ("*.py", "*.toml"),
    "examples/notebooks": ("*.ipynb",),
    "models": ("*.toml",),
}
_LINK = re.compile(r"\]\(((?:\.\./)+(?:CONTRIBUTING\.md|(?:examples|models)(?:/[^)\s]*)?))\)")


def on_files(files: Files, config: Any) -> Files:
    """Add what is made: pages of scripts and plants, and all pictures."""
    for folder in SHOWN:
        for path in _shown(folder):
            files.append(File.generated(config, _page(path), content=_listing(path)))
    developers = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").replace("](docs/", "](")
    files.append(File.generated(config, "contributing.md", content=developers))
    digest = drawn.package_digest()
    themes = drawn.themes()

    def add(name: str, svg: str) -> None:
        for theme, colours in themes.items():
            files.append(File.generated(config, f"{name}-{theme}.svg", content=drawn.as_file(svg, colours)))

    for script in gallery.scripts():
        add(f"pictures/gallery/{script.name}", drawn.of_script(gallery.FOLDER / f"{script.name}.py", digest))
    written = [file for file in files.documentation_pages() if file.abs_src_path is not None]
    for file in written:
        for k, svg in enumerate(drawn.of_page(file.content_string, file.src_uri, digest)):
            add(f"pictures/{_picture(file.src_uri, k)}", svg)
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Put in what is made, and lead links to files of the repository to their pages."""
    up = "../" * page.file.src_uri.count("/")
    for k, picture in enumerate(pictures(markdown)):
        shown = gallery.figure(f"{up}pictures/{_picture(page.file.src_uri, k)}", picture.description, caption=True)
        markdown = markdown.replace(picture.comment, shown, 1)
    markdown = tables.shown(markdown)
    markdown = names.MARK.sub(lambda found: names.entries(found[1], found[2]), markdown)
    made = {"gallery": gallery.page, "all public names": names.every}
    made |= {f"list of {folder}": partial(_list, folder) for folder in SHOWN}
    for mark, make in made.items():
        if f"<!-- {mark} -->" in markdown:  # no page pays for what another shows
            markdown = markdown.replace(f"<!-- {mark} -->", make())
    return _LINK.sub(lambda found: f"]({_page_of(found[1], page.file.src_uri, up)})", markdown)


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Make formulas fit to be shown, and lead names of the package to the reference."""
    up = "../" * page.file.src_uri.count("/")
    shown = names.pages_linked(formulas.shown(html), up)
    return names.linked(shown, reference=page.file.src_uri.startswith("reference/python/"))


def _shown(folder: str) -> list[Path]:
    found = [path for pattern in SHOWN[folder] for path in (ROOT / folder).glob(pattern)]
    return sorted(path for path in found if path.name[0] != "_")


def _page(path: Path) -> str:
    where = path.relative_to(ROOT)
    return f"{where.parent.as_posix()}/{path.stem}-{path.suffix[1:]}.md"


def _list(folder: str) -> str:
    shown = [(path, path.relative_to(ROOT).as_posix()) for path in _shown(folder)]
    rows = "\n".join(f"| [{path.name}](../../{where}) | {_told(path)} |" for path, where in shown)
    return f"| file | holds |\n| --- | --- |\n{rows}\n"


def _told(path: Path) -> str:
    """Return what a file says about itself: the first line of a script, the name in a TOML file, a notebook's title."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        return _cells(text)[0][1].partition("\n")[0].lstrip("# ")
    if path.suffix == ".toml":
        return str(tomllib.loads(text)["name"])
    return (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


def _picture(uri: str, k: int) -> str:
    return f"{uri.removesuffix('.md').replace('/', '-')}-{k + 1}"


def _cells(text: str) -> list[tuple[str, str]]:
    """Return kind and text of every cell of a notebook."""
    return [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"]]


def _listing(path: Path) -> str:
    where = path.relative_to(ROOT).as_posix()
    if path.suffix == ".ipynb":
        cells = _cells(path.read_text(encoding="utf-8"))
        return "\n\n".join(text if kind == "markdown" else f"````python\n{text}\n````" for kind, text in cells) + "\n"
    language = {".py": "python", ".toml": "toml"}[path.suffix]
    hidden = "---\nsearch:\n  exclude: true\n---\n\n"  # its words are those of the pages that lead to it
    return f"{hidden}# {where}\n\n````{language}\n{path.read_text(encoding='utf-8').rstrip()}\n````\n"


def _page_of(link: str, uri: str, up: str) -> str:
    """Return the page in the site of a file of the repository that a page of docs/ links to."""
    target = posixpath.normpath(posixpath.join("docs", posixpath.dirname(uri), link))
    if target == "CONTRIBUTING.md":
        return f"{up}contributing.md"
    if target in SHOWN:
        return f"{up}start/examples.md#{target}"
    stem, _, suffix = target.rpartition(".")
    if posixpath.dirname(stem) == "examples/gallery":
        return f"{up}start/gallery.md#{posixpath.basename(stem)}"
    return f"{up}{stem}-{suffix}.md"
