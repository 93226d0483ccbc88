"""What watches axes in one process: sources and the fleet that they feed; a check of what they need."""

from __future__ import annotations

import gc
import ssl
import threading
from pathlib import Path
from typing import Any

from fdd.bounds import MOST_AXES
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.files import require_writable
from fdd.service.bus import Bus
from fdd.service.config import Serve
from fdd.service.config_sources import read_secret
from fdd.service.fleet import Fleet
from fdd.service.http.tokens import Tokens
from fdd.service.profiles import Profiles, Share
from fdd.service.sources import open_source
from fdd.service.store import Store
from fdd.service.storing import Targets
from fdd.unit import Unit

GC_THRESHOLD = 50_000
"""Python's own is 700: waiting blocks of a hundred axes would start the garbage collector all the time."""


class Watch(Fleet):
    """The fleet of a `serve.yaml` with its sources.

    Attributes
    ----------
    began : set once all sources have begun.

    Raises InputError: a model, profile or channel map that cannot be used.
    """

    def __init__(
        self, config: Serve, store: Store, bus: Bus, targets: Targets, share: Share = Share()
    ) -> None:
        super().__init__(config, store, bus, targets, share)
        self.began = threading.Event()
        self._sources = [open_source(source, share.has) for source in config.sources]

    def run(self, stop: threading.Event) -> None:
        """Work what the sources bring until `stop` is set; state is kept at the end.

        Raises InputError: a source cannot even begin. LeaseLost: somebody else watches these axes.
        """
        ended = threading.Event()
        gc.freeze()  # what was imported stays
        gc.set_threshold(GC_THRESHOLD)
        try:
            for source in self._sources:
                source.start(self.inbox.put, ended)
            self.began.set()
            super().run(stop)
        finally:
            self.inbox.close()
            ended.set()

    def problems(self) -> list[str]:
        """What hinders it, a line each."""
        found = super().problems()
        for name, status in self.sources().items():
            if status["refused_lately"]:
                found.append(f"source {name} refused messages: {status['refused_lately']}")
            if not status["connected"]:
                why = f": {status['last_error']}" if status["last_error"] else ""
                found.append(f"source {name} is not connected{why}")
        return found

    @property
    def store_errors(self) -> int:
        """How often the store could not be written."""
        return self.writer.errors

    def sources(self) -> dict[str, dict[str, Any]]:
        """How each source stands, by name."""
        return {status["name"]: status for status in (source.status() for source in self._sources)}


def check(config: Serve) -> None:
    """Open all files that the configuration names, and make none.

    Raises InputError: the first one that cannot be used: a profile, model, map, log, secret, certificate or
    folder.
    """
    require_writable(config.state, folder=True)
    Profiles(config.units, config.fallback)
    if isinstance(config.units, Path):
        if not config.units.is_dir():
            raise InputError("no such folder", where=config.units, mend="make it, or correct units")
        for profile in sorted(config.units.glob("*.yaml"))[:MOST_AXES]:
            Unit.load(profile)
    Model.load(config.model)
    if config.tokens is not None:
        Tokens.load(config.tokens)
    if config.listen.tls is not None:
        tls = config.listen.tls
        try:
            ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(tls.cert, tls.key)
        except OSError as error:  # ssl's own errors are OSErrors
            raise InputError(
                f"cannot be used for TLS ({error.strerror or error})", where=f"{tls.cert}, {tls.key}"
            ) from None
    for source in config.sources:
        open_source(source).check()
    outputs = config.outputs
    if outputs.mqtt is not None:
        outputs.mqtt.client("check")
    for hook in outputs.webhooks:
        if hook.secret_file is not None:
            read_secret(hook.secret_file)
    if outputs.jsonl is not None:
        require_writable(outputs.jsonl)
    if outputs.recording is not None:
        require_writable(outputs.recording.folder, folder=True)
