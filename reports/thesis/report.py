"""``python -m reports thesis``: all experiments in the thesis's order, and the report on them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fdd.cli.console import progress
from fdd.markdown import table
from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis import control, flow, friction, response
from reports.thesis.runs import Figures
from reports.writing import FOLDER, OutOption, draw, require_folder, template, write_report

HEAD = ["what", "thesis, where", "thesis", "plant", "unit", "deviation", "verdict"]
EXPERIMENTS: tuple[Callable[[Unit, Unit, int], Figures], ...] = (
    flow.gain,
    flow.leakage,
    friction.static_friction,
    friction.sliding_friction,
    flow.bulk_modulus,
    flow.transfer_function,
    response.servomotor,
    response.low_speed,
    response.high_speed,
    control.dead_band,
    control.position_step,
    control.ultimate_gain,
)
"""One for each section of the report, a block of its name in the template."""


READING = 0.05
"""Relative deviation allowed where the thesis gives no spread: its plots cannot be read closer."""


@dataclass(frozen=True)
class Row:
    """One number of the thesis beside the plant's.

    `where`: section, equation or table of the thesis. `thesis`, `plant`: values in `unit`. `tolerance`:
    allowed distance; None for `READING` of the thesis's value. `why`: shown where the row does not meet.
    `note`: shown in any case. `digits`: significant ones to show.
    """

    what: str
    where: str
    thesis: float
    plant: float
    unit: str
    tolerance: float | None = None
    why: str = ""
    note: str = ""
    digits: int = 3

    @property
    def allowed(self) -> float:
        """Largest distance that meets, in `unit`."""
        return READING * abs(self.thesis) if self.tolerance is None else self.tolerance

    @property
    def verdict(self) -> Literal["meets", "does not meet"]:
        """Whether the plant's value lies within the tolerance; NaN does not."""
        return "meets" if abs(self.plant - self.thesis) <= self.allowed else "does not meet"

    @property
    def deviation(self) -> str:
        """Relative to the thesis, in percent, or as a factor where it is off by more than three."""
        if self.plant != self.plant:
            return "none found"
        ratio = self.plant / self.thesis
        if ratio > 3.0 or 0.0 < ratio < 1.0 / 3.0:
            return f"× {ratio:.2g}"
        percent = round(100.0 * (ratio - 1.0), 1)
        return f"{percent:+.1f} %" if percent else "0.0 %"

    def cells(self) -> list[str]:
        """As the tables show it."""
        values = (number_text(value, self.digits) for value in (self.thesis, self.plant))
        verdict = self.verdict if self.verdict == "meets" else f"**{self.verdict}**"
        unit = "" if self.unit == "1" else self.unit
        return [self.what, self.where, *values, unit, self.deviation, verdict]


def number_text(number: float, digits: int = 3) -> str:
    """A number with its significant digits, without an exponent, never ``-0``."""
    if number != number or number == 0.0:
        return "0" if number == 0.0 else "none"
    return format(Decimal(f"{number:.{digits - 1}e}"), "f")


def thesis(
    out: OutOption = FOLDER, seed: Annotated[int, typer.Option(min=0, max=10_000, help="Of all trials.")] = 0
) -> None:
    """Repeat the thesis's experiments on the plant, its numbers beside the thesis's (a minute)."""
    require_folder(out, pictures=True)
    sections = []
    with progress("the thesis's experiments", float(len(EXPERIMENTS))) as advance:
        for number, experiment in enumerate(EXPERIMENTS, 1):
            name = experiment.__name__
            found = experiment(Unit.load("axis_a"), Unit.load("axis_b"), 100_000 * seed + 1)
            panels = found.pop("picture", [])
            if panels:
                columns, height = (2, 6.0) if len(panels) == 4 else (1, 4.2 if len(panels) == 1 else 5.6)
                draw(out / "thesis" / f"{name}.png", panels, columns=columns, height=height)
            sections.append(section(name, found))
            advance(float(number))
    write_report(out / "thesis.md", report_text(sections, seed))
    for text, rows in sections:
        print(f"{_title(text)}: {_met(rows)} of {len(rows)} numbers meet the thesis's")


def section(name: str, found: Figures) -> tuple[str, list[Row]]:
    """An experiment's section of the report, its title without a number, and the rows in it."""
    rows: list[Row] = []

    def shown() -> str:
        cells = [[*row.cells(), f"± {number_text(row.allowed, 2)}"] for row in rows]
        return "\n".join([*table([*HEAD, "allowed"], cells), *_said(rows)])

    text = _block(
        name, **found, details=Details(), hertz=2.0 * math.pi, rows=shown,
        row=lambda *values, **more: rows.append(Row(*values, **more)),
        picture=lambda caption: f"![{caption}](thesis/{name}.png)\n\n*{caption}*\n",
    )  # fmt: skip
    return re.sub(r"\n{3,}", "\n\n", text).strip(), rows


def _title(text: str) -> str:
    return text.partition("\n")[0].removeprefix("## ")


def _met(rows: list[Row]) -> int:
    return sum(row.verdict == "meets" for row in rows)


def anchor(title: str) -> str:
    """A heading's anchor as Markdown readers make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def report_text(sections: list[tuple[str, list[Row]]], seed: int) -> str:
    """The whole of ``reports/thesis.md``."""
    every, summary, body = [row for _, rows in sections for row in rows], [], []
    for number, (text, rows) in enumerate(sections, 1):
        title = f"{number}. {_title(text)}"
        link = f"**[{title}](#{anchor(title)})**"
        summary.append([link, *[""] * (len(HEAD) - 2), f"**{_met(rows)} of {len(rows)} meet**"])
        summary += [row.cells() for row in rows]
        body += [text.replace(f"## {_title(text)}", f"## {title}", 1), ""]
    return _block(
        "report", met=_met(every), rows=len(every), reading=READING, seed=seed,
        summary="\n".join(table(HEAD, summary)), body="\n".join(body),
    )  # fmt: skip


def _block(name: str, **given: Any) -> str:
    """A block of the template."""
    page = template(Path(__file__).with_name("thesis.md.j2"), number=number_text)
    return "".join(page.blocks[name](page.new_context(given)))


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
