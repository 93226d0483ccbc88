"""Comparisons and lives for people: tables for terminal and page, and the plots."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED
from fdd.history import Comparison, EstimateChange, Life
from fdd.history.compare import NO_CHANGE
from fdd.history.trend import Course
from fdd.report import traces as tr
from fdd.report.page import Sheet, Table
from fdd.report.plots import TO_RPM, Figure, Section
from fdd.report.tables import NOTHING, number, with_std
from fdd.report.words import candidates, fault_title, percent, seconds, span
from fdd.residuals.balances import BALANCES

SHOWN = {"m": (1e3, "mm"), "Pa": (1e-5, "bar"), "rad/s": (TO_RPM, "rpm"), "N": (1e-3, "kN")}
"""SI unit of a signal to factor and unit for people."""
Z95 = 1.96


def compare_sheet(found: Comparison) -> Sheet:
    """The page of a comparison."""
    quiet = found.headline == NO_CHANGE
    blind = all(c.changed is None for c in found.estimates)
    verdicts = []
    for name, said in (("A", found.a), ("B", found.b)):
        faults = "; ".join(
            f"{candidates(f)} since {seconds(f.onset_s)}"
            + ("" if f.severity is None else f", severity {f.severity:.2f}")
            + f", {percent(f.confidence)} sure"
            for f in said.faults
        )
        told = f": {faults}" if faults else ""
        verdicts.append(f"{name}: {said.log}, {said.verdict} in {span(said.duration_s)}{told}")
    return Sheet(
        kicker=f"{found.a.log} (A) and {found.b.log} (B), unit {found.unit}, axis {found.axis}",
        headline=found.headline,
        kind="inconclusive" if quiet and blind else "healthy" if quiet else "faulty",
        remarks=[*verdicts, *found.notes], tables=_compare_tables(found),
        sections=[],
    )  # fmt: skip


def _compare_tables(found: Comparison) -> list[Table]:
    """Estimates, balances and duty."""
    conditions = "; ".join(
        f"{ESTIMATED[c.quantity][2].lower()} {c.conditions}" for c in found.estimates if c.conditions
    )
    balances: list[tuple[str, ...]] = [
        (BALANCES[c.balance].title if c.balance in BALANCES else c.balance,
         number(c.a, 3), number(c.b, 3), number(c.b / c.a if c.a and c.b else None, 3))
        for c in found.balances
    ]  # fmt: skip
    duty: list[tuple[str, ...]] = []
    for row in found.duty:
        factor, unit = SHOWN.get(row.unit, (1.0, row.unit))
        texts = (
            NOTHING if x is None else ", ".join(
                number(v, 3) if abs(v) < 1e3 else number(round(v), 9) for v in (value * factor for value in x)
            )
            for x in (row.a, row.b)
        )  # fmt: skip
        duty.append((row.signal.replace("_", " "), unit, *texts))
    tables = [
        Table(
            "Estimates at the end", ("Quantity", "A ± std", "B ± std", "B − A ± std", "Changed, p"),
            [_estimate(c) for c in found.estimates],
            f"{conditions[:1].upper() + conditions[1:]}. Test: {found.test}.",
            marked={k for k, c in enumerate(found.estimates) if c.changed},
        ),
        Table(
            "How well the balances close", ("Balance", "A", "B", "B over A"), balances,
            "Root mean square of each balance's misfit over the log, in what the profile's healthy one is: "
            "about 1 while healthy.",
        ),
        Table(
            "Duty", ("Signal", "Unit", "A", "B"), duty,
            "5th, 50th and 95th percentile, of speeds, pressures, current and load as magnitudes. "
            "Another duty explains much that differs.",
        ),
    ]  # fmt: skip
    return [t for t in tables if t.rows]


def _estimate(change: EstimateChange) -> tuple[str, ...]:
    _, unit, title = ESTIMATED[change.quantity]
    k = DISPLAY_SCALE[change.quantity]
    pairs = ((change.a, change.a_std), (change.b, change.b_std), (change.difference, change.std))
    texts = [NOTHING if v is None or std is None else with_std(v * k, std * k) for v, std in pairs]
    told = {True: "yes, ", False: "no, ", None: "not shown"}[change.changed]
    p = "" if change.p_holm is None else number(change.p_holm, 2)
    return f"{title} ({unit})", *texts, told + p


def trend_sheet(life: Life, courses: Sequence[Course]) -> Sheet:
    """The page of a unit's life."""
    told = any(t.direction for t in life.trends) or any(log.faults for log in life.logs)
    fitted = any(t.slope is not None for t in life.trends)
    how = (
        "As factors of the profile's healthy value, temperature taken out as told. Bars: 95 % of "
        f"each {life.each} alone, with what all of the unit err by together. Band: 95 % of the line. "
        f"Diamonds: {life.each}s with an alarm."
    )
    return Sheet(
        kicker=f"Unit {life.unit}, axis {life.axis}, {len(life.logs)} {life.each}s", headline=life.headline,
        kind="faulty" if told else "healthy" if fitted else "inconclusive",
        remarks=life.notes, tables=_trend_tables(life),
        sections=[Section("Estimates over time", how, [_course_figure(c, life) for c in courses])],
    )  # fmt: skip


def _trend_tables(life: Life) -> list[Table]:
    """A row a quantity, and a row a log."""
    trends: list[tuple[str, ...]] = [
        (ESTIMATED[t.quantity][2], str(len(t.points)), t.temperature, number(t.between, 2),
         number(t.first, 3), number(t.last, 3), number(t.p_holm, 2), t.sentence)
        for t in life.trends
    ]  # fmt: skip
    values = {t.quantity: {p.log: with_std(p.value, p.std) for p in t.points} for t in life.trends}
    titles = [ESTIMATED[name][2] for name in values]
    logs = [
        (x.log, NOTHING if x.started_at is None else x.started_at[:16].replace("T", " "),
         x.left_out or ": ".join([x.verdict, *filter(None, [", ".join(map(fault_title, x.faults))])]),
         *(v.get(x.log, NOTHING) for v in values.values()))
        for x in life.logs
    ]  # fmt: skip
    logs_title, spread = f"{life.each.capitalize()}s", f"Std of {life.each}s"
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


def _course_figure(course: Course, life: Life) -> Figure:
    trend = course.trend
    alarmed = {x.log for x in life.logs if x.faults}
    start = next((x.started_at for x in life.logs if x.at == 0.0 and life.order == "started_at"), None)

    def places(at: NDArray[np.float64]) -> Any:
        """Dates, or the logs' numbers."""
        if start is None:
            return (at + 1.0).tolist()
        first = datetime.fromisoformat(start)
        return [f"{first + timedelta(days=float(d)):%Y-%m-%d %H:%M:%S}" for d in at]

    data: list[tr.Trace] = []
    low, high = course.line - course.half, course.line + course.half
    if course.time.size:
        x = places(course.time)
        style = {"color": tr.BLUE, "width": 1.6, "dash": "solid" if trend.direction else "dot"}
        data = [
            tr.outline(x + x[::-1], [*high.tolist(), *np.maximum(low, 0.0)[::-1].tolist()], tr.BLUE),
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
    # A y range for the values and usual bars; one log that hardly knows must not flatten the others.
    at, values, stds = (np.array([getattr(p, n) for p in trend.points]) for n in ("at", "value", "std"))
    half = Z95 * np.minimum(np.minimum(2.0 * np.median(stds), stds.max()), stds)
    least, most = max(min([*(values - half), *low]), 0.0), max([*(values + half), *high])
    # Nor a limit that is far off.
    near = 4.0 * np.ptp(np.append(values, 1.0))
    if trend.direction and trend.limit is not None and abs(trend.limit - 1.0) < near:
        least, most = min(least, trend.limit), max(most, trend.limit)
        ends = places(np.array([at.min(), at.max()]))
        style = {"color": tr.VERMILLION, "width": 1.6, "dash": "dash"}
        name = f"limit {trend.limit:.3g}"
        data.append(tr.scatter(ends, [trend.limit] * 2, name, line=style, hoverinfo="skip"))
    pad = 0.06 * (most - least)
    reach = [float(f"{max(least - pad, 0.0):.5g}"), float(f"{most + pad:.5g}")]
    layout = {**tr.layout(hoverformat=".3f", range=reach), "hovermode": "closest"}
    undated = {"title": {"text": "log, in the order of names"}}
    layout["xaxis"] = undated if start is None else {"type": "date"}
    title = ESTIMATED[trend.quantity][2]
    name, unit = f"trend-{trend.quantity}", "over the healthy one"
    return Figure(name, title, data, layout, unit, trend.sentence, height=320)
