"""``python -m reports thesis``: all experiments in the thesis's order, and the report on them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import typer

from fdd.campaign.card import table
from fdd.cli.console import progress
from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis import control, flow, friction, response
from reports.thesis.runs import VOLT, Figures, holding_leakage, hydraulic_gain
from reports.writing import FOLDER, OutOption, draw, number_text, render, require_folder, write_report

AXES = {name: Unit.load(f"axis_{name.lower()}") for name in "AB"}
TEMPLATE = Path(__file__).with_name("thesis.md.j2")
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


class Row(NamedTuple):
    """One number of the thesis beside the plant's; `where` in the thesis it stands.

    `tolerance`: allowed distance, None for `READING` of the thesis's value. `why`: shown where the row does
    not meet. `note`: shown in any case. `digits`: significant ones to show.
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


def thesis(
    out: OutOption = FOLDER, seed: Annotated[int, typer.Option(min=0, max=10_000, help="Of all trials.")] = 0
) -> None:
    """Repeat the thesis's experiments on the plant, its numbers beside the thesis's (3 min)."""
    require_folder(out, pictures=True)
    sections = []
    with progress("the thesis's experiments", float(len(EXPERIMENTS))) as advance:
        for number, experiment in enumerate(EXPERIMENTS, 1):
            name = experiment.__name__
            found = experiment(AXES["A"], AXES["B"], 100_000 * seed + 1)
            if panels := found.pop("picture", []):
                columns, height = {1: (1, 4.2), 2: (1, 5.6), 4: (2, 6.0)}[len(panels)]
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

    text = render(
        TEMPLATE, name, **found, details=Details(), hertz=2.0 * math.pi, volt=VOLT, units=AXES, rows=shown,
        gain_of=hydraulic_gain, holding=holding_leakage,
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
    return render(
        TEMPLATE, "report", met=_met(every), rows=len(every), reading=READING, seed=seed,
        summary="\n".join(table(HEAD, summary)), body="\n".join(body),
    )  # fmt: skip


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
