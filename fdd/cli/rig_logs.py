"""``fdd inspect``: what a log holds; ``fdd map``: a channel map proposed from it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli.command import argument, option
from fdd.errors import InputError
from fdd.files import require_writable, write_text

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.logs.mapping import Proposal, Question
    from fdd.logs.rates import SignalView

WIDE = 120
"""Columns of a terminal that has room for all figures."""


def inspect(log: Annotated[Path, argument("A log of any format.", "LOG")]) -> None:
    """Show what a log holds: signals, units, rates, ranges, gaps, and a small picture of each."""
    from fdd.cli.console import output, progress
    from fdd.logs.formats import format_of, open_log
    from fdd.logs.rates import inspect as inspected

    with progress(f"reading {log.name}"):
        opened = open_log(log)
        views = inspected(opened)
    console = output()
    kind = format_of(log).name
    console.print(f"{log.name}: {kind}, {len(views)} signals, {log.stat().st_size / 1e6:.3g} MB")
    console.print(_inspection_table(views, wide=console.width >= WIDE))
    for note in opened.notes:
        console.print(f"• {note}")
    if opened.truncated:
        console.print("• the file ends before its data does")


def _inspection_table(views: list[SignalView], *, wide: bool) -> Table:
    """A row a signal, below its topic or group; in a narrow window without what matters less."""
    import math

    from rich.text import Text

    from fdd.cli.console import grid
    from fdd.logs.formats.trees import path_parts
    from fdd.logs.rates import picture

    def number(value: float, digits: int = 4) -> str:
        return "" if math.isnan(value) else f"{value:.{digits}g}"

    numbers = ("Hz", "missing", "least", "most", *(("rows", "gap s", "median") if wide else ()))
    rows, group = [], ""
    for v in views:
        topic, name = path_parts(v.name)
        if v.name.startswith("/"):  # a topic, a point and the field in its messages
            last, _, name = name.partition(".")
            topic = f"{topic}/{last}"
        if topic != group:
            group = topic
            rows.append([topic])
        name = f"  {name}" if topic else name
        if v.problem:
            rows.append([name, v.unit, *[""] * len(numbers), v.problem[:40]])
            continue
        more = (str(v.rows), number(v.longest_gap, 3), number(v.middle)) if wide else ()
        figures = (number(v.rate), str(v.missing or ""), number(v.low), number(v.high), *more)
        rows.append([name, v.unit, *figures, picture(v.values, 32 if wide else 12)])
    columns = ("signal", "unit", *numbers, "course")
    filled = [k for k in range(len(columns)) if k == 0 or any(row[k] for row in rows if len(row) > 1)]
    table = grid((columns[k] for k in filled), numbers=numbers, whole=("unit", "course"))
    for row in rows:
        table.add_row(*(Text(row[k]) for k in filled if k < len(row)), style="bold" if len(row) == 1 else "")
    return table


def map(
    logs: Annotated[list[Path], argument("Logs of a rig, of any format; the first is looked at.", "LOG...")],
    out: Annotated[Path, option("Map to write (YAML).", "--out", "-o")],
    name: Annotated[str | None, option("Name of the rig; the file's else.")] = None,
    axis: Annotated[str | None, option("Name of the axis in answers.")] = None,
    given: Annotated[
        list[str] | None,
        option(
            "What you know: a channel's signal, its unit (position=:mm for the unit alone), the scale of raw "
            "counts (position=raw*0.025-5:mm), or that there is none (motor_current=).",
            "--set", metavar="CHANNEL=[SIGNAL][*SCALE[+OFFSET]][:UNIT]",
        ),
    ] = None,
    yes: Annotated[bool, option("Take the likeliest answer to every question.", "--yes", "-y")] = False,
) -> None:  # fmt: skip
    """Propose a channel map from names, units and what the signals do; ask where that is not enough."""
    from fdd.cli.console import output, progress, remark
    from fdd.logs import ChannelMap, read_log
    from fdd.logs.formats import open_log
    from fdd.logs.mapping import balance_words, given_of, propose

    require_writable(out)
    known = given_of(given or [])
    with progress(f"reading {logs[0].name}"):
        log = open_log(logs[0])
        found = propose(log, known)
    console = output()
    if found.questions and not yes and not sys.stdin.isatty():
        asked = (f"{q.text} Likeliest: {', or else '.join(q.options)}" for q in found.questions)
        mend = f"answer with {' '.join(q.hint for q in found.questions)}, or --yes"
        raise InputError(". ".join(asked), where=logs[0], mend=mend)
    for question in list(found.questions):
        if yes:
            found.assume(question)
        else:
            found.answer(question, _answered(question))
    text = found.map_text(name or logs[0].parent.resolve().name, axis, logs[0].name)
    channel_map = ChannelMap.from_yaml(text)  # what is written is what is read
    read = [read_log(path, channel_map) for path in logs]
    write_text(out, text)
    console.print(_proposal_table(found))
    for line in (*found.notes, *balance_words(read[0].samples)):
        console.print(f"• {line}")
    if found.unused:
        console.print(f"• not used: {', '.join(found.unused[:20])}")
    for log_read in read[1:]:
        for line in balance_words(log_read.samples):
            if "wrong way" in line or "not how" in line:
                remark(f"{log_read.name}: {line}")
    console.print(f"Map of {len(found.rows)} channels written to {out}")


def _proposal_table(found: Proposal) -> Table:
    from fdd.cli.console import grid
    from fdd.samples import CHANNELS

    rows = []
    for channel in (c for c in CHANNELS if c in found.rows):
        row = found.rows[channel]
        source = row.source
        factor = "" if source.scale == 1.0 else f"{source.scale:.5g} × "
        name = source.column or f"{source.topic} {source.field}"
        signal = f"{'−' if source.sign < 0 else ''}{factor}{name}"
        sure = f"{100 * row.confidence:.0f} %"
        rows.append((channel, signal, source.unit or CHANNELS[channel].unit, sure, row.why))
    return grid(("channel", "signal", "unit", "sure", "because"), rows, numbers=("sure",), whole=("channel",))


def _answered(question: Question) -> str:
    options = list(question.options)
    listed = [f"  {k}  {likely}" for k, likely in enumerate(options, 1)]
    typer.echo("\n".join([question.text, *listed, f"or start again with {question.hint}"]), err=True)
    chosen = typer.prompt("Number", default=1, type=int, err=True)
    return options[min(max(int(chosen), 1), len(options)) - 1]
