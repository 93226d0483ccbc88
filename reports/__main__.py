"""``python -m reports NAME``: each command measures one report, or prints one table of a data set."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from fdd.campaign.dataset import How, over_units
from fdd.cli.command import Commands, EngineOption, WorkersOption, prepare_process
from fdd.cli.console import counted
from fdd.diagnosis.model import Model
from reports import datasets, disturbed
from reports.estimators.report import estimators
from reports.live.report import load, outage, soak
from reports.plant.report import plant
from reports.thesis.report import thesis
from reports.troubles import troubles

DatasetArgument = Annotated[Path, typer.Argument(help="Folder that fdd generate made.", show_default=False)]
ModelOption = Annotated[
    str | None, typer.Option(help="Of fdd train; the shipped one else.", show_default=False)
]

app = typer.Typer(
    name="reports", cls=Commands, add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True,
    help="Measure what README and reports say of fdd.",
)  # fmt: skip
for command in (thesis, plant, estimators, load, outage, soak, troubles):
    app.command()(command)


def of_data_set(measure: Callable[..., list[Any]], table: Callable[[Any], str], words: str) -> None:
    """Add a command that measures something of each unit of a data set and prints a table."""

    def command(
        dataset: DatasetArgument, model: ModelOption = None, workers: WorkersOption = None,
        engine: EngineOption = "local",
    ) -> None:  # fmt: skip
        with counted(dataset.name) as advance:
            how = How(workers=workers, engine=engine, progress=advance)
            found = over_units(measure, [dataset], Model.load(model), **how)
        print(table(found), end="")

    app.command(measure.__name__.replace("_", "-"), help=words)(command)


for measure, table, words in (
    (datasets.budget, datasets.budget_table,
     "Where visible faults are lost, and what healthy logs differ by."),
    (datasets.identification, datasets.identification_table,
     "Identify each unit from its data sheet: refusals, and do deviations come true?"),
    (datasets.scales, datasets.scales_table,
     "Read healthy logs in wrong units of measure: refused, or warned of?"),
    (disturbed.disturbed, disturbed.disturbed_table, "Compare answers on logs holed, resampled or mirrored."),
    (datasets.left_out, datasets.left_out_table, "Diagnose faulty logs without their fault's signatures."),
):  # fmt: skip
    of_data_set(measure, table, words)

if __name__ == "__main__":
    prepare_process()
    app(prog_name="python -m reports")
