"""``fdd validate``: how good the whole path is on a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

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
        typer.Option(
            "--out",
            "-o",
            help="Folder for validation.md, disturbed.md or left_out.md.",
            show_default=False,
        ),
    ] = None,
    disturbed: Annotated[
        bool,
        typer.Option(
            "--disturbed",
            help="Compare instead the answers on logs that are cut, holed, mirrored or kept in other units.",
        ),
    ] = False,
    without_each: Annotated[
        bool,
        typer.Option(
            "--without-each", help="Say instead what is made of faults that the catalogue does not have."
        ),
    ] = False,
    workers: WorkersOption = None,
    engine: EngineOption = "local",
) -> None:
    """Diagnose every log of a data set and compare with its truth."""
    from fdd.errors import InputError
    from fdd.files import require_writable, write_text, written

    if disturbed and without_each:
        raise InputError("--disturbed and --without-each are two questions", mend="ask one of them")
    if out is not None:
        require_writable(out, folder=True)

    from fdd.campaign import disturb, left_out
    from fdd.campaign.dataset import Dataset
    from fdd.campaign.validate import outcomes_csv, report_text, summary
    from fdd.campaign.validate import validate as run
    from fdd.cli.console import progress

    data = Dataset.load(dataset)
    with progress(f"validating on {data.recipe.name}", 1.0) as advance:

        def step(done: int, total: int) -> None:
            advance(done / max(total, 1))

        how: Any = {"workers": workers, "engine": engine, "progress": step}
        if disturbed:
            told = disturb.table(disturb.compare(dataset, model, **how))
            files = {"disturbed.md": told}
        elif without_each:
            told = left_out.table(left_out.left_out(dataset, model, **how))
            files = {"left_out.md": told}
        else:
            outcomes = run(dataset, model, **how)
            told = summary(outcomes)
            files = {"validation.md": report_text(outcomes, data), "outcomes.csv": outcomes_csv(outcomes)}
    print(told, end="")
    if out is not None:
        with written(out):
            out.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            write_text(out / name, text)
        print(f"Written to {out}")
