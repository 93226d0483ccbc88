"""``fdd simulate --list-faults``: the fault catalogue for people at a terminal."""

from __future__ import annotations

from rich import box
from rich.table import Table
from rich.text import Text

from fdd.faults import ADDED_BY, CATALOGUE

WIDTH_IN_A_FILE = 160
"""Columns where the table does not go to a terminal."""

COLUMNS = {
    "fault": None,
    "family": None,
    "what the plant does": 3,
    "severity 1.0": 3,
    "variants": 1,
    "sides": None,
}
"""Title to its share of the width; None takes what it needs."""
CAPTION = "Of variants, sides and laws the first is the default."


def fault_table() -> Table:
    """The catalogue: id, family, what the plant does, severity 1.0, variants and sides; below it each law."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=CAPTION)
    for name, ratio in COLUMNS.items():
        table.add_column(name, no_wrap=ratio is None, ratio=ratio)
    for entry in CATALOGUE.values():
        origin = f" (package {ADDED_BY[entry.id]})" if entry.id in ADDED_BY else ""
        plant = entry.plant + ("" if entry.simulated else " (not simulated)") + origin
        sides = ", ".join(map(str, entry.sides))
        plain = (entry.id, entry.family, plant, entry.severity, ", ".join(entry.variants), sides)
        table.add_row(*map(Text, plain), style="" if entry.simulated else "dim")
        for law, words in entry.laws.items():
            table.add_row(Text(f"  law={law}"), "", Text(words))
    return table
