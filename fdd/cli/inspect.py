"""``fdd inspect``: what a log holds, before anything is said about the actuator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fdd.cli.options import argument

WIDE = 120
"""Columns of a terminal that has room for all figures."""

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.logs.inspection import SignalView


def inspect(log: Annotated[Path, argument("A log of any format.", "LOG")]) -> None:
    """Show what a log holds: signals, units, rates, ranges, gaps, and a small picture of each."""
    from fdd.cli.console import output, progress
    from fdd.logs.formats import open_log
    from fdd.logs.formats.registry import format_of
    from fdd.logs.inspection import inspect as inspected

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


def inspection_table(views: list[SignalView], *, wide: bool) -> Table:
    """A row a signal, below its topic or group; in a narrow window without what matters less."""
    import math

    from rich.text import Text

    from fdd.cli.console import grid
    from fdd.logs.inspection import picture
    from fdd.logs.names import path_parts

    def number(value: float, digits: int = 4) -> str:
        return "" if math.isnan(value) else f"{value:.{digits}g}"

    numbers = ("Hz", "missing", "least", "most", *(("rows", "gap s", "median") if wide else ()))
    rows, group = [], ""
    for v in views:
        topic, name = path_parts(v.name)
        if v.name.startswith("/"):  # a topic, a point and the field in its messages
            last, _, name = name.partition(".")
            topic = f"{topic}/{last}"
        if topic != group:
            group = topic
            rows.append([topic])
        name = f"  {name}" if topic else name
        if v.problem:
            blank = [""] * len(numbers)
            rows.append([name, v.unit, *blank, v.problem[:40]])
            continue
        more = (str(v.rows), number(v.longest_gap, 3), number(v.middle)) if wide else ()
        figures = (number(v.rate), str(v.missing or ""), number(v.low), number(v.high), *more)
        rows.append([name, v.unit, *figures, picture(v.values, 32 if wide else 12)])
    columns = ("signal", "unit", *numbers, "course")
    filled = [k for k in range(len(columns)) if k == 0 or any(row[k] for row in rows if len(row) > 1)]
    shown = [columns[k] for k in filled]
    table = grid(shown, numbers=numbers, whole=("unit", "course"))
    for row in rows:
        table.add_row(*(Text(row[k]) for k in filled if k < len(row)), style="bold" if len(row) == 1 else "")
    return table
