"""What of a page is code, piece by piece: for the site that draws its pictures, and the tests that run it.

A page is run from top to bottom in one namespace and one empty folder. ``python`` blocks are executed; a ``text``
block right below one is what it prints. A block with ``title="FILE"`` is that file. In ``console`` blocks lines that
begin with ``$ platform-ctrl`` are run. Blocks within an HTML comment are run too, and not shown. The comment
``<!-- picture: NAME | description -->`` shows the figure that is called NAME at that point.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import NamedTuple

_PIECE = re.compile(
    r"^```(?P<language>\w*)(?:[ ]+title=\"(?P<title>[^\"]*)\")?[ ]*\n(?P<text>.*?)^```[ ]*$"
    r"|^<!-- picture: (?P<name>\w+) \| (?P<description>.*?) -->$",
    re.MULTILINE | re.DOTALL,
)


class Block(NamedTuple):
    """A fenced block of a page.

    Attributes
    ----------
    language, title, text
        As it is written; `title` is empty where there is none.
    follows
        Whether only blank lines part it from the block above.
    """

    language: str
    title: str
    text: str
    follows: bool


class Picture(NamedTuple):
    """A place where a figure is shown: its name in the page's namespace, what is on it, and the comment itself."""

    name: str
    description: str
    comment: str


def pieces(page: str) -> Iterator[Block | Picture]:
    """Yield blocks and pictures of a page in their order."""
    end = 0
    for found in _PIECE.finditer(page):
        if found["name"]:
            yield Picture(found["name"], " ".join(found["description"].split()), found[0])
        else:
            follows = not page[end : found.start()].strip() and end > 0
            yield Block(found["language"], found["title"] or "", found["text"], follows)
            end = found.end()


def commands(block: Block) -> Iterator[tuple[list[str], int]]:
    """Yield the arguments of our own commands in a console block, and the exit code that each is said to have."""
    for line in block.text.splitlines():
        if line.startswith("$ platform-ctrl "):
            command, _, expected = line[2:].partition("  # exit code ")
            yield shlex.split(command)[1:], int(expected or 0)


def blocks(page: str, language: str) -> list[str]:
    """Return the texts of a page's blocks in `language`."""
    return [piece.text for piece in pieces(page) if isinstance(piece, Block) and piece.language == language]


def pictures(page: str) -> list[Picture]:
    """Return the places of a page where figures are shown."""
    return [piece for piece in pieces(page) if isinstance(piece, Picture)]
