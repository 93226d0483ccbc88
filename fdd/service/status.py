"""How an axis stands, as the page, the metrics and the buses are told: plain values that JSON takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fdd.diagnosis.findings import FaultFinding

Numbers = list[float | None]


@dataclass(frozen=True, kw_only=True)
class AxisStatus:
    """An axis as it stands now.

    Attributes
    ----------
    state : learning, healthy, in alarm, unacknowledged, silent or failed. headline : why, in a sentence.
    last_wall : Unix seconds, when its last samples came. lag_s : s of data that wait for their diagnosis.
    rate_hz : of its samples. quality : counts of what was missing or odd since the service started.
    alarms, unacknowledged, priority : how many stand, and the worst of them.
    """

    name: str
    unit: str
    state: str
    headline: str
    last_wall: float | None = None
    lag_s: float = 0.0
    samples: int = 0
    rate_hz: float | None = None
    verdict: str = "inconclusive"
    probabilities: dict[str, float] = field(default_factory=dict)
    estimates: dict[str, dict[str, Any]] = field(default_factory=dict)
    quality: dict[str, int] = field(default_factory=dict)
    alarms: int = 0
    unacknowledged: int = 0
    priority: str | None = None


@dataclass(frozen=True, kw_only=True)
class Series:
    """Quantities over the stream's time (s), SI; `std` where there is one."""

    time: list[float]
    values: dict[str, Numbers]
    std: dict[str, Numbers] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Bands:
    """Signals over the stream's time (s), SI: least and largest of each stretch."""

    time: list[float]
    low: dict[str, Numbers]
    high: dict[str, Numbers]


@dataclass(frozen=True, kw_only=True)
class AxisDetail:
    """An axis with its last ten minutes and the findings that stand.

    Attributes
    ----------
    misfits : how badly each balance closes, in what a healthy unit's does.
    """

    status: AxisStatus
    findings: list[FaultFinding]
    estimates: Series
    misfits: Series
    probabilities: Series
    signals: Bands
