"""``fdd validate``: how good the whole path is on a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fdd.cli.options import DatasetArgument, EngineOption, WorkersOption, option


def validate(
    dataset: DatasetArgument,
    model: Annotated[str | None, option("Model file that fdd train wrote; the shipped one else.")] = None,
    out: Annotated[Path | None, option("Folder for validation.md and outcomes.csv.", "--out", "-o")] = None,
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
    from fdd.cli.console import counted
    from fdd.diagnosis.model import Model

    data = Dataset.load(dataset)
    with counted(f"validating on {data.recipe.name}") as step:
        outcomes = run(dataset, model, workers=workers, engine=engine, progress=step)
    asked = Model.load(model)
    print(summary(outcomes, asked), end="")
    if out is not None:
        with written(out):
            out.mkdir(parents=True, exist_ok=True)
        write_text(out / "validation.md", report_text(outcomes, data, asked))
        write_text(out / "outcomes.csv", outcomes_csv(outcomes))
        print(f"Written to {out}")
