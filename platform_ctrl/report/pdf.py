"""The report as PDF: the same document as the page, set by typst.

The document goes in as data: the template shows every text as it is, whatever characters are in it.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
from importlib import resources
from pathlib import Path
from types import ModuleType
from typing import Any

from platform_ctrl.common.files import write_whole
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.errors import InputError, PlatformCtrlError
from platform_ctrl.report.axes.picture import theme_colours
from platform_ctrl.report.page.blocks import Document, Listing, Plate
from platform_ctrl.report.page.job_page import prepared
from platform_ctrl.verification.verdict import JobResult

# What XML 1.0 cannot hold, and other control characters: nothing that can be set.
_UNSETTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff\ufffe\uffff]")
_LONG = re.compile(r"\S{60,}")
_VARIABLE = re.compile(r"var\(--([a-z0-9-]+)(?:, *#[0-9a-f]+)?\)")
# Fonts of figures: those they are laid out for.
_FIGURE_FONT = "DejaVu Sans"


@check_arguments
def write_pdf(result: JobResult | Document, path: str | os.PathLike[str]) -> Path:
    """Write the report as PDF to `path`: the whole file, or nothing if that fails.

    Parameters
    ----------
    result
        From `platform_ctrl.report.prepared`, or from `platform_ctrl.verification.check_job` if none of its options is
        needed.
    path
        The file; an existing one is replaced.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        The file cannot be written, or typst is not installed.
    PlatformCtrlError
        Typst could not set the document.
    """
    return write_whole(path, pdf_bytes(result))


@check_arguments
def pdf_bytes(result: JobResult | Document) -> bytes:
    """Return the report as PDF: the content of the page in the same order; the same bytes for the same result."""
    typst = typesetter()
    return typeset(typst, prepared(result))


def typesetter() -> ModuleType:
    """Return the module typst."""
    try:
        import typst
    except ImportError:
        raise InputError("a PDF is set by typst, which is not installed: pip install 'platform_ctrl[pdf]'") from None
    return typst


def typeset(typst: ModuleType, content: Document) -> bytes:
    """Return a document as PDF."""
    import matplotlib as mpl

    templates = resources.files("platform_ctrl.report") / "templates"
    colours = theme_colours("light")
    data = plain_data(content, colours) | {"colours": colours}
    inputs = {"document": json.dumps(data, ensure_ascii=False)}
    fonts = [str(Path(mpl.get_data_path()) / "fonts" / "ttf")]
    template = templates.joinpath("report.typ").read_bytes()
    # A letter that no font has breaks the standard of accessible documents: it is shown as a box then.
    for standards in (["ua-1"], []):
        try:
            made = typst.compile(template, font_paths=fonts, sys_inputs=inputs, timestamp=0, pdf_standards=standards)
        except RuntimeError as error:
            words = " ".join(str(error).split())
        else:
            return bytes(made)
    raise PlatformCtrlError(f"the report cannot be typeset as PDF, typst reports: {words}")


def plain_data(item: Any, colours: dict[str, str]) -> Any:
    """Return a document as dicts, lists, text and numbers, its pictures in the colours of the light page."""
    if isinstance(item, str):
        return _LONG.sub(_breakable, _UNSETTABLE.sub("\ufffd", item))
    if isinstance(item, tuple):
        return [plain_data(one, colours) for one in item]
    if not dataclasses.is_dataclass(item):
        return item
    data = {field.name: plain_data(getattr(item, field.name), colours) for field in dataclasses.fields(item)}
    if hasattr(item, "kind"):
        data["kind"] = item.kind
    if isinstance(item, Plate):
        data["svg"] = standalone_svg(item.svg, colours)
    if isinstance(item, Listing):
        data["attached"] = item.text if item.file else ""
    return data


def _breakable(word: re.Match[str]) -> str:
    """Return a long word in which a line may end: otherwise it would leave the page."""
    return "\u200b".join(re.findall(r".{1,20}", word[0]))


def standalone_svg(svg: str, colours: dict[str, str]) -> str:
    """Return a picture of the page as a file of its own: colours in place of variables, and the font of figures."""
    svg = _VARIABLE.sub(lambda found: colours.get(found[1], found[0]), svg)
    head, _, rest = svg.partition("<svg")
    space = "" if "xmlns=" in rest.partition(">")[0] else ' xmlns="http://www.w3.org/2000/svg"'
    rest = rest.replace("system-ui,-apple-system", f"'{_FIGURE_FONT}',system-ui")
    return _UNSETTABLE.sub("\ufffd", f'{head}<svg{space} font-family="{_FIGURE_FONT}"{rest}')
