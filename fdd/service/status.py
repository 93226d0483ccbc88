"""How an axis stands, lately and over its life: as the page, the metrics and the buses tell."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

import fdd
from fdd.diagnosis.estimates import healthy_of
from fdd.diagnosis.findings import ESTIMATED, Diagnosis, Estimate, FaultFinding, Quality
from fdd.faults import FAMILIES, fault
from fdd.history.trend import severity_one, trend_of
from fdd.report.words import percent
from fdd.samples import CHANNELS, Samples
from fdd.service.alarms import PRIORITIES, Alarm, Priority
from fdd.service.store import Store, profile_key
from fdd.service.store.schema import SPANS_S
from fdd.unit import Unit, shipped_units

if TYPE_CHECKING:
    from fdd.service.axis import AxisWatch

SILENT_S = 10.0
"""s without a sample after which an axis is told to be silent."""
AxisState = Literal["learning", "healthy", "in alarm", "unacknowledged", "silent", "failed"]
SPAN_S = 600.0
LOOK_S = 5.0
BAND_S = 1.2
"""Stretches of which least and largest are kept: five hundred of them are what a picture has room for."""
FRESH_S = 30 * 86400.0
"""s by which a stamp may differ from the time of day, and yet count as one; else it is from any start."""
Numbers = list[float | None]
_NAMES = tuple(name for name in CHANNELS if name != "time")
_Floats = NDArray[np.float32]
Each = Literal["minute", "hour", "day"]
Row = Mapping[str, Any]

HEALTHY_LEAKAGE, LEAKAGE_FACTOR = "leakage_healthy", "leakage_factor"
"""Rolled up beside the leakage: what the profile says of it at that oil temperature, and their ratio."""
MOST_ALARMS = 100_000
_FORM = {"minute": "%Y-%m-%d %H:%M", "hour": "%Y-%m-%d %H:00", "day": "%Y-%m-%d"}


class Series(BaseModel):
    """Quantities over the stream's time (s), SI; `std` where there is one."""

    time: list[float] = []
    values: dict[str, Numbers] = {}
    std: dict[str, Numbers] = {}


class Bands(BaseModel):
    """Signals over the stream's time (s), SI: least and largest of each stretch."""

    time: list[float] = []
    low: dict[str, Numbers] = {}
    high: dict[str, Numbers] = {}


class AxisStatus(BaseModel):
    """An axis as it stands now.

    Attributes
    ----------
    headline : why it is in its state, in a sentence.
    silent : whether no samples come, whatever its state. zone : whose clock its times are told in (IANA);
        None is that of the service's machine. clock : Unix seconds where the stream's clock stands at 0.
    last_wall : Unix seconds, when its last samples came. lag_s : s of data that wait for their diagnosis.
    rate_hz : of its samples. quality : counts of what was missing or odd since the service started.
    alarms, unacknowledged, priority : how many stand, and the worst of them.
    """

    name: str
    unit: str
    state: AxisState
    headline: str
    silent: bool = False
    zone: str | None = None
    clock: float | None = None
    last_wall: float | None = None
    lag_s: float = 0.0
    samples: int = 0
    rate_hz: float | None = None
    verdict: str = "inconclusive"
    probabilities: dict[str, float] = {}
    estimates: dict[str, Estimate] = {}
    quality: dict[str, int] = {}
    alarms: int = 0
    unacknowledged: int = 0
    priority: Priority | None = None


class AxisDetail(BaseModel):
    """An axis with its last ten minutes and the findings that stand; `misfits` are how badly each balance
    closes, in what a healthy unit's does."""

    status: AxisStatus
    findings: list[FaultFinding] = []
    estimates: Series = Series()
    misfits: Series = Series()
    probabilities: Series = Series()
    signals: Bands = Bands()


def status_of(
    watch: AxisWatch, alarms: Sequence[Alarm], counters: Mapping[str, float], now: float,
    zone: str | None = None,
) -> AxisStatus:  # fmt: skip
    """How an axis stands now (Unix s), by its alarms and counters: the inbox's, and whether it is put off."""
    live = [a for a in alarms if a.state in ("UNACK", "ACKED", "RTNUN")]
    open_ = [a for a in live if a.state != "ACKED"]
    lag_s, put_off = counters.get("lag_s", 0.0), bool(counters.get("put_off"))
    silent = not put_off and (watch.last_wall is None or abs(now - watch.last_wall) > SILENT_S)
    state: AxisState = (
        "failed" if watch.failed else "unacknowledged" if open_ else "in alarm" if live
        else "silent" if silent else "learning" if watch.learning is not None else "healthy"
    )  # fmt: skip
    late = f"; overloaded: {lag_s:.0f} s behind" if put_off else ""
    headline = _headline(watch, live, silent, zone) + late
    verdict = "faulty" if watch.standing else "inconclusive" if state in ("failed", "learning") else "healthy"
    return AxisStatus(
        name=watch.name, unit=watch.unit.name, state=state, headline=headline,
        silent=silent, zone=zone, clock=watch.wall_of(0.0), last_wall=watch.last_wall,
        lag_s=lag_s, samples=watch.samples, rate_hz=watch.rate_hz, verdict=verdict,
        probabilities=watch.probabilities, estimates=watch.estimates,
        quality=watch.quality() | {"overrun": int(counters.get("dropped_samples", 0))},
        alarms=len(live), unacknowledged=len(open_),
        priority=max((a.priority for a in live), key=PRIORITIES.index, default=None),
    )  # fmt: skip


def _headline(watch: AxisWatch, live: Sequence[Alarm], silent: bool, zone: str | None) -> str:
    ended = f"samples come since {_clock_time(watch.last_wall, zone)}" if silent else ""
    also = f"; no {ended}" if silent else ""
    if watch.failed:
        return watch.failed + also
    if live:
        # What the last look still saw comes before what waits to return: it may have been the same fault.
        worst = max(live, key=lambda a: (a.seen >= a.time, PRIORITIES.index(a.priority), a.confidence or 0.0))
        size = "" if worst.severity is None else f", severity {worst.severity:.2f}"
        sure = "" if worst.confidence is None else f", {percent(worst.confidence)} sure"
        since = _clock_time(watch.wall_of(worst.body["onset_s"]), zone)
        gone = "" if worst.standing else "; it is gone"
        return f"{fault(worst.fault).title.capitalize()}{size}{sure}, since {since}{gone}{also}"
    if silent:
        return f"No {ended}"
    if watch.learning is not None:
        return "Learning what is normal; until then only changes are told"
    return "No fault found"


def _clock_time(wall: float | None, zone: str | None) -> str:
    if wall is None:
        return "the service began"
    place = None if zone is None else ZoneInfo(zone)
    return f"{datetime.fromtimestamp(wall, UTC).astimezone(place):%Y-%m-%d %H:%M:%S %Z}"


class Recent:
    """What is kept of an axis for its page; of each look time, estimates, misfits and probabilities."""

    def __init__(self) -> None:
        self.looks = deque[tuple[float, dict[str, Estimate], dict[str, float], dict[str, float]]](
            maxlen=round(SPAN_S / LOOK_S)
        )
        # Number of the stretch, least and largest.
        self._bands: deque[tuple[int, _Floats, _Floats]] = deque(maxlen=round(SPAN_S / BAND_S))

    def add(self, samples: Samples) -> None:
        """Take samples that follow the last ones."""
        place = np.floor(samples.time / BAND_S).astype(np.int64)
        starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
        values = np.full((len(_NAMES), len(samples)), np.nan, dtype=np.float32)
        for k, name in enumerate(_NAMES):
            if name in samples:
                values[k] = samples[name]
        low = np.fmin.reduceat(values, starts, axis=1)
        high = np.fmax.reduceat(values, starts, axis=1)
        for k, band in enumerate(place[starts].tolist()):
            one, other = low[:, k], high[:, k]
            if self._bands and self._bands[-1][0] == band:
                _, before, after = self._bands.pop()
                one, other = np.fmin(before, one), np.fmax(after, other)
            self._bands.append((band, one, other))

    def drawn(self) -> dict[str, Any]:
        """Estimates, misfits of the balances and probabilities of the families (`Series`), and signals."""
        times = [look[0] for look in self.looks]
        names = self.looks[-1][1] if self.looks else ()
        low, high = (np.array([b[k] for b in self._bands]).reshape(-1, len(_NAMES)).T for k in (1, 2))
        seen = [k for k in range(len(_NAMES)) if np.isfinite(low[k]).any()]
        return {
            "estimates": Series(
                time=times,
                values={name: [look[1][name].held for look in self.looks] for name in names},
                std={name: [look[1][name].held_std for look in self.looks] for name in names},
            ),
            "misfits": _series(times, [look[2] for look in self.looks]),
            "probabilities": _series(times, [look[3] for look in self.looks]),
            "signals": Bands(
                time=[band * BAND_S for band, _, _ in self._bands],
                low={_NAMES[k]: _numbers(low[k]) for k in seen},
                high={_NAMES[k]: _numbers(high[k]) for k in seen},
            ),
        }


def _series(times: list[float], rows: Sequence[Mapping[str, float]]) -> Series:
    names = dict.fromkeys(name for row in rows for name in row)
    return Series(time=times, values={n: [r.get(n) for r in rows] for n in names})


def _numbers(column: _Floats) -> Numbers:
    return [None if np.isnan(v) else float(v) for v in column]


def answers_of(store: Store, axis: str, unit: Unit, each: Each, since: float = 0.0) -> list[Diagnosis]:
    """An axis's minutes, hours or days since a time (Unix seconds) in their order, each as a log's answer.

    The standard deviation is of the estimate: its own and what it varied by, of leakage at one temperature.
    A span has the alarms that stood in it.
    """
    names = (*ESTIMATED, HEALTHY_LEAKAGE, LEAKAGE_FACTOR)
    rows = {n: {r["start_wall"]: r for r in store.rollups(axis, n, each, since)} for n in names}
    alarms = [a for a in store.alarms(limit=MOST_ALARMS) if a["axis"] == axis]
    spans = sorted({start for found in rows.values() for start in found})
    healthy, out = healthy_of(unit), []
    for start in spans:
        stood = [
            FaultFinding.model_validate(a["body"])
            for a in reversed(alarms)
            if a["raised_wall"] < start + SPANS_S[each] and (a["returned_wall"] or math.inf) >= start
        ]
        known = {n: _estimate(n, healthy[n], rows[n].get(start)) for n in ESTIMATED}
        warm, factor = (rows[n].get(start) for n in (HEALTHY_LEAKAGE, LEAKAGE_FACTOR))
        if warm is not None:
            known["leakage"] = _estimate("leakage", warm["mean"], factor, warm["mean"])
        out.append(
            Diagnosis(
                log=f"{datetime.fromtimestamp(start, UTC):{_FORM[each]}}", axis=axis, unit=unit.name,
                duration_s=SPANS_S[each], samples=0, verdict="faulty" if stood else "healthy", faults=stood,
                probabilities=dict.fromkeys(FAMILIES, 0.0), quality=Quality(),
                versions={"fdd": fdd.__version__},
                started_at=datetime.fromtimestamp(start, UTC).isoformat().replace("+00:00", "Z"),
                estimates=known,
            )
        )  # fmt: skip
    return out


def sentence_of(store: Store, axis: str, quantity: str, each: Each, since: float) -> str:
    """Where a quantity is going, as `fdd trend` tells it; "" of another one, and without a profile."""
    row = next((row for row in store.axes() if row["name"] == axis), None)
    unit = None if row is None or quantity not in ESTIMATED else _profile(store, row)
    if unit is None or not (answers := answers_of(store, axis, unit, each, since)):
        return ""
    life, _ = trend_of(answers, severity_one(unit), each)
    return next((t.sentence for t in life.trends if t.quantity == quantity), "")


def _profile(store: Store, row: Row) -> Unit | None:
    """Of an axis's row; None where the store does not hold it."""
    text = store.meta(profile_key(row["profile_sha256"] or ""))
    if text is not None:
        return Unit.from_yaml(text, where=f"the profile of axis {row['name']}")
    return Unit.load(row["unit"]) if row["unit"] in shipped_units() else None


def _estimate(name: str, healthy: float, row: Row | None, scale: float = 1.0) -> Estimate:
    """Of a span's row; not observable without one."""
    value, std = (None, None) if row is None else (scale * row["mean"], scale * row["std"])
    unit, known = ESTIMATED[name][0], row is not None
    return Estimate(unit=unit, baseline=healthy, value=value, std=std, observable=known)
