"""Logs as live axes: those that drop into a folder, each once it is whole, or replayed at any speed."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from fdd.bounds import MAX_DONE_BYTES
from fdd.diagnosis.findings import Quality
from fdd.errors import InputError
from fdd.files import require_writable, write_text
from fdd.logs import read_log
from fdd.logs.quality import nominal_period
from fdd.monitor import Replay, WallClock
from fdd.samples import Samples
from fdd.service.blocks import axis_name
from fdd.service.config_sources import FolderSource, ReplaySource
from fdd.service.sources import Source, Window

NOTE = ".fdd-done.json"
AT_REST_S = 2.0
"""s for which a file's size and time of change stay before it is taken for whole."""
_NOTED_S = 5.0
ON_THEIR_WAY = 4
"""Blocks of one log that may wait for the fleet."""
LARGEST_S = 1.0
"""s of data in a block."""


class Done(BaseModel):
    """What became of one file; another size or time of change is another file of that name, and read again.

    `accepted` blocks were stored, `whole` says whether these are all, `error` why it cannot be read.
    """

    model_config = ConfigDict(extra="forbid")

    size: int
    changed_ns: int
    accepted: int = 0
    whole: bool = False
    error: str | None = None

    def is_of(self, stat: os.stat_result) -> bool:
        """Whether it is of a file as it stands now."""
        return (self.size, self.changed_ns) == (stat.st_size, stat.st_mtime_ns)


class _Note(BaseModel):
    model_config = ConfigDict(extra="forbid")

    schema_: Literal["fdd.done/1"] = Field(default="fdd.done/1", alias="schema")
    files: dict[str, Done] = {}


class Folder(Source[FolderSource]):
    """Logs of a folder and its direct subfolders, oldest first; nothing is moved.

    The file ``.fdd-done.json`` in the folder notes what was read and what could not be, so that a restart
    goes on where it was. A log with a date keeps it (seconds since 1970), else its times start at 0.
    """

    def __init__(self, config: FolderSource) -> None:
        super().__init__(config)
        self._folder, self._note_path, self._note = config.folder, config.folder / NOTE, _Note()
        # Size and time of change of files that are not known to be whole, and since when (s).
        self._seen: dict[Path, tuple[int, int, float]] = {}

    def check(self) -> None:
        """Refuse a folder that is missing, or cannot be written."""
        if not self._folder.is_dir():
            raise InputError("no such folder", where=self._folder, mend="make it, or correct the source")
        require_writable(self._note_path)

    def _begin(self, stop: threading.Event) -> None:
        self.check()
        path, mend = self._note_path, "remove it, and all logs of the folder are read again"
        if path.exists():
            if path.stat().st_size > MAX_DONE_BYTES:
                raise InputError(f"more than {MAX_DONE_BYTES} bytes", where=path, mend=mend)
            try:
                self._note = _Note.model_validate_json(path.read_bytes())
            except (OSError, ValueError):
                raise InputError("not a note of what is done", where=path, mend=mend) from None
        self._run(self._watch, stop)

    def status(self) -> dict[str, Any]:
        """How it stands; `files` read whole, `bad_files` that could not be."""
        files = list(self._note.files.values())
        whole, bad = sum(f.whole for f in files), sum(f.error is not None for f in files)
        return {**super().status(), "files": whole, "bad_files": bad}

    def _watch(self, stop: threading.Event) -> None:
        while not stop.is_set():
            try:
                for path, found in self._whole_files():
                    if stop.is_set():
                        return
                    self._work(path, found, stop)
                self._set(connected=True)
            except OSError as error:  # a network folder that went away comes back
                self._told(f"{self._folder}: {error.strerror or error}")
                self._set(connected=False)
            stop.wait(self._config.every)

    def _whole_files(self) -> list[tuple[Path, os.stat_result]]:
        """New plain files at rest in the folder and its direct subfolders, the longest unchanged first."""
        now, seen, found = time.monotonic(), {}, []
        entries = [e for e in os.scandir(self._folder) if not e.name.startswith(".")]
        for folder in [e for e in entries if e.is_dir(follow_symlinks=False)]:
            entries += [e for e in os.scandir(folder) if not e.name.startswith(".")]
        for path in [Path(e.path) for e in entries if e.is_file()]:
            try:
                self._key(path).encode()
                stat = path.stat()
            except FileNotFoundError:  # it went away meanwhile
                continue
            except UnicodeEncodeError:
                self._told(InputError("a name that is not UTF-8, passed over", where=ascii(path.name)))
                continue
            known = self._note.files.get(self._key(path))
            if known is not None and (known.whole or known.error is not None) and known.is_of(stat):
                continue
            size, changed, since = self._seen.get(path, (-1, -1, now))
            if (size, changed) != (stat.st_size, stat.st_mtime_ns):
                since = now
            seen[path] = stat.st_size, stat.st_mtime_ns, since
            # One that was moved in whole has not changed for long by its own time.
            if now - since >= AT_REST_S or time.time() - max(stat.st_mtime, stat.st_ctime) >= AT_REST_S:
                found.append((path, stat))
        self._seen = seen
        return sorted(found, key=lambda f: (f[1].st_mtime_ns, f[0].name))

    def _work(self, path: Path, found: os.stat_result, stop: threading.Event) -> None:
        done = self._note.files.get(self._key(path))
        if done is None or not done.is_of(found):
            done = self._note.files[self._key(path)] = Done(size=found.st_size, changed_ns=found.st_mtime_ns)
        try:
            log = read_log(path, self._map)
            inside = None if path.parent == self._folder else path.parent.name
            axis = axis_name(self._config.axis or log.axis or inside)
            if not done.is_of(path.stat()):
                return  # it was written to while it was read
            samples = log.samples
            if log.start_ns:
                samples = Samples(samples.time + log.start_ns * 1e-9, samples.columns)
            self._stream(axis, samples, done, stop)
        except InputError as error:
            told = error if error.where == str(path) else error.at(path)
            done.error = str(told)
            self.refuse(told)
        self._write_note()

    def _stream(self, axis: str, samples: Samples, done: Done, stop: threading.Event) -> None:
        """Put the blocks that were not accepted yet."""
        rows, first, window = rows_of(samples), done.accepted, Window(ON_THEIR_WAY)
        noted, sent = time.monotonic(), first
        parts = samples.rows(first * rows, len(samples)).blocks(rows)
        for number in self._take_all(axis, parts, first, window, stop):
            sent = number + 1
            # Blocks are accepted in order: all but those on their way were.
            done.accepted = sent - window.waiting
            if time.monotonic() - noted > _NOTED_S:
                self._write_note()
                noted = time.monotonic()
        window.drained(stop)
        done.accepted = sent - window.waiting
        done.whole = done.accepted >= -(-len(samples) // rows)

    def _key(self, path: Path) -> str:
        return path.relative_to(self._folder).as_posix()

    def _write_note(self) -> None:
        # Of files that are gone nothing need be known.
        self._note = _Note(files={k: v for k, v in self._note.files.items() if (self._folder / k).exists()})
        try:
            write_text(self._note_path, self._note.model_dump_json(by_alias=True, indent=1))
        except InputError as error:  # a full disk: told, and tried again with the next file
            self._told(error)


class Replays(Source[ReplaySource]):
    """One log for each axis, played in a thread of its own."""

    _running = 0

    def check(self) -> None:
        """Refuse a log that cannot be opened."""
        for path in self._config.logs.values():
            try:
                path.open("rb").close()
            except OSError as error:
                problem = f"cannot be read ({error.strerror})"
                raise InputError(problem, where=path, mend="correct its path") from None

    def _begin(self, stop: threading.Event) -> None:
        self._running = len(self._config.logs)
        self._set(connected=True)
        for axis, path in self._config.logs.items():
            self._spawn(self._play, axis, path, stop, ended=self._ended)

    def status(self) -> dict[str, Any]:
        """How it stands; `running` tells how many logs are being played."""
        return {**super().status(), "running": self._running}

    def _ended(self) -> None:
        with self._lock:
            self._running -= 1
            self._state["connected"] = self._running > 0

    def _play(self, axis: str, path: Path, stop: threading.Event) -> None:
        samples = read_log(path, self._map).samples
        speed = None if self._config.speed == "max" else self._config.speed
        played = Replay(samples, Quality(), speed=speed, clock=WallClock(stop))
        parts = (rows for part in played if len(part) for rows in part.blocks(rows_of(samples)))
        for _ in self._take_all(axis, parts, 0, Window(ON_THEIR_WAY), stop):
            pass


def rows_of(samples: Samples) -> int:
    """Rows of a block of `LARGEST_S`."""
    return max(1, round(LARGEST_S / nominal_period(samples.time))) if len(samples) > 1 else 1
