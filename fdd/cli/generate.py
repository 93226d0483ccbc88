"""``fdd generate``: a labelled fault-injection data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.options import EngineOption, WorkersOption


def generate(
    recipe: Annotated[Path, typer.Argument(help="Recipe of the campaign (YAML).", show_default=False)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the data set.", show_default=False)],
    workers: WorkersOption = None,
    units: Annotated[
        int | None, typer.Option(min=1, help="Units, instead of the recipe's.", show_default=False)
    ] = None,
    logs: Annotated[
        int | None,
        typer.Option(min=0, help="Logs of each unit, instead of the recipe's.", show_default=False),
    ] = None,
    twins: Annotated[
        bool | None,
        typer.Option(
            "--twins/--no-twins",
            show_default=False,
            help="Each faulty log once more without its faults, instead of the recipe's; twice the time.",
        ),
    ] = None,
    engine: EngineOption = "local",
) -> None:
    """Generate a labelled data set of simulated runs."""
    from fdd.files import require_writable, written

    require_writable(out, folder=True)

    from fdd.campaign.generate import generate as run
    from fdd.campaign.recipe import Recipe
    from fdd.cli.console import progress

    campaign = Recipe.load(recipe)
    given = {"units": units, "logs_per_unit": logs, "twins": twins}
    asked = {name: value for name, value in given.items() if value is not None}
    if asked:
        campaign = Recipe(**{**campaign.model_dump(by_alias=True), **asked})
    with progress(f"generating {out.name}", 1.0) as advance, written(out):
        run(
            campaign,
            out,
            workers=workers,
            engine=engine,
            progress=lambda done, total: advance(done / max(total, 1)),
        )
    print(f"Data set written to {out}")
