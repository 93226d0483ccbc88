"""A page of tables and plots under one headline, for answers about several logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

import fdd
from fdd.report.page import page
from fdd.report.plots import Section
from fdd.report.words import MARKS


@dataclass
class Table:
    """Rows of text under a title; all but the first column are shown as numbers where `numbers`.

    Attributes
    ----------
    note : above it. columns : titles, the first that of the rows' names. rows : as many texts each. marked :
        places of rows that stand out.
    """

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]
    note: str = ""
    numbers: bool = True
    marked: set[int] = field(default_factory=set)


@dataclass
class Sheet:
    """What a page says.

    Attributes
    ----------
    kicker : above the headline: what it is about. kind : of verdict, which gives the colour.
    """

    kicker: str
    headline: str
    kind: Literal["healthy", "faulty", "inconclusive"]
    remarks: list[str]
    tables: list[Table]
    sections: list[Section]


def render_sheet(sheet: Sheet, *, alone: bool = True, made: datetime | None = None) -> str:
    """The page as HTML, tables after the first behind the plots; text from logs is escaped.

    Parameters
    ----------
    alone : the page holds plotly.js; else it loads the one beside it, see `plotly.write_bundle`.
    made : when; now, where None.
    """
    shown: Sequence[Section] = [s for s in sheet.sections if s.figures]
    for section in shown:
        section.figures[-1].wide = len(section.figures) % 2 == 1
    return page(
        "sheet.html", [f for s in shown for f in s.figures], alone=alone, made=made, sheet=sheet,
        sections=shown, mark=MARKS[sheet.kind], version=fdd.__version__,
    )  # fmt: skip
