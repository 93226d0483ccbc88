"""The API: what each address answers, and which role it asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

import fdd
from fdd.errors import InputError
from fdd.report.decimate import envelope
from fdd.service.alarms import STATES, Action, Doing
from fdd.service.http.answers import (
    Alarm,
    AuditRecord,
    AxisDetail,
    AxisStatus,
    Bands,
    Health,
    Note,
    OutOfService,
    Rollup,
    Session,
    Shelf,
    Trend,
)
from fdd.service.http.callers import Caller, Sessions, Tokens
from fdd.service.http.doors import Fleet, Store
from fdd.service.http.events import Hub
from fdd.service.http.guard import COOKIE, cookie_of
from fdd.service.http.uploads import Uploads
from fdd.service.life import Each, sentence_of

STANDING = STATES[1:]
LEVELS: dict[Each, float] = {"minute": 86400.0, "hour": 30 * 86400.0, "day": 3650 * 86400.0}
"""How far a trend goes back where the request does not say."""
Handler = Callable[[Request], Awaitable[Any]]


@dataclass(frozen=True)
class Api:
    """Everything that the addresses need.

    Attributes
    ----------
    health : gives the `Health` of the fleet and the store (``status``, ``problems``).
    metrics : gives the text and its type for Prometheus's Accept header.
    secure : whether the page is reached by TLS. trouble : raised where the store cannot be used now.
    """

    fleet: Fleet
    store: Store
    hub: Hub
    uploads: Uploads
    sessions: Sessions
    tokens: Tokens | None
    health: Callable[[], Any]
    metrics: Callable[[str], tuple[bytes, str]]
    secure: bool
    trouble: type[Exception]

    def routes(self) -> list[Route]:
        """All addresses; each names the role that it asks for, None where it asks for none."""
        table: list[tuple[str, str, Handler, str | None]] = [
            ("GET", "/api/axes", self.axes, "view"),
            ("GET", "/api/axes/{name:path}/trend", self.trend, "view"),
            ("GET", "/api/axes/{name:path}", self.axis, "view"),
            ("GET", "/api/alarms", self.alarms, "view"),
            ("POST", "/api/alarms/{id:int}/acknowledge", self.acting("acknowledge", Note), "acknowledge"),
            ("POST", "/api/alarms/{id:int}/shelve", self.acting("shelve", Shelf), "acknowledge"),
            ("POST", "/api/alarms/{id:int}/unshelve", self.acting("unshelve", Note), "acknowledge"),
            (
                "POST",
                "/api/alarms/{id:int}/out-of-service",
                self.acting("out_of_service", OutOfService),
                "admin",
            ),
            ("GET", "/api/audit", self.audit, "view"),
            ("GET", "/api/health", self.health_, None),
            ("GET", "/api/events", self.events, "view"),
            ("POST", "/api/diagnose", self.diagnose, "acknowledge"),
            ("GET", "/api/session", self.session, "view"),
            ("POST", "/api/login", self.login, None),
            ("POST", "/api/logout", self.logout, None),
            ("GET", "/metrics", self.metrics_, "view"),
        ]
        return [
            Route(path, _guarded(handler, role), methods=[method]) for method, path, handler, role in table
        ]

    async def axes(self, request: Request) -> Any:
        """Every axis as it stands now."""
        found = await run_in_threadpool(self.fleet.axes)
        return {"axes": [AxisStatus.model_validate(a) for a in found]}

    async def axis(self, request: Request) -> Any:
        """One axis with its last ten minutes, signals in `points` stretches."""
        points = _number(request, "points", 600.0, 10.0, 6000.0)
        detail = AxisDetail.model_validate(await self._detail(request.path_params["name"]))
        return detail.model_copy(update={"signals": thinned(detail.signals, int(points))})

    async def _detail(self, name: str) -> Any:
        try:
            return await run_in_threadpool(self.fleet.axis, name)
        except KeyError:
            raise HTTPException(404, "no such axis") from None

    async def trend(self, request: Request) -> Any:
        """A quantity over an axis's life."""
        name, asked = request.path_params["name"], request.query_params
        quantity = asked.get("quantity", "leakage")
        level = next((x for x in LEVELS if x == asked.get("level", "hour")), None)
        if level is None:
            raise HTTPException(400, f"level is one of {', '.join(LEVELS)}")
        if len(quantity) > 64 or not quantity.isidentifier():
            raise HTTPException(400, "quantity is a name such as leakage")
        now = time.time()
        since = _number(request, "since", now - LEVELS[level], 0.0, now)
        await self._detail(name)
        rows = await run_in_threadpool(self.store.rollups, name, quantity, level, since)
        told = await run_in_threadpool(sentence_of, self.store, name, quantity, level, since)
        points = [Rollup.model_validate(r) for r in rows]
        return Trend(axis=name, quantity=quantity, level=level, points=points, sentence=told)

    async def alarms(self, request: Request) -> Any:
        """Alarms by state; those that stand where none is asked for, all with ``state=all``."""
        asked = [s for s in request.query_params.get("state", "").split(",") if s]
        if set(asked) - {*STATES, "all"}:
            raise HTTPException(400, f"state is all, or of {', '.join(STATES)}")
        states = None if "all" in asked else asked or STANDING
        limit = int(_number(request, "limit", 1000.0, 1.0, 10000.0))
        rows = await run_in_threadpool(lambda: self.store.alarms(states, limit=limit))
        return {"alarms": [Alarm.model_validate(r) for r in rows]}

    def acting(self, kind: Doing, model: type[Note]) -> Handler:
        """The address that does `kind` to an alarm."""

        async def act(request: Request) -> Any:
            body = _read(model, await request.body())
            id = request.path_params["id"]
            if id >= 1 << 63 or await run_in_threadpool(self.store.alarm, id) is None:
                raise HTTPException(404, "no such alarm")
            until = time.time() + 60.0 * body.minutes if isinstance(body, Shelf) else None
            done: Doing = "in_service" if isinstance(body, OutOfService) and body.back else kind
            action = Action(done, id, request.state.caller.name, body.note, until)
            try:
                await run_in_threadpool(self.fleet.act, action)
            except self.trouble:
                raise
            except InputError as error:
                raise HTTPException(409, str(error)) from None
            return Alarm.model_validate(await run_in_threadpool(self.store.alarm, id))

        return act

    async def audit(self, request: Request) -> Any:
        """What was done by whom, the newest first; of one alarm by ``alarm``."""
        alarm = int(_number(request, "alarm", 0.0, 0.0, 2.0**53))
        limit = int(_number(request, "limit", 200.0, 1.0, 10000.0))
        rows = await run_in_threadpool(lambda: self.store.audit(alarm_id=alarm or None, limit=limit))
        return {"records": [AuditRecord.model_validate(r) for r in rows]}

    async def health_(self, request: Request) -> Any:
        """Whether the service works; why not is told to callers with a token alone."""
        found = Health.model_validate(await run_in_threadpool(self.health))
        if request.state.caller is None:
            return {"status": found.status}
        return found.model_copy(update={"version": fdd.__version__})

    async def events(self, request: Request) -> Response:
        """Events as they happen (server-sent), from the one after Last-Event-ID on."""
        stream = self.hub.stream(request.headers.get("last-event-id"))
        return StreamingResponse(stream, media_type="text/event-stream", headers={"x-accel-buffering": "no"})

    async def diagnose(self, request: Request) -> Any:
        """A log in the body, diagnosed; its name in ``name`` or the header ``x-fdd-name``."""
        asked = request.query_params
        name = asked.get("name") or request.headers.get("x-fdd-name", "")
        return await self.uploads.diagnose(request.stream(), name, asked.get("unit"), asked.get("map"))

    async def session(self, request: Request) -> Any:
        """Who is calling."""
        caller: Caller = request.state.caller
        return Session.model_validate({**vars(caller), "tokens": self.tokens is not None})

    async def login(self, request: Request) -> Any:
        """A token for the page's cookie."""
        try:
            token = orjson.loads(await request.body())["token"]
        except (ValueError, KeyError, TypeError):
            raise HTTPException(400, 'the body is {"token": "…"}') from None
        caller = None if self.tokens is None else self.tokens.caller(str(token))
        if caller is None:
            return request.state.unknown()
        response = answer(Session.model_validate({**vars(caller), "tokens": True}))
        response.set_cookie(
            COOKIE, self.sessions.begin(caller, time.monotonic()), httponly=True, samesite="strict",
            secure=self.secure, path="/",
        )  # fmt: skip
        return response

    async def logout(self, request: Request) -> Any:
        """End the page's session."""
        cookie = cookie_of(request.headers)
        if cookie is not None:
            self.sessions.end(cookie)
        response = answer({})
        response.delete_cookie(COOKIE, path="/")
        return response

    async def metrics_(self, request: Request) -> Response:
        """Counts and figures for Prometheus."""
        text, kind = await run_in_threadpool(self.metrics, request.headers.get("accept", ""))
        return Response(text, media_type=kind)


def _guarded(handler: Handler, role: str | None) -> Callable[[Request], Awaitable[Response]]:
    async def guarded(request: Request) -> Response:
        caller: Caller | None = request.state.caller
        if role is not None and caller is None:
            raise HTTPException(401, "give a token", {"www-authenticate": "Bearer"})
        if role is not None and caller is not None and not caller.may(role):
            raise HTTPException(403, f"this needs the role {role}, {caller.name} has {caller.role}")
        found = await handler(request)
        return found if isinstance(found, Response) else answer(found)

    return guarded


def answer(body: Any) -> Response:
    """A body as JSON; NaN and infinities are null."""

    def plain(value: Any) -> Any:
        if isinstance(value, BaseModel):
            return value.model_dump(by_alias=True)
        raise TypeError(type(value).__name__)

    return Response(orjson.dumps(body, default=plain), media_type="application/json")


def _read(model: type[Note], body: bytes) -> Note:
    try:
        return model.model_validate_json(body or b"{}")
    except ValidationError as error:
        first: Mapping[str, Any] = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])[:60]
        raise HTTPException(400, f"{place or 'body'}: {first['msg']}") from None


def _number(request: Request, name: str, default: float, least: float, most: float) -> float:
    text = request.query_params.get(name)
    if text is None:
        return default
    try:
        value = float(text[:40])
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise HTTPException(400, f"{name} is a number from {least:.0f} to {most:.0f}")
    return value


def thinned(signals: Bands, points: int) -> Bands:
    """Signals in at most so many stretches, none of their extremes lost.

    Examples
    --------
    >>> low, high = {"position": [0, 1, -5, None]}, {"position": [0, 9, 0, None]}
    >>> bands = Bands(time=[0, 1, 2, 3], low=low, high=high)
    >>> thinned(bands, 2).low, thinned(bands, 2).high
    ({'position': [0.0, -5.0]}, {'position': [9.0, 0.0]})
    """
    if len(signals.time) <= points:
        return signals
    when, out = np.array(signals.time, float), Bands()
    for name, low in signals.low.items():
        rows = (np.array(low, float), np.array(signals.high[name], float))
        mid, least, most = envelope(when, *rows, points)
        out.time, out.low[name], out.high[name] = mid.tolist(), _nulls(least), _nulls(most)
    return out


def _nulls(values: Any) -> list[float | None]:
    return [v if math.isfinite(v) else None for v in values.tolist()]
