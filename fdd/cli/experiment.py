"""``fdd experiment``: one of the thesis's experiments on logs of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fdd.cli.options import (
    AxisOption,
    JsonOption,
    MapOption,
    argument,
    option,
    require_outputs,
    write_json,
)

if TYPE_CHECKING:
    from fdd.identification.experiments.outcome import Outcome
    from fdd.logs import Log
    from fdd.unit import Unit


Experiment = Literal["frequency-response", "friction", "leakage", "gain", "bulk-modulus"]


def experiment(
    kind: Annotated[Experiment, argument("What to find out.")],
    logs: Annotated[list[Path], argument("Logs of one unit.", "LOG...")],
    unit: Annotated[
        str,
        typer.Option("--unit", "--base", help="Profile to compare with: a YAML file or a shipped one."),
    ] = "axis_a",
    map_: MapOption = None,
    axis: AxisOption = None,
    html: Annotated[Path | None, option("Write a page with plots.")] = None,
    json_: JsonOption = None,
    given: Annotated[
        Literal["pump_speed", "command"], typer.Option("--input", help="Of the frequency response.")
    ] = "pump_speed",
    caused: Annotated[
        Literal["rate", "position", "pressure_difference"],
        typer.Option("--output", help="Of the frequency response; rate is the piston's velocity."),
    ] = "rate",
    order: Annotated[int | None, option("Poles of its model; by BIC from 1 to 4 else.", min=1, max=8)] = None,
    window: Annotated[
        float, typer.Option(min=0.05, max=60.0, help="s, windows of its measured spectra.")
    ] = 1.0,
) -> None:
    """Find frequency response, friction, leakage, gain or bulk modulus in logs, with 95 % intervals.

    What a log does not tell is said, and why.
    """
    import json

    from fdd.cli.console import progress
    from fdd.files import write_text
    from fdd.logs import ChannelMap, read_log
    from fdd.unit import Unit

    require_outputs(json_, html)
    profile = Unit.load(unit)
    channel_map = None if map_ is None else ChannelMap.load(map_)
    with progress(f"{kind} of {len(logs)} logs"):
        read = [read_log(path, channel_map, axis) for path in logs]
        found = _run(kind, read, logs, profile, given=given, caused=caused, order=order, window_s=window)
    names = [path.name for path in logs]
    if html is not None:
        from fdd.report.page import page
        from fdd.report.tables import version_rows

        told = [(t.quantity, *t.shown()) for t in found.told]
        html_text = page(
            "experiment.html", found.figures, title=found.title, logs=names, unit=profile.name, told=told,
            not_told=found.not_told, notes=found.notes, heads=found.heads, rows=found.rows,
            plots=found.figures, versions=version_rows(),
        )  # fmt: skip
        write_text(html, html_text)
    if json_ is not None:
        data = {**found.as_data(), "logs": names, "unit": profile.name}
        write_json(json_, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False))
        if json_ == "-":
            return
    _print(found)
    if html is not None:
        print(f"Page written to {html}")


def _run(kind: Experiment, logs: list[Log], paths: list[Path], unit: Unit, **of_response: Any) -> Outcome:
    from fdd.identification.experiments.bulk_modulus import bulk_modulus
    from fdd.identification.experiments.friction import friction
    from fdd.identification.experiments.gain import gain
    from fdd.identification.experiments.leakage import leakage
    from fdd.identification.experiments.response import frequency_response
    from fdd.identification.record import even_record

    records = [even_record(log.samples, unit, str(path)) for log, path in zip(logs, paths, strict=True)]
    if kind == "frequency-response":
        return frequency_response(records, unit, **of_response)
    others = {"friction": friction, "leakage": leakage, "gain": gain, "bulk-modulus": bulk_modulus}
    return others[kind](records, unit)


def _print(found: Outcome) -> None:
    """Figures, then what the log does not tell, then the table and the notes."""
    from rich.text import Text

    from fdd.cli.console import NARROW, grid, output, print_whole

    console = output()
    console.print(Text(found.title, style="bold"))
    if found.told:
        rows = [(told.quantity, *told.shown()) for told in found.told]
        heads = ("quantity", "value", "95 %", "unit", "")
        console.print(grid(heads, rows, numbers=("value", "95 %"), **NARROW))
    for sentence in found.not_told:
        console.print(Text(f"• Not told: {sentence}", style="yellow"), soft_wrap=True)
    if found.rows:
        print_whole(
            console, grid(found.heads, found.rows, whole=found.heads[:1], collapse_padding=True, **NARROW)
        )
    for note in found.notes:
        console.print(Text(f"• {note}"), soft_wrap=True)
