"""Models of the API's answers and bodies that are nowhere else in the service."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from fdd.service.alarms import LONGEST_SHELF_S


class AuditRecord(BaseModel):
    """What was done to an alarm or the service, by whom; never changed."""

    id: int
    wall: float
    who: str
    action: str
    alarm_id: int | None = None
    axis: str | None = None
    note: str = ""


class Span(BaseModel):
    """A quantity over a minute, an hour or a day, SI."""

    start_wall: float
    n: int
    mean: float | None
    std: float | None
    min: float | None
    max: float | None


class Trend(BaseModel):
    """A quantity over an axis's life; `sentence` tells where it goes, as `fdd trend` does."""

    axis: str
    quantity: str
    level: Literal["minute", "hour", "day"]
    points: list[Span]
    sentence: str = ""


class Health(BaseModel):
    """Whether the service can do its work; callers without a token see the status alone.

    `sources` : how each stands: `connected`, messages `received` and `refused`, `last_error`, and more.
    """

    status: Literal["ok", "degraded"]
    problems: list[str] | None = None
    axes: int | None = None
    sources: dict[str, dict[str, Any]] | None = None
    version: str | None = None


class Session(BaseModel):
    """Who is calling. `tokens` : whether the service asks for tokens at all."""

    name: str
    role: Literal["view", "acknowledge", "admin"]
    tokens: bool


class Problem(BaseModel):
    """Why a request was refused, in one line."""

    error: str


class Login(BaseModel):
    """Body of a login on the page."""

    token: str


class Note(BaseModel):
    """Body of an acknowledgement or an unshelving."""

    model_config = ConfigDict(extra="forbid", strict=True)

    note: str = Field(default="", max_length=1000)


class Shelf(Note):
    """Body of a shelving. `minutes` : how long, a week at most."""

    minutes: float = Field(gt=0, le=LONGEST_SHELF_S / 60.0)
