"""Pages in HTML that need no network: of one diagnosis, of an answer about several logs, of many answers.

plotly.js, which draws their figures, is shipped beside this module: the package plotly.js-cartesian-dist-min
as it was published, gzipped. The basic one, smaller by a fifth, would draw all figures, too.
"""

from __future__ import annotations

import base64
import csv
import gzip
import hashlib
import io
import json
import platform
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, lru_cache
from importlib import metadata, resources
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote

from markupsafe import Markup

import fdd
from fdd.diagnosis.findings import Diagnosis, FaultFinding, Trajectories
from fdd.files import whole_file
from fdd.report import tables
from fdd.report.plots import Figure, Section, sections
from fdd.report.words import MARKS, candidates, percent, second_opinion_words, seconds, span, verdict_words
from fdd.samples import Samples
from fdd.unit import Unit

if TYPE_CHECKING:
    import jinja2

PLOTLY_VERSION = "4.1.1"
PLOTLY_FILE = "plotly.min.js"
"""What pages look for beside them that do not hold it."""
COLUMNS = (
    "log", "unit", "axis", "started_at", "duration_s", "samples", "verdict", "fault", "family", "ambiguity",
    "shares", "confidence", "onset_s", "detected_s", "severity", "severity_low", "severity_high", "channel",
    "side", "next_check", "quality_notes", "error", "report",
)  # fmt: skip
"""Of summary.csv: one row a log and fault, one for a log without faults; contract's names and SI units."""
ORDER = ("faulty", "unreadable", "inconclusive", "healthy")


def render_report(
    diagnosis: Diagnosis, trajectories: Trajectories, samples: Samples, unit: Unit,
    settings: dict[str, str], *, alone: bool = True,
) -> str:  # fmt: skip
    """The report of one diagnosis as HTML, see `page`; text from the log is escaped.

    `settings` are what the diagnosis was run with, name to value, shown as they are.
    """
    found = sections(diagnosis, trajectories, samples)
    return page(
        "page.html", [f for s in found for f in s.figures], alone=alone,
        verdict=verdict_words(diagnosis, unit), second_opinion=second_opinion_words(diagnosis),
        diagnosis=diagnosis, duration=span(diagnosis.duration_s),
        sample_count=tables.grouped(diagnosis.samples), sections=found,
        probabilities=tables.probability_rows(diagnosis), estimates=tables.estimate_rows(diagnosis),
        quality=tables.quality_rows(diagnosis), sensors=tables.sensor_rows(diagnosis),
        invisible=tables.invisible_rows(diagnosis), unit_rows=tables.unit_rows(unit),
        versions=_versions(), settings=sorted(settings.items()),
    )  # fmt: skip


def page(name: str, figures: list[Figure], *, alone: bool = True, **shown: object) -> str:
    """A page from its template, with its figures, what draws them, and a policy that lets nothing else run.

    `alone` it holds plotly.js (0.7 MB); else it loads the one beside it, see `write_bundle`.
    """
    plain = [{"id": f.id, "data": f.data, "layout": f.layout, "height": f.height} for f in figures]
    bundle, bundle_hash = _bundle() if alone else ("", "")
    script = _part("page.js")
    # No browser checks the hash of a script that it loads from disk: what the page's own script loads may
    # run, and nothing else that stands in the page.
    others = bundle_hash if alone else "'strict-dynamic'"
    drawn = json.dumps(plain, allow_nan=False, separators=(",", ":")).encode("ascii")
    packed = base64.b64encode(gzip.compress(drawn, 6, mtime=0)).decode("ascii")  # the script unpacks it
    return _template(name).render(
        **shown, made=_stamp(), style=Markup(_part("page.css")), figures=packed, bundle=bundle,
        script=Markup(script), script_sources=Markup(f"{_source_hash(script.encode())} {others}"),
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


def render_sheet(sheet: Sheet) -> str:
    """The sheet as HTML, see `page`: tables after the first behind the plots; text from logs is escaped."""
    shown = [s for s in sheet.sections if s.figures]
    for section in shown:
        section.figures[-1].wide = len(section.figures) % 2 == 1
    return page(
        "sheet.html", [f for s in shown for f in s.figures], sheet=sheet, sections=shown,
        mark=MARKS.get(sheet.kind), version=fdd.__version__,
    )  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One log: its answer, and its page relative to the folder or an empty string."""

    answer: Diagnosis
    page: str

    @property
    def state(self) -> str:
        """The verdict, or ``unreadable``."""
        return "unreadable" if self.answer.error else self.answer.verdict

    @property
    def surest(self) -> FaultFinding | None:
        """The fault that the log is listed with."""
        return max(self.answer.faults, key=lambda f: f.confidence, default=None)


def _worst_first(row: Row) -> tuple[int, float, float]:
    """Key that sorts rows: by verdict, then the severest, then the surest; what has no severity is severe."""
    fault = row.surest
    if fault is None:
        return ORDER.index(row.state), 0.0, row.answer.probabilities.get("healthy", 0.0)
    severity = 1.0 if fault.severity is None else fault.severity
    return ORDER.index(row.state), -severity, -fault.confidence


def render_index(rows: Sequence[Row], *, missing: int = 0) -> str:
    """The page that lists the logs, worst first, as HTML that runs its one script only; `missing` counts logs
    that were not reached. Text from logs is escaped."""
    counts = Counter(row.state for row in rows)
    script = _part("index.js")
    return _template("index.html").render(
        title=f"Diagnosis of {len(rows)} logs", missing=missing, made=_stamp(), version=fdd.__version__,
        counts=[(state, counts[state]) for state in ORDER if counts[state]],
        rows=[_shown(rank, row) for rank, row in enumerate(sorted(rows, key=_worst_first))],
        style=Markup(_part("page.css") + _part("index.css")), script=Markup(script),
        script_sources=Markup(_source_hash(script.encode())),
    )  # fmt: skip


def _shown(rank: int, row: Row) -> dict[str, object]:
    """A row's texts, and the keys that its columns sort by."""
    answer, fault = row.answer, row.surest
    texts = dict.fromkeys(("fault", "since", "confidence", "severity"), "")
    keys: dict[str, float | str] = dict.fromkeys(("since", "confidence", "severity"), "")
    if fault is not None:
        more = f" and {len(answer.faults) - 1} more" if len(answer.faults) > 1 else ""
        texts |= {"fault": candidates(fault) + more, "since": seconds(fault.onset_s),
                  "confidence": percent(fault.confidence)}  # fmt: skip
        keys |= {"since": fault.onset_s, "confidence": fault.confidence}
        if fault.severity is not None:
            texts["severity"], keys["severity"] = f"{fault.severity:.2f}", fault.severity
    return {
        **texts, "keys": keys, "rank": rank, "log": answer.log, "unit": answer.unit, "state": row.state,
        "mark": MARKS.get(row.state, "×"), "error": answer.error or "", "notes": len(answer.quality.notes),
        "page": quote(row.page),
    }  # fmt: skip


def summary_csv(rows: Sequence[Row]) -> str:
    """The table for spreadsheets and pandas: comma, point, UTF-8 with a byte order mark; see `COLUMNS`."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\r\n")
    writer.writeheader()
    of_log = ("log", "unit", "axis", "started_at", "duration_s", "samples", "verdict", "error")
    of_fault = ("fault", "family", "onset_s", "detected_s", "severity", "channel", "side", "next_check")
    for row in rows:
        answer = row.answer
        common: dict[str, object] = {name: getattr(answer, name) for name in of_log}
        common |= {"quality_notes": len(answer.quality.notes), "report": row.page}
        found: list[dict[str, object]] = []
        for fault in answer.faults:
            low, high = fault.severity_interval or (None, None)
            shares = (str(fault.shares.get(name, "")) for name in fault.ambiguity)
            found.append({
                **{name: getattr(fault, name) for name in of_fault},
                "ambiguity": " ".join(fault.ambiguity), "shares": " ".join(shares).strip(),
                "confidence": round(fault.confidence, 6), "severity_low": low, "severity_high": high,
            })  # fmt: skip
        for each in found or [{}]:
            writer.writerow({k: _cell(v) for k, v in {**common, **each}.items()})
    return "\ufeff" + out.getvalue()


def _cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula is marked as text."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@")) else value


@cache  # a batch's pages all tell the same, and a package's version is looked up in its files
def _versions() -> list[tuple[str, str]]:
    """Versions of what computed the diagnosis."""
    libraries = [(name, metadata.version(name)) for name in ("numpy", "scipy", "numba", "scikit-learn")]
    fdd_itself = [("fdd", fdd.__version__), ("Python", platform.python_version())]
    return [*fdd_itself, *libraries, ("plotly.js", PLOTLY_VERSION)]


def _stamp() -> str:
    """When a page was made, to the minute."""
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M UTC}"


@lru_cache
def _template(name: str) -> jinja2.Template:
    """A page's template, e.g. ``"page.html"``: what is put into it is escaped."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    # A number stays on one line with the unit that follows.
    unit = re.compile(r"(?<=\d) (?=(?:%|s|min|h)\b|%)")
    environment.filters["unbroken"] = lambda text: unit.sub("\u00a0", text)
    return environment.from_string(_part(name))


@lru_cache
def _part(name: str) -> str:
    """The text of a part of a page, e.g. ``"page.css"``."""
    return (resources.files("fdd.report") / f"{name}.j2").read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _bundle() -> tuple[str, str]:
    """The bundle for a page that stands alone: base64 of gzip, and what a policy calls its script."""
    zipped = (resources.files("fdd.report") / f"{PLOTLY_FILE}.gz").read_bytes()
    return base64.b64encode(zipped).decode("ascii"), _source_hash(gzip.decompress(zipped))


def write_bundle(folder: Path) -> None:
    """Put the bundle into a folder of pages that share it; an InputError where it cannot be written."""
    with whole_file(folder / PLOTLY_FILE) as temporary:
        temporary.write_bytes(gzip.decompress(base64.b64decode(_bundle()[0])))


def _source_hash(script: bytes) -> str:
    """A script as a Content-Security-Policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script).digest()).decode('ascii')}'"
