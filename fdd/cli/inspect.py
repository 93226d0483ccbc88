"""``fdd inspect``: what a log holds, before anything is said about the actuator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

WIDE = 120
"""Columns of a terminal that has room for all figures."""

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.logs.inspection import SignalView


def inspect_log(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log of any format.", show_default=False)],
    html: Annotated[
        Path | None,
        typer.Option("--html", help="Write a page with a picture of each signal.", show_default=False),
    ] = None,
) -> None:
    """Show what a log holds: signals, units, rates, ranges, gaps, and a small picture of each."""
    from fdd.cli.console import output, progress
    from fdd.files import require_writable, write_text
    from fdd.logs.formats import open_log
    from fdd.logs.formats.registry import format_of
    from fdd.logs.inspection import inspect

    if html is not None:
        require_writable(html)
    with progress(f"reading {log.name}"):
        opened = open_log(log)
        views = inspect(opened)
    console = output()
    kind = format_of(log).name
    console.print(
        f"{log.name}: {kind}, {len(views)} signals, {log.stat().st_size / 1e6:.3g} MB", markup=False
    )
    console.print(inspection_table(views, wide=console.width >= WIDE))
    for note in opened.notes:
        console.print(f"• {note}", markup=False)
    if opened.truncated:
        console.print("• the file ends before its data does", markup=False)
    if html is not None:
        from fdd.report.inspection import inspection_page

        write_text(html, inspection_page(log.name, kind, views))
        console.print(f"Page written to {html}", markup=False)


def inspection_table(views: list[SignalView], *, wide: bool) -> Table:
    """A row a signal; in a narrow window without what matters less."""
    import math

    from rich import box
    from rich.table import Table
    from rich.text import Text

    from fdd.logs.inspection import picture

    def number(value: float, digits: int = 4) -> str:
        return "" if math.isnan(value) else f"{value:.{digits}g}"

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("signal", overflow="fold")
    table.add_column("unit", no_wrap=True)
    numbers = ("Hz", "missing", "least", "most")
    for title in (*numbers, *(("rows", "gap s", "median") if wide else ())):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("course", no_wrap=True)
    for v in views:
        if v.problem:
            blank = [""] * (7 if wide else 4)
            table.add_row(Text(v.name), Text(v.unit), *blank, Text(v.problem[:40], style="yellow"))
            continue
        more = (str(v.rows), number(v.longest_gap, 3), number(v.middle)) if wide else ()
        table.add_row(
            Text(v.name),
            Text(v.unit),
            number(v.rate),
            str(v.missing or ""),
            number(v.low),
            number(v.high),
            *more,
            picture(v.values, 32 if wide else 12),
        )
    return table
