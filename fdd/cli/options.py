"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

UnitOption = Annotated[
    str | None,
    typer.Option(
        "--unit", help="Unit profile: a YAML file or a shipped one (axis_a, axis_b).", show_default=False
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
    str | None, typer.Option("--axis", help="Axis of an MCAP file with several.", show_default=False)
]
