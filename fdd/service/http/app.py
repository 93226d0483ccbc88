"""The whole HTTP service put together: API, page and guard."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Mapping
from importlib import resources
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.report.words import FAMILY_TITLES
from fdd.residuals.balances import BALANCES
from fdd.service.http.api import Api, answer
from fdd.service.http.callers import Sessions, Tokens
from fdd.service.http.doors import Fleet, Store
from fdd.service.http.events import Hub
from fdd.service.http.guard import Guard, problem
from fdd.service.http.openapi import document
from fdd.service.http.uploads import Folders, Uploads

TYPES = {
    "html": "text/html; charset=utf-8", "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8", "svg": "image/svg+xml",
}  # fmt: skip


def web(
    *,
    fleet: Fleet,
    store: Store,
    hub: Hub,
    health: Callable[[], Any],
    metrics: Callable[[str], tuple[bytes, str]],
    trouble: type[Exception] = OSError,
    tokens: Tokens | None = None,
    hosts: Iterable[str] = (),
    folders: Folders | None = None,
    secure: bool = False,
) -> Guard:
    """The service as an ASGI application.

    Parameters
    ----------
    health : gives ``{"status": "ok" | "degraded", "problems": [...], "axes": n}``.
    metrics : gives Prometheus's text and its content type for an Accept header.
    trouble : what the fleet and the store raise when the store cannot be used now; answered by 503.
    tokens : who may call; None lets everybody in as admin, for a service that only this machine reaches.
    hosts : names that the service is reached by, beside addresses and localhost.
    folders : of profiles and maps that ``/api/diagnose`` may use.
    secure : whether it is reached by TLS.

    Examples
    --------
    >>> web(fleet=fleet, store=store, hub=Hub(bus), health=health, metrics=metrics)  # doctest: +SKIP
    """
    sessions = Sessions()
    uploads = Uploads(folders or Folders())
    api = Api(fleet, store, hub, uploads, sessions, tokens, health, metrics, secure, trouble)
    described = document()

    async def openapi(request: Request) -> Response:
        return answer(described)

    inner = Starlette(
        routes=[*api.routes(), Route("/openapi.json", openapi), *_page()],
        middleware=[Middleware(GZipMiddleware, minimum_size=2000, compresslevel=4)],
        exception_handlers={
            HTTPException: _told,
            InputError: _unusable,
            trouble: _troubled,
            Exception: _failed,
        },
    )
    return Guard(inner, tokens=tokens, sessions=sessions, hosts=hosts, secure=secure)


async def _told(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return problem(error.status_code, error.detail, dict(error.headers or {}))


async def _failed(request: Request, error: Exception) -> Response:
    return problem(500, "internal error")


async def _unusable(request: Request, error: Exception) -> Response:
    return problem(500, str(error))


async def _troubled(request: Request, error: Exception) -> Response:
    return problem(503, f"not possible now: {error}; try again", {"retry-after": "5"})


def words() -> Mapping[str, Any]:
    """The product's words for the page: what faults, families, balances and quantities are called.

    Examples
    --------
    >>> words()["families"]["aeration"]
    'Air in the oil'
    """
    return {
        "faults": {name: fault.title for name, fault in CATALOGUE.items()},
        "families": FAMILY_TITLES,
        "balances": {name: balance.title for name, balance in BALANCES.items()},
        "quantities": {
            name: {"title": title, "unit": unit, "scale": DISPLAY_SCALE[name]}
            for name, (_, unit, title) in ESTIMATED.items()
        },
    }


def _page() -> list[Route]:
    """The page's files, read once: an address is looked up among them and never made a path."""
    files = {
        f.name: f.read_bytes()
        for f in (resources.files("fdd.service.http") / "page").iterdir()
        if f.name.rpartition(".")[2] in TYPES
    }
    found = [_file(f"/page/{name}", name, body) for name, body in files.items() if name != "index.html"]
    spoken = b"export default " + bytes(answer(words()).body) + b";\n"
    return [
        _file("/", "index.html", files["index.html"]),
        _file("/page/words.js", "words.js", spoken),
        *found,
    ]


def _file(path: str, name: str, body: bytes) -> Route:
    tag = f'"{hashlib.sha256(body).hexdigest()[:20]}"'
    headers = {"etag": tag, "cache-control": "no-cache"}

    async def serve(request: Request) -> Response:
        if re.sub(r"^W/", "", request.headers.get("if-none-match", "")) == tag:
            return Response(status_code=304, headers=headers)
        return Response(body, headers=headers, media_type=TYPES[name.rpartition(".")[2]])

    return Route(path, serve)
