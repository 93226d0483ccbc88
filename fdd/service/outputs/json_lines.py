"""Events as JSON lines in a file: whole lines, rotated by size, on the disk before they count as told."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import orjson

from fdd.files import require_writable
from fdd.service.outputs.courier import Undelivered
from fdd.service.outputs.doors import Parcel

MOST_BYTES, OLD_FILES = 64 << 20, 4
"""Of a file, and how many full ones are kept beside it, as FILE.1 (the newest) to FILE.4."""
LONGEST_HALF_LINE = 1 << 20
STATUS_EVERY_S = 60.0


class JsonLines:
    """A file that lines are appended to.

    Parameters
    ----------
    path : the file. most_bytes : of it, before the next one is begun.

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
        require_writable(self._path)
        self._file: int | None = None
        self._noted: dict[str, float] = {}

    def append(self, event: Mapping[str, Any], *, sync: bool = False) -> None:
        """Append one line, whole or not at all.

        Parameters
        ----------
        event : JSON-able. sync : wait until it is on the disk.

        Raises
        ------
        Undelivered : it cannot be written; the file ends with a whole line all the same.
        """
        line = orjson.dumps(event, option=orjson.OPT_APPEND_NEWLINE)
        try:
            self._append(line, sync)
        except OSError as error:
            self.close()
            raise Undelivered(f"{self._path}: {error.strerror or error}", down=True) from None

    def deliver(self, parcel: Parcel) -> None:
        """Append an alarm's transition or a finding; it is on the disk when this returns.

        Raises
        ------
        Undelivered : as `append`.
        """
        self.append({"id": parcel.id, "kind": parcel.kind, "data": dict(parcel.body)}, sync=True)

    def note(self, axis: str, state: Mapping[str, Any]) -> None:
        """Append an axis's status, once a minute at most; where that fails it is lost.

        Raises
        ------
        Undelivered : as `append`.
        """
        now = time.monotonic()
        if now - self._noted.get(axis, -STATUS_EVERY_S) >= STATUS_EVERY_S:
            self._noted[axis] = now
            self.append({"kind": "status", "axis": axis, "data": dict(state)})

    def close(self) -> None:
        """Close the file; the next line opens it again."""
        if self._file is not None:
            with suppress(OSError):
                os.close(self._file)
            self._file = None

    def _append(self, line: bytes, sync: bool) -> None:
        # A file that was moved away or removed by others is begun anew.
        if self._file is not None and not _is(self._path, self._file):
            self.close()
        file = self._open() if self._file is None else self._file
        size = os.fstat(file).st_size
        if size and size + len(line) > self._most_bytes:
            self._rotate()
            file, size = self._open(), 0
        try:
            if os.write(file, line) < len(line):
                raise OSError(errno.ENOSPC, "no space left for a whole line")
            if sync:
                os.fsync(file)
        except OSError:
            with suppress(OSError):
                os.ftruncate(file, size)
            raise

    def _open(self) -> int:
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o640)
        _drop_half_line(self._file)
        return self._file

    def _rotate(self) -> None:
        self.close()
        for k in range(OLD_FILES, 0, -1):
            older = self._path if k == 1 else _numbered(self._path, k - 1)
            if older.exists():
                older.replace(_numbered(self._path, k))


def _numbered(path: Path, k: int) -> Path:
    return path.with_name(f"{path.name}.{k}")


def _is(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _drop_half_line(file: int) -> None:
    """Cut off what a crash left of a line: it was never told as written."""
    end = os.fstat(file).st_size
    start = max(0, end - LONGEST_HALF_LINE)
    tail = os.pread(file, end - start, start)
    half = tail[tail.rfind(b"\n") + 1 :]
    if half and not half.startswith(b"{"):
        raise OSError(errno.EINVAL, "the last line is none of ours; name another file")
    os.ftruncate(file, end - len(half))
