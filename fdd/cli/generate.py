"""``fdd generate``: a labelled fault-injection data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fdd.cli.options import EngineOption, WorkersOption, argument, option


def generate(
    recipe: Annotated[Path, argument("Recipe of the campaign (YAML).")],
    out: Annotated[Path, option("Folder of the data set.", "--out", "-o")],
    workers: WorkersOption = None,
    units: Annotated[int | None, option("Units, instead of the recipe's.", min=1)] = None,
    logs: Annotated[int | None, option("Logs of each unit, instead of the recipe's.", min=0)] = None,
    twins: Annotated[
        bool | None,
        option("Each faulty log once more without its faults, instead of the recipe's; twice the time.",
               "--twins/--no-twins"),
    ] = None,
    engine: EngineOption = "local",
) -> None:  # fmt: skip
    """Generate a labelled data set of simulated runs."""
    from fdd.files import require_writable, written

    require_writable(out, folder=True)

    from fdd.campaign.generate import generate as run
    from fdd.campaign.recipe import Recipe
    from fdd.cli.console import counted

    campaign = Recipe.load(recipe)
    given = {"units": units, "logs_per_unit": logs, "twins": twins}
    asked = {name: value for name, value in given.items() if value is not None}
    if asked:
        campaign = Recipe(**{**campaign.model_dump(by_alias=True), **asked})
    with counted(f"generating {out.name}") as step, written(out):
        run(campaign, out, workers=workers, engine=engine, progress=step)
    print(f"Data set written to {out}")
