"""Several logs of one unit: what changed between two of them, and where a unit is going over its life.

Here is what ``fdd compare`` and ``fdd trend`` say, as data (SI, where a name carries no unit).
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from fdd.diagnosis.findings import FaultFinding

_ANSWER = ConfigDict(populate_by_name=True, json_schema_serialization_defaults_required=True)
Interval = tuple[float, float]


class LogSaid(BaseModel):
    """One of the two logs: what `fdd diagnose` says of it."""

    log: str
    started_at: str | None
    duration_s: float
    verdict: Literal["healthy", "faulty", "inconclusive"]
    faults: list[FaultFinding]
    notes: list[str]


class EstimateChange(BaseModel):
    """One estimate in both logs.

    Attributes
    ----------
    conditions : that both are given at. a, b : at the end of each log, with their standard deviations; None
        where the log does not show it. std : of the difference, with what healthy logs differ by.
    p_value : two-sided, of no change; p_holm : among all rows. changed : p_holm below 0.05, None untold.
    """

    quantity: str
    unit: str
    conditions: str
    a: float | None
    a_std: float | None
    b: float | None
    b_std: float | None
    difference: float | None
    std: float | None
    p_value: float | None
    p_holm: float | None
    changed: bool | None


class Closure(BaseModel):
    """How badly a balance closes: root mean square over the log of its misfit, where healthy is about 1."""

    balance: str
    a: float | None
    b: float | None


class DutyRow(BaseModel):
    """A signal's 5th, 50th and 95th percentile in both logs; speeds and pressures as magnitudes."""

    signal: str
    unit: str
    a: tuple[float, float, float] | None
    b: tuple[float, float, float] | None


class Comparison(BaseModel):
    """The answer of ``fdd compare --json``."""

    model_config = _ANSWER

    schema_: Literal["fdd.comparison/1"] = Field(default="fdd.comparison/1", alias="schema")
    headline: str
    unit: str
    axis: str
    a: LogSaid
    b: LogSaid
    test: str
    estimates: list[EstimateChange]
    balances: list[Closure]
    duty: list[DutyRow]
    notes: list[str]


class TrendLog(BaseModel):
    """One log of a life: when, what was diagnosed, and why it does not count for the lines, if so."""

    log: str
    started_at: str | None
    at: float | None
    verdict: Literal["healthy", "faulty", "inconclusive"]
    faults: list[str]
    left_out: str | None


class Point(BaseModel):
    """A log's estimate as a factor of the profile's, temperature taken out, and its standard deviation."""

    log: str
    at: float
    value: float
    std: float


class Trend(BaseModel):
    """One quantity over the unit's life; slope and factors are in the profile's healthy value.

    Attributes
    ----------
    temperature : how it was taken out. likelihood_gain : log, of that over the other way; None without
        choice. between : std from log to log beyond the logs' own. slope : a day, or a log where they have no
        dates.
    p_value, p_holm : two-sided, of a slope of 0, and among all quantities. first, last : the line's ends.
    direction : None where no trend could be told. limit : factor. until_limit : from the last log, in days or
        logs, 0 where it is passed; until_limit_interval : 80 %.
    """

    quantity: str
    temperature: Literal["viscosity law", "regression", "not taken out"]
    likelihood_gain: float | None = None
    points: list[Point]
    between: float | None = None
    slope: float | None = None
    slope_interval: Interval | None = None
    p_value: float | None = None
    p_holm: float | None = None
    first: float | None = None
    last: float | None = None
    direction: Literal["rises", "falls"] | None = None
    limit: float | None = None
    until_limit: float | None = None
    until_limit_interval: Interval | None = None
    sentence: str = ""


class Life(BaseModel):
    """The answer of ``fdd trend --json``. `each` : what one of `logs` is; a store has hours or days."""

    model_config = _ANSWER

    schema_: Literal["fdd.trend/1"] = Field(default="fdd.trend/1", alias="schema")
    headline: str
    unit: str
    axis: str
    order: Literal["started_at", "name"]
    per: Literal["day", "log"]
    each: Literal["log", "minute", "hour", "day"]
    logs: list[TrendLog]
    trends: list[Trend]
    notes: list[str]
