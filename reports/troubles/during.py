"""The troubles: each lasts while its context does."""

from __future__ import annotations

import resource
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from reports.service import Process
from reports.troubles.trial import Mqtt, Sender


@contextmanager
def locked(process: Process, sender: Sender) -> Iterator[None]:
    """Another program holds the store's lock."""
    other = sqlite3.connect(process.state / "fdd.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    try:
        yield
    finally:
        other.execute("ROLLBACK")
        other.close()


@contextmanager
def full(process: Process, sender: Sender) -> Iterator[None]:
    """A file fills the disk (a small tmpfs) that the state folder is on."""
    filler = process.state / "filler"
    with filler.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    try:
        yield
    finally:
        filler.unlink()


@contextmanager
def no_growth(process: Process, sender: Sender) -> Iterator[None]:
    """No file of the process may grow beyond 64 KiB (RLIMIT_FSIZE), as with a quota."""
    pid, kind = process.popen.pid, resource.RLIMIT_FSIZE
    soft, hard = resource.prlimit(pid, kind)
    resource.prlimit(pid, kind, (1 << 16, hard))
    try:
        yield
    finally:
        resource.prlimit(pid, kind, (soft, hard))


@contextmanager
def renamed_file(process: Process, sender: Sender) -> Iterator[None]:
    """The store's file is moved away, and later back."""
    path = process.state / "fdd.db"
    path.rename(away := path.with_name("away.db"))
    try:
        yield
    finally:
        away.rename(path)


@contextmanager
def broker_away(process: Process, sender: Sender) -> Iterator[None]:
    """The broker is stopped, and started again."""
    assert isinstance(sender, Mqtt)
    sender.broker.stop()
    try:
        yield
    finally:
        sender.broker.start()


@contextmanager
def clock_ahead(process: Process, sender: Sender) -> Iterator[None]:
    """The host's clock is an hour ahead, and set back."""
    with _clock(process.clock, 3600):
        yield


@contextmanager
def clock_back(process: Process, sender: Sender) -> Iterator[None]:
    """The host's clock is set back by an hour, and is set right."""
    with _clock(process.clock, -3600):
        yield


@contextmanager
def _clock(clock: Path, off: int) -> Iterator[None]:
    for seconds in (off, 0):
        (new := clock.with_name("clock.new")).write_text(str(seconds))
        new.rename(clock)
        if seconds:
            yield


@contextmanager
def set_in_the_middle(process: Process, sender: Sender) -> Iterator[None]:
    """From the middle of the run on its stamps are an hour off."""
    yield
