"""All axes in shards, each an actor that Ray places and starts again elsewhere, asked as one fleet."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fdd.engines import connected, enter
from fdd.errors import InputError
from fdd.service.alarms import Action, Transition
from fdd.service.bus import Bus, Event
from fdd.service.config import Outputs as OutputsConfig
from fdd.service.config import Serve
from fdd.service.config_sources import MqttSource, source_name
from fdd.service.fleet import ACT_S
from fdd.service.outputs.targets import Outputs
from fdd.service.profiles import Share
from fdd.service.status import AxisDetail, AxisStatus
from fdd.service.store import LeaseLost, Store, StoreTrouble
from fdd.service.storing import Targets
from fdd.service.watch import Watch

LOG = logging.getLogger("fdd.service")
AGAIN_S = 3.0
"""Rest of a shard after a failure, such as a store that is away; then all is opened anew."""
NEWS_S = 0.5
"""Longest wait of a shard for something to tell."""
ASK_S = 3.0
"""For an answer; a shard that is silent for longer is away."""
STOP_S = 15.0
MOST_EVENTS = 500
MEMORY_BYTES = 256 << 20
"""That a shard reserves, and no processor: jobs that take all of them must not keep a lost shard waiting."""
CALLS = 16
"""Of a shard that are answered at once."""


@dataclass
class News:
    """What a shard has to tell since it was last asked; `lost` : somebody else watches its axes for good."""

    problems: list[str]
    events: list[Event] = field(default_factory=list)
    sources: dict[str, dict[str, Any]] = field(default_factory=dict)
    store_errors: int = 0
    axes: int = 0
    lost: str | None = None


class Shard:
    """Watch a share of the axes, in a thread; whatever fails is begun anew from what the store has.

    Parameters
    ----------
    folder : that relative paths start from. config : of this shard. leases : those of the service.
    """

    def __init__(
        self, folder: str, config: Serve, share: Share, leases: Mapping[str, str], targets: Targets
    ) -> None:
        logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
        self._config, self._share, self._leases, self._targets = config, share, leases, targets
        self._bus, self._stop = Bus(), threading.Event()
        self._events = self._bus.subscribe()
        self._watch: Watch | None = None
        self._problem = "is being started"
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
            outputs = Outputs(self._config.outputs, store, self._bus)
            watch = self._watch = Watch(self._config, store, self._bus, self._targets, self._share)
            outputs.start(ended)
            try:
                watch.run(self._stop)
            finally:
                self._watch = None
                ended.set()
                outputs.join()
        finally:
            store.close()

    def ask(self, method: str, *given: Any) -> Any:
        """What a method of its fleet gives: `axes`, `axis`, `act` or `remove`."""
        if self._watch is None:
            raise StoreTrouble(f"shard {self._share.number} {self._problem}", mend="try again")
        return getattr(self._watch, method)(*given)

    def news(self) -> News:
        """What happened since the last call, waiting a moment for it."""
        events, event = list[Event](), self._events.get(NEWS_S)
        while event is not None:
            events.append(event)
            event = self._events.get() if len(events) < MOST_EVENTS else None
        watch = self._watch
        if watch is None:
            return News([self._problem], events, lost=self._lost)
        return News(watch.problems(), events, watch.sources(), watch.store_errors, watch.count)

    def stop(self) -> None:
        """Keep everything, and end."""
        self._stop.set()
        self._thread.join(STOP_S)


class Shards:
    """The shards of a `serve.yaml`, on the Ray cluster that RAY_ADDRESS names; asked as a `Watch` is.

    Parameters
    ----------
    config : the file. store : with the service's lease; shards open it by its URL. bus : is told what the
        shards tell.

    Raises InputError: a source that cannot be read in shards, or no Ray.
    """

    def __init__(self, config: Serve, store: Store, bus: Bus, targets: Targets) -> None:
        self._store, self._bus = store, bus
        self._shares = [Share(number, config.shards) for number in range(config.shards)]
        parts = [part_of(config, share) for share in self._shares]
        self._ray, self._began = connected(log_to_driver=True)
        # A call is not repeated by Ray: nothing is done to an alarm behind the back of who gave up waiting.
        actor = self._ray.remote(Shard).options(
            num_cpus=0, memory=MEMORY_BYTES, max_restarts=-1, max_task_retries=0, max_concurrency=CALLS,
            scheduling_strategy="SPREAD",
        )  # fmt: skip
        self._actors = [
            actor.remote(str(Path.cwd()), part, share, store.leases, targets)
            for part, share in zip(parts, self._shares, strict=True)
        ]
        self._news: dict[int, News] = {}  # of the shards that are there
        self._lost: str | None = None
        self.began = threading.Event()

    def run(self, stop: threading.Event) -> None:
        """Hear the shards until `stop` is set, then let them keep everything.

        Raises InputError: another service has taken over.
        """
        self.began.set()
        for share in self._shares:
            threading.Thread(target=self._hear, args=(share.number, stop), daemon=True).start()
        stop.wait()
        self._ray.wait([a.stop.remote() for a in self._actors], num_returns=len(self._actors), timeout=STOP_S)
        for actor in self._actors:
            self._ray.kill(actor)
        if self._began:
            self._ray.shutdown()
        if self._lost is not None:
            raise InputError(self._lost)

    def _hear(self, number: int, stop: threading.Event) -> None:
        asked = None
        while not stop.is_set():
            asked = asked or self._actors[number].news.remote()
            if not self._ray.wait([asked], timeout=ASK_S)[0]:
                # Asked before Ray has found out that it is gone: this very answer may still come.
                self._news.pop(number, None)
                continue
            try:
                news = self._news[number] = self._ray.get(asked)
            except self._ray.exceptions.RayError:
                self._news.pop(number, None)
                stop.wait(0.2)
            else:
                for event in news.events:
                    self._bus.publish(event)
                if news.lost is not None:
                    self._lost = news.lost
                    stop.set()
            asked = None

    @property
    def store_errors(self) -> int:
        """How often the store could not be written, since each shard began."""
        return sum(news.store_errors for news in self._news.copy().values())

    @property
    def count(self) -> int:
        """Axes of the shards that are there."""
        return sum(news.axes for news in self._news.copy().values())

    def problems(self) -> list[str]:
        """What hinders them, a line each."""
        away = News(["is away"])
        told = [(n, self._news.get(n, away).problems) for n in range(len(self._shares))]
        return [f"shard {number}: {line}" for number, lines in told for line in lines]

    def sources(self) -> dict[str, dict[str, Any]]:
        """How each shard's sources stand, by its number and their name."""
        found = sorted(self._news.copy().items(), key=lambda item: item[0])
        return {f"{number}/{name}": s for number, news in found for name, s in news.sources.items()}

    def axes(self) -> list[AxisStatus]:
        """How every axis stands; those of a shard that is away have failed until it is there again."""
        found: list[AxisStatus] = []
        for share in self._shares:
            try:
                found += self._asked(share, "axes")
            except StoreTrouble as error:
                found += [
                    AxisStatus(name=row["name"], unit=row["unit"] or "", state="failed", headline=str(error))
                    for row in self._store.axes()
                    if share.has(row["name"])
                ]
        return found

    def axis(self, name: str) -> AxisDetail:
        """One axis with its last ten minutes; raises KeyError, or StoreTrouble where its shard is away."""
        return self._asked(self._share_of(name), "axis", name)

    def act(self, action: Action) -> Transition:
        """Do something to an alarm; it is stored when this returns. Raises as that of a fleet."""
        alarm = self._store.alarm(action.alarm_id)
        if alarm is None:
            raise InputError(f"there is no alarm {action.alarm_id}", mend="look at the list anew")
        share = self._share_of(alarm["axis"])
        return self._asked(share, "act", action, most=ACT_S + ASK_S)

    def remove(self, axis: str, who: str) -> None:
        """Watch an axis no longer; raises as that of a fleet."""
        self._asked(self._share_of(axis), "remove", axis, who, most=ACT_S + ASK_S)

    def _share_of(self, axis: str) -> Share:
        return next(share for share in self._shares if share.has(axis))

    def _asked(self, share: Share, method: str, *given: Any, most: float = ASK_S) -> Any:
        away = StoreTrouble(f"shard {share.number} is away: Ray starts it again", mend="try again")
        if share.number not in self._news:
            raise away
        answer = self._actors[share.number].ask.remote(method, *given)
        try:
            return self._ray.get(answer, timeout=most)
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except self._ray.exceptions.RayError:
            self._ray.cancel(answer)
            raise away from None


def part_of(config: Serve, share: Share) -> Serve:
    """The file as one shard has it: with sessions of its own at the brokers, and a folder for its recordings.

    Raises InputError: a source that several shards cannot read, each its own axes.

    Examples
    --------
    >>> text = "schema: fdd.serve/1\\nsources: [{type: mqtt, host: h, topics: ['a/{axis}'], client_id: rig}]"
    >>> part_of(Serve.from_yaml(text), Share(1, 2)).sources[0].client_id
    'rig-1'
    """
    sources = []
    for source in config.sources:
        name = source_name(source)
        if not isinstance(source, MqttSource):
            raise InputError(
                f"source {name}: shards cannot share one of type {source.type}", mend="publish by MQTT"
            )
        if any("{axis}" not in topic.split("/") for topic in source.topics):
            raise InputError(
                f"source {name}: shards know their axes by the topic", mend="name them by a level {axis}"
            )
        session = source.client_id or f"fdd-{socket.gethostname()}-{name}"
        sources.append(source.model_copy(update={"client_id": f"{session}-{share.number}"}))
    kept = config.outputs.recording
    if kept is not None:
        most = max(kept.most_bytes // share.of, 1 << 20)
        folder = kept.folder / f"shard-{share.number}"
        kept = kept.model_copy(update={"folder": folder, "most_bytes": most})
    return config.model_copy(update={"sources": sources, "outputs": OutputsConfig(recording=kept)})
