"""The command tree; and ``fdd schema``: the JSON Schema of what fdd writes and reads."""

from __future__ import annotations

import json
from importlib import import_module
from typing import Annotated, Literal

import typer

from fdd import __version__
from fdd.cli import profile
from fdd.cli.command import USAGE, Commands, argument

Kind = Literal["diagnosis", "comparison", "trend", "map", "profile", "recipe", "serve"]
MODELS: dict[Kind, str] = {
    "diagnosis": "fdd.diagnosis.findings:Diagnosis",
    "comparison": "fdd.history:Comparison",
    "trend": "fdd.history:Life",
    "map": "fdd.logs:ChannelMap",
    "profile": "fdd.unit:Unit",
    "recipe": "fdd.campaign.recipe:Recipe",
    "serve": "fdd.service.config:Serve",
}
ANSWERS = ("diagnosis", "comparison", "trend")


app = typer.Typer(
    name="fdd", cls=Commands, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip


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
    "Rigs": {"inspect": "rig_logs", "map": "rig_logs", "identify": "profile", "experiment": "profile",
             "publish": "serve"},
    "Research": {"simulate": "simulate", "generate": "campaign", "features": "campaign", "train": "campaign",
                 "validate": "campaign"},
}  # fmt: skip
"""Panel of the help to its commands, each the function of its name in that module."""
for panel, commands in COMMANDS.items():
    for name, module in commands.items():
        app.command(name, rich_help_panel=panel)(getattr(import_module(f"fdd.cli.{module}"), name))
app.add_typer(profile.app, name="profile", rich_help_panel="Rigs")


@app.command(rich_help_panel="Research")
def schema(kind: Annotated[Kind, argument("Of what.")]) -> None:
    """Print the JSON Schema of an answer, a comparison, a trend, a map, a profile, a recipe or serve.yaml."""
    # It knows types, names and ranges of single values; what values must be to each other only fdd tells.
    # YAML is meant as version 1.2 reads it, where ``2e8`` is a number.
    from fdd.samples import CHANNELS

    module, name = MODELS[kind].split(":")
    model = getattr(import_module(module), name)
    # Answers are written, the others are read.
    made = model.model_json_schema(mode="serialization" if kind in ANSWERS else "validation")
    if kind == "map":  # channels stand below ``channels:`` or at the top level
        each = {name: {"$ref": "#/$defs/ChannelSource"} for name in CHANNELS}
        channels = {"type": "object", "properties": each, "additionalProperties": False}
        made["properties"] |= {"channels": channels, **each}
        del made["required"]
    # What the models' docstrings say is for Python.
    made.pop("description", None)
    title = made["properties"]["schema"]["const"]
    told = {"$schema": "https://json-schema.org/draft/2020-12/schema", **made, "title": title}
    print(json.dumps(told, indent=2, ensure_ascii=False))
