"""What a person sees at a terminal: progress, a diagnosis, a comparison, a life, an experiment."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rich import box
from rich.console import Console, Group, OverflowMethod, RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from fdd.cli.command import write_json
from fdd.engines import Advance
from fdd.files import write_text

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis
    from fdd.report.page import Sheet
    from fdd.report.words import FindingWords
    from fdd.unit import Unit

PATIENCE_S = 2.0
"""Nothing is shown of what is done sooner."""
NARROW: dict[str, Any] = {"show_edge": False, "pad_edge": False}
"""Shape of a table without margins."""
HARDEST = 5
"""Faults named of those that the log would not have shown; the report has them all."""
SENTENCE = 24
"""Characters in a line of a column of sentences, at least."""
COLOURS = {"healthy": "green", "faulty": "red", "inconclusive": "yellow"}


class _Pipe(Console):
    """A console whose reader may go away: that ends the command, with its own exit status."""

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError


def output() -> Console:
    """Console on standard output, as it stands now; what comes from logs is plain text, never markup."""
    return _Pipe(file=sys.stdout, highlight=False, emoji=False, markup=False)


def remark(text: str) -> None:
    """One line on standard error that is no error."""
    print(f"fdd: {' '.join(text.split())}", file=sys.stderr)


@contextmanager
def progress(title: str, total: float | None = None) -> Iterator[Advance]:
    """Show progress on standard error where that is a terminal; gives the function to call with how much is
    done in all, of `total`. None shows a spinner only."""
    console = Console(file=sys.stderr, highlight=False, emoji=False, markup=False)
    if not console.is_terminal:
        yield lambda done: None
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    bars = (BarColumn(), TimeRemainingColumn()) if total else ()
    shown = Progress(
        SpinnerColumn(), TextColumn("{task.description}"), *bars, console=console, transient=True
    )
    task = shown.add_task(title, total=total)
    timer = threading.Timer(PATIENCE_S, shown.start)
    timer.daemon = True
    timer.start()
    try:
        yield lambda done: shown.update(task, completed=done)
    finally:
        timer.cancel()
        timer.join()
        shown.stop()


@contextmanager
def counted(title: str) -> Iterator[Callable[[int, int], None]]:
    """`progress` for work that tells (done, total)."""
    with progress(title, 1.0) as advance:
        yield lambda done, total: advance(done / max(total, 1))


def grid(
    columns: Iterable[str], rows: Iterable[Sequence[str]] = (), *, numbers: Collection[str] = (),
    whole: Collection[str] = (), **shape: Any,
) -> Table:  # fmt: skip
    """A table of plain text, of that `shape` of rich's.

    `numbers` are the columns that stand to the right, `whole` those beside them that are never wrapped.
    """
    table = Table(box=box.SIMPLE_HEAD, **shape)
    for name in columns:
        tight = name in numbers or name in whole
        overflow: OverflowMethod = "ellipsis" if tight else "fold"
        table.add_column(
            name, justify="right" if name in numbers else "left", no_wrap=tight, overflow=overflow
        )
    for row in rows:
        table.add_row(*map(Text, row))
    return table


def diagnosis_view(diagnosis: Diagnosis, unit: Unit | None = None) -> RenderableType:
    """Verdict, findings with their evidence, estimates and what was odd in the data.

    Everything that comes from the log is shown as plain text, never as markup.
    """
    from fdd.report import tables
    from fdd.report.words import second_opinion_words, verdict_words

    words = verdict_words(diagnosis, unit)
    colour = COLOURS[words.kind]
    head = Text(f"{words.mark} {words.headline}", style=f"bold {colour}")
    if words.remark:
        head.append(f"\n{words.remark}", style="not bold default")
    parts: list[RenderableType] = [
        Panel(head, title=Text(diagnosis.log), title_align="left", border_style=colour, box=box.ROUNDED)
    ]
    parts += [_finding(finding, named=len(words.findings) > 1) for finding in words.findings]
    shown = [f"{title.lower()} {percent}" for title, percent, _ in tables.probability_rows(diagnosis)]
    parts += [_estimates(diagnosis), Text(f"Probabilities: {', '.join(shown) or 'none'}")]
    if diagnosis.second_opinion is not None:
        parts.append(Text(second_opinion_words(diagnosis)))
    parts.append(_quality(diagnosis))
    hardest = tables.invisible_rows(diagnosis)[:HARDEST]
    hidden = "; ".join(f"{fault} {severity}" for fault, severity in hardest)
    if hidden:
        parts.append(Text(f"Would have been invisible here: {hidden}", style="dim"))
    return Group(*(Padding(part, (0, 2)) if isinstance(part, Text) else part for part in parts))


def _finding(finding: FindingWords, *, named: bool) -> Text:
    rest = (finding.detection, finding.place, finding.alternatives, finding.severity)
    lines = [*(f"• {sentence}" for sentence in finding.evidence), " ".join(filter(None, rest))]
    lines += [finding.check] if finding.check else []
    text = Text()
    if named:
        text.append(f"{finding.headline}\n", style="bold")
    return text.append("".join(f"{line}\n" for line in lines))


def _estimates(diagnosis: Diagnosis) -> Table:
    from fdd.report.tables import estimate_rows

    numbers = ("healthy", "estimated", "change")
    heads, whole = ("at the end", *numbers, "unit"), ("at the end", "unit")
    table = grid(heads, numbers=numbers, whole=whole, collapse_padding=True)
    for row in estimate_rows(diagnosis):
        style = "" if row["observable"] == "yes" else "dim"
        table.add_row(*(row[key] for key in ("quantity", "baseline", "value", "change", "unit")), style=style)
    return table


def _quality(diagnosis: Diagnosis) -> Text:
    from fdd.report.tables import grouped, sensor_rows

    q = diagnosis.quality
    text = Text(
        f"Data: {grouped(diagnosis.samples)} samples in {diagnosis.duration_s:.1f} s, unit "
        f"{diagnosis.unit}, axis {diagnosis.axis}; {q.dropped_samples} dropped, {q.nan_samples} with missing "
        f"values, {q.time_jumps} jumps in time"
    )
    untrusted = "; ".join(f"{name}: {state}" for name, state in sensor_rows(diagnosis))
    for note in (f"sensors not trusted: {untrusted}" if untrusted else "", *q.notes):
        if note:
            text.append(f"\n• {note}", style="yellow")
    return text


def tell_sheet(answer: str, sheet: Sheet, json_: str | None, report: Path | None) -> None:
    """An answer as data, as a page, and for people, as far as each is asked for."""
    from fdd.report.page import render_sheet

    write_json(json_, answer)
    if report is not None:
        write_text(report, render_sheet(sheet))
    if json_ != "-":
        print_sheet(sheet)


def print_sheet(sheet: Sheet, console: Console | None = None) -> None:
    """What ``fdd compare``, ``fdd trend`` and ``fdd experiment`` print: headline, remarks and tables.

    Titles of columns may wrap, and sentences in lines of some words; a terminal that is too narrow for names
    and numbers breaks the table's lines itself.
    """
    from fdd.report.tables import NOTHING

    console = console or output()
    console.print(sheet.headline, soft_wrap=True)
    for remark in sheet.remarks:
        console.print(Text(f"• {remark}", style="yellow"), soft_wrap=True)
    for table in sheet.tables:
        told = [k for k, _ in enumerate(table.columns) if any(row[k] != NOTHING for row in table.rows)]
        made = grid((table.columns[k] for k in told), **NARROW)
        for k, column in zip(told, made.columns, strict=True):
            column.justify = "right" if table.numbers and k else "left"
            cells = [row[k] for row in table.rows]
            longest = max(map(len, cells), default=0)
            number = column.justify == "right" or any("±" in cell for cell in cells)
            words = (len(word) for text in (table.columns[k], *cells) for word in text.split())
            column.min_width = max(longest if number else min(longest, SENTENCE) if k else 0, *words)
        for place, row in enumerate(table.rows):
            made.add_row(*(Text(row[k]) for k in told), style="bold" if place in table.marked else "")
        made.title, made.title_justify, made.title_style = Text(table.title), "left", "bold"
        least = console.measure(made, options=console.options.update(max_width=1000)).minimum
        console.print(made, width=max(least, console.width), crop=False)
        if table.note:
            console.print(Text(f"  {table.note}\n", style="dim"))
