"""The API: what each address answers, which role it asks for, and its server-sent events."""

import asyncio
import threading
import time
from collections.abc import AsyncIterable, AsyncIterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Body, Depends, HTTPException, Path, Query, Request, Response
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, ConfigDict, Field

import fdd
from fdd.bounds import MOST_LISTENERS
from fdd.errors import InputError
from fdd.service.alarms import LONGEST_SHELF_S, STANDING, STATES, Action, Alarm
from fdd.service.queues import Bus, Subscription
from fdd.service.status import AxisDetail, AxisStatus, Each, sentence_of
from fdd.service.store import StoreTrouble
from fdd.service.tokens import LOCAL, Caller, Role

if TYPE_CHECKING:
    from fdd.service.service import Service

COOKIE, COOKIE_S = "fdd_token", 12 * 3600
"""The page's; it ends after a working shift."""
REACH_S: dict[Each, float] = {"minute": 86400.0, "hour": 30 * 86400.0, "day": 3650 * 86400.0}
"""How far a trend goes back where the request does not say."""
KEPT = 1000
"""Events that a listener may be behind; one that is farther behind is told to read everything anew."""
LOOK_S = 0.2
LONGEST_S = 3600.0
"""Then a listener connects anew, and who it is is asked again."""
RESET = ServerSentEvent(event="reset", data={"kind": "reset"})
_bearer, _cookie = HTTPBearer(auto_error=False), APIKeyCookie(name=COOKIE, auto_error=False)
Header = Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]
Cookie = Annotated[str | None, Depends(_cookie)]
AlarmId = Annotated[int, Path(ge=1, lt=1 << 63)]
Limit = Annotated[int, Query(ge=1, le=10000)]


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
    role: Role
    tokens: bool


class Problem(BaseModel):
    """Why a request was refused, in one line."""

    error: str


class Note(BaseModel):
    """Body of an acknowledgement or an unshelving."""

    model_config = ConfigDict(extra="forbid", strict=True)

    note: str = Field(default="", max_length=1000)


class Shelf(Note):
    """Body of a shelving. `minutes` : how long, a week at most."""

    minutes: float = Field(gt=0, le=LONGEST_SHELF_S / 60.0)


class Hub:
    """Tells a bounded number of listeners what the bus tells, until `stop` is set.

    One that falls behind, or that comes back after its connection was lost, is told ``reset``.
    """

    def __init__(self, bus: Bus, stop: threading.Event) -> None:
        self._bus, self._stop, self._listeners = bus, stop, 0

    async def listener(self) -> AsyncIterator[Subscription]:
        """What a listener hears while its request lasts. Raises HTTPException: 503, there are too many."""
        if self._listeners >= MOST_LISTENERS:
            raise HTTPException(503, "too many listeners; close a page", {"retry-after": "30"})
        # Counted from here on: of many that ask at once none has begun to read.
        heard = self._bus.subscribe(most=KEPT)
        self._listeners += 1
        try:
            yield heard
        finally:
            self._listeners -= 1
            heard.close()

    async def told(self, heard: Subscription, again: bool) -> AsyncIterator[ServerSentEvent]:
        """What a listener is sent; `again`: it listened before, and may have missed something."""
        end, lost, number = time.monotonic() + LONGEST_S, 0, 0
        yield ServerSentEvent(comment="connected", retry=2000)
        if again:
            yield RESET
        while time.monotonic() < end and not self._stop.is_set():
            if heard.lost > lost:
                lost = heard.lost
                yield RESET
            elif (event := heard.get()) is not None:
                number += 1
                # JSON holds no line break, so that nothing in a name or note can begin a field of the stream.
                data = orjson.dumps(event, default=str, option=orjson.OPT_SERIALIZE_NUMPY).decode()
                yield ServerSentEvent(raw_data=data, id=str(number))
            else:
                await asyncio.sleep(LOOK_S)


def router(service: "Service", stop: threading.Event) -> APIRouter:
    """All addresses of a service; `stop` ends its events."""
    fleet, store, tokens, hub = service.fleet, service.store, service.tokens, Hub(service.bus, stop)
    api = APIRouter(responses={"default": {"model": Problem}})

    def caller(request: Request, header: Header, cookie: Cookie) -> Caller | None:
        if tokens is None:
            return LOCAL
        token = header.credentials if header else cookie
        if token is None and "authorization" not in request.headers:
            return None
        return known(token or "")

    def known(token: str) -> Caller:
        found = None if tokens is None else tokens.caller(token)
        if found is None:
            raise HTTPException(401, "unknown token", {"www-authenticate": "Bearer"})
        return found

    Known = Annotated[Caller | None, Depends(caller)]

    def needs(role: Role) -> Any:
        def allowed(who: Known) -> Caller:
            if who is None:
                raise HTTPException(401, "give a token", {"www-authenticate": "Bearer"})
            if not who.may(role):
                raise HTTPException(403, f"this needs the role {role}, {who.name} has {who.role}")
            return who

        return Depends(allowed)

    view = [needs("view")]
    Operator = Annotated[Caller, needs("acknowledge")]
    Admin = Annotated[Caller, needs("admin")]

    def detail(name: str) -> AxisDetail:
        try:
            return fleet.axis(name)
        except KeyError:
            raise HTTPException(404, "no such axis") from None

    @api.get("/api/axes", dependencies=view)
    def axes() -> dict[Literal["axes"], list[AxisStatus]]:
        """Every axis as it stands now."""
        return {"axes": fleet.axes()}

    @api.get("/api/axes/{name:path}/trend", dependencies=view)
    def trend(
        name: str,
        quantity: Annotated[str, Query(max_length=64, pattern=r"^[A-Za-z_]\w*$")] = "leakage",
        level: Each = "hour",
        since: Annotated[float | None, Query(ge=0, allow_inf_nan=False)] = None,
    ) -> Trend:
        """A quantity over the axis's life, since a Unix time."""
        begin = time.time() - REACH_S[level] if since is None else since
        detail(name)
        told = sentence_of(store, name, quantity, level, begin)
        points: Any = store.rollups(name, quantity, level, begin)
        return Trend(axis=name, quantity=quantity, level=level, points=points, sentence=told)

    @api.get("/api/axes/{name:path}", dependencies=view)
    def axis(name: str) -> AxisDetail:
        """One axis with its last ten minutes."""
        return detail(name)

    @api.delete("/api/axes/{name:path}", status_code=204)
    def remove(name: str, who: Admin) -> None:
        """Watch an axis no longer, and forget its life; if it sends again it begins anew."""
        try:
            fleet.remove(name, who.name)
        except KeyError:
            raise HTTPException(404, "no such axis") from None

    @api.get("/api/alarms", dependencies=view)
    def alarms(
        state: Annotated[str, Query(max_length=100)] = "", limit: Limit = 1000
    ) -> dict[Literal["alarms"], list[Alarm]]:
        """Alarms of some states (UNACK,RTNUN), of all, or those that stand."""
        asked = [s for s in state.split(",") if s]
        if set(asked) - {*STATES, "all"}:
            raise HTTPException(400, f"state is all, or of {', '.join(STATES)}")
        found: Any = store.alarms(None if "all" in asked else asked or STANDING, limit=limit)
        return {"alarms": found}

    def act(action: Action) -> Alarm:
        if store.alarm(action.alarm_id) is None:
            raise HTTPException(404, "no such alarm")
        try:
            return fleet.act(action).alarm
        except StoreTrouble:
            raise
        except InputError as error:
            raise HTTPException(409, str(error)) from None

    @api.post("/api/alarms/{id}/acknowledge")
    def acknowledge(id: AlarmId, who: Operator, body: Note = Note()) -> Alarm:
        """Acknowledge an alarm."""
        return act(Action("acknowledge", id, who.name, body.note))

    @api.post("/api/alarms/{id}/shelve")
    def shelve(id: AlarmId, who: Operator, body: Shelf) -> Alarm:
        """Shelve an alarm for some minutes."""
        return act(Action("shelve", id, who.name, body.note, time.time() + 60.0 * body.minutes))

    @api.post("/api/alarms/{id}/unshelve")
    def unshelve(id: AlarmId, who: Operator, body: Note = Note()) -> Alarm:
        """Take it off the shelf."""
        return act(Action("unshelve", id, who.name, body.note))

    @api.get("/api/audit", dependencies=view)
    def audit(
        alarm: Annotated[int | None, Query(ge=0, lt=1 << 63)] = None, limit: Limit = 200
    ) -> dict[Literal["records"], list[AuditRecord]]:
        """What was done by whom, the newest first; of one alarm, or of all."""
        found: Any = store.audit(alarm_id=alarm or None, limit=limit)
        return {"records": found}

    @api.get("/api/health", response_model_exclude_none=True)
    def health_(who: Known) -> Health:
        """Whether the service works; why not is told to callers with a token alone."""
        found = Health(**service.health(), version=fdd.__version__)
        return found if who is not None else Health(status=found.status)

    @api.get("/api/events", dependencies=view, response_class=EventSourceResponse)
    async def events(
        request: Request, heard: Annotated[Subscription, Depends(hub.listener)]
    ) -> AsyncIterable[ServerSentEvent]:
        """Events as they happen (server-sent)."""
        async for event in hub.told(heard, "last-event-id" in request.headers):
            yield event

    @api.get("/api/session")
    def session(who: Annotated[Caller, *view]) -> Session:
        """Who is calling."""
        return Session(name=who.name, role=who.role, tokens=tokens is not None)

    @api.post("/api/login")
    def login(token: Annotated[str, Body(embed=True)], response: Response) -> Session:
        """Keep a token in a cookie, for the page."""
        found, secure = known(token), service.config.listen.tls is not None
        response.set_cookie(COOKIE, token, max_age=COOKIE_S, httponly=True, samesite="strict", secure=secure)
        return Session(name=found.name, role=found.role, tokens=True)

    @api.post("/api/logout", status_code=204)
    def logout(response: Response) -> None:
        """Forget the cookie."""
        response.delete_cookie(COOKIE)

    def metrics(request: Request) -> Response:
        """Counts and figures for Prometheus."""
        text, kind = service.metrics(request.headers.get("accept", ""))
        return Response(text, media_type=kind)

    if service.config.outputs.metrics:
        api.add_api_route("/metrics", metrics, dependencies=view, response_class=Response)
    return api
