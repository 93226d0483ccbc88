"""``python -m reports thesis``: all experiments in the thesis's order, and the report on them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fdd.cli.console import progress
from fdd.markdown import table
from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis import control, dead_band, flow, friction, response, servomotor
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
    servomotor.servomotor,
    response.low_speed,
    response.high_speed,
    dead_band.dead_band,
    control.chatter_filter,
    control.position_step,
    control.ultimate_gain,
)
"""One for each section of the report, a block of its name in the template."""


READING = 0.05
"""Relative deviation allowed where the thesis gives no spread: its plots cannot be read closer."""


@dataclass(frozen=True)
class Row:
    """One number of the thesis beside the plant's.

    `what`, `where`: quantity, and section, equation or table of the thesis. `thesis`, `plant`: values in
    `unit`. `unit`: as it is to be shown. `tolerance`: allowed distance in `unit`; None for `READING` of the
    thesis's value. `why`: the reason, shown where the row does not meet. `note`: what a reader must know in
    any case; may be empty. `digits`: significant ones to show.
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
        return [
            self.what,
            self.where,
            number_text(self.thesis, self.digits),
            number_text(self.plant, self.digits),
            "" if self.unit == "1" else self.unit,
            self.deviation,
            self.verdict if self.verdict == "meets" else f"**{self.verdict}**",
        ]


def number_text(number: float, digits: int = 3) -> str:
    """A number with its significant digits, without an exponent where it reads well, never ``-0``."""
    if number != number:
        return "none"
    if number == 0.0:
        return "0"
    if 1e-4 <= abs(number) < 10.0**digits:
        places = max(digits - 1 - int(f"{number:.{digits - 1}e}".split("e")[1]), 0)
        return f"{number:.{places}f}"
    if 10.0**digits <= abs(number) < 1e6:
        return f"{float(f'{number:.{digits}g}'):.0f}"
    return f"{number:.{digits}g}"


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
    write_report(out / "thesis.md", "\n".join(report_lines(sections, seed)))
    for text, rows in sections:
        print(f"{_title(text)}: {_met(rows)} of {len(rows)} numbers meet the thesis's")


def section(name: str, found: Figures) -> tuple[str, list[Row]]:
    """An experiment's section of the report, its title without a number, and the rows in it."""
    rows: list[Row] = []

    def shown() -> str:
        cells = [[*row.cells(), f"± {number_text(row.allowed, 2)}"] for row in rows]
        return "\n".join([*table([*HEAD, "allowed"], cells), *_said(rows)])

    page = template(Path(__file__).with_name("thesis.md.j2"), number=number_text)
    given: dict[str, Any] = {
        **found, "details": Details(), "hertz": 2.0 * math.pi, "rows": shown,
        "row": lambda *values, **more: rows.append(Row(*values, **more)),
        "picture": lambda caption: f"![{caption}](thesis/{name}.png)\n\n*{caption}*\n",
    }  # fmt: skip
    text = "".join(page.blocks[name](page.new_context(given)))
    return re.sub(r"\n{3,}", "\n\n", text).strip(), rows


def _title(text: str) -> str:
    return text.partition("\n")[0].removeprefix("## ")


def _met(rows: list[Row]) -> int:
    return sum(row.verdict == "meets" for row in rows)


def anchor(title: str) -> str:
    """A heading's anchor as Markdown readers make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def report_lines(sections: list[tuple[str, list[Row]]], seed: int) -> list[str]:
    """The whole of ``reports/thesis.md``."""
    every, summary, body = [row for _, rows in sections for row in rows], [], []
    for number, (text, rows) in enumerate(sections, 1):
        title = f"{number}. {_title(text)}"
        link = f"**[{title}](#{anchor(title)})**"
        summary.append([link, *[""] * (len(HEAD) - 2), f"**{_met(rows)} of {len(rows)} meet**"])
        summary += [row.cells() for row in rows]
        body += [text.replace(f"## {_title(text)}", f"## {title}", 1), ""]
    return [
        "# The thesis's experiments on its simulated prototype",
        "",
        "The prototype of this project's reference, a master's thesis on a dual electro-hydrostatic "
        "actuator with fault injection, is simulated by `fdd.plant` with the profiles `axis_a` "
        "and `axis_b`. Here the experiments of its chapters 5, 6 and 7 are repeated on the "
        "simulated prototype as the thesis describes them, through simulated sensors, and what they give "
        "stands beside what the thesis prints. Every parameter comes from the profiles, where its source is "
        "noted, or is an assumption of `fdd.plant.Details`. Five assumed numbers were taken from what "
        "is shown here: the seals' break-away share from Table 5.1, the lag of their friction from section "
        "5.3's run-up, their resistance to quick changes from the decay of eq. 6.13's pole pair, the dead "
        "band of the drive's input from Table 6.1, and the share of the leakage that goes through the case "
        "drain from section 5.2. Nothing else was tuned to these results.",
        "",
        f"**{_met(every)} of {len(every)} numbers meet the thesis's.** A number meets where it lies within "
        f"the thesis's own spread, or within {100 * READING:.0f} % where the thesis gives none, unless the "
        "row names another tolerance. Where one does not, its section gives the reason and, where there "
        "is one, the experiment that shows it. Where the thesis contradicts itself, both of its values "
        "are shown.",
        "",
        f"Made by `python -m reports thesis --seed {seed}`.",
        "",
        "## Summary",
        "",
        *table(HEAD, summary),
        *body,
    ]


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
