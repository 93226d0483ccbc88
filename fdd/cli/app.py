"""The command tree."""

from __future__ import annotations

from typing import Annotated

import typer

from fdd import __version__
from fdd.cli import (
    benchmark,
    compare,
    demo,
    diagnose,
    experiment,
    generate,
    identify,
    inspect,
    monitor,
    performance,
    profile,
    schema,
    serve,
    simulate,
    thesis,
    train,
    trend,
    validate,
)
from fdd.cli import map as map_command
from fdd.cli.failures import USAGE, Commands

app = typer.Typer(
    name="fdd",
    cls=Commands,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"fdd {__version__}")
        raise typer.Exit(0)


@app.callback(invoke_without_command=True)
def fdd(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Fault detection and diagnosis for electro-hydrostatic actuators.

    Exit status: 0 done, 2 wrong usage or unusable input; with --exit-code 1 a fault was found, 3 a verdict
    is inconclusive.
    """
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit(USAGE)


app.command()(diagnose.diagnose)
app.command()(compare.compare)
app.command()(trend.trend)
app.command("inspect")(inspect.inspect_log)
app.command("map")(map_command.propose_map)
app.command()(monitor.monitor)
app.command()(serve.serve)
app.command()(identify.identify)
app.command()(experiment.experiment)
app.add_typer(profile.app, name="profile")
app.command()(simulate.simulate)
app.command()(generate.generate)
app.command()(train.train)
app.command()(validate.validate)
app.command()(thesis.thesis)
app.command()(performance.performance)
app.command()(benchmark.benchmark)
app.command()(schema.schema)
app.command()(demo.demo)
