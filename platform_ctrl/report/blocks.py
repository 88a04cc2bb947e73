"""The content of a page: sections of blocks in their order, prepared once, and set as HTML.

Everything in a block is text, to be shown as it is; only a plate's picture is markup.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from platform_ctrl.common.files import templates
from platform_ctrl.common.palette import PALETTE, declarations
from platform_ctrl.common.values import value
from platform_ctrl.errors import began_with_interrupt, reason
from platform_ctrl.job.quantities import tied
from platform_ctrl.report import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@value
class Cell:
    """A cell of a table."""

    text: str  # The content
    note: str = ""  # Below the text, small
    tone: str = ""  # "good", "bad", "quiet" or nothing
    bar: float | None = None  # A bar after the text, filled by a share from 0 to 1


@value
class Column:
    """A column: its title, a line below that, whether it holds numbers, and whether it is the one that counts."""

    title: str
    tag: str = ""
    number: bool = False
    strong: bool = False


@value
class Row:
    """Cells, the first of which names the row."""

    cells: tuple[Cell, ...]  # One for each column
    missed: bool = False  # Whether it is a requirement that is not met
    name: str = ""  # Where links to it lead; empty: nowhere


@value
class Group:
    """Rows under a title; nothing where there is only one group. `quiet`: it counts less than the others."""

    rows: tuple[Row, ...]
    title: str = ""
    quiet: bool = False


@value
class Table:
    """A table; without titles it has no head."""

    kind: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    groups: tuple[Group, ...]
    form: str = ""  # "requirements", "designs", "narrow" or nothing

    @property
    def headed(self) -> bool:
        """Whether there is a head."""
        return any(column.title for column in self.columns)


@value
class Paragraph:
    """Running text; `tone` is ``quiet``, ``bad`` or nothing."""

    kind: ClassVar[str] = "paragraph"
    text: str
    tone: str = ""


@value
class Missing(Paragraph):
    """A note in place of a figure or a part of the page that could not be made: its name, and why."""


@value
class Verdict:
    """The banner: the verdict in a few words, what is not met, and an aside."""

    kind: ClassVar[str] = "verdict"
    passed: bool
    words: str
    lines: tuple[str, ...] = ()
    aside: str = ""


@value
class Plate:
    """A figure: its SVG, its title, and a sentence on what to see."""

    kind: ClassVar[str] = "plate"
    svg: str
    title: str
    caption: str
    small: bool = False


@value
class Listing:
    """Text to be copied: a command, or a file of that name."""

    kind: ClassVar[str] = "listing"
    text: str
    file: str = ""


@value
class Subsection:
    """Blocks under a heading of their own; folded ones a page shows when their title is clicked, paper shows them."""

    kind: ClassVar[str] = "part"
    title: str
    blocks: tuple[Block, ...]
    folded: bool = False


@value
class Columns:
    """Blocks side by side where there is room for two columns."""

    kind: ClassVar[str] = "columns"
    left: tuple[Block, ...]
    right: tuple[Block, ...]


@value
class Distance:
    """A mark of `Distances`: place from 0 to 1, row of marks from 0 up, words, and the name of the row it leads to."""

    at: float
    level: int
    words: str
    row: str
    passed: bool


@value
class Distances:
    """Requirements by their distance to the limit: marks above an axis with its ticks (place, words) and the limit."""

    kind: ClassVar[str] = "distances"
    words: str
    marks: tuple[Distance, ...]
    ticks: tuple[tuple[float, str], ...]
    limit: float

    @property
    def levels(self) -> int:
        """Rows of marks."""
        return 1 + max((mark.level for mark in self.marks), default=0)


Block = Paragraph | Verdict | Table | Plate | Listing | Subsection | Columns | Distances


@value
class PageSection:
    """A section: where links lead, its title, and its blocks. The first of a page may have no title."""

    name: str
    title: str
    blocks: tuple[Block, ...]
    verdict: str = ""  # On the section, beside its title
    passed: bool = True  # What that verdict is


@value
class PageContent:
    """A whole page."""

    kicker: str  # What kind of page it is
    title: str  # Name of the job
    source: str  # The platform and where its numbers come from
    # In a few words, for the title of a window and the head of printed pages
    passed: bool
    verdict: str
    sections: tuple[PageSection, ...]


def sentence(text: str) -> str:
    """Return text with a capital first letter, the rest unchanged."""
    return text[:1].upper() + text[1:]


def columns(titles: str, numbers: str = "") -> tuple[Column, ...]:
    """Return columns; `titles` and those of the columns of numbers have ``|`` between them."""
    return tuple(Column(title=title, number=title in numbers.split("|")) for title in titles.split("|"))


def cells(*texts: str) -> tuple[Cell, ...]:
    """Return plain cells."""
    return tuple(Cell(text=text) for text in texts)


def table(titles: str, rows: Sequence[Sequence[str]], *, numbers: str = "", form: str = "") -> Table:
    """Return a plain table: columns as `columns`, a text for each cell, and the form of `Table`."""
    body = tuple(Row(cells=cells(*row)) for row in rows)
    return Table(columns=columns(titles, numbers), groups=(Group(rows=body),), form=form)


def made(title: str, make: Callable[[], Block | Sequence[Block] | None]) -> tuple[Block, ...]:
    """Return the blocks that `make` returns; where it fails, words instead: no part of a page costs the others."""
    try:
        found = make()
    except Exception as error:
        if began_with_interrupt(error):
            raise
        return (Missing(text=f"{title}: not drawn: {reason(error)}", tone="bad"),)
    if found is None:
        return ()
    return tuple(found) if isinstance(found, Sequence) else (found,)


def section(
    name: str,
    title: str,
    make: Callable[[], Block | Sequence[Block] | None],
    verdict: tuple[str, bool] = ("", True),
) -> list[PageSection]:
    """Return a section of the blocks that `make` returns, with the verdict on it; none where there are no blocks."""
    words, passed = verdict
    blocks = made(title or name, make)
    return [PageSection(name=name, title=title, blocks=blocks, verdict=words, passed=passed)] if blocks else []


def drawn(
    title: str, draw: Callable[[], Figure | None], caption: str | Callable[[], str], *, small: bool = False
) -> tuple[Block, ...]:
    """Return the plate of the figure that `draw` returns; nothing where it returns none."""

    def make() -> Plate | None:
        figure = draw()
        if figure is None:
            return None
        words = caption if isinstance(caption, str) else caption()
        # Title and caption describe it too where it cannot be seen.
        return Plate(svg=style.svg(figure, f"{title}. {words}"), title=title, caption=words, small=small)

    return made(title, make)


def missing(item: Any) -> list[str]:
    """Return the words on all that is missing in blocks, of a document with the titles of its sections."""
    if isinstance(item, PageContent):
        return [f"{one.title or one.name}: {words}" for one in item.sections for words in missing(one.blocks)]
    if isinstance(item, Missing):
        return [item.text]
    if dataclasses.is_dataclass(item):
        item = [getattr(item, field.name) for field in dataclasses.fields(item)]
    return [words for one in item for words in missing(one)] if isinstance(item, list | tuple) else []


def html(document: PageContent) -> str:
    """Return a document as a page that needs nothing else."""
    palette = {theme: declarations(colours) for theme, colours in PALETTE.items()}
    pages = templates("platform_ctrl.report", autoescape=True)
    pages.filters["tied"] = tied
    return pages.get_template("page.html").render(document=document, palette=palette)
