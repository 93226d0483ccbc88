"""All parts of `fdd serve` put together, started and stopped."""

from __future__ import annotations

import fcntl
import logging
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from fdd.engines import Engine
from fdd.errors import InputError
from fdd.service.bus import Bus
from fdd.service.config import Serve
from fdd.service.http.app import Server
from fdd.service.http.tokens import Tokens
from fdd.service.outputs.metrics import Metrics
from fdd.service.outputs.targets import Outputs
from fdd.service.shards import Shards
from fdd.service.store import Store, StoreTrouble
from fdd.service.watch import Watch, check

LOG = logging.getLogger("fdd.service")
COMPACT_S = 3600.0
STOP_S = 20.0
LOOK_S = 5.0
AGAIN_S = 5.0
"""Before a server that is away at the start is tried again."""


class Service:
    """Everything that a `serve.yaml` describes.

    Parameters
    ----------
    config : the file. engine : ``ray`` watches the axes in shards on many machines.

    Attributes
    ----------
    address : what a browser opens. tokens : who may call; None lets everybody in as admin.
    metrics : the text and its type for Prometheus's Accept header.

    Raises InputError: a profile, a port, a file or the store that cannot be used.
    """

    def __init__(self, config: Serve, engine: Engine = "local") -> None:
        check(config)
        self.config = config
        self._failure: Exception | None = None
        self._known: set[str] = set()
        self._alone = _only_one(config.state)
        self.store, self.bus = _opened(config.store_url), Bus()
        # With Ray each shard records by itself: the samples are there.
        ray = engine == "ray"
        outputs = config.outputs.model_copy(update={"recording": None}) if ray else config.outputs
        self._outputs = Outputs(outputs, self.store, self.bus)
        watching: type[Watch | Shards] = Shards if ray else Watch
        self.fleet = watching(config, self.store, self.bus, self._outputs.targets)
        self.tokens = None if config.tokens is None else Tokens.load(config.tokens)
        self.metrics = Metrics(self.fleet, self.store, self._outputs)
        self._server = Server(self)
        self.address = self._server.address

    def health(self) -> dict[str, Any]:
        """Whether it can do its work, and what hinders it."""
        told = {name: status.get("last_error") for name, status in self._outputs.status().items()}
        problems = self.fleet.problems() + [f"output {n}: {error}" for n, error in told.items() if error]
        return {
            "status": "degraded" if problems else "ok",
            "problems": problems,
            "axes": self.fleet.count,
            "sources": self.fleet.sources(),
        }

    def run(self, stop: threading.Event, began: Callable[[], None] = lambda: None) -> None:
        """Work until `stop` is set, then keep everything.

        Parameters
        ----------
        began : called when all sources have begun.

        Raises Exception: what ended the fleet's thread: a source that cannot even begin, another service that
        has taken over, or a fault of fdd. Whoever started it sees a status that is not 0.
        """
        worker = threading.Thread(target=self._work, args=(stop,), name="fleet", daemon=True)
        self._outputs.start(stop)
        self._server.start()
        worker.start()
        try:
            while worker.is_alive() and not self.fleet.began.wait(0.05):
                pass
            if self.fleet.began.is_set():
                began()
            compacted = time.monotonic()
            while not stop.wait(LOOK_S):
                self._log_problems()
                if time.monotonic() - compacted >= COMPACT_S:
                    compacted = time.monotonic()
                    try:
                        gone = self.store.compact(time.time(), **self.config.retention.model_dump())
                        LOG.info("compacted: %s", gone)
                    except InputError as error:
                        LOG.warning("not compacted: %s", error)
        finally:
            stop.set()
            self._server.stop()
            worker.join(STOP_S)
            self._outputs.join(STOP_S)
            self.store.close()
            self._alone.close()
        if self._failure is not None:
            raise self._failure

    def _log_problems(self) -> None:
        """What health tells stands in the log too, once for as long as it is so."""
        # Figures change from look to look: what they are of does not.
        found = {re.sub(r"\d+", "#", line): line for line in self.health()["problems"]}
        for key in found.keys() - self._known:
            LOG.warning("degraded: %s", found[key])
        if self._known and not found:
            LOG.info("all well again")
        self._known = set(found)

    def _work(self, stop: threading.Event) -> None:
        try:
            self.fleet.run(stop)
        except Exception as error:
            if not isinstance(error, InputError):
                LOG.exception("the fleet's thread ended")
            self._failure = error
        finally:
            stop.set()


def _opened(url: str) -> Store:
    """The store, claimed; a server that is away at the start is waited for, as it would be later.

    Raises InputError: a file that cannot be used, or a database that somebody must mend.
    """
    while True:
        try:
            store = Store(url)
            store.claim("serve")
        except StoreTrouble as error:
            if url.startswith("sqlite"):
                raise
            LOG.warning("%s; it is tried again in %g s", error, AGAIN_S)
            time.sleep(AGAIN_S)
        else:
            return store


def _only_one(state: Path) -> IO[bytes]:
    """A lock of the state folder, held while the process lives.

    Raises InputError: another process has it, or the folder cannot be written.
    """
    try:
        state.mkdir(parents=True, exist_ok=True)
        lock = (state / "lock").open("wb")
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            "another fdd serve keeps its state there", where=state, mend="stop it, or name another folder"
        ) from None
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", where=state) from None
    return lock
