"""Pictures of the site, drawn by the code beside them; kept in build/ until that code or the package changes."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

from blocks import Picture, commands, pictures, pieces

from platform_ctrl.common.palette import PALETTE, declarations

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "build" / "site-pictures"
_FONT = "font-family:system-ui,-apple-system,Segoe UI,Roboto,DejaVu Sans,sans-serif"


def package_digest() -> str:
    """Return what changes whenever a picture may change."""
    found = hashlib.sha256()
    for folder, pattern in (("platform_ctrl", "**/*.py"), ("models", "*.toml"), ("docs/site", "*.py")):
        for path in sorted((ROOT / folder).glob(pattern)):
            found.update(path.read_bytes())
    return found.hexdigest()


def themes() -> dict[str, str]:
    """Return the colours of figures in light and dark, as declarations of CSS variables."""
    return {str(theme): declarations(colours) for theme, colours in PALETTE.items()}


def as_file(svg: str, theme: str) -> str:
    """Return an SVG element of `platform_ctrl.report.style.svg` as a file of its own, in one theme's colours."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" style="{theme};{_FONT}" '
    return head + svg.removeprefix("<svg ")


def of_script(path: Path, digest: str) -> str:
    """Return the picture of a gallery script: what it binds to `figure`."""
    text = path.read_text(encoding="utf-8")
    description = text.partition('"""')[2].partition("\n")[0].rstrip(".")
    return _kept([path.name, text, digest], lambda: [_svg(_figure(text, path.name), description)])[0]


def _figure(text: str, name: str) -> Any:
    """Return what a script binds to `figure`; the file that it would save is not drawn."""
    from matplotlib.pyplot import Figure

    with tempfile.TemporaryDirectory() as folder, chdir(folder), patch.object(Figure, "savefig"):
        return _run(text, name)["figure"]


def of_page(page: str, name: str, digest: str) -> list[str]:
    """Return the pictures of a page, in their order."""
    return _kept([name, page, digest], lambda: _draw(page, name)) if pictures(page) else []


def _draw(page: str, name: str) -> list[str]:
    """Run a page as far as its last picture; of its commands those that make files to start from, the tests run all."""
    from platform_ctrl.cli import main

    out: list[str] = []
    wanted = len(pictures(page))
    namespace: dict[str, Any] = {"__name__": "__page__"}
    with tempfile.TemporaryDirectory() as folder, chdir(folder), redirect_stdout(StringIO()):
        for piece in pieces(page):
            if len(out) == wanted:
                break
            if isinstance(piece, Picture):
                out.append(_svg(namespace[piece.name], piece.description))
            elif piece.title:
                Path(piece.title).write_text(piece.text, encoding="utf-8")
            elif piece.language == "python":
                exec(compile(piece.text, name, "exec"), namespace)
            elif piece.language == "console":
                for arguments, _ in commands(piece):
                    if arguments[0] == "new":
                        main(arguments)
    return out


def _run(text: str, name: str) -> dict[str, Any]:
    namespace: dict[str, Any] = {"__name__": "__page__"}
    exec(compile(text, name, "exec"), namespace)
    return namespace


def _svg(figure: Any, description: str) -> str:
    from platform_ctrl.report import style

    with style.settings():
        return style.svg(getattr(figure, "figure", None) or figure, description)


def _kept(key: list[str], make: Any) -> list[str]:
    """Return what `make` makes, or what it made for the same `key` before."""
    path = KEPT / f"{hashlib.sha256(json.dumps(key).encode()).hexdigest()}.json"
    if path.exists():
        return list(json.loads(path.read_text(encoding="utf-8")))
    made = make()
    KEPT.mkdir(parents=True, exist_ok=True)
    whole = path.with_suffix(f".{os.getpid()}")
    whole.write_text(json.dumps(made), encoding="utf-8")
    whole.replace(path)
    return list(made)
