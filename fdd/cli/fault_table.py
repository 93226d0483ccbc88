"""``fdd simulate --list-faults``: the fault catalogue for people at a terminal."""

from __future__ import annotations

from rich import box
from rich.table import Table
from rich.text import Text

from fdd.faults import ADDED_BY, CATALOGUE

WIDTH_IN_A_FILE = 160
"""Columns where the table does not go to a terminal."""

CAPTION = "Of variants, sides and laws the first is the default."


def fault_table() -> Table:
    """The catalogue: id, family, what the plant does, severity 1.0, variants and sides; below it each law."""
    table = Table(box=box.SIMPLE_HEAD, show_lines=False, pad_edge=False, caption=CAPTION)
    table.add_column("fault", no_wrap=True)
    table.add_column("family", no_wrap=True)
    table.add_column("what the plant does", ratio=3)
    table.add_column("severity 1.0", ratio=3)
    table.add_column("variants", ratio=1)
    table.add_column("sides", no_wrap=True)
    for entry in CATALOGUE.values():
        plain = (
            entry.id,
            entry.family,
            entry.plant + ("" if entry.simulated else " (not simulated)") + _origin(entry.id),
            entry.severity,
            ", ".join(entry.variants),
            ", ".join(map(str, entry.sides)),
        )
        table.add_row(*(Text(cell) for cell in plain), style="" if entry.simulated else "dim")
        for law, words in entry.laws.items():
            table.add_row(Text(f"  law={law}"), "", Text(words))
    return table


def _origin(name: str) -> str:
    return f" (package {ADDED_BY[name]})" if name in ADDED_BY else ""


def show_faults() -> None:
    """Print the catalogue on standard output."""
    from fdd.cli.console import output

    console = output()
    if not console.is_terminal:
        console.width = WIDTH_IN_A_FILE
    console.print(fault_table())
