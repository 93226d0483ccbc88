"""The HTTP service put together: API, page, what guards them, and the port they are served on."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from importlib import resources
from typing import TYPE_CHECKING, Any

import uvicorn
from fastapi import FastAPI, HTTPException
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse, Response
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException as StarletteException
from starlette.middleware.gzip import GZipMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import fdd
from fdd.bounds import MAX_HEAD_BYTES, MAX_REQUEST_BYTES, MOST_HTTP_CONNECTIONS
from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.report.words import FAMILY_TITLES
from fdd.residuals.balances import BALANCES
from fdd.service.config_sources import bound_socket
from fdd.service.http.api import router
from fdd.service.store import StoreTrouble

if TYPE_CHECKING:
    from fdd.service.service import Service

PAGE = resources.files("fdd.service.http") / "page"
MARK = "x-fdd"
"""A header that a form or a link of another site cannot send."""
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-cache",
}


def web(service: Service, stop: threading.Event) -> ASGIApp:
    """The service as an ASGI application; `stop` ends its events."""
    app = FastAPI(
        title="fdd serve", version=fdd.__version__, docs_url=None, redoc_url=None, strict_content_type=False
    )
    app.include_router(router(service, stop))
    app.add_middleware(GZipMiddleware, minimum_size=2000, compresslevel=4)
    if service.tokens is None:
        # By a name that leads here a page of another site could reach the service (DNS rebinding).
        own = ["localhost", "127.0.0.1", "[::1]", *service.config.listen.names]
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=own, www_redirect=False)
    for kind, answer in ANSWERS.items():
        app.add_exception_handler(kind, lambda request, error, answer=answer: answer(error))

    @app.get("/", include_in_schema=False)
    def page() -> FileResponse:
        return FileResponse(str(PAGE / "index.html"))

    @app.get("/page/words.js", include_in_schema=False)
    def spoken() -> Response:
        # The product's words: what faults, families, balances and quantities are called.
        words = {
            "faults": {name: fault.title for name, fault in CATALOGUE.items()},
            "families": FAMILY_TITLES,
            "balances": {name: balance.title for name, balance in BALANCES.items()},
            "quantities": {
                name: {"title": title, "unit": unit, "scale": DISPLAY_SCALE[name]}
                for name, (_, unit, title) in ESTIMATED.items()
            },
        }
        text = b"export default " + bytes(JSONResponse(words).body) + b";\n"
        return Response(text, media_type="text/javascript")

    app.mount("/page", StaticFiles(directory=str(PAGE)))
    return guarded(app)


def guarded(app: ASGIApp) -> ASGIApp:
    """The outermost layer: headers for browsers, no requests of other sites' pages, bounded bodies."""

    async def guard(scope: Scope, receive: Receive, send: Send) -> None:
        # The server has neither sockets of the web nor a lifespan to tell of.
        came = 0

        async def bounded() -> Message:
            nonlocal came
            message = await receive()
            came += len(message.get("body", b""))
            if came > MAX_REQUEST_BYTES:
                raise HTTPException(413, f"the body may have {MAX_REQUEST_BYTES} bytes")
            return message

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        own = {"authorization", MARK} & {*Headers(scope=scope)}
        if scope["method"] not in ("GET", "HEAD") and not own:
            refusal = _problem(403, f"not sent by this page; give a token, or the header {MARK}: 1")
            await refusal(scope, receive, with_headers)
        else:
            await app(scope, bounded, with_headers)

    return guard


def _problem(status: int, text: str, headers: Mapping[str, str] | None = None) -> Response:
    """A refusal as JSON, in one line."""
    return JSONResponse({"error": " ".join(text.split())[:500]}, status, headers)


ANSWERS: dict[type[Exception], Callable[[Any], Response]] = {
    StarletteException: lambda error: _problem(error.status_code, error.detail, error.headers),
    RequestValidationError: lambda error: _problem(
        400, f"{'.'.join(map(str, error.errors()[0]['loc']))[:60]}: {error.errors()[0]['msg']}"
    ),
    StoreTrouble: lambda error: _problem(503, f"not possible now: {error}; try again", {"retry-after": "5"}),
    InputError: lambda error: _problem(500, str(error)),
    Exception: lambda error: _problem(500, "internal error"),
}
"""How what an address raises is told."""


class Server:
    """uvicorn on a socket of its own; `address` is what a browser opens.

    Raises InputError: the port is taken.
    """

    def __init__(self, service: Service) -> None:
        listen, self._stop = service.config.listen, threading.Event()
        tls = listen.tls
        config = uvicorn.Config(
            web(service, self._stop), http="h11", ws="none", lifespan="off", interface="asgi3",
            log_config=None, log_level=logging.ERROR, access_log=False, server_header=False,
            proxy_headers=False, limit_concurrency=MOST_HTTP_CONNECTIONS, timeout_keep_alive=5,
            timeout_graceful_shutdown=3, h11_max_incomplete_event_size=MAX_HEAD_BYTES,
            ssl_certfile=None if tls is None else tls.cert, ssl_keyfile=None if tls is None else tls.key,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        where = f"listen {listen.host}:{listen.port}"
        self._socket = bound_socket(listen.host, listen.port, where, "give a free port (--port)")
        self._socket.listen(1024)
        host, port = self._socket.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        self.address = f"{'http' if tls is None else 'https'}://{shown}:{port}/"
        run = self._server.run
        self._thread = threading.Thread(target=run, args=([self._socket],), name="http", daemon=True)
        self.start = self._thread.start

    def stop(self, timeout: float = 20.0) -> bool:
        """End it; whether it has within so many seconds."""
        self._stop.set()
        self._server.should_exit = True
        self._thread.join(timeout)
        return not self._thread.is_alive()
