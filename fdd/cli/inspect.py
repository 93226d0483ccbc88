"""``fdd inspect``: what a log holds, before anything is said about the actuator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fdd.cli.options import argument, option

WIDE = 120
"""Columns of a terminal that has room for all figures."""

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.logs.inspection import SignalView


def inspect(
    log: Annotated[Path, argument("A log of any format.", "LOG")],
    html: Annotated[Path | None, option("Write a page with a picture of each signal.")] = None,
) -> None:
    """Show what a log holds: signals, units, rates, ranges, gaps, and a small picture of each."""
    from fdd.cli.console import output, progress
    from fdd.files import require_writable, write_text
    from fdd.logs.formats import open_log
    from fdd.logs.formats.registry import format_of
    from fdd.logs.inspection import inspect as inspected

    if html is not None:
        require_writable(html)
    with progress(f"reading {log.name}"):
        opened = open_log(log)
        views = inspected(opened)
    console = output()
    kind = format_of(log).name
    console.print(f"{log.name}: {kind}, {len(views)} signals, {log.stat().st_size / 1e6:.3g} MB")
    console.print(inspection_table(views, wide=console.width >= WIDE))
    for note in opened.notes:
        console.print(f"• {note}")
    if opened.truncated:
        console.print("• the file ends before its data does")
    if html is not None:
        from fdd.report.inspection import inspection_page

        write_text(html, inspection_page(log.name, kind, views))
        console.print(f"Page written to {html}")


def inspection_table(views: list[SignalView], *, wide: bool) -> Table:
    """A row a signal; in a narrow window without what matters less."""
    import math

    from rich.text import Text

    from fdd.cli.console import grid
    from fdd.logs.inspection import picture

    def number(value: float, digits: int = 4) -> str:
        return "" if math.isnan(value) else f"{value:.{digits}g}"

    numbers = ("Hz", "missing", "least", "most", *(("rows", "gap s", "median") if wide else ()))
    table = grid(("signal", "unit", *numbers, "course"), numbers=numbers, whole=("unit", "course"))
    for v in views:
        if v.problem:
            blank = [""] * len(numbers)
            table.add_row(Text(v.name), Text(v.unit), *blank, Text(v.problem[:40], style="yellow"))
            continue
        more = (str(v.rows), number(v.longest_gap, 3), number(v.middle)) if wide else ()
        figures = (number(v.rate), str(v.missing or ""), number(v.low), number(v.high), *more)
        table.add_row(Text(v.name), Text(v.unit), *figures, picture(v.values, 32 if wide else 12))
    return table
