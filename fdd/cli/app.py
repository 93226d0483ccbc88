"""The command tree."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated

import typer

from fdd import __version__
from fdd.cli import profile
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


COMMANDS = {
    "Use": {"diagnose": "diagnose", "monitor": "monitor", "serve": "serve", "compare": "history",
            "trend": "history", "demo": "diagnose"},
    "Rigs": {"inspect": "rig_logs", "map": "rig_logs", "identify": "identify", "experiment": "identify",
             "publish": "serve"},
    "Research": {"simulate": "simulate", "generate": "campaign", "features": "campaign", "train": "campaign",
                 "validate": "campaign", "schema": "schema"},
}  # fmt: skip
"""Panel of the help to its commands, each the function of its name in that module."""
for panel, commands in COMMANDS.items():
    for name, module in commands.items():
        app.command(name, rich_help_panel=panel)(getattr(import_module(f"fdd.cli.{module}"), name))
app.add_typer(profile.app, name="profile", rich_help_panel="Rigs")
