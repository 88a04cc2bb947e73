"""What a campaign came to, on the terminal: probabilities, what drives them, the worst runs, and the verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from platform_ctrl.cli.terminal import screen

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from platform_ctrl.campaign.rare_result import RareResult
    from platform_ctrl.campaign.summary import Summary
    from platform_ctrl.report.campaign_tables import ProbabilityRow

# Narrower terminals get lines instead of a table.
_NARROW = 100
# Worst runs that are named; the page has more.
_WORST = 3


def show_campaign(summary: Summary) -> None:
    """Print every requirement with its probability and bounds, what drives them, the worst runs, and the verdict."""
    from platform_ctrl.report import campaign_tables as tables

    console = screen()
    rows = tables.probability_rows(summary)
    if console.width >= _NARROW:
        console.print(_table(summary, rows))
    else:
        console.print(summary.plan.job.name, style="bold", markup=False)
        for row in rows:
            console.print(_line(row), markup=False)
    _show_drivers(console, summary)
    _show_worst(console, summary)
    for rare in summary.rare:
        show_rare(summary, rare)
    first, *more = tables.verdict(summary), *tables.verdict_lines(summary)
    word, style = ("PASSED", "green") if summary.passed else ("FAILED", "bold red")
    console.print(f"{word}: {first}", style=style, markup=False)
    for line in more:
        console.print(line, markup=False)


def show_rare(summary: Summary, rare: RareResult) -> None:
    """Print a rare event: its probability with its interval, what it took, and what has to come together."""
    from rich.table import Table

    from platform_ctrl.report import campaign_tables as tables

    console = screen()
    console.print(f"rare event: {tables.rare_words(rare)}", style="bold", markup=False)
    grid = Table.grid(padding=(0, 2))
    for name, words in tables.rare_rows(rare):
        grid.add_row(f"  {name}", words)
    moved = tables.moved_words(summary.plan, rare)
    if moved:
        grid.add_row("  what moves together", moved)
    console.print(grid)


def _table(summary: Summary, rows: tuple[ProbabilityRow, ...]) -> Table:
    from rich.table import Table
    from rich.text import Text

    confidence = f"{100.0 * summary.statistics.confidence:g} % bounds"
    name = summary.plan.job.name
    table = Table(title=Text(name), title_justify="left", title_style="bold", header_style="bold", expand=False)
    table.add_column("manoeuvre", overflow="fold")
    table.add_column("requirement", no_wrap=True)
    for heading in ("limit", "violations", "probability", confidence, "99 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    before = ""
    for row in rows:
        if row.group != before:
            table.add_section()
        style = "red" if row.numbers.events else ""
        table.add_row(
            Text("" if row.group == before else _named(row)),
            Text(row.requirement),
            Text(row.limit),
            Text(row.violations, style=style),
            Text(row.probability, style=style),
            Text(row.bounds),
            Text(row.high_quantile),
        )
        before = row.group
    return table


def _named(row: ProbabilityRow) -> str:
    from platform_ctrl.report.campaign_tables import ALL_MANOEUVRES

    return "all, over their limits" if row.group == ALL_MANOEUVRES else row.group


def _line(row: ProbabilityRow) -> str:
    limit = f" (at most {row.limit})" if row.limit not in ("", "–") else ""
    return f"{_named(row)}: {row.requirement}{limit}: {row.violations}, {row.probability} ({row.bounds})"


def _show_drivers(console: Console, summary: Summary) -> None:
    from platform_ctrl.report import campaign_tables as tables

    for one in summary.sensitivities:
        if one.manoeuvre is None:
            name = tables.requirement_name(one.figure)
            violating = tables.violation_drivers(one)
            more = f"; its violations by {violating}" if violating else ""
            console.print(f"{name} is driven by {tables.short_drivers(one)}{more}", markup=False)
    for found in tables.causes(summary):
        console.print(tables.contrast_words(found), markup=False)


def _show_worst(console: Console, summary: Summary) -> None:
    from platform_ctrl.report import campaign_tables as tables

    for one, words in tables.worst_rows(summary, summary.statistics.worst[:_WORST], tables.all_drivers(summary)):
        shown = f"{words[0]} {words[1]} (at most {words[2]})"
        console.print(f"worst: run {one.run}, {one.manoeuvre}: {shown}", markup=False)
