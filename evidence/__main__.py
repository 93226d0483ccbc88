"""``python -m evidence``: each command remakes one report."""

from __future__ import annotations

import typer

from evidence.commands.diagnosis import budget, disturbed, identification, left_out, scales
from evidence.commands.estimators import estimators
from evidence.commands.load import load
from evidence.commands.plant import plant
from evidence.commands.soak import soak
from evidence.commands.thesis import thesis
from evidence.commands.troubles import troubles
from fdd.cli.failures import Commands, prepare_process

app = typer.Typer(
    name="evidence", cls=Commands, add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True,
    help="Measure what README and reports say of fdd.",
)  # fmt: skip
for command in (
    thesis,
    plant,
    estimators,
    disturbed,
    left_out,
    budget,
    identification,
    scales,
    load,
    soak,
    troubles,
):
    app.command()(command)

if __name__ == "__main__":
    prepare_process()
    app(prog_name="python -m evidence")
