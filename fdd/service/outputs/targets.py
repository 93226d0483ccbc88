"""Where messages go: a signed webhook, or lines of JSON in a file. Each delivers one, or says why not."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import ssl
import time
from collections.abc import Mapping
from contextlib import suppress
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import orjson

from fdd import __version__
from fdd.files import require_writable
from fdd.service.store import OutboxMessage

TIMEOUT_S = 5.0
"""For each answer of the network."""
MOST_ANSWER_BYTES = 1024
"""Of an answer's body, for the log; the rest is not read."""
LONGEST_ASKED_S = 86400.0
"""Of what a target may ask for by Retry-After."""
MOST_BYTES = 64 << 20
"""Of a file of lines; a full one becomes FILE.1, in place of the one before."""
STATUS_EVERY_S = 60.0


class Undelivered(Exception):
    """A message did not arrive.

    Parameters
    ----------
    problem : one line. wait_s : s that the target asks for, before which nothing is tried again.
    final : it never will arrive. down : the target takes nothing now.
    """

    def __init__(self, problem: str, *, wait_s: float = 0.0, final: bool = False, down: bool = False) -> None:
        super().__init__(" ".join(problem.split())[:300])
        self.wait_s, self.final, self.down = min(wait_s, LONGEST_ASKED_S), final, down


class Webhook:
    """One receiver of POSTs.

    Parameters
    ----------
    url : http or https; redirects are not followed, so that what is signed goes nowhere else.
    secret : key of the signature; None leaves it out.

    Attributes
    ----------
    name : target in the outbox: host and first characters of the URL's SHA-256, as a URL may hold secrets.
    """

    def __init__(self, url: str, secret: bytes | None = None) -> None:
        self._url, self._secret = url, secret
        self._tls = ssl.create_default_context()  # with the system's authorities
        self.name = f"webhook:{urlsplit(url).hostname}-{hashlib.sha256(url.encode()).hexdigest()[:8]}"

    def deliver(self, message: OutboxMessage) -> None:
        """POST a message, the same bytes at every attempt.

        Raises Undelivered: no connection, no answer in time, or an answer other than 2xx.
        """
        told = {"schema": "fdd.event/1", "id": message.id, "kind": message.kind, "data": message.body}
        body = orjson.dumps(told)
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"fdd/{__version__}",
            "Idempotency-Key": hashlib.sha256(body).hexdigest()[:32],
        }
        if self._secret is not None:
            stamp = str(int(time.time()))
            headers |= {"X-Fdd-Timestamp": stamp, "X-Fdd-Signature": signature(self._secret, stamp, body)}
        try:
            with httpx.stream(
                "POST", self._url, content=body, headers=headers, timeout=TIMEOUT_S, verify=self._tls,
                follow_redirects=False, trust_env=False,
            ) as answer:  # fmt: skip
                said = next(answer.iter_raw(MOST_ANSWER_BYTES), b"")
        except httpx.HTTPError as error:  # an answer that is cut is none
            raise Undelivered(f"{type(error).__name__}: {error}", down=True) from None
        status = answer.status_code
        if not answer.is_success:
            down = status in (429, 503)
            final = not (down or status in (408, 425) or status >= 500)
            reason = f"{status} {answer.reason_phrase} {said.decode('utf-8', 'replace')}"
            wait_s = _asked(answer.headers.get("Retry-After", ""))
            raise Undelivered(reason, wait_s=wait_s, final=final, down=down)


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


class JsonLines:
    """A file that lines are appended to; it is opened for each, so that log rotators may move it.

    Raises
    ------
    InputError : no such folder, no permission, or no file.

    Examples
    --------
    >>> JsonLines(Path("events.jsonl")).append({"kind": "status", "axis": "A1"})
    >>> Path("events.jsonl").read_text()
    '{"kind":"status","axis":"A1"}\\n'
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES) -> None:
        self._path, self._most_bytes = path, most_bytes
        require_writable(path)
        self._noted: dict[str, float] = {}

    def append(self, event: Mapping[str, Any]) -> None:
        """Append one line, whole or not at all; on the disk when this returns. Raises Undelivered."""
        line = orjson.dumps(event, option=orjson.OPT_APPEND_NEWLINE)
        try:
            with suppress(FileNotFoundError):
                if self._path.stat().st_size + len(line) > self._most_bytes:
                    self._path.replace(f"{self._path}.1")
            with self._path.open("ab", buffering=0) as file:
                size = file.tell()
                try:
                    if file.write(line) < len(line):
                        raise OSError("no space left for a whole line")
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(size)
                    raise
        except OSError as error:
            raise Undelivered(f"{self._path}: {error.strerror or error}", down=True) from None

    def deliver(self, message: OutboxMessage) -> None:
        """Append an alarm's transition or a finding; raises as `append`."""
        self.append({"id": message.id, "kind": message.kind, "data": message.body})

    def note(self, axis: str, state: Mapping[str, Any]) -> None:
        """Append an axis's status, once a minute at most; where that fails it is lost."""
        now = time.monotonic()
        if state and now - self._noted.get(axis, -STATUS_EVERY_S) >= STATUS_EVERY_S:
            self._noted[axis] = now
            self.append({"kind": "status", "axis": axis, "data": dict(state)})
