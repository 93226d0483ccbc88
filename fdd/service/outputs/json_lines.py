"""Events as JSON lines in a file: whole lines, on the disk before they count as told."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import orjson

from fdd.files import require_writable
from fdd.service.outputs.delivery import Undelivered
from fdd.service.store import OutboxMessage

MOST_BYTES = 64 << 20
"""Of a file; a full one becomes FILE.1, in place of the one before."""
STATUS_EVERY_S = 60.0


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
        """Append one line, whole or not at all; it is on the disk when this returns.

        Raises
        ------
        Undelivered : it cannot be written.
        """
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
