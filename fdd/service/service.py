"""All parts of `fdd serve` put together, started and stopped."""

from __future__ import annotations

import fcntl
import logging
import threading
import time
from pathlib import Path
from typing import IO, Any

from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.samples import Samples
from fdd.service.alarms import STATES
from fdd.service.bus import Bus
from fdd.service.config import Serve
from fdd.service.fleet import Fleet
from fdd.service.http import Folders, Hub, Listen, Server, Tokens, web
from fdd.service.inbox import Inbox
from fdd.service.outputs import Metrics, Outputs
from fdd.service.profiles import Profiles
from fdd.service.sources import Source, open_source
from fdd.service.store import Store, StoreTrouble

LOG = logging.getLogger("fdd.service")
COMPACT_S = 3600.0
DAY_S = 86400.0
STOP_S = 20.0


class Service:
    """Everything that a `serve.yaml` describes.

    Parameters
    ----------
    config : the file.

    Attributes
    ----------
    address : what a browser opens.

    Raises
    ------
    InputError : a profile, a port, a file or the store that cannot be used.

    Examples
    --------
    >>> service = Service(Serve.load("serve.yaml"))  # doctest: +SKIP
    >>> service.run(stop)  # doctest: +SKIP
    """

    def __init__(self, config: Serve) -> None:
        self._config = config
        self._alone = _only_one(config.state)
        model = Model.load(config.model)
        self._store = Store(config.store_url)
        self._bus = Bus()
        self._inbox = Inbox(config.limits.inbox_seconds, config.limits.inbox_bytes)
        self._outputs = Outputs(config.outputs, self._store, self._bus, self._profile_of)
        recorder = self._outputs.recorder
        self.fleet = Fleet(
            Profiles(config.units, config.fallback), model, self._store, self._bus, self._inbox,
            targets=self._outputs.targets, hold=config.limits.hold, learn_s=60.0 * config.learn_minutes,
            record=_unheard if recorder is None else recorder.push,
        )  # fmt: skip
        self._sources: list[Source] = [open_source(source) for source in config.sources]
        self._hub = Hub(self._bus)
        tokens = None if config.tokens is None else Tokens.load(config.tokens)
        metrics = Metrics(
            self.fleet.axes, lambda: self._store.alarms(STATES[1:]), self._outputs.status,
            lambda: self.fleet.store_errors,
        )  # fmt: skip
        tls = config.listen.tls
        app = web(
            fleet=self.fleet, store=self._store, hub=self._hub, health=self.health, metrics=metrics,
            trouble=StoreTrouble, tokens=tokens, hosts=config.listen.names, secure=tls is not None,
            folders=Folders(None if isinstance(config.units, dict) else config.units, config.maps),
        )  # fmt: skip
        listen = Listen(
            config.listen.host, config.listen.port, None if tls is None else tls.cert,
            None if tls is None else tls.key,
        )  # fmt: skip
        self._server = Server(app, listen, has_tokens=tokens is not None)
        self.address = self._server.address

    def _profile_of(self, axis: str) -> str | None:
        return self.fleet.profile_of(axis)

    def health(self) -> dict[str, Any]:
        """Whether it can do its work, and what hinders it."""
        problems = []
        if self.fleet.trouble is not None:
            problems.append(f"the store cannot be written: {self.fleet.trouble}")
        for source in self._sources:
            status = source.status()
            if not status["connected"]:
                why = f": {status['last_error']}" if status["last_error"] else ""
                problems.append(f"source {status['name']} is not connected{why}")
        for name, status in self._outputs.status().items():
            if status.get("last_error"):
                problems.append(f"output {name}: {status['last_error']}")
        return {
            "status": "degraded" if problems else "ok",
            "problems": problems,
            "axes": len(self.fleet.axes()),
        }

    def run(self, stop: threading.Event) -> None:
        """Work until `stop` is set, then keep everything."""
        sources_stop = threading.Event()
        worker = threading.Thread(target=self._work, args=(stop,), name="fleet", daemon=True)
        self._hub.start(stop)
        self._outputs.start(stop)
        serving = self._server.start(stop)
        worker.start()
        try:
            for source in self._sources:
                source.start(self._inbox.put, sources_stop)
            while not stop.wait(COMPACT_S):
                self._compact()
        finally:
            sources_stop.set()
            stop.set()
            worker.join(STOP_S)
            self._outputs.join(STOP_S)
            serving.join(STOP_S)
            self._store.close()
            self._alone.close()

    def _work(self, stop: threading.Event) -> None:
        try:
            self.fleet.run(stop)
        except Exception:
            LOG.exception("the fleet's thread ended")
            raise
        finally:
            stop.set()

    def _compact(self) -> None:
        kept = self._config.retention
        findings = None if kept.findings is None else kept.findings * DAY_S
        try:
            gone = self._store.compact(
                time.time(), minutes=kept.minutes * DAY_S, hours=kept.hours * DAY_S, findings=findings
            )
        except InputError as error:
            LOG.warning("not compacted: %s", error)
        else:
            LOG.info("compacted: %s", gone)


def _unheard(axis: str, samples: Samples) -> None:
    """Nothing is recorded."""


def _only_one(state: Path) -> IO[bytes]:
    """A lock of the state folder, held while the process lives.

    Raises
    ------
    InputError : another process has it, or the folder cannot be written.
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
