"""One shard of the axes, as it runs in an actor of Ray; it knows nothing of Ray itself."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fdd.engines import enter
from fdd.service.alarms import Action, Transition
from fdd.service.bus import Bus, Event
from fdd.service.config import Serve
from fdd.service.outputs import Outputs
from fdd.service.share import Share
from fdd.service.status import AxisDetail, AxisStatus
from fdd.service.store import LeaseLost, Store, StoreTrouble
from fdd.service.watch import Watch

LOG = logging.getLogger("fdd.service")
AGAIN_S = 3.0
"""Rest after a failure, such as a store that is away; then all is opened anew."""
NEWS_S = 0.5
"""Longest wait for something to tell."""
MOST_EVENTS = 500
STOP_S = 15.0

Targets = Mapping[tuple[str, bool], Sequence[str]]
"""Kind of event, and whether people are told, to the targets of its outbox."""


@dataclass(frozen=True)
class News:
    """What a shard has to tell since it was last asked.

    Attributes
    ----------
    lost : why it ended for good: somebody else watches its axes.
    """

    events: list[Event]
    problems: list[str]
    sources: dict[str, dict[str, Any]]
    store_errors: int
    lost: str | None


class Shard:
    """Watch a share of the axes, in a thread; whatever fails is begun anew from what the store has.

    Parameters
    ----------
    folder : that relative paths start from. config : of this shard. leases : those of the service.

    Examples
    --------
    >>> shard = Shard(".", config, Share(0, 2), store.leases, {})  # doctest: +SKIP
    >>> shard.axes(); shard.stop()  # doctest: +SKIP
    """

    def __init__(
        self, folder: str, config: Serve, share: Share, leases: Mapping[str, str], targets: Targets
    ) -> None:
        logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
        logging.getLogger("alembic").setLevel(logging.WARNING)
        self._config, self._share, self._leases, self._targets = config, share, leases, targets
        self._bus, self._stop = Bus(), threading.Event()
        self._events = self._bus.subscribe()
        self._watch: Watch | None = None
        self._problem: str | None = None
        self._lost: str | None = None
        enter(folder)
        self._thread = threading.Thread(target=self._live, name="shard", daemon=True)
        self._thread.start()

    def _live(self) -> None:
        while not self._stop.is_set():
            try:
                self._run()
            except LeaseLost as error:
                self._lost = str(error)
                return
            except Exception as error:
                LOG.exception("shard %d", self._share.number)
                self._problem = " ".join(f"{type(error).__name__}: {error}".split())
                self._stop.wait(AGAIN_S)

    def _run(self) -> None:
        ended = threading.Event()
        store = Store(self._config.store_url, leases=self._leases)
        try:
            # From here on nobody else writes what this shard reads next.
            store.claim(f"shard {self._share.number}")
            outputs = Outputs(self._config.outputs, store, self._bus, lambda axis: watch.profile_of(axis))
            watch = Watch(
                self._config, store, self._bus, lambda kind, notify: self._targets[kind, notify],
                outputs.push, self._share,
            )  # fmt: skip
            outputs.start(ended)
            self._watch, self._problem = watch, None
            try:
                watch.run(self._stop)
            finally:
                self._watch = None
                ended.set()
                outputs.join()
        finally:
            store.close()

    def _ready(self) -> Watch:
        if self._watch is None:
            raise StoreTrouble(f"shard {self._share.number} is being started", mend="try again")
        return self._watch

    def axes(self) -> list[AxisStatus]:
        """How every axis of it stands; so for the others, see `Fleet`."""
        return self._ready().axes()

    def axis(self, name: str) -> AxisDetail:
        """One axis with its last ten minutes."""
        return self._ready().axis(name)

    def act(self, action: Action) -> Transition:
        """Do something to an alarm."""
        return self._ready().act(action)

    def news(self) -> News:
        """What happened since the last call, waiting a moment for it."""
        events = []
        event = self._events.get(NEWS_S)
        while event is not None:
            events.append(event)
            event = self._events.get() if len(events) < MOST_EVENTS else None
        watch = self._watch
        problems = ["is being started"] if watch is None else watch.problems()
        problems = problems if self._problem is None else [self._problem]
        if watch is None:
            return News(events, problems, {}, 0, self._lost)
        return News(events, problems, watch.sources(), watch.store_errors, self._lost)

    def stop(self) -> None:
        """Keep everything, and end."""
        self._stop.set()
        self._thread.join(STOP_S)
