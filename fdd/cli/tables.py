"""A diagnosis, a comparison and a life for people at a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from fdd.cli.console import grid
from fdd.report import tables
from fdd.report.words import FindingWords, second_opinion_words, verdict_words

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis
    from fdd.report.sheet import Table as SheetTable

HARDEST = 5
"""Faults named of those that the log would not have shown; the report has them all."""
COLOURS = {"healthy": "green", "faulty": "red", "inconclusive": "yellow"}


def diagnosis_view(diagnosis: Diagnosis) -> RenderableType:
    """Verdict, findings with their evidence, estimates and what was odd in the data.

    Everything that comes from the log is shown as plain text, never as markup.
    """
    words = verdict_words(diagnosis)
    colour = COLOURS[words.kind]
    head = Text(f"{words.mark} {words.headline}", style=f"bold {colour}")
    if words.remark:
        head.append(f"\n{words.remark}", style="not bold default")
    parts: list[RenderableType] = [
        Panel(head, title=Text(diagnosis.log), title_align="left", border_style=colour, box=box.ROUNDED)
    ]
    parts += [_finding(finding, named=len(words.findings) > 1) for finding in words.findings]
    parts += [_estimates(diagnosis), _families(diagnosis)]
    if diagnosis.second_opinion is not None:
        parts.append(Text(second_opinion_words(diagnosis)))
    parts.append(_quality(diagnosis))
    hardest = tables.invisible_rows(diagnosis)[:HARDEST]
    hidden = "; ".join(f"{fault} {severity}" for fault, severity in hardest)
    if hidden:
        parts.append(Text(f"Would have been invisible here: {hidden}", style="dim"))
    return Group(*(Padding(part, (0, 2)) if isinstance(part, Text) else part for part in parts))


def _finding(finding: FindingWords, *, named: bool) -> Text:
    text = Text()
    if named:
        text.append(f"{finding.headline}\n", style="bold")
    for sentence in finding.evidence:
        text.append(f"• {sentence}\n")
    rest = " ".join(
        s for s in (finding.detection, finding.place, finding.alternatives, finding.severity) if s
    )
    text.append(f"{rest}\n")
    if finding.check:
        text.append(f"{finding.check}\n")
    return text


def _estimates(diagnosis: Diagnosis) -> Table:
    numbers = ("healthy", "estimated", "change")
    table = grid(("at the end", *numbers, "unit"), numbers=numbers, whole=("at the end", "unit"))
    for row in tables.estimate_rows(diagnosis):
        seen = row["observable"] == "yes"
        change = row["change"] if seen else "not seen"
        table.add_row(
            row["quantity"], row["baseline"], row["value"], change, row["unit"], style="" if seen else "dim"
        )
    return table


def _families(diagnosis: Diagnosis) -> Text:
    shown = [f"{title.lower()} {percent}" for title, percent, _ in tables.probability_rows(diagnosis)]
    return Text(f"Probabilities: {', '.join(shown) or 'none'}")


def _quality(diagnosis: Diagnosis) -> Text:
    q = diagnosis.quality
    text = Text(
        f"Data: {tables.grouped(diagnosis.samples)} samples in {diagnosis.duration_s:.1f} s, unit "
        f"{diagnosis.unit}, axis {diagnosis.axis}; {q.dropped_samples} dropped, {q.nan_samples} with missing "
        f"values, {q.time_jumps} jumps in time"
    )
    untrusted = "; ".join(f"{name}: {state}" for name, state in tables.sensor_rows(diagnosis))
    if untrusted:
        text.append(f"\n• sensors not trusted: {untrusted}", style="yellow")
    for note in q.notes:
        text.append(f"\n• {note}", style="yellow")
    return text


def print_sheet(
    console: Console, lines: Sequence[str], shown: Sequence[SheetTable], notes: Sequence[str]
) -> None:
    """What ``fdd compare`` and ``fdd trend`` print: lines, tables and notes."""
    for line in lines:
        console.print(line, soft_wrap=True)
    for table in shown:
        made = grid(table.columns, numbers=table.columns[1:] if table.numbers else ())
        made.title, made.title_justify, made.title_style = Text(table.title), "left", "bold"
        for k, row in enumerate(table.rows):
            made.add_row(*map(Text, row), style="bold" if k in table.marked else "")
        console.print(made)
        if table.note:
            console.print(Text(f"  {table.note}\n", style="dim"))
    for note in notes:
        console.print(Text(f"• {note}", style="yellow"))
