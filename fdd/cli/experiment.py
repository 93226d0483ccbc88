"""``fdd experiment``: one of the thesis's experiments on logs of one's own."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli.options import AxisOption, MapOption

if TYPE_CHECKING:
    from fdd.identification.experiments.outcome import Outcome
    from fdd.logs import Log
    from fdd.unit import Unit


class Experiment(StrEnum):
    """What there is to find out."""

    FREQUENCY_RESPONSE = "frequency-response"
    FRICTION = "friction"
    LEAKAGE = "leakage"
    GAIN = "gain"
    BULK_MODULUS = "bulk-modulus"


class Input(StrEnum):
    """Of a frequency response."""

    PUMP_SPEED = "pump_speed"
    COMMAND = "command"


class Output(StrEnum):
    """Of a frequency response."""

    RATE = "rate"
    POSITION = "position"
    PRESSURE_DIFFERENCE = "pressure_difference"


def experiment(
    kind: Annotated[Experiment, typer.Argument(help="What to find out.", show_default=False)],
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Logs of one unit.", show_default=False)
    ],
    unit: Annotated[
        str,
        typer.Option("--unit", "--base", help="Profile to compare with: a YAML file or a shipped one."),
    ] = "axis_a",
    map_: MapOption = None,
    axis: AxisOption = None,
    html: Annotated[
        Path | None, typer.Option("--html", help="Write a page with plots.", show_default=False)
    ] = None,
    json_: Annotated[
        str | None,
        typer.Option(
            "--json", metavar="FILE|-", help="Write figures and curves as JSON; - is standard output."
        ),
    ] = None,
    given: Annotated[Input, typer.Option("--input", help="Of the frequency response.")] = Input.PUMP_SPEED,
    caused: Annotated[
        Output, typer.Option("--output", help="Of the frequency response; rate is the piston's velocity.")
    ] = Output.RATE,
    order: Annotated[
        int | None,
        typer.Option(min=1, max=8, help="Poles of its models; by BIC from 1 to 4 else.", show_default=False),
    ] = None,
    window: Annotated[
        float, typer.Option(min=0.05, max=60.0, help="s, windows of its measured spectra.")
    ] = 1.0,
) -> None:
    """Find frequency response, friction, leakage, gain or bulk modulus in logs, with 95 % intervals.

    What a log does not tell is said, and why.
    """
    import json

    from fdd.cli.console import progress
    from fdd.cli.which_logs import read_logs
    from fdd.files import require_writable, write_text
    from fdd.logs import ChannelMap
    from fdd.unit import Unit

    for path in (html, None if json_ in (None, "-") else Path(str(json_))):
        if path is not None:
            require_writable(path)
    profile = Unit.load(unit)
    read = read_logs(logs, None if map_ is None else ChannelMap.load(map_), axis)
    with progress(f"{kind.value} of {len(read)} logs"):
        found = _run(
            kind, read, logs, profile, given=given.value, caused=caused.value, order=order, window=window
        )
    names = [path.name for path in logs]
    if html is not None:
        from fdd.report.experiment import experiment_page

        told = [(t.quantity, *t.shown()) for t in found.told]
        page = experiment_page(found.title, names, profile.name, told, found.not_told, found.notes,
                               (found.heads, found.rows), found.figures)  # fmt: skip
        write_text(html, page)
    if json_ is not None:
        data = {**found.as_data(), "logs": names, "unit": profile.name}
        text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)
        if json_ == "-":
            print(text)
            return
        write_text(json_, text + "\n")
    _print(found)
    if html is not None:
        print(f"Page written to {html}")


def _run(
    kind: Experiment,
    logs: list[Log],
    paths: list[Path],
    unit: Unit,
    *,
    given: str,
    caused: str,
    order: int | None,
    window: float,
) -> Outcome:
    from fdd.identification.experiments.bulk_modulus import bulk_modulus
    from fdd.identification.experiments.friction import friction
    from fdd.identification.experiments.gain import gain
    from fdd.identification.experiments.leakage import leakage
    from fdd.identification.experiments.response import frequency_response
    from fdd.identification.record import even_record

    records = [even_record(log.samples, unit, str(path)) for log, path in zip(logs, paths, strict=True)]
    if kind is Experiment.FREQUENCY_RESPONSE:
        return frequency_response(records, unit, given=given, caused=caused, order=order, window_s=window)
    others = {"friction": friction, "leakage": leakage, "gain": gain, "bulk-modulus": bulk_modulus}
    return others[kind.value](records, unit)


def _print(found: Outcome) -> None:
    """Figures, then what the log does not tell, then the table and the notes."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from fdd.cli.console import output

    console = output()
    console.print(Text(found.title, style="bold"))
    if found.told:
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
        for title in ("quantity", "value", "95 %", "unit", ""):
            table.add_column(
                title, justify="right" if title in ("value", "95 %") else "left", overflow="fold"
            )
        for told in found.told:
            table.add_row(*(Text(cell) for cell in (told.quantity, *told.shown())))
        console.print(table)
    for sentence in found.not_told:
        console.print(Text(f"• Not told: {sentence}", style="yellow"), soft_wrap=True)
    if found.rows:
        detail = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
        for head in found.heads:
            detail.add_column(head, overflow="fold")
        for row in found.rows:
            detail.add_row(*(Text(cell) for cell in row))
        console.print(detail)
    for note in found.notes:
        console.print(Text(f"• {note}"), soft_wrap=True)
