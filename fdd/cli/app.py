"""The command tree."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from fdd import __version__
from fdd.cli import (
    compare,
    demo,
    diagnose,
    experiment,
    features,
    generate,
    identify,
    inspect,
    monitor,
    profile,
    publish,
    schema,
    serve,
    simulate,
    train,
    trend,
    validate,
)
from fdd.cli import map as map_command
from fdd.cli.failures import USAGE, Commands

app = typer.Typer(
    name="fdd",
    cls=Commands,
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

    Exit status: 0 done, 2 wrong usage or unusable input;
    with --exit-code 1 a fault was found, 3 a verdict is inconclusive.
    """
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit(USAGE)


PANELS: dict[str, dict[str, Callable[..., None]]] = {
    "Use": {
        "diagnose": diagnose.diagnose, "monitor": monitor.monitor, "serve": serve.serve,
        "compare": compare.compare, "trend": trend.trend, "demo": demo.demo,
    },
    "Rigs": {
        "inspect": inspect.inspect_log, "map": map_command.propose_map, "identify": identify.identify,
        "experiment": experiment.experiment, "publish": publish.publish,
    },
    "Research": {
        "simulate": simulate.simulate, "generate": generate.generate, "features": features.features,
        "train": train.train, "validate": validate.validate, "schema": schema.schema,
    },
}  # fmt: skip
for group, commands in PANELS.items():
    for name, command in commands.items():
        app.command(name, rich_help_panel=group)(command)
app.add_typer(profile.app, name="profile", rich_help_panel="Rigs")
