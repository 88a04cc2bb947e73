"""The gallery: a script of examples/gallery, a section."""

from __future__ import annotations

import html
from pathlib import Path
from typing import NamedTuple

from pictures import ROOT

FOLDER = ROOT / "examples" / "gallery"


class Script(NamedTuple):
    """A script of the gallery: its name, the two parts of its docstring, and what a user copies."""

    name: str
    title: str
    text: str
    code: str


def scripts() -> list[Script]:
    """Return the scripts of the gallery by their titles."""
    return sorted((_read(path) for path in FOLDER.glob("*.py")), key=lambda script: script.title.lower())


def _read(path: Path) -> Script:
    text = path.read_text(encoding="utf-8")
    docstring = text.split('"""')[1]
    title, _, rest = docstring.strip().partition("\n")
    return Script(path.stem, title.rstrip("."), rest.strip(), text.split('"""', 2)[2].strip())


def page() -> str:
    """Return the gallery as Markdown: an overview, then every plot with its code."""
    found = scripts()
    cards = "\n".join(_card(script) for script in found)
    sections = "\n\n".join(_section(script) for script in found)
    return f'<div class="gallery-overview">\n{cards}\n</div>\n\n{sections}\n'


def figure(name: str, description: str, caption: bool = False) -> str:
    """Return a picture of the site as HTML, one file for light and one for dark pages."""
    told = html.escape(description, quote=True)
    images = "".join(
        f'<a class="only-{theme}" href="{name}-{theme}.svg">'
        f'<img src="{name}-{theme}.svg" alt="{told}" loading="lazy"></a>'
        for theme in ("light", "dark")
    )
    below = f"<figcaption>{html.escape(description)}</figcaption>" if caption else ""
    return f'<figure class="plot">{images}{below}</figure>'


def _card(script: Script) -> str:
    images = "".join(
        f'<img class="only-{theme}" src="../pictures/gallery/{script.name}-{theme}.svg" alt="" loading="lazy">'
        for theme in ("light", "dark")
    )
    return f'<a class="gallery-card" href="#{script.name}">{images}<span>{html.escape(script.title)}</span></a>'


def _section(script: Script) -> str:
    picture = figure(f"../pictures/gallery/{script.name}", script.title)
    return f"## {script.title} {{#{script.name}}}\n\n{script.text}\n\n{picture}\n\n```python\n{script.code}\n```"
