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


PANELS = {
    "Use": ("diagnose", "monitor", "serve", "compare", "trend", "demo"),
    "Rigs": ("inspect", "map", "identify", "experiment", "publish"),
    "Research": ("simulate", "generate", "features", "train", "validate", "schema"),
}
"""Each command is the function of its name in the module of that name."""
for panel, names in PANELS.items():
    for name in names:
        command = getattr(import_module(f"fdd.cli.{name}"), name)
        app.command(name, rich_help_panel=panel)(command)
app.add_typer(profile.app, name="profile", rich_help_panel="Rigs")
