"""Where blocks come from; here what all sources share: counts, the last error, threads that end heard."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, Generic, TypeVar

from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.samples import Samples
from fdd.service.blocks import Block, nothing
from fdd.service.config_sources import AnySource

LOG = logging.getLogger("fdd.service")
LATELY_S, LOGGED_S = 20.0, 10.0
Put = Callable[[Block], None]
Config = TypeVar("Config", bound=AnySource)


class Source(ABC, Generic[Config]):
    """One source, of its part of `serve.yaml`; it runs in threads of its own, and counts what it receives."""

    def __init__(self, config: Config) -> None:
        self.name, self._config = config.name or config.type, config
        self._map = None if config.map is None else ChannelMap.load(config.map)
        self._lock = threading.Lock()
        self._state: dict[str, Any] = {"connected": False, "last_error": None}
        self._state |= {"received": 0, "refused": 0, "reconnects": 0}
        # When a refusal was last told in the log, monotonic s; refusals since then; the last one and when.
        self._logged, self._unlogged, self._refusal = -1e9, 0, (-1e9, "")
        self._ignored: dict[str, None] = {}

    def start(self, put: Put, stop: threading.Event) -> None:
        """Begin to put blocks, until `stop` is set; returns at once.

        Raises InputError: it cannot even begin: a port that is taken, a password file that is missing.
        """
        self._put = put
        self._begin(stop)

    def check(self) -> None:
        """Open the files and folders that its part of `serve.yaml` names, or raise InputError."""

    @abstractmethod
    def _begin(self, stop: threading.Event) -> None:
        """Begin in threads of its own; raises as `start`."""

    def status(self) -> dict[str, Any]:
        """How it stands: `connected`, `received` and `refused` messages, `last_error`, `reconnects`, more.

        `refused_lately` says why a message was refused within the last 20 s; "" where none was.
        """
        with self._lock:
            at, why = self._refusal
            lately = why if time.monotonic() - at < LATELY_S else ""
            more = {"refused_lately": lately, "ignored_columns": list(self._ignored)}
            return {"name": self.name, **self._state, **more}

    def _run(self, target: Callable[..., None], *args: Any) -> None:
        """Run the source's own thread; with it the connection ends."""
        self._set(connected=True)
        self._spawn(target, *args, ended=lambda: self._set(connected=False))

    def _spawn(self, target: Callable[..., None], *args: Any, ended: Callable[[], None] = nothing) -> None:
        """Run `target` in a thread; what it raises becomes the last error."""

        def run() -> None:
            try:
                target(*args)
            except InputError as error:
                self._told(error)
            except Exception as error:  # a fault of fdd; the other sources go on
                self._told(f"internal error: {type(error).__name__}: {error}")
            finally:
                ended()

        threading.Thread(target=run, daemon=True, name=f"fdd-{self.name}").start()

    def take(self, block: Block) -> None:
        """Hand a block on. Raises InputError: the service watches as many axes as it can."""
        if block.unit is None and self._config.unit is not None:
            block = replace(block, unit=self._config.unit)
        self._put(block)
        with self._lock:
            self._state["received"] += 1
            for name in block.ignored:
                if len(self._ignored) < 8:
                    self._ignored[name[:40]] = None

    def _take_all(
        self, axis: str, parts: Iterable[Samples], first: int, window: Window, stop: threading.Event
    ) -> Iterator[int]:
        """Hand on blocks that are numbered from `first`, each once there is room for it; their numbers."""
        for number, rows in enumerate(parts, first):
            if not window.wait(stop):
                return
            told = window.accepted
            self.take(Block(axis, rows, number, time.time(), patient=True, accepted=told))
            yield number

    def refuse(self, error: InputError) -> None:
        """Count a message that cannot be used, and say why; in the log not more often than people read."""
        self._count("refused")
        self._told(error)
        now = time.monotonic()
        with self._lock:
            self._refusal, self._unlogged = (now, self._state["last_error"]), self._unlogged + 1
            if now - self._logged < LOGGED_S:
                return
            many, self._logged, self._unlogged = self._unlogged, now, 0
        LOG.warning("source %s: %d refused, the last one: %s", self.name, many, self._refusal[1])

    def _told(self, error: object) -> None:
        """Keep an error, in one line."""
        self._set(last_error=" ".join(str(error).split())[:500])

    def _count(self, name: str) -> None:
        with self._lock:
            self._state[name] = self._state.get(name, 0) + 1

    def _set(self, **state: Any) -> None:
        with self._lock:
            self._state.update(state)


class Window:
    """How many blocks may be on their way: a source that can wait does, until the fleet has stored some."""

    def __init__(self, most: int) -> None:
        self._most, self._changed, self.waiting = most, threading.Condition(), 0

    def wait(self, stop: threading.Event) -> bool:
        """Wait until another block may go; False where `stop` was set."""
        with self._changed:
            goes = self.drained(stop, self._most - 1)
            self.waiting += goes
        return goes

    def accepted(self) -> None:
        """A block was stored."""
        with self._changed:
            self.waiting -= 1
            self._changed.notify_all()

    def drained(self, stop: threading.Event, most: int = 0) -> bool:
        """Wait until no more blocks than `most` are on their way; False where `stop` was set."""
        with self._changed:
            while self.waiting > most and not stop.is_set():
                self._changed.wait(0.2)
        return not stop.is_set()
