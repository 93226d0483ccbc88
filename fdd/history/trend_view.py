"""A life for people: tables for terminal and page, a CSV table, and the plots over time."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.findings import ESTIMATED
from fdd.history.answers import Life
from fdd.history.trend import Course
from fdd.report import traces as tr
from fdd.report.overview import cell
from fdd.report.plots import Figure, Section
from fdd.report.sheet import Sheet, Table
from fdd.report.tables import NOTHING, number, with_std
from fdd.report.words import fault_title

Z95 = 1.96


def trend_sheet(life: Life, courses: Sequence[Course]) -> Sheet:
    """The page of a unit's life."""
    told = any(t.direction for t in life.trends) or any(log.faults for log in life.logs)
    fitted = any(t.slope is not None for t in life.trends)
    return Sheet(
        kicker=f"Unit {life.unit}, axis {life.axis}, {len(life.logs)} {life.each}s",
        headline=life.headline,
        kind="faulty" if told else "healthy" if fitted else "inconclusive",
        remarks=life.notes,
        tables=trend_tables(life),
        sections=[
            Section(
                "Estimates over time",
                "As factors of the profile's healthy value, temperature taken out as told. Bars: 95 % of "
                f"each {life.each} alone, with what all of the unit err by together. Band: 95 % of the line. "
                f"Diamonds: {life.each}s with an alarm.",
                [_figure(c, life) for c in courses],
            )
        ],
    )


def trend_tables(life: Life) -> list[Table]:
    """A row a quantity, and a row a log."""
    trends: list[tuple[str, ...]] = [
        (ESTIMATED[t.quantity][2], str(len(t.points)), t.temperature, number(t.between, 2),
         number(t.first, 3), number(t.last, 3), number(t.p_holm, 2), t.sentence)
        for t in life.trends
    ]  # fmt: skip
    values = {t.quantity: {p.log: with_std(p.value, p.std) for p in t.points} for t in life.trends}
    titles = [ESTIMATED[name][2] for name in values]
    logs = [
        (
            x.log,
            NOTHING if x.started_at is None else x.started_at[:16].replace("T", " "),
            x.left_out or ": ".join([x.verdict, *filter(None, [", ".join(map(fault_title, x.faults))])]),
            *(v.get(x.log, NOTHING) for v in values.values()),
        )
        for x in life.logs
    ]
    logs_title = f"{life.each.capitalize()}s"
    spread = f"Std of {life.each}s"
    heads = ("Quantity", logs_title, "Temperature", spread, "First", "Last", "p (Holm)", "Trend")
    return [
        Table(
            "Trends", heads, trends,
            "Weighted least squares with scatter between them (REML, Knapp and Hartung); a trend is told at "
            "5 % over all quantities together (Holm). Limits are severity 1, unless given.",
            numbers=False, marked={k for k, t in enumerate(life.trends) if t.direction},
        ),
        Table(
            logs_title, (life.each.capitalize(), "Began", "Verdict", *titles), logs,
            "Estimates as factors of the profile's, ± standard deviation.", numbers=False,
        ),
    ]  # fmt: skip


def trend_csv(life: Life) -> str:
    """trend.csv: one row a log; comma, point, UTF-8 with a byte order mark."""
    points = {t.quantity: {p.log: (p.value, p.std) for p in t.points} for t in life.trends}
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\r\n")
    columns = [f"{name}{end}" for name in points for end in ("", "_std")]
    writer.writerow(["log", "started_at", f"{life.per}s", "verdict", "faults", *columns, "left_out"])
    for x in life.logs:
        figures = [v for found in points.values() for v in found.get(x.log, (None, None))]
        at, *plain = [None if v is None else float(f"{v:.6g}") for v in (x.at, *figures)]
        faults = " ".join(x.faults)
        writer.writerow([cell(x.log), x.started_at, at, x.verdict, faults, *plain, cell(x.left_out)])
    return "\ufeff" + out.getvalue()


def _figure(course: Course, life: Life) -> Figure:
    trend = course.trend
    alarmed = {x.log for x in life.logs if x.faults}
    dated = (x.started_at for x in life.logs if x.at == 0.0 and life.order == "started_at")
    start = next(dated, None)

    def places(at: NDArray[np.float64]) -> Any:
        """Dates, or the logs' numbers."""
        if start is None:
            return (at + 1.0).tolist()
        first = datetime.fromisoformat(start)
        return [f"{first + timedelta(days=float(d)):%Y-%m-%d %H:%M:%S}" for d in at]

    data: list[tr.Trace] = []
    if course.time.size:
        x = places(course.time)
        low, high = np.maximum(course.line - course.half, 0.0), course.line + course.half
        style = {"color": tr.BLUE, "width": 1.6, "dash": "solid" if trend.direction else "dot"}
        data = [
            tr.outline(x + x[::-1], [*high.tolist(), *low[::-1].tolist()], tr.BLUE),
            tr.scatter(x, course.line.tolist(), "line, 95 %", line=style),
        ]
    for name, colour, symbol, alarm in (
        (life.each, tr.BLUE, "circle", False),
        (f"{life.each} with an alarm", tr.VERMILLION, "diamond", True),
    ):
        chosen = [p for p in trend.points if (p.log in alarmed) == alarm]
        if chosen:
            bars = {"type": "data", "array": [Z95 * p.std for p in chosen], "thickness": 1, "width": 3}
            data.append(
                tr.scatter(
                    places(np.array([p.at for p in chosen])), [p.value for p in chosen], name, mode="markers",
                    text=[tr.label(p.log) for p in chosen], error_y=bars,
                    marker={"color": colour, "size": 8, "symbol": symbol},
                    hovertemplate="%{text}: %{y:.3f}<extra></extra>",
                )
            )  # fmt: skip
    if trend.direction and trend.limit is not None and _near(course):
        ends = places(np.array([min(p.at for p in trend.points), max(p.at for p in trend.points)]))
        style = {"color": tr.VERMILLION, "width": 1.6, "dash": "dash"}
        name = f"limit {trend.limit:.3g}"
        data.append(tr.scatter(ends, [trend.limit] * 2, name, line=style, hoverinfo="skip"))
    layout = {**tr.layout(hoverformat=".3f", range=_view(course)), "hovermode": "closest"}
    undated = {"title": {"text": "log, in the order of names"}}
    layout["xaxis"] = undated if start is None else {"type": "date"}
    title = ESTIMATED[trend.quantity][2]
    name, unit = f"trend-{trend.quantity}", "over the healthy one"
    return Figure(name, title, data, layout, unit, trend.sentence, height=320)


def _view(course: Course) -> list[float]:
    """A y range for the values and usual bars; one log that hardly knows must not flatten the others."""
    points = course.trend.points
    bar = Z95 * min(2.0 * float(np.median([p.std for p in points])), max(p.std for p in points))
    low = min([p.value - min(bar, Z95 * p.std) for p in points] + [*(course.line - course.half)])
    low = max(low, 0.0)
    high = max([p.value + min(bar, Z95 * p.std) for p in points] + [*(course.line + course.half)])
    if course.trend.direction and course.trend.limit is not None and _near(course):
        low, high = min(low, course.trend.limit), max(high, course.trend.limit)
    pad = 0.06 * (high - low)
    return [float(f"{max(low - pad, 0.0):.5g}"), float(f"{high + pad:.5g}")]


def _near(course: Course) -> bool:
    """Whether the limit may be drawn: far off it would flatten what is to be seen."""
    values = [1.0, *(p.value for p in course.trend.points)]
    return course.trend.limit is not None and abs(course.trend.limit - 1.0) < 4.0 * float(np.ptp(values))
