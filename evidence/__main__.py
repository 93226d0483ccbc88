"""``python -m evidence``: each command remakes one report."""

from __future__ import annotations

import typer

from evidence.commands import estimators, house, load, mutations, plant, soak, thesis, troubles
from fdd.cli.failures import Commands, prepare_process

app = typer.Typer(
    name="evidence", cls=Commands, add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True,
    help="Measure what README and reports say of fdd.",
)  # fmt: skip
for module in (thesis, plant, estimators, load, soak, troubles, house, mutations):
    app.command()(getattr(module, module.__name__.rpartition(".")[2]))

if __name__ == "__main__":
    prepare_process()
    app(prog_name="python -m evidence")
