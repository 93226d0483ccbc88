"""What every request passes before anything of it is read: host, rate, origin, caller, size and time."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import time
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie

import orjson
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fdd.bounds import MAX_HEAD_BYTES, MAX_REQUEST_BYTES, limit
from fdd.service.http.callers import LOCAL, Caller, Sessions, Tokens
from fdd.service.http.connections import Rates

COOKIE = "fdd_session"
MARK = "x-fdd"
"""A header that a form or a link of another site cannot send."""
REQUESTS_PER_S, REQUESTS_AT_ONCE = 30.0, 150.0
GUESSES_PER_S, GUESSES_AT_ONCE = 0.1, 10.0
BODY_S, BODY_BYTES_PER_S = 15.0, 65536.0
"""A body may take that long, and a second more for each so many bytes that have come."""
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=()",
}
_log = logging.getLogger(__name__)


def problem(status: int, text: str, headers: dict[str, str] | None = None) -> Response:
    """A refusal as JSON, in one line; the connection of one whose body was not read is closed."""
    headers = dict(headers or {})
    if status in (400, 403, 408, 413, 421, 429, 431, 503):
        headers["connection"] = "close"
    body = orjson.dumps({"error": " ".join(text.split())[:500]})
    return Response(body, status, headers, media_type="application/json")


class Guard:
    """The outermost layer.

    Parameters
    ----------
    app : what is guarded; finds the caller (or None) as ``request.state.caller`` and the refusal of a wrong
        token as ``request.state.unknown()``.
    tokens : None where none are asked for; then whoever reaches the service is `LOCAL`.
    hosts : names that the service goes by, beside IP addresses and localhost.
    secure : whether it is reached by TLS.

    Examples
    --------
    >>> Guard(app, tokens=None, sessions=Sessions(), hosts=["rig-7"], secure=False)  # doctest: +SKIP
    """

    def __init__(
        self, app: ASGIApp, *, tokens: Tokens | None, sessions: Sessions, hosts: Iterable[str], secure: bool
    ) -> None:
        self._app, self._tokens, self._sessions = app, tokens, sessions
        self._hosts = {"localhost", *(h.lower() for h in hosts)}
        self._secure = secure
        self._requests = Rates(REQUESTS_PER_S, REQUESTS_AT_ONCE)
        self._guesses = Rates(GUESSES_PER_S, GUESSES_AT_ONCE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Guard one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("cache-control", "no-store")
                if self._secure:
                    headers["strict-transport-security"] = "max-age=31536000"
            await send(message)

        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, with_headers)
            return
        try:
            await self._app(scope, _bounded(scope, receive), with_headers)
        except Exception as error:
            # Answered by now, where an answer was still possible.
            _log.error("%r: %s: %s", scope["path"][:200], type(error).__name__, error)

    def _refusal(self, scope: Scope) -> Response | None:
        headers, now = Headers(scope=scope), time.monotonic()
        client = _client(scope)
        if not self._requests.take(client, now):
            return problem(429, "too many requests; wait a moment", {"retry-after": "2"})
        head = sum(len(name) + len(value) for name, value in scope["headers"])
        if head + len(scope["raw_path"]) + len(scope["query_string"]) > MAX_HEAD_BYTES:
            return problem(431, f"the request's head may have {MAX_HEAD_BYTES} bytes")
        host = headers.getlist("host")
        if len(host) != 1 or not self._is_ours(host[0]):
            return problem(421, "unknown host name; open the service by its address or a name in its hosts")
        token = headers.get("authorization")
        caller = self._caller(headers, token, now)
        if token is not None and caller is None:
            return self._unknown(client)
        # Another site's page cannot send a token in a header; a cookie, or what needs none, it can.
        if scope["method"] not in ("GET", "HEAD") and token is None and not _is_same_origin(headers, host[0]):
            return problem(403, f"not sent by this page; give a token, or the header {MARK}: 1")
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit()) or int(length[:20]) > _most(scope):
            return problem(413, f"the body may have {_most(scope)} bytes")
        state = scope.setdefault("state", {})
        state["caller"] = caller
        state["unknown"] = lambda: self._unknown(client)
        return None

    def _unknown(self, client: str) -> Response:
        """A wrong token; a right one passes however many wrong ones came from the same address."""
        if self._guesses.take(client, time.monotonic()):
            return problem(401, "unknown token", {"www-authenticate": "Bearer"})
        return problem(429, "too many wrong tokens; wait a minute", {"retry-after": "60"})

    def _caller(self, headers: Headers, token: str | None, now: float) -> Caller | None:
        if self._tokens is None:
            return LOCAL
        if token is not None:
            scheme, _, rest = token.partition(" ")
            return self._tokens.caller(rest.strip()) if scheme.lower() == "bearer" else None
        cookie = cookie_of(headers)
        return None if cookie is None else self._sessions.caller(cookie, now)

    def _is_ours(self, host: str) -> bool:
        """A rebound DNS name is a name; an address is what the client itself chose to reach."""
        name = host.lower()
        if name.startswith("["):
            name = name[1:].partition("]")[0]
        else:
            name = name.rpartition(":")[0] if ":" in name else name
        if name.rstrip(".") in self._hosts:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


def cookie_of(headers: Headers) -> str | None:
    """The session's cookie in a request."""
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return None
    return None if found is None else found.value


def _client(scope: Scope) -> str:
    """The address that rates are counted by; of IPv6 the network, of which a client has all addresses."""
    host = (scope.get("client") or ("", 0))[0]
    return ":".join(host.split(":")[:4]) if ":" in host else host


def _is_same_origin(headers: Headers, host: str) -> bool:
    origin = headers.get("origin")
    if origin is not None and origin.partition("://")[2].lower() != host.lower():
        return False
    return headers.get("sec-fetch-site", "same-origin") == "same-origin" and MARK in headers


def _most(scope: Scope) -> int:
    return limit("MAX_UPLOAD_BYTES") if scope["path"] == "/api/diagnose" else MAX_REQUEST_BYTES


def _bounded(scope: Scope, receive: Receive) -> Receive:
    """The request's body, no longer and no slower than allowed."""
    most, begun, came, more = _most(scope), time.monotonic(), 0, True

    async def bounded() -> Message:
        nonlocal came, more
        if not more:
            return await receive()
        left = begun + BODY_S + came / BODY_BYTES_PER_S - time.monotonic()
        try:
            message = await asyncio.wait_for(receive(), max(left, 0.01))
        except TimeoutError:
            raise HTTPException(408, "the body comes too slowly") from None
        came += len(message.get("body", b""))
        more = bool(message.get("more_body"))
        if came > most:
            raise HTTPException(413, f"the body may have {most} bytes")
        return message

    return bounded
