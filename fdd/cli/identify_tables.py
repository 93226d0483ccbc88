"""What ``fdd identify`` prints: may the profile be used, what changed, and on wish everything behind it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from fdd.cli.console import NARROW, grid, output
from fdd.identification.experiments.outcome import NORMAL_95, SHOWN

if TYPE_CHECKING:
    from fdd.identification import Identification
    from fdd.identification.from_logs import Identified
    from fdd.identification.profile import TableRow

WIDE = 120
"""Columns of a terminal that has room for notes."""


def print_result(made: Identified, out: Path, *, verbose: bool) -> None:
    """Print the verdict, the table, and with `verbose` sensors and notes."""
    found, judged, unit = made.found, made.judged, made.unit
    console = output()
    wide = console.width >= WIDE
    accepted = " (accepted)" if judged.refusals else ""
    console.print(Text(judged.sentence + accepted), soft_wrap=True)
    console.print(physics_table(found, sensors=verbose, notes=verbose and wide))
    if verbose:
        for note in found.notes:
            console.print(Text(f"• {note}"))
    for remark in judged.remarks:
        console.print(Text(f"• {remark}"), soft_wrap=True)
    seconds = 0.0 if unit.baseline is None else unit.baseline.seconds
    console.print(
        Text(f"Healthy baseline from {seconds:.0f} s. Profile {unit.name} written to {out}"), soft_wrap=True
    )


def as_data(made: Identified) -> dict[str, Any]:
    """The result as ``--json`` writes it, SI; `std` is one standard deviation."""
    found, judged, unit = made.found, made.judged, made.unit
    return {
        "schema": "fdd.identification/1",
        "verdict": judged.verdict, "sentence": judged.sentence,
        "refusals": judged.refusals, "limits": judged.limits, "remarks": judged.remarks,
        "profile": unit.name,
        "baseline_seconds": 0.0 if unit.baseline is None else unit.baseline.seconds,
        "origin": None if unit.origin is None else unit.origin.to_plain(),
        "table": [
            {"quantity": r.quantity, "unit": r.unit, "before": r.base, "after": r.identified, "std": r.std,
             "word": word(r), "note": r.note}
            for r in (*found.balances, *found.table)
        ],
        "notes": found.notes,
    }  # fmt: skip


def physics_table(found: Identification, *, sensors: bool, notes: bool) -> Table:
    """Quantity, before, after, its 95 % uncertainty, unit, and a plain word."""
    numbers = ("before", "after", "± (95 %)")
    heads, shape = ("quantity", *numbers, "unit", ""), {"collapse_padding": True, **NARROW}
    table = grid(heads, numbers=numbers, whole=("unit",), **shape)
    rows = found.balances or [r for r in found.table if sensors or not r.quantity.startswith("sensors.")]
    for row in rows:
        factor, unit = SHOWN.get(row.unit, (1.0, row.unit))
        table.add_row(
            Text(row.quantity.replace(".", " ").replace("_", " ")),
            f"{factor * row.base:.4g}",
            f"{factor * (row.base if row.identified is None else row.identified):.4g}",
            "" if row.std is None else f"{float(f'{NORMAL_95 * factor * row.std:.2g}'):g}",
            unit,
            Text(word(row) + (f" ({row.note})" if row.note and (notes or found.balances) else "")),
            style="dim" if row.identified is None else "",
        )
    return table


def word(row: TableRow) -> str:
    """Whether a number is this unit's own, and if not why."""
    if row.identified is not None:
        return "identified"
    return "kept, not measured" if "measured" in row.note else "kept, the logs do not excite it"
