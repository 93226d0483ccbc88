"""``python -m reports NAME``: each command measures one report, or prints one table."""

from __future__ import annotations

import typer

from fdd.cli.failures import Commands, prepare_process
from reports.estimators.report import estimators
from reports.plant.report import plant
from reports.thesis.report import thesis

app = typer.Typer(
    name="reports", cls=Commands, add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True,
    help="Measure what README and reports say of fdd.",
)  # fmt: skip
for command in (thesis, estimators, plant):
    app.command()(command)

if __name__ == "__main__":
    prepare_process()
    app(prog_name="python -m reports")
