"""All parts of `fdd serve` put together, started and stopped."""

from __future__ import annotations

import fcntl
import gc
import logging
import re
import ssl
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from fdd.bounds import MOST_AXES
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.files import require_writable
from fdd.service.config import Serve
from fdd.service.config_sources import AnySource, read_secret
from fdd.service.fleet import Fleet
from fdd.service.http import Server
from fdd.service.outputs import Metrics
from fdd.service.outputs.targets import Outputs
from fdd.service.queues import Bus
from fdd.service.sources import Source
from fdd.service.sources.listening import Datagrams, TcpLines
from fdd.service.sources.logs import Folder, Replays
from fdd.service.sources.mqtt import Mqtt
from fdd.service.store import Store, StoreTrouble
from fdd.service.tokens import Tokens
from fdd.unit import Unit

LOG = logging.getLogger("fdd.service")
COMPACT_S = 3600.0
STOP_S = 20.0
LOOK_S = 5.0
AGAIN_S = 5.0
"""Before a server that is away at the start is tried again."""
GC_THRESHOLD = 50_000
"""Python's own is 700: waiting blocks of a hundred axes would start the garbage collector all the time."""
SOURCES: dict[str, type[Source[Any]]] = {
    "mqtt": Mqtt, "folder": Folder, "replay": Replays, "tcp": TcpLines, "udp": Datagrams,
}  # fmt: skip


class Service:
    """Everything that a `serve.yaml` describes; without `tokens` everybody is let in as admin.

    Raises InputError: a profile, a port, a file or the store that cannot be used.
    """

    def __init__(self, config: Serve) -> None:
        check_files(config)
        self.config = config
        self._failure: Exception | None = None
        self._known: set[str] = set()
        self._alone = _only_one(config.state)
        self.store, self.bus = _opened(config.store_url), Bus()
        self.outputs = Outputs(config.outputs, self.store, self.bus)
        self.fleet = Fleet(config, self.store, self.bus, self.outputs.targets)
        self._sources = [open_source(source) for source in config.sources]
        self.tokens = None if config.tokens is None else Tokens.load(config.tokens)
        self.metrics = Metrics(self)
        self._server = Server(self)
        self.address = self._server.address

    def health(self) -> dict[str, Any]:
        """Whether it can do its work, and what hinders it."""
        problems, sources = self.fleet.problems(), self.sources()
        for name, status in sources.items():
            if status["refused_lately"]:
                problems.append(f"source {name} refused messages: {status['refused_lately']}")
            if not status["connected"]:
                why = f": {status['last_error']}" if status["last_error"] else ""
                problems.append(f"source {name} is not connected{why}")
        told = {name: status.get("last_error") for name, status in self.outputs.status().items()}
        problems += [f"output {name}: {error}" for name, error in told.items() if error]
        state = "degraded" if problems else "ok"
        return {"status": state, "problems": problems, "axes": self.fleet.count, "sources": sources}

    def sources(self) -> dict[str, dict[str, Any]]:
        """How each source stands, by name."""
        return {status["name"]: status for status in (source.status() for source in self._sources)}

    def run(self, stop: threading.Event, began: Callable[[], None] = lambda: None) -> None:
        """Work until `stop` is set, then keep everything; `began` is called when all sources have begun.

        Raises Exception: what ended the fleet's thread: a source that cannot even begin, another service that
        has taken over, or a fault of fdd. Whoever started it sees a status that is not 0.
        """
        worker = threading.Thread(target=self._work, args=(stop, began), name="fleet", daemon=True)
        self.outputs.start(stop)
        self._server.start()
        worker.start()
        try:
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
            self.outputs.join(STOP_S)
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

    def _work(self, stop: threading.Event, began: Callable[[], None]) -> None:
        """Start the sources and work what they bring; `run` raises what ends it."""
        ended = threading.Event()
        gc.freeze()  # what was imported stays
        gc.set_threshold(GC_THRESHOLD)
        try:
            for source in self._sources:
                source.start(self.fleet.inbox.put, ended)
            began()
            self.fleet.run(stop)
        except Exception as error:
            if not isinstance(error, InputError):
                LOG.exception("the fleet's thread ended")
            self._failure = error
        finally:
            self.fleet.inbox.close()
            ended.set()
            stop.set()


def open_source(config: AnySource) -> Source[Any]:
    """The source that a part of `serve.yaml` describes.

    Raises InputError: its map cannot be read, or has what a stream cannot use.
    """
    return SOURCES[config.type](config)


def _opened(url: str) -> Store:
    """The store, claimed; a server that is away at the start is waited for, as it would be later."""
    while True:
        try:
            store = Store(url)
            store.claim()
        except StoreTrouble as error:
            if url.startswith("sqlite"):
                raise
            LOG.warning("%s; it is tried again in %g s", error, AGAIN_S)
            time.sleep(AGAIN_S)
        else:
            return store


def _only_one(state: Path) -> IO[bytes]:
    """A lock of the state folder, held while the process lives."""
    try:
        state.mkdir(parents=True, exist_ok=True)
        lock = (state / "lock").open("wb")
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        problem, mend = "another fdd serve keeps its state there", "stop it, or name another folder"
        raise InputError(problem, where=state, mend=mend) from None
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", where=state) from None
    return lock


def check_files(config: Serve) -> None:
    """Open all files that the configuration names, and make none.

    Raises InputError: the first one that cannot be used: a profile, model, map, log, secret, certificate or
    folder.
    """
    require_writable(config.state, folder=True)
    profiles: set[str] = set() if config.fallback is None else {config.fallback}
    if isinstance(config.units, dict):
        profiles |= {*config.units.values()}
    elif config.units is not None:
        if not config.units.is_dir():
            raise InputError("no such folder", where=config.units, mend="make it, or correct units")
        profiles |= {str(path) for path in sorted(config.units.glob("*.yaml"))[:MOST_AXES]}
    for profile in sorted(profiles):
        Unit.load(profile)
    Model.load(config.model)
    if config.tokens is not None:
        Tokens.load(config.tokens)
    if (tls := config.listen.tls) is not None:
        try:
            ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(tls.cert, tls.key)
        except OSError as error:  # ssl's own errors are OSErrors
            problem = f"cannot be used for TLS ({error.strerror or error})"
            raise InputError(problem, where=f"{tls.cert}, {tls.key}") from None
    for source in config.sources:
        open_source(source).check()
    outputs = config.outputs
    if outputs.mqtt is not None:
        outputs.mqtt.client("check")
    for hook in outputs.webhooks:
        if hook.secret_file is not None:
            read_secret(hook.secret_file)
    if outputs.recording is not None:
        require_writable(outputs.recording.folder, folder=True)
