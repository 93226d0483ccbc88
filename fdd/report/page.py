"""Pages: verdict, plots and tables in one HTML file that needs no network."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from markupsafe import Markup

import fdd
from fdd.diagnosis.findings import Diagnosis, Trajectories
from fdd.files import write_text
from fdd.report import plotly, tables
from fdd.report.plots import Figure, Section, sections
from fdd.report.words import MARKS, second_opinion_words, span, verdict_words
from fdd.samples import Samples
from fdd.unit import Unit

if TYPE_CHECKING:
    import jinja2


def render_report(
    diagnosis: Diagnosis, trajectories: Trajectories, samples: Samples, unit: Unit,
    settings: dict[str, str], *, alone: bool = True, made: datetime | None = None,
) -> str:  # fmt: skip
    """The report of one diagnosis as HTML, see `page`; text from the log is escaped.

    `settings` are what the diagnosis was run with, name to value, shown as they are.
    """
    found = sections(diagnosis, trajectories, samples)
    return page(
        "page.html", [f for s in found for f in s.figures], alone=alone, made=made,
        verdict=verdict_words(diagnosis, unit), second_opinion=second_opinion_words(diagnosis),
        diagnosis=diagnosis, duration=span(diagnosis.duration_s),
        sample_count=tables.grouped(diagnosis.samples), sections=found,
        probabilities=tables.probability_rows(diagnosis), estimates=tables.estimate_rows(diagnosis),
        quality=tables.quality_rows(diagnosis), sensors=tables.sensor_rows(diagnosis),
        invisible=tables.invisible_rows(diagnosis), unit_rows=tables.unit_rows(unit),
        versions=tables.version_rows(), settings=sorted(settings.items()),
    )  # fmt: skip


def page(
    name: str, figures: list[Figure], *, alone: bool = True, made: datetime | None = None, **shown: object
) -> str:
    """A page from its template, with its figures, what draws them, and a policy that lets nothing else run.

    Parameters
    ----------
    alone : the page holds plotly.js (0.7 MB); else it loads the one beside it, see `plotly.write_bundle`.
    made : when; now, where None.
    """
    plain = [{"id": f.id, "data": f.data, "layout": f.layout, "height": f.height} for f in figures]
    bundle, bundle_hash = plotly.bundle() if alone else ("", "")
    script = part("page.js")
    # No browser checks the hash of a script that it loads from disk: what the page's own script loads may
    # run, and nothing else that stands in the page.
    others = bundle_hash if alone else "'strict-dynamic'"
    drawn = json.dumps(plain, allow_nan=False, separators=(",", ":")).encode("ascii")
    return template(name).render(
        **shown, made=stamp(made), style=Markup(part("page.css")), figures=plotly.packed(drawn),
        bundle=bundle, script=Markup(script),
        script_sources=Markup(f"{plotly.source_hash(script.encode())} {others}"),
    )  # fmt: skip


@dataclass
class Table:
    """Rows of text under a title and a note; all columns but the first, the names, are shown as numbers where
    `numbers`. `marked` are places of rows that stand out."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]
    note: str = ""
    numbers: bool = True
    marked: set[int] = field(default_factory=set)


@dataclass
class Sheet:
    """A page of tables and plots under one headline, for answers about several logs. The `kicker` above it
    says what it is about; `kind` is that of the verdict, which gives mark and colour."""

    kicker: str
    headline: str
    kind: Literal["healthy", "faulty", "inconclusive", "plain"]
    remarks: list[str]
    tables: list[Table]
    sections: list[Section]


def render_sheet(sheet: Sheet, *, alone: bool = True, made: datetime | None = None) -> str:
    """The sheet as HTML, see `page`: tables after the first behind the plots; text from logs is escaped."""
    shown = [s for s in sheet.sections if s.figures]
    for section in shown:
        section.figures[-1].wide = len(section.figures) % 2 == 1
    return page(
        "sheet.html", [f for s in shown for f in s.figures], alone=alone, made=made, sheet=sheet,
        sections=shown, mark=MARKS.get(sheet.kind), version=fdd.__version__,
    )  # fmt: skip


def stamp(made: datetime | None) -> str:
    """When a page was made, to the minute; now, where None."""
    return f"{made or datetime.now(UTC):%Y-%m-%d %H:%M UTC}"


def write_report(
    path: str | Path, diagnosis: Diagnosis, trajectories: Trajectories, samples: Samples, unit: Unit,
    settings: dict[str, str], *, alone: bool = True,
) -> None:  # fmt: skip
    """Write the report whole or not at all, see `render_report`; an InputError where that cannot be."""
    write_text(path, render_report(diagnosis, trajectories, samples, unit, settings, alone=alone))


@lru_cache
def template(name: str) -> jinja2.Template:
    """A page's template, e.g. ``"page.html"``: what is put into it is escaped."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    # A number stays on one line with the unit that follows.
    unit = re.compile(r"(?<=\d) (?=(?:%|s|min|h)\b|%)")
    environment.filters["unbroken"] = lambda text: unit.sub("\u00a0", text)
    return environment.from_string(part(name))


@lru_cache
def part(name: str) -> str:
    """The text of a part of a page, e.g. ``"page.css"``."""
    return (resources.files("fdd.report") / f"{name}.j2").read_text(encoding="utf-8")
