"""All experiments in the thesis's order, and the report on them as Markdown."""

from __future__ import annotations

import re
from collections.abc import Callable

from evidence.thesis import (
    bulk_modulus,
    chatter_filter,
    dead_band,
    dual_operation,
    gain,
    leakage,
    position_step,
    servomotor,
    sliding_friction,
    static_friction,
    transfer_function,
    ultimate_gain,
    whole_eha,
)
from evidence.thesis.findings import READING, Finding, Row, number_text
from fdd.markdown import table
from fdd.unit import Unit

HEAD = ["what", "thesis, where", "thesis", "plant", "unit", "deviation", "verdict"]
Measure = Callable[[Unit, Unit, int], Finding]

EXPERIMENTS: tuple[Measure, ...] = (
    gain.measure,
    leakage.measure,
    static_friction.measure,
    sliding_friction.measure,
    bulk_modulus.measure,
    transfer_function.measure,
    servomotor.measure,
    whole_eha.measure_low,
    whole_eha.measure_high,
    dead_band.measure,
    chatter_filter.measure,
    position_step.measure,
    ultimate_gain.measure,
    dual_operation.measure,
)
"""One for each section of the report."""

PICTURES = "thesis"
"""Folder of the pictures, beside the report."""


def run_all(
    axis_a: Unit, axis_b: Unit, *, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> list[Finding]:
    """Run every experiment.

    Parameters
    ----------
    axis_a, axis_b : the prototype's two axes.
    seed : of all trials; another one shares no trial with it.
    progress : told how many of how many experiments are done.

    Returns
    -------
    One finding an experiment, in the thesis's order.
    """
    findings = []
    for k, measure in enumerate(EXPERIMENTS):
        findings.append(measure(axis_a, axis_b, 100_000 * seed + 1))
        if progress is not None:
            progress(k + 1, len(EXPERIMENTS))
    return findings


def anchor(title: str) -> str:
    """A heading's anchor as Markdown readers make it.

    Examples
    --------
    >>> anchor("Whole actuator, low speed")
    'whole-actuator-low-speed'
    """
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def report_text(findings: list[Finding], axis_a: Unit, axis_b: Unit, seed: int) -> str:
    """The whole of ``reports/thesis.md``."""
    rows = [row for finding in findings for row in finding.rows]
    met = sum(row.verdict == "meets" for row in rows)
    lines = [
        "# The thesis's experiments on its simulated prototype",
        "",
        "The prototype of this project's reference, a master's thesis on a dual electro-hydrostatic "
        f"actuator with fault injection, is simulated by `fdd.plant` with the profiles `{axis_a.name}` "
        f"and `{axis_b.name}`. Here the experiments of its chapters 5, 6 and 7 are repeated on the "
        "simulated prototype as the thesis describes them, through simulated sensors, and what they give "
        "stands beside what the thesis prints. Every parameter comes from the profiles, where its source is "
        "noted, or is an assumption of `fdd.plant.Details`. Five assumed numbers were taken from what "
        "is shown here: the seals' break-away share from Table 5.1, the lag of their friction from section "
        "5.3's run-up, their resistance to quick changes from the decay of eq. 6.13's pole pair, the dead "
        "band of the drive's input from Table 6.1, and the share of the leakage that goes through the case "
        "drain from section 5.2. Nothing else was tuned to these results.",
        "",
        f"**{met} of {len(rows)} numbers meet the thesis's.** A number meets where it lies within the "
        f"thesis's own spread, or within {100 * READING:.0f} % where the thesis gives none, unless the "
        "row names another tolerance. Where one does not, its section gives the reason and, where there "
        "is one, the experiment that shows it. Where the thesis contradicts itself, both of its values "
        "are shown.",
        "",
        f"Made by `python -m evidence thesis --seed {seed}`.",
        "",
        "## Summary",
        "",
        *_summary(findings),
    ]  # fmt: skip
    for number, finding in enumerate(findings, 1):
        lines += _section(number, finding)
    return "\n".join(lines) + "\n"


def _summary(findings: list[Finding]) -> list[str]:
    rows: list[list[str]] = []
    for number, finding in enumerate(findings, 1):
        if not finding.rows:
            continue
        title = f"{number}. {finding.title}"
        met = sum(row.verdict == "meets" for row in finding.rows)
        link = f"**[{title}](#{anchor(title)})**"
        rows.append([link, *[""] * (len(HEAD) - 2), f"**{met} of {len(finding.rows)} meet**"])
        rows += [_cells(row) for row in finding.rows]
    return table(HEAD, rows)


def _cells(row: Row) -> list[str]:
    return [
        row.what,
        row.where,
        row.value(row.thesis),
        row.value(row.plant),
        "" if row.unit == "1" else row.unit,
        row.deviation,
        row.verdict if row.verdict == "meets" else f"**{row.verdict}**",
    ]


def _section(number: int, finding: Finding) -> list[str]:
    lines = [f"## {number}. {finding.title}", "", finding.method, ""]
    for picture in finding.pictures:
        lines += [f"![{picture.caption}]({PICTURES}/{picture.name}.png)", "", f"*{picture.caption}*", ""]
    if finding.rows:
        lines += [
            *table(
                [*HEAD, "allowed"],
                [[*_cells(r), f"± {number_text(r.allowed, 2)}"] for r in finding.rows],
            ),
            *_said(finding.rows),
        ]
    for one in finding.tables:
        lines += [f"{one.title}:", "", *table(one.heads, one.cells)]
    for remark in finding.remarks:
        lines += [remark, ""]
    return lines


def _said(rows: list[Row]) -> list[str]:
    """Reasons and notes below the table, each once, with the rows that it is for."""
    said: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.verdict != "meets" and row.why:
            said.setdefault(("Does not meet", row.why), []).append(row.what)
        if row.note:
            said.setdefault(("Note", row.note), []).append(row.what)
    lines = [f"- {kind}, {'; '.join(names)}: {text}" for (kind, text), names in said.items()]
    return [*lines, ""] if lines else []
