"""Options that several commands share."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.completion import units
from fdd.engines import Engine
from fdd.errors import InputError

UnitOption = Annotated[
    str | None,
    typer.Option(
        "--unit",
        help="Unit profile: a YAML file or a shipped one (axis_a, axis_b).",
        show_default=False,
        autocompletion=units,
    ),
]
MapOption = Annotated[
    Path | None, typer.Option("--map", help="Channel map (YAML) of the logs.", show_default=False)
]
ModelOption = Annotated[
    Path | None, typer.Option("--model", help="Trained model; the shipped one else.", show_default=False)
]
JsonOption = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE|-", help="Write the answer as JSON; - is standard output."),
]
AxisOption = Annotated[
    str | None,
    typer.Option("--axis", help="Axis of an MCAP file, or a store, with several.", show_default=False),
]
ReportOption = Annotated[
    Path | None, typer.Option("--report", metavar="FILE.html", help="Write a page.", show_default=False)
]
FolderOption = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", metavar="DIR", show_default=False,
        help="Folder for all of it: index.html with its tables, as CSV and JSON too, and reports.",
    ),
]  # fmt: skip
WorkersOption = Annotated[
    int | None,
    typer.Option(
        min=1, max=256, help="Processes for several jobs; one for each core else.", show_default=False
    ),
]
EngineOption = Annotated[
    Engine, typer.Option(help="What runs them: this machine, or the Ray cluster that RAY_ADDRESS names.")
]


def require_packages(extra: str, *names: str) -> None:
    """Refuse what an extra is missing for.

    Raises
    ------
    InputError : one of the packages is not installed.
    """
    missing = next((name for name in names if importlib.util.find_spec(name) is None), None)
    if missing is not None:
        raise InputError(f"needs the package {missing}", mend=f"install fdd[{extra}]")
