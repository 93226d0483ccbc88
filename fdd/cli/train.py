"""``fdd train``: a classifier from a data set."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.table import Table


def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that fdd generate made.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the model.", show_default=False)],
) -> None:
    """Train a classifier and tell how it does on units that it has not seen."""
    from fdd.cli.outputs import require_writable, written

    require_writable(out, folder=True)

    from fdd.campaign.train import train as fit
    from fdd.cli.console import output, progress

    with progress(f"training on {dataset.name}", 1.0) as advance:
        model, report = fit(dataset, progress=lambda done, total: advance(done / max(total, 1)))
    with written(out):
        model.save(out)
    console = output()
    for title, figures in sections(report).items():
        console.print(results_table(title, figures))
    print(f"Model written to {out}")


def sections(report: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """A report as tables: its plain figures first, then each nested mapping."""
    plain = {k: v for k, v in report.items() if not isinstance(v, Mapping)}
    nested = {k.replace("_", " ").capitalize(): v for k, v in report.items() if isinstance(v, Mapping)}
    return ({"Cross-validated": plain} if plain else {}) | nested


def results_table(title: str, figures: Mapping[str, Any]) -> Table:
    """A table of figures; rows that are mappings themselves get a column for each of their keys."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    columns = list(dict.fromkeys(k for row in figures.values() if isinstance(row, Mapping) for k in row))
    table.add_column("")
    for column in columns or [""]:
        table.add_column(str(column).replace("_", " "), justify="right")
    for name, row in figures.items():
        cells = [row.get(c) for c in columns] if isinstance(row, Mapping) else [row]
        table.add_row(Text(str(name).replace("_", " ")), *(Text(_shown(c)) for c in cells))
    return table


def _shown(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
