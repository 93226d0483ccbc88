"""``fdd identify``: a unit's own profile from its healthy logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fdd.cli.options import (
    AxisOption,
    JsonOption,
    MapOption,
    argument,
    option,
    require_outputs,
    units,
    write_json,
)

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.identification import Identification
    from fdd.identification.from_logs import Identified
    from fdd.identification.profile import TableRow

WIDE = 120
"""Columns of a terminal that has room for notes."""


def identify(
    logs: Annotated[list[Path], argument("Logs of this unit while healthy.", "HEALTHY_LOG...")],
    out: Annotated[Path, option("Profile to write (YAML).", "--out", "-o")],
    base: Annotated[
        str,
        typer.Option(help="Profile of a similar unit: a YAML file or a shipped one.", autocompletion=units),
    ] = "axis_a",
    map_: MapOption = None,
    axis: AxisOption = None,
    name: Annotated[str | None, option("Name of the new profile; by default base, date, hash.")] = None,
    add: Annotated[
        Path | None, option("Narrow this identified profile with more logs.", metavar="PROFILE")
    ] = None,
    accept: Annotated[bool, typer.Option(help="Write a profile that would be refused.")] = False,
    json_: JsonOption = None,
    verbose: Annotated[bool, typer.Option(help="Sensors and notes too.")] = False,
) -> None:
    """Identify a unit from its healthy logs, so that its own spread is no fault."""
    import json

    from fdd.cli.console import progress
    from fdd.identification.from_logs import identify_logs

    require_outputs(json_, out)
    made = identify_logs(logs, base, map_, add=add, axis=axis, name=name, accept=accept, progress=progress)
    made.unit.save(out)
    write_json(json_, json.dumps(_as_data(made), indent=1, ensure_ascii=False))
    if json_ != "-":
        _print_result(made, out, verbose=verbose)


def _print_result(made: Identified, out: Path, *, verbose: bool) -> None:
    """The verdict, the table, and with `verbose` sensors and notes."""
    from fdd.cli.console import output

    found, judged, unit = made.found, made.judged, made.unit
    console = output()
    wide = console.width >= WIDE
    console.print(judged.sentence + (" (accepted)" if judged.refusals else ""), soft_wrap=True)
    console.print(_physics_table(found, sensors=verbose, notes=verbose and wide))
    if verbose:
        for note in found.notes:
            console.print(f"• {note}")
    for remark in judged.remarks:
        console.print(f"• {remark}", soft_wrap=True)
    seconds = 0.0 if unit.baseline is None else unit.baseline.seconds
    told = f"Healthy baseline from {seconds:.0f} s. Profile {unit.name} written to {out}"
    console.print(told, soft_wrap=True)


def _as_data(made: Identified) -> dict[str, Any]:
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
             "word": _word(r), "note": r.note}
            for r in (*found.balances, *found.table)
        ],
        "notes": found.notes,
    }  # fmt: skip


def _physics_table(found: Identification, *, sensors: bool, notes: bool) -> Table:
    """Quantity, before, after, its 95 % uncertainty, unit, and a plain word."""
    from fdd.cli.console import NARROW, grid
    from fdd.identification.experiments.outcome import NORMAL_95, SHOWN

    numbers = ("before", "after", "± (95 %)")
    heads, shape = ("quantity", *numbers, "unit", ""), {"collapse_padding": True, **NARROW}
    table = grid(heads, numbers=numbers, whole=("unit",), **shape)
    rows = found.balances or [r for r in found.table if sensors or not r.quantity.startswith("sensors.")]
    for row in rows:
        factor, unit = SHOWN.get(row.unit, (1.0, row.unit))
        table.add_row(
            row.quantity.replace(".", " ").replace("_", " "),
            f"{factor * row.base:.4g}",
            f"{factor * (row.base if row.identified is None else row.identified):.4g}",
            "" if row.std is None else f"{float(f'{NORMAL_95 * factor * row.std:.2g}'):g}",
            unit,
            _word(row) + (f" ({row.note})" if row.note and (notes or found.balances) else ""),
            style="dim" if row.identified is None else "",
        )
    return table


def _word(row: TableRow) -> str:
    """Whether a number is this unit's own, and if not why."""
    if row.identified is not None:
        return "identified"
    return "kept, not measured" if "measured" in row.note else "kept, the logs do not excite it"
