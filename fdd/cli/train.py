"""``fdd train``: a classifier from a data set."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.campaign.train import TrainingReport


def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that fdd generate made.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the model.", show_default=False)],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; one for each core else.", show_default=False)
    ] = None,
) -> None:
    """Train a classifier and tell how it does on units that it has not seen."""
    from fdd.files import require_writable, written

    require_writable(out, folder=True)

    from fdd.campaign.train import train as fit
    from fdd.cli.console import output, progress

    try:
        with progress(f"training on {dataset.name}", 1.0) as advance:
            model, report = fit(
                dataset,
                workers=workers or os.cpu_count() or 1,
                progress=lambda done, total: advance(done / max(total, 1)),
            )
    except InputError as error:
        raise (error if error.where else error.at(dataset)) from None
    with written(out):
        model.save(out)
    console = output()
    console.print(confusion_table(report))
    for line in figures(report):
        print(line)
    print(f"Model written to {out}")


def confusion_table(report: TrainingReport) -> Table:
    """Logs by true family (rows) and answer (columns), over units left out of training."""
    from rich import box
    from rich.table import Table

    table = Table(title="Cross-validated over units: logs by true family and answer", box=box.SIMPLE_HEAD)
    table.add_column("true family")
    for name in report.families:
        table.add_column(name.replace("_", " "), justify="right")
    table.add_column("no alarm", justify="right")
    for name, row in zip(report.families, report.confusion, strict=False):
        table.add_row(name.replace("_", " "), *(str(count) if count else "·" for count in row))
    return table


def figures(report: TrainingReport) -> list[str]:
    """The summary below the table, a sentence each."""
    import numpy as np

    lines = [
        f"Isolated: {100.0 * report.isolated:.1f} % of faulty logs got the right family.",
        f"False alarms: {report.false_alarms} in {report.healthy_hours:.2f} h without a fault.",
    ]
    if report.delays.size:
        half, most = np.percentile(report.delays, [50.0, 90.0])
        lines.append(f"Delay from onset to alarm: {half:.1f} s median, {most:.1f} s for nine in ten.")
    return lines
