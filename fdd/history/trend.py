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
from fdd.faults import CATALOGUE
from fdd.history import Life, Point, Trend, TrendLog
from fdd.history.compare import BETWEEN, LEVEL, seen
from fdd.history.line import fit_over_time, holm
from fdd.report.words import fault_title
from fdd.residuals.oil import air_compliance
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

Array = NDArray[np.float64]

Limits = dict[str, tuple[float | None, float | None]]
"""Quantity to its least and greatest factor of the profile's; None where there is no limit."""
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
    """The life of a unit, from the answers of its logs, or of `each` of its hours or days, in any order,
    those of unreadable logs among them; `limits` are those of `severity_one` or `given_limits`.

    Raises InputError: answers of several units, or none at all.
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

    def began(answer: Diagnosis) -> float:
        return datetime.fromisoformat(answer.started_at or "").timestamp() if dated else 0.0

    read.sort(key=lambda a: (began(a), a.log))
    start, per = began(read[0]), "day" if dated else "log"
    at = [(began(a) - start) / DAY_S if dated else float(k) for k, a in enumerate(read)]
    logs = []
    for answer, day in [*zip(read, at, strict=True), *((a, None) for a in answers if a.error is not None)]:
        failed = any(f.family == "sensor" for f in answer.faults)
        logs.append(TrendLog(
            log=answer.log, started_at=answer.started_at, at=day, verdict=answer.verdict,
            faults=[f.fault for f in answer.faults],
            left_out="a sensor failed: its estimates do not count" if failed else answer.error,
        ))  # fmt: skip
    counted = [(a, t) for a, t, log in zip(read, at, logs, strict=False) if log.left_out is None]
    fitted = [_fit(name, counted, limits.get(name, (None, None)), each) for name in ESTIMATED]
    courses = [c for c in fitted if c is not None]
    trends = [c.trend for c in courses]
    told = [t for t in trends if t.p_value is not None]
    for trend, p in zip(told, holm([t.p_value or 0.0 for t in told]), strict=True):
        trend.p_holm = p
        change = abs((trend.last or 0.0) - (trend.first or 0.0))
        if p < LEVEL and change > SMALLEST * BETWEEN[trend.quantity]:
            trend.direction = "rises" if (trend.slope or 0.0) > 0.0 else "falls"
        _tell(trend, per)
    notes = [] if dated else [UNDATED]
    ends = [t + a.duration_s / DAY_S for a, t in zip(read, at, strict=True)]
    if dated and any(t < end - 1.0 / DAY_S for t, end in zip(at[1:], ends, strict=False)):
        notes.append(OVERLAPPING)
    headline = _headline(trends, logs, each, warned=bool(notes))
    if counted and not np.ptp(_warmth([a for a, _ in counted])):
        notes.append(f"No {each} tells an oil temperature of its own: none is taken out.")
    life = Life(
        headline=headline, unit=read[0].unit, axis=read[0].axis, order="started_at" if dated else "name",
        per=per, each=each, logs=logs, trends=trends, notes=notes,
    )  # fmt: skip
    return life, courses


def _warmth(answers: Sequence[Diagnosis]) -> Array:
    """ln of each log's healthy leakage over their median's (n,): 0 for all where none tells a temperature."""
    healthy = np.array([a.estimates["leakage"].baseline or 1.0 for a in answers])
    return np.asarray(np.log(healthy / np.median(healthy)))


def _fit(
    name: str, counted: Sequence[tuple[Diagnosis, float]], limit: tuple[float | None, float | None],
    each: Each,
) -> Course | None:  # fmt: skip
    """The quantity over time; None where no log shows it."""
    shown = [
        (a, t, pair[0] / e.baseline, pair[1] / e.baseline)
        for a, t in counted
        if (e := a.estimates[name]).baseline and (pair := seen(e)) is not None
    ]
    if not shown:
        return None
    answers, *columns = zip(*shown, strict=True)
    time, factors, stds = map(np.array, columns)
    span = float(np.ptp(time))

    def as_points(values: Array, stds: Array) -> list[Point]:
        rows = zip(answers, time.tolist(), values.tolist(), stds.tolist(), strict=True)
        return [Point(log=a.log, at=t, value=v, std=s) for a, t, v, s in rows]

    if len(shown) < LEAST_LOGS or span <= 0.0:
        count = f"{len(shown)} {each} shows" if len(shown) == 1 else f"{len(shown)} {each}s show"
        why, points = f"{count} it; a line needs {LEAST_LOGS}, at several times", as_points(factors, stds)
        untold = Trend(quantity=name, temperature="not taken out", sentence=why, points=points)
        return Course(untold, *[np.empty(0)] * 3)
    # From the last log backwards, in spans of all: numbers near one, and what is wanted of it at hand.
    scaled = (time - time[-1]) / span
    found = fit_over_time(scaled, factors, stds, _warmth(answers), BETWEEN[name], leaks=name == "leakage")
    line, grid = found.line, np.linspace(scaled.min(), 0.0, 100)
    design = np.zeros((grid.size, line.coefficients.size))
    design[:, 0], design[:, 1] = 1.0, grid
    middle, half = line.band(design)
    middle = np.maximum(middle, 0.0)  # where a steep line would go on below nothing
    slope = float(line.coefficients[1]) / span
    low, high = line.interval(1)
    trend = Trend(
        quantity=name, temperature=found.way, likelihood_gain=found.gain,
        points=as_points(found.values, found.stds), between=line.between, slope=slope,
        slope_interval=(low / span, high / span), p_value=line.p_value(1), first=float(middle[0]),
        last=max(float(line.coefficients[0]), 0.0), limit=limit[1] if slope > 0.0 else limit[0],
    )  # fmt: skip
    if trend.limit is not None and (crossed := line.crossing(trend.limit)) is not None:
        until, least, most = (max(t, 0.0) * span for t in crossed)
        trend.until_limit, trend.until_limit_interval = until, (least, most)
    return Course(trend, time[-1] + grid * span, middle, half)


def _tell(trend: Trend, per: str) -> None:
    """The trend in one sentence; without one, nothing comes to a limit."""
    if trend.slope is None or trend.slope_interval is None:
        return
    factor, unit = 1.0, "log"
    if per == "day":  # the time in which it changes by some percent
        units = ((1.0 / 24.0, "hour"), (1.0, "day"), (30.0, "30 days"))
        factor, unit = next((u for u in units if abs(trend.slope) * u[0] > 1e-3), (365.25, "year"))
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


def severity_one(unit: Unit) -> Limits:
    """What faults of severity 1 make of the estimates, as factors of the profile's."""
    rubbing = {f.name: f.value for f in CATALOGUE["seal_wear"].figures}
    friction = (rubbing["loose_friction"], rubbing["tight_friction"])
    air = next(f.value for f in CATALOGUE["aeration"].figures if f.name == "free_air")
    oil = unit.oil
    softer = air * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    return {
        "leakage": (None, 1.0 + Scales.of(unit).fault_leakage / unit.pump.total_leakage),
        "bulk_modulus": (1.0 / (1.0 + oil.bulk_modulus * softer), None),
        "coulomb_friction": friction,
        "viscous_friction": friction,
    }


def given_limits(texts: Sequence[str]) -> Limits:
    """Limits as a command line gives them.

    Raises InputError: no such quantity, or no factor.

    Examples
    --------
    >>> given_limits(["leakage=2.0", "bulk_modulus=0.5"])
    {'leakage': (None, 2.0), 'bulk_modulus': (0.5, None)}
    """
    out: Limits = {}
    for text in texts:
        name, _, factor = text.partition("=")
        try:
            value = float(factor)
        except ValueError:
            value = 1.0
        if name not in ESTIMATED or not 0.0 < value < 1e6 or value == 1.0:
            raise InputError(
                f"--limit {text!r}: not a quantity and a factor of the profile's",
                mend=f"write e.g. leakage=2.0; quantities: {', '.join(ESTIMATED)}",
            )
        least, most = out.get(name, (None, None))
        out[name] = (least, value) if value > 1.0 else (value, most)
    return out
