"""``fdd train``: what a data set's healthy and faulty logs teach of the evidence."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.campaign.train import ScoredLog


def train(
    datasets: Annotated[
        list[Path], typer.Argument(help="Folders that fdd generate made.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Model file (JSON).", show_default=False)],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; one for each core else.", show_default=False)
    ] = None,
) -> None:
    """Learn from data sets how often healthy logs reach a score, and what a score is worth."""
    from fdd.files import require_writable

    require_writable(out)

    from fdd.campaign.train import train as fit
    from fdd.cli.console import output, progress

    try:
        with progress("training", 1.0) as advance:
            model, logs = fit(
                datasets,
                workers=workers or os.cpu_count() or 1,
                progress=lambda done, total: advance(done / max(total, 1)),
            )
    except InputError as error:
        raise (error if error.where else error.at(datasets[0])) from None
    model.save(out)
    output().print(confusion_table(logs))
    tail = model.tail
    print(
        f"Healthy: {tail.hours:.2f} h; scores pass {tail.height:.2f} {tail.rate_per_hour:.2f} times an hour, "
        f"and {tail.threshold(1.0):.2f} once."
    )
    print(f"A score of {model.calibration.midpoint:.2f} is a fault as likely as not.")
    print(f"Model written to {out}")


def confusion_table(logs: list[ScoredLog]) -> Table:
    """Logs by true family (rows) and answer (columns)."""
    from rich import box
    from rich.table import Table

    families = sorted({x.family for x in logs})
    answers = [*sorted({x.answer for x in logs if x.answer}), ""]
    table = Table(title="Logs by true family and answer", box=box.SIMPLE_HEAD)
    table.add_column("true family")
    for name in answers:
        table.add_column(name.replace("_", " ") or "no alarm", justify="right")
    for family in families:
        counts = [sum(x.family == family and x.answer == a for x in logs) for a in answers]
        table.add_row(family.replace("_", " "), *(str(c) if c else "·" for c in counts))
    return table
