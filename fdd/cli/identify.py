"""``fdd identify``: a unit's own profile from its healthy logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli.options import AxisOption, MapOption
from fdd.errors import InputError

WIDE = 120
"""Columns of a terminal that has room for notes."""

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.identify import Identification


def identify(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="HEALTHY_LOG...", help="Logs of this unit while healthy.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Profile to write (YAML).", show_default=False)],
    base: Annotated[
        str, typer.Option(help="Profile of a similar unit: a YAML file or a shipped one.")
    ] = "axis_a",
    map_: MapOption = None,
    axis: AxisOption = None,
    name: Annotated[str | None, typer.Option(help="Name of the new profile.", show_default=False)] = None,
) -> None:
    """Identify a unit from its healthy logs, so that its own spread is no fault."""
    from fdd.files import require_writable

    require_writable(out)

    from pydantic import ValidationError
    from rich.text import Text

    from fdd.cli.console import output, progress
    from fdd.diagnosis.baseline import add_baseline
    from fdd.identify import identify_unit
    from fdd.logs import ChannelMap, read_log
    from fdd.unit import Unit

    profile = Unit.load(base)
    try:
        profile.model_copy().name = name or profile.name
    except ValidationError:
        raise InputError(
            f"--name {name!r} is no name", mend="use 1 to 64 letters, digits, blanks, _ . and -"
        ) from None
    channel_map = None if map_ is None else ChannelMap.load(map_)
    with progress("reading", len(logs)) as advance:
        samples = []
        for k, path in enumerate(logs):
            samples.append(read_log(path, channel_map, axis).samples)
            advance(k + 1)
    with progress("identifying"):
        found = identify_unit(samples, profile, name)
    with progress("measuring the healthy baseline"):
        unit = add_baseline(found.unit, samples)
    unit.save(out)
    console = output()
    console.print(identification_table(found, notes=console.width >= WIDE))
    for note in found.notes:
        console.print(Text(f"• {note}"))
    windows = 0 if unit.baseline is None else unit.baseline.windows
    console.print(Text(f"Healthy baseline from {windows} windows. Profile {unit.name} written to {out}"))


def identification_table(found: Identification, *, notes: bool) -> Table:
    """Quantity, base, identified value with its spread, and (where there is room) how it was found."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("quantity", no_wrap=True)
    for title in ("base", "identified", "±"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    if notes:
        table.add_column("note")
    for row in found.table:
        kept = row.identified is None
        table.add_row(
            Text(row.quantity),
            f"{row.base:.4g}",
            "kept" if row.identified is None else f"{row.identified:.4g}",
            "" if row.std is None else f"{row.std:.2g}",
            row.unit,
            *([Text(row.note)] if notes else []),
            style="dim" if kept else "",
        )
    return table
