"""Webhooks: an HTTP POST of JSON for each alarm transition and finding, signed."""

from __future__ import annotations

import hashlib
import hmac
import http.client
import re
import ssl
import time
from contextlib import closing
from email.utils import parsedate_to_datetime
from urllib.parse import urlsplit

import orjson

from fdd import __version__
from fdd.service.outputs.delivery import Undelivered
from fdd.service.store import OutboxMessage

SCHEMA = "fdd.event/1"
TIMEOUT_S = 5.0
"""For each answer of the network."""
MOST_ANSWER_BYTES = 1024
"""Of an answer's body, for the log; the rest is not read."""


class Webhook:
    """One receiver.

    Parameters
    ----------
    url : http or https; redirects are not followed, so that what is signed goes nowhere else.
    secret : key of the signature; None leaves it out.

    Attributes
    ----------
    name : target in the outbox: host and first characters of the URL's SHA-256, as a URL may hold secrets.
    """

    def __init__(self, url: str, secret: bytes | None = None) -> None:
        parts = urlsplit(url)
        self._secret = secret
        self._tls = ssl.create_default_context() if parts.scheme == "https" else None
        self._host, self._port = str(parts.hostname), parts.port
        self._path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        self.name = f"webhook:{self._host}-{hashlib.sha256(url.encode()).hexdigest()[:8]}"

    def deliver(self, message: OutboxMessage) -> None:
        """POST a message, the same bytes at every attempt.

        Raises
        ------
        Undelivered : no connection, no answer in time, or an answer other than 2xx.
        """
        body = orjson.dumps({"schema": SCHEMA, "id": message.id, "kind": message.kind, "data": message.body})
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"fdd/{__version__}",
            "Idempotency-Key": hashlib.sha256(body).hexdigest()[:32],
        }
        if self._secret is not None:
            stamp = str(int(time.time()))
            headers |= {"X-Fdd-Timestamp": stamp, "X-Fdd-Signature": signature(self._secret, stamp, body)}
        try:
            status, reason, wait_s = self._post(body, headers)
        except (OSError, http.client.HTTPException) as error:
            raise Undelivered(f"{type(error).__name__}: {error}", down=True) from None
        if not 200 <= status < 300:
            down = status in (429, 503)
            final = not (down or status in (408, 425) or status >= 500)
            raise Undelivered(reason, wait_s=wait_s, final=final, down=down)

    def _post(self, body: bytes, headers: dict[str, str]) -> tuple[int, str, float]:
        """Status, a line about it, and how many seconds the receiver asks to wait."""
        if self._tls is None:
            link = http.client.HTTPConnection(self._host, self._port, timeout=TIMEOUT_S)
        else:
            link = http.client.HTTPSConnection(self._host, self._port, timeout=TIMEOUT_S, context=self._tls)
        link.response_class = _Answer
        with closing(link):
            link.request("POST", self._path, body, headers)
            answer = link.getresponse()
            said = answer.read(MOST_ANSWER_BYTES)
            # Of a body that ends too early http.client gives what there is, and still waits for the rest.
            if len(said) < MOST_ANSWER_BYTES and answer.length:
                raise http.client.IncompleteRead(said, answer.length)
        reason = f"{answer.status} {answer.reason} {said.decode('utf-8', 'replace')}"
        return answer.status, reason, _asked(answer.headers.get("Retry-After", ""))


class _Answer(http.client.HTTPResponse):
    """An answer whose head must be whole: http.client takes one that is cut there for one without a body."""

    def begin(self) -> None:
        """Read the head; raises RemoteDisconnected where it ends before its empty line."""
        last, plain = b"", self.fp.readline

        def noted(most: int | None = -1) -> bytes:
            nonlocal last
            last = plain(most)
            return last

        self.fp.readline = noted  # type: ignore[method-assign]
        super().begin()
        if last not in (b"\r\n", b"\n"):
            raise http.client.RemoteDisconnected("the answer is cut")


def signature(secret: bytes, stamp: str, body: bytes) -> str:
    """HMAC-SHA256 over ``stamp.body``, as X-Fdd-Signature carries it.

    Examples
    --------
    >>> signature(b"key", "1700000000", b"{}")[:20]
    'sha256=9d713ed406bb7'
    """
    return "sha256=" + hmac.new(secret, stamp.encode() + b"." + body, hashlib.sha256).hexdigest()


def _asked(text: str) -> float:
    """s that Retry-After asks for, given in seconds or as a date; 0 where it is neither."""
    if re.fullmatch(r"[0-9]{1,9}", text.strip()):
        return float(text)
    try:
        return max(0.0, parsedate_to_datetime(text).timestamp() - time.time())
    except (TypeError, ValueError, OverflowError):
        return 0.0
