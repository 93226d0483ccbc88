"""A unit over its life: each estimate through time, its slope, and when it comes to a limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.findings import ESTIMATED, Diagnosis
from fdd.errors import InputError
from fdd.history.answers import Life, Point, Trend, TrendLog
from fdd.history.changes import BETWEEN, LEVEL, seen
from fdd.history.limits import Limits
from fdd.history.line import Line, holm
from fdd.history.temperature import Fitted, covariate, fit_over_time
from fdd.report.words import fault_title

Array = NDArray[np.float64]

Each = Literal["log", "minute", "hour", "day"]
LEAST_LOGS = 4
"""For a line whose scatter is to be known: two more than it has coefficients."""
SMALLEST = 2.0
"""Of what healthy logs differ by (`BETWEEN`), the least change over all of them that is a trend."""
UNTOLD = "no trend that could be told"
UNDATED = (
    "Not all logs tell when they began: they stand in the order of their names, and a trend is one only if "
    "that is the order in which they were recorded."
)
OVERLAPPING = "Some logs began before the one before had ended: a trend over such logs is doubtful."
DAY_S = 86_400.0


@dataclass(frozen=True)
class Course:
    """A trend with what its picture needs: the line over time (m,) with half its 95 % band (m,)."""

    trend: Trend
    time: Array
    line: Array
    half: Array


def trend_of(answers: Sequence[Diagnosis], limits: Limits, each: Each = "log") -> tuple[Life, list[Course]]:
    """The life of a unit, from the answers of its logs.

    Parameters
    ----------
    answers : of one profile and axis, in any order, those of unreadable logs among them.
    limits : factors of the profile's, see `fdd.history.limits`. each : what one answer is of.

    Raises
    ------
    InputError : answers of several units, or none at all.
    """
    read = [a for a in answers if a.error is None]
    if not read:
        raise InputError("no log could be read", mend="see what is said of each")
    for word, names in (("profiles", {a.unit for a in read}), ("axes", {a.axis for a in read})):
        if len(names) > 1:
            raise InputError(
                f"the logs were diagnosed as of several {word}: {', '.join(sorted(names))}",
                mend="give the logs of one unit, with one --unit and --axis",
            )
    dated = all(a.started_at for a in read)
    read.sort(key=lambda a: (_stamp(a) if dated else 0.0, a.log))
    start = _stamp(read[0]) if dated else 0.0
    at = {id(a): (_stamp(a) - start) / DAY_S if dated else float(k) for k, a in enumerate(read)}
    logs = [_log(a, at.get(id(a))) for a in [*read, *(a for a in answers if a.error is not None)]]
    counted = [a for a, log in zip(read, logs, strict=False) if log.left_out is None]
    fitted = [_fit(name, counted, at, limits.get(name, (None, None)), each) for name in ESTIMATED]
    courses = [c for c in fitted if c is not None]
    trends = [c.trend for c in courses]
    told = [t for t in trends if t.p_value is not None]
    for trend, p in zip(told, holm([t.p_value or 0.0 for t in told]), strict=True):
        trend.p_holm = p
        change = abs((trend.last or 0.0) - (trend.first or 0.0))
        if p < LEVEL and change > SMALLEST * BETWEEN[trend.quantity]:
            trend.direction = "rises" if (trend.slope or 0.0) > 0.0 else "falls"
    per = "day" if dated else "log"
    for course in courses:
        _tell(course.trend, per)
    notes = [] if dated else [UNDATED]
    ends = [at[id(a)] + a.duration_s / DAY_S for a in read]
    if dated and any(at[id(b)] < end - 1.0 / DAY_S for b, end in zip(read[1:], ends, strict=False)):
        notes.append(OVERLAPPING)
    life = Life(
        headline=_headline(trends, logs, each, warned=bool(notes)), unit=read[0].unit, axis=read[0].axis,
        order="started_at" if dated else "name", per=per, each=each, logs=logs, trends=trends, notes=notes,
    )  # fmt: skip
    if counted and not np.ptp(_warmth(counted)):
        life.notes.append(f"No {each} tells an oil temperature of its own: none is taken out.")
    return life, courses


def _stamp(answer: Diagnosis) -> float:
    """s since 1970."""
    return datetime.fromisoformat(answer.started_at or "1970-01-01T00:00:00Z").timestamp()


def _log(answer: Diagnosis, at: float | None) -> TrendLog:
    left_out = answer.error
    if any(f.family == "sensor" for f in answer.faults):
        left_out = "a sensor failed: its estimates do not count"
    return TrendLog(
        log=answer.log, started_at=answer.started_at, at=at, verdict=answer.verdict,
        faults=[f.fault for f in answer.faults], left_out=left_out,
    )  # fmt: skip


def _warmth(answers: Sequence[Diagnosis]) -> Array:
    return covariate(np.array([a.estimates["leakage"].baseline or 1.0 for a in answers]))


def _fit(
    name: str, answers: Sequence[Diagnosis], at: dict[int, float], limit: tuple[float | None, float | None],
    each: Each,
) -> Course | None:  # fmt: skip
    """The quantity over time; None where no log shows it."""
    shown = [
        (a, pair[0] / e.baseline, pair[1] / e.baseline)
        for a in answers
        if (e := a.estimates[name]).baseline and (pair := seen(e)) is not None
    ]
    if not shown:
        return None
    logs, time = [a.log for a, _, _ in shown], np.array([at[id(a)] for a, _, _ in shown])
    factors, stds = np.array([v for _, v, _ in shown]), np.array([s for _, _, s in shown])
    span = float(np.ptp(time))
    none = np.empty(0)
    if len(shown) < LEAST_LOGS or span <= 0.0:
        count = f"{len(shown)} {each}" + ("" if len(shown) == 1 else "s")
        why = f"{count} tell of it; a line needs {LEAST_LOGS}, at several times"
        points = _points(logs, time, factors, stds)
        untold = Trend(quantity=name, temperature="not taken out", sentence=why, points=points)
        return Course(untold, none, none, none)
    # From the last log backwards, in spans of all: numbers near one, and what is wanted of it at hand.
    scaled = (time - time[-1]) / span
    warmth, between = _warmth([a for a, _, _ in shown]), BETWEEN[name]
    found = fit_over_time(scaled, factors, stds, warmth, between, leaks=name == "leakage")
    grid = np.linspace(scaled.min(), 0.0, 100)
    design = np.zeros((grid.size, found.line.coefficients.size))
    design[:, 0], design[:, 1] = 1.0, grid
    middle, half = found.line.band(design)
    middle = np.maximum(middle, 0.0)  # where a steep line would go on below nothing
    trend = _trend(name, found, span, limit, _points(logs, time, found.values, found.stds))
    trend.first = float(middle[0])
    return Course(trend, time[-1] + grid * span, middle, half)


def _trend(
    name: str, found: Fitted, span: float, limit: tuple[float | None, float | None], points: list[Point]
) -> Trend:
    line: Line = found.line
    slope = float(line.coefficients[1]) / span
    low, high = line.interval(1)
    trend = Trend(
        quantity=name, temperature=found.way, likelihood_gain=found.gain, points=points,
        between=line.between, slope=slope, slope_interval=(low / span, high / span),
        p_value=line.p_value(1), last=max(float(line.coefficients[0]), 0.0),
        limit=limit[1] if slope > 0.0 else limit[0],
    )  # fmt: skip
    crossed = None if trend.limit is None else line.crossing(trend.limit)
    if crossed is not None:
        until, least, most = (max(t, 0.0) * span for t in crossed)
        trend.until_limit, trend.until_limit_interval = until, (least, most)
    return trend


def _points(logs: list[str], time: Array, values: Array, stds: Array) -> list[Point]:
    return [
        Point(log=log, at=float(t), value=float(v), std=float(s))
        for log, t, v, s in zip(logs, time, values, stds, strict=True)
    ]


def _tell(trend: Trend, per: str) -> None:
    """The trend in one sentence; without one, nothing comes to a limit."""
    if trend.slope is None or trend.slope_interval is None:
        return
    factor, unit = _readable(trend.slope, per)
    low, high = (100.0 * factor * x for x in trend.slope_interval)
    slope = f"{100.0 * factor * trend.slope:+.3g} % per {unit} ({low:+.3g} to {high:+.3g}, 95 %)"
    slope = slope.replace("-", "−")
    if trend.direction is None:
        trend.until_limit = trend.until_limit_interval = None
        trend.sentence = f"{UNTOLD}: {slope}"
        return
    trend.sentence = f"{trend.direction}: {slope}"
    if trend.limit is None:
        return
    if trend.until_limit is None or trend.until_limit_interval is None:
        trend.sentence += f"; when it comes to {trend.limit:.3g} times the profile's cannot be told"
    elif trend.until_limit == 0.0:
        trend.sentence += f"; past {trend.limit:.3g} times the profile's"
    else:
        least, most = trend.until_limit_interval
        trend.sentence += (
            f"; {trend.limit:.3g} times the profile's in {trend.until_limit:.3g} {per}s "
            f"({least:.3g} to {most:.3g}, 80 %)"
        )


def _readable(slope: float, per: str) -> tuple[float, str]:
    """The time in which a slope is told, in `per`: a change of some percent."""
    if per == "log":
        return 1.0, "log"
    for factor, unit in ((1.0 / 24.0, "hour"), (1.0, "day"), (30.0, "30 days")):
        if abs(slope) * factor > 1e-3:
            return factor, unit
    return 365.25, "year"


def _headline(trends: Sequence[Trend], logs: Sequence[TrendLog], each: Each, *, warned: bool) -> str:
    """The faults that were found, then what goes on most surely."""
    named = dict.fromkeys(fault_title(f) for log in logs for f in log.faults)
    faulty = sum(bool(log.faults) for log in logs)
    parts = [f"faults in {faulty} of {len(logs)} {each}s ({', '.join(named)})"] if faulty else []
    told = sorted((t for t in trends if t.direction), key=lambda t: t.p_value or 0.0)
    parts += [f"{ESTIMATED[t.quantity][2].lower()} {t.sentence}" for t in told]
    if not told:
        counted = sum(log.left_out is None for log in logs)
        of_all = "" if counted == len(logs) else f" of {len(logs)}"
        parts.append(f"{UNTOLD} in {counted}{of_all} {each}s")
    elif warned:
        parts.append("their order is doubtful, see the notes")
    return "; ".join(parts)
