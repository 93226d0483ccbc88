"""The API's answers, as models: what is sent is what the published schema says."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding

AxisState = Literal["learning", "healthy", "in alarm", "unacknowledged", "silent", "failed"]
AlarmState = Literal["NORMAL", "UNACK", "ACKED", "RTNUN", "SHELVED", "OUT_OF_SERVICE"]
Priority = Literal["low", "medium", "high", "urgent"]
Numbers = list[float | None]


class Answer(BaseModel):
    """What all answers share: read from objects or mappings, keys that are not known are left out."""

    model_config = ConfigDict(from_attributes=True, json_schema_serialization_defaults_required=True)


class AxisStatus(Answer):
    """An axis as it stands now.

    Attributes
    ----------
    verdict : healthy, faulty or inconclusive. headline : the verdict in a sentence.
    last_wall : Unix seconds of its last sample's arrival. lag_s : how far its diagnosis is behind.
    alarms, unacknowledged : how many stand. priority : the worst of them.
    """

    name: str
    unit: str
    state: AxisState
    last_wall: float | None = None
    lag_s: float | None = None
    samples: int = 0
    rate_hz: float | None = None
    verdict: str = "inconclusive"
    headline: str = ""
    probabilities: dict[str, float] = Field(default_factory=dict)
    estimates: dict[str, Estimate] = Field(default_factory=dict)
    quality: dict[str, int] = Field(default_factory=dict)
    alarms: int = 0
    unacknowledged: int = 0
    priority: Priority | None = None


class Series(Answer):
    """Quantities over the stream's time (s), SI; `std` where there is one."""

    time: list[float] = Field(default_factory=list)
    values: dict[str, Numbers] = Field(default_factory=dict)
    std: dict[str, Numbers] = Field(default_factory=dict)


class Bands(Answer):
    """Signals over the stream's time (s), SI: least and largest of each stretch."""

    time: list[float] = Field(default_factory=list)
    low: dict[str, Numbers] = Field(default_factory=dict)
    high: dict[str, Numbers] = Field(default_factory=dict)


class AxisDetail(Answer):
    """An axis with its last ten minutes and the findings that stand.

    Attributes
    ----------
    misfits : how badly each balance closes, in what a healthy unit's does.
    """

    status: AxisStatus
    findings: list[FaultFinding] = Field(default_factory=list)
    estimates: Series = Field(default_factory=Series)
    misfits: Series = Field(default_factory=Series)
    probabilities: Series = Field(default_factory=Series)
    signals: Bands = Field(default_factory=Bands)


class Alarm(Answer):
    """An alarm by ISA-18.2; times in Unix seconds, `raised_time` in s of the stream's clock."""

    id: int
    axis: str
    fault: str
    family: str
    channel: str | None = None
    state: AlarmState
    priority: Priority
    raised_time: float | None = None
    raised_wall: float
    acked_by: str | None = None
    acked_wall: float | None = None
    returned_wall: float | None = None
    shelved_by: str | None = None
    shelved_until: float | None = None
    note: str = ""
    count: int = 1
    chattering: bool = False
    severity: float | None = None
    confidence: float | None = None
    body: dict[str, Any] = Field(default_factory=dict)


class AuditRecord(Answer):
    """What was done to an alarm or the service, by whom; never changed."""

    id: int
    wall: float
    who: str
    action: str
    alarm_id: int | None = None
    axis: str | None = None
    note: str = ""


class Rollup(Answer):
    """A quantity over a minute, an hour or a day, SI."""

    start_wall: float
    n: int
    mean: float | None
    std: float | None
    min: float | None
    max: float | None


class Trend(Answer):
    """A quantity over an axis's life; `sentence` tells where it goes, as `fdd trend` does."""

    axis: str
    quantity: str
    level: Literal["minute", "hour", "day"]
    points: list[Rollup]
    sentence: str = ""


class Health(Answer):
    """Whether the service can do its work; callers without a token see the status alone."""

    status: Literal["ok", "degraded"]
    problems: list[str] = Field(default_factory=list)
    axes: int = 0
    version: str = ""


class Session(Answer):
    """Who is calling. `tokens` : whether the service asks for tokens at all."""

    name: str
    role: Literal["view", "acknowledge", "admin"]
    tokens: bool


class Problem(Answer):
    """Why a request was refused, in one line."""

    error: str


class Note(BaseModel):
    """Body of an acknowledgement, an unshelving, a taking out of service or back."""

    model_config = ConfigDict(extra="forbid", strict=True)

    note: str = Field(default="", max_length=1000)


class Shelf(Note):
    """Body of a shelving. `minutes` : how long, a week at most."""

    minutes: float = Field(gt=0, le=10080)


class OutOfService(Note):
    """Body of a taking out of service, or back with `back`."""

    back: bool = False


ALL: tuple[type[BaseModel], ...] = (
    AxisStatus, AxisDetail, Alarm, AuditRecord, Trend, Health, Session, Problem, Diagnosis,
)  # fmt: skip
BODIES: tuple[type[BaseModel], ...] = (Note, Shelf, OutOfService)
