"""Many answers at a glance: a page and a table."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from urllib.parse import quote

from markupsafe import Markup

import fdd
from fdd.diagnosis.findings import Diagnosis, FaultFinding
from fdd.report.page import part, stamp, template
from fdd.report.plotly import source_hash
from fdd.report.words import MARKS, candidates, percent, seconds

COLUMNS = (
    "log", "unit", "axis", "started_at", "duration_s", "samples", "verdict", "fault", "family", "ambiguity",
    "shares", "confidence", "onset_s", "detected_s", "severity", "severity_low", "severity_high", "channel",
    "side", "next_check", "quality_notes", "error", "report",
)  # fmt: skip
"""Of summary.csv: one row a log and fault, one for a log without faults; contract's names and SI units."""
ORDER = ("faulty", "unreadable", "inconclusive", "healthy")


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


def render_index(rows: Sequence[Row], *, missing: int = 0, made: datetime | None = None) -> str:
    """The page that lists the logs, worst first, as HTML that needs no network and runs its one script only.

    `missing` counts logs that were not reached; `made` is when, now where None. Text from logs is escaped.
    """
    counts = Counter(row.state for row in rows)
    script = part("index.js")
    return template("index.html").render(
        title=f"Diagnosis of {len(rows)} logs", missing=missing, made=stamp(made), version=fdd.__version__,
        counts=[(state, counts[state]) for state in ORDER if counts[state]],
        rows=[_shown(rank, row) for rank, row in enumerate(sorted(rows, key=_worst_first))],
        style=Markup(part("page.css") + part("index.css")), script=Markup(script),
        script_sources=Markup(source_hash(script.encode())),
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
            writer.writerow({k: cell(v) for k, v in {**common, **each}.items()})
    return "\ufeff" + out.getvalue()


def cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula is marked as text."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@")) else value
