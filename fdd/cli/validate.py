"""``fdd validate``: how good the whole path is on a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.options import EngineOption, WorkersOption


def validate(
    dataset: Annotated[Path, typer.Argument(help="Folder that fdd generate made.", show_default=False)],
    model: Annotated[
        str | None,
        typer.Option(help="Model file that fdd train wrote; the shipped one else.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for validation.md and outcomes.csv.", show_default=False),
    ] = None,
    workers: WorkersOption = None,
    engine: EngineOption = "local",
) -> None:
    """Diagnose every log of a data set and compare with its truth."""
    from fdd.files import require_writable, write_text, written

    if out is not None:
        require_writable(out, folder=True)

    from fdd.campaign.dataset import Dataset
    from fdd.campaign.validate import outcomes_csv, report_text, summary
    from fdd.campaign.validate import validate as run
    from fdd.cli.console import progress
    from fdd.diagnosis.model import Model

    data = Dataset.load(dataset)
    with progress(f"validating on {data.recipe.name}", 1.0) as advance:

        def step(done: int, total: int) -> None:
            advance(done / max(total, 1))

        outcomes = run(dataset, model, workers=workers, engine=engine, progress=step)
    asked = Model.load(model)
    print(summary(outcomes, asked), end="")
    if out is not None:
        with written(out):
            out.mkdir(parents=True, exist_ok=True)
        write_text(out / "validation.md", report_text(outcomes, data, asked))
        write_text(out / "outcomes.csv", outcomes_csv(outcomes))
        print(f"Written to {out}")
