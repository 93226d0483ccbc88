"""``fdd map``: a channel map proposed from a log."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.logs.mapping import Proposal, Question


def propose_map(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Logs of one rig, of any format; the first is looked at.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Map to write (YAML).", show_default=False)],
    name: Annotated[
        str | None, typer.Option(help="Name of the rig; the file's else.", show_default=False)
    ] = None,
    axis: Annotated[str | None, typer.Option(help="Name of the axis in answers.", show_default=False)] = None,
    given: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="CHANNEL=SIGNAL[:UNIT]",
            show_default=False,
            help="What you know: a channel's signal, its unit (position=:mm for the unit alone), or none.",
        ),
    ] = None,
    words: Annotated[
        Path | None, typer.Option(help="Your own words in signal names (fdd.words/1).", show_default=False)
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Take the likeliest answer to every question.")
    ] = False,
) -> None:
    """Propose a channel map from names, units and what the signals do; ask where that is not enough."""
    from fdd.cli.console import output, progress, remark
    from fdd.files import require_writable, write_text
    from fdd.logs import ChannelMap, read_log
    from fdd.logs.formats import open_log
    from fdd.logs.mapping import Words, propose
    from fdd.logs.mapping.writing import balance_words, map_text

    require_writable(out)
    signals, units = _given(given or [])
    with progress(f"reading {logs[0].name}"):
        log = open_log(logs[0])
        found = propose(log, Words(words), signals)
    _set_units(found, units)
    console = output()
    for question in list(found.questions):
        found.answer(question, _answered(question, logs[0], ask=not yes))
    text = map_text(found, name or logs[0].parent.resolve().name, axis, logs[0].name)
    channel_map = ChannelMap.from_yaml(text)  # what is written is what is read
    read = [read_log(path, channel_map) for path in logs]
    write_text(out, text)
    console.print(proposal_table(found))
    for line in (*found.notes, *balance_words(read[0].samples)):
        console.print(f"• {line}", markup=False)
    if found.unused:
        console.print(f"• not used: {', '.join(found.unused[:20])}", markup=False)
    for log_read in read[1:]:
        wrong = [w for w in balance_words(log_read.samples) if "wrong way" in w or "not how" in w]
        for line in wrong:
            remark(f"{log_read.name}: {line}")
    console.print(f"Map of {len(found.rows)} channels written to {out}", markup=False)


def proposal_table(found: Proposal) -> Table:
    """Channel, signal, unit, sign and scale, how sure, and why."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from fdd.samples import CHANNELS

    table = Table(box=box.SIMPLE_HEAD)
    for title in ("channel", "signal", "unit"):
        table.add_column(title, overflow="fold")
    table.add_column("sure", justify="right", no_wrap=True)
    table.add_column("because", overflow="fold")
    for channel in CHANNELS:
        if (row := found.rows.get(channel)) is None:
            continue
        source = row.source
        factor = "" if source.scale == 1.0 else f"{source.scale:.5g} × "
        signal = (
            f"{'−' if source.sign < 0 else ''}{factor}{source.column or f'{source.topic} {source.field}'}"
        )
        table.add_row(
            channel,
            Text(signal),
            source.unit or CHANNELS[channel].unit,
            f"{100 * row.confidence:.0f} %",
            Text(row.why),
        )
    return table


def _given(options: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Signals and units by channel."""
    from fdd.logs.near_misses import did_you_mean
    from fdd.measures import measure
    from fdd.samples import CHANNELS

    signals: dict[str, str] = {}
    units: dict[str, str] = {}
    for option in options:
        channel, equals, value = option.partition("=")
        if not equals or (channel not in CHANNELS and channel != "pressure"):
            raise InputError(
                f"--set {option}: no channel {channel!r}{did_you_mean(channel, ('pressure', *CHANNELS))}",
                mend=f"write CHANNEL=SIGNAL[:UNIT], with one of: {', '.join(CHANNELS)}",
            )
        signal, colon, unit = value.rpartition(":") if ":" in value else (value, "", "")
        if colon:
            measure(unit, CHANNELS["pressure_1" if channel == "pressure" else channel].dimension)
            units[channel] = unit
        if signal or not colon:
            signals[channel] = signal
    return signals, units


def _set_units(found: Proposal, units: dict[str, str]) -> None:
    for channel, unit in units.items():
        for name, row in found.rows.items():
            if name == channel or (channel == "pressure" and name.startswith("pressure")):
                row.source = row.source.model_copy(update={"unit": unit})
        found.questions = [q for q in found.questions if not (q.channel == channel and unit)]


def _answered(question: Question, log: Path, *, ask: bool) -> str:
    options = list(question.options)
    if not ask:
        return options[0]
    if not sys.stdin.isatty():
        likeliest = f":{options[0]}" if "unit" in question.text else options[0]
        raise InputError(
            f"{question.text} Likeliest: {options[0]}, or else {', '.join(options[1:])}",
            where=log,
            mend=f"answer with --set {question.channel}={likeliest}, or --yes",
        )
    from fdd.cli.console import messages

    console = messages()
    console.print(question.text, markup=False)
    for k, option in enumerate(options, 1):
        console.print(f"  {k}  {option}", markup=False)
    chosen = typer.prompt("Number", default=1, type=int, err=True)
    return options[min(max(int(chosen), 1), len(options)) - 1]
