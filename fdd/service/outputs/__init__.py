"""What the service tells the outside; here what all targets share, and the metrics that are asked for."""

from __future__ import annotations

import math
import random
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, get_args

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from fdd import __version__
from fdd.faults import FAMILIES
from fdd.service.alarms import STANDING
from fdd.service.queues import Bus, Kind
from fdd.service.status import AxisState, AxisStatus
from fdd.service.store import OutboxMessage, Store

if TYPE_CHECKING:
    from fdd.service.service import Service

MOST_TAKEN = 200
"""Messages looked at in one go."""
MOST_ATTEMPTS = 20
"""Of a message that the target refuses for now, some two hours; while the target is down none is counted."""
LONGEST_WAIT_S = 600.0
LOOK_S = 0.5
"""Between two looks into the outbox."""
TROUBLE_S = 5.0
"""Rest after a failure that no one foresaw, such as a store that is locked."""
KINDS: tuple[Kind, ...] = ("alarm", "finding")
"""What goes through the outbox."""
UNITS = {
    "leakage": "cubic_meters_per_pascal_second",
    "bulk_modulus": "pascals",
    "coulomb_friction": "newtons",
    "viscous_friction": "newton_seconds_per_meter",
}
"""Estimated quantities and their units, as names of metrics spell them."""

Statuses = Mapping[str, Mapping[str, Any]]
_Rows = Iterable[tuple[tuple[str, ...], float | None]]
_Metrics = dict[str, tuple[str, str]]
# Counters by their keys; all others are gauges.
_COUNTED = {
    "samples", "dropped", "received", "refused", "reconnects",
    "delivered", "failed", "given_up", "lost", "files", "lost_blocks",
}  # fmt: skip
_AXES: _Metrics = {
    "up": ("fdd_axis_up", "1 while an axis sends and is diagnosed."),
    "samples": ("fdd_samples", "Samples taken."),
    "dropped": ("fdd_dropped_samples", "Samples lost on the way."),
    "lag": ("fdd_block_lag_seconds", "How far the diagnosis is behind."),
    "rate": ("fdd_sample_rate_hertz", "Samples a second."),
    "last": ("fdd_last_sample_timestamp_seconds", "Unix time of the last sample."),
}
for _name, _unit in UNITS.items():
    _title = _name.replace("_", " ").capitalize()
    _AXES[_name] = f"fdd_{_name}_{_unit}", f"{_title}."
    _AXES[f"{_name}_std"] = f"fdd_{_name}_stddev_{_unit}", f"{_title}, standard deviation."
_SOURCES: _Metrics = {
    "connected": ("fdd_source_connected", "1 while a source can be read."),
    "received": ("fdd_source_blocks", "Blocks taken."),
    "refused": ("fdd_source_refused", "Messages that cannot be used."),
    "reconnects": ("fdd_source_reconnects", "Connections made anew."),
}
_OUTPUTS: _Metrics = {
    "delivered": ("fdd_output_delivered", "Messages delivered."),
    "failed": ("fdd_output_failures", "Attempts that failed."),
    "given_up": ("fdd_output_given_up", "Messages given up."),
    "lost": ("fdd_output_lost_events", "Live events lost."),
    "pending": ("fdd_output_pending", "Messages that wait."),
    "files": ("fdd_output_recordings", "Recordings written."),
    "lost_blocks": ("fdd_output_lost_blocks", "Blocks the recorder lost."),
}


class Undelivered(Exception):
    """A message did not arrive, and (`final`) never will, or the target takes nothing now (`down`)."""

    def __init__(self, problem: str, *, final: bool = False, down: bool = False) -> None:
        super().__init__(" ".join(problem.split())[:300])
        self.final, self.down = final, down


class Target(ABC):
    """One receiver of messages, in their order and each at least once: one that fails holds back the next.

    `kinds` of messages are sent to it; one that `is_live` takes statuses (`note`), and hears what a
    chattering alarm does. `counts`: messages delivered, attempts failed, messages given up, those that wait
    (at most `MOST_TAKEN`) and live events lost, so far. `last_error`: "" while all is well.
    """

    kinds: Sequence[Kind] = KINDS
    is_live = False

    def __init__(self, name: str, store: Store) -> None:
        self.name, self._store = name, store
        self._failures, self._rests_until = 0, 0.0
        self.counts = dict.fromkeys(("delivered", "failed", "given_up", "pending", "lost"), 0)
        self.last_error = ""

    @abstractmethod
    def deliver(self, message: OutboxMessage) -> None:
        """Send one message. Raises Undelivered: it did not arrive."""

    def note(self, axis: str, state: Mapping[str, Any]) -> None:  # noqa: B027 (most take none)
        """Take an axis's live status."""

    def tick(self) -> None:  # noqa: B027 (most need none)
        """Called now and then."""

    def status(self) -> dict[str, Any]:
        """Counts and the last error."""
        return {**self.counts, "last_error": self.last_error}

    def once(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Deliver what waits, up to the first message that fails."""
        if time.monotonic() < self._rests_until:
            return
        messages = self._store.outbox(MOST_TAKEN, self.name)
        self.counts["pending"] = len(messages)
        for message in messages:
            if stopped():
                return
            try:
                self.deliver(message)
            except Exception as error:  # one that no target can take must not stop all others for ever
                if not self._is_given_up(message, error):
                    return
            else:
                self._store.settle(message.id, done=True)
                self.counts["delivered"] += 1
                self._failures = 0
            self.counts["pending"] -= 1
        self.last_error = ""

    def _is_given_up(self, message: OutboxMessage, error: Exception) -> bool:
        """Give up, or rest before the next attempt; which of them."""
        if not isinstance(error, Undelivered):
            error = Undelivered(f"{type(error).__name__}: {error}")
        self.counts["failed"] += 1
        self.last_error = str(error)
        attempts = message.attempts + 1
        if error.final or (attempts >= MOST_ATTEMPTS and not error.down):
            never = f"{message.kind} {message.id} never arrived at {self.name}"
            self._store.settle(message.id, done=True, why=f"{never} ({attempts} attempts: {error})")
            self.counts["given_up"] += 1
            return True
        if not error.down:
            self._store.settle(message.id, done=False)
        self._failures += 1
        wait = min(LONGEST_WAIT_S, 2.0 ** min(self._failures, 30)) * random.uniform(0.5, 1.0)
        self._rests_until = time.monotonic() + wait
        return False

    def run(self, bus: Bus, stop: threading.Event) -> None:
        """Deliver what comes, and note live states, until `stop` is set."""
        live: list[Kind] = ["status"] if self.is_live else []
        events = bus.subscribe([*self.kinds, *live])
        looked = -LOOK_S
        while not stop.is_set():
            try:
                event = events.get(LOOK_S)
                if event is not None and event.kind == "status":
                    self.note(event.axis, event.data)
                self.counts["lost"] = events.lost
                told = event is not None and event.kind in self.kinds
                if told or time.monotonic() - looked >= LOOK_S:
                    self.tick()
                    self.once(stop.is_set)
                    looked = time.monotonic()
            except Exception as error:  # the thread must outlive a store in trouble
                self.last_error = f"{type(error).__name__}: {error}"
                stop.wait(TROUBLE_S)
        events.close()


class Metrics(Collector):
    """What `GET /metrics` answers: of axes and sources, alarms that stand, and outputs. Between scrapes they
    cost nothing: all is read when it is asked for."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._registry.register(self)

    def __call__(self, accept: str = "") -> tuple[bytes, str]:
        """The text and its content type, in the format that the scraper accepts."""
        encode, content_type = choose_encoder(accept)
        return encode(self._registry), content_type

    def describe(self) -> Iterable[Metric]:
        """Nothing is read before the first scrape."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """All metrics, as things stand."""
        fleet = self._service.fleet
        axes = sorted(fleet.axes(), key=lambda axis: axis.name)
        yield GaugeMetricFamily("fdd_axes", "Axes that are watched.", len(axes))
        yield _gauge("fdd_build_info", "Version of fdd.", ["version"], [((__version__,), 1)])
        yield CounterMetricFamily("fdd_store_errors", "Failures of the store.", fleet.writer.errors)
        yield from _of({axis.name: _figures(axis) for axis in axes}, "axis", _AXES)
        states = [(a, s) for a in axes for s in get_args(AxisState)]
        there = [((a.name, s), a.state == s or (s == "silent" and a.silent)) for a, s in states]
        yield _gauge("fdd_axis_state", "1 for the state an axis is in.", ["axis", "state"], there)
        chances = [((a.name, f), a.probabilities.get(f)) for a in axes for f in FAMILIES]
        yield _gauge("fdd_fault_probability", "Probability of a family.", ["axis", "family"], chances)
        known = [((a.name, q), e.observable) for a in axes for q, e in a.estimates.items() if q in UNITS]
        yield _gauge("fdd_estimate_observable", "1 while it can be estimated.", ["axis", "quantity"], known)
        # A store in trouble must not take the other metrics away, nor tell of no alarms.
        with suppress(Exception):
            names, labels = {axis.name for axis in axes}, ["axis", "family", "state", "priority"]
            standing = (alarm for alarm in self._service.store.alarms(STANDING) if alarm["axis"] in names)
            counts = Counter(tuple(alarm[label] for label in labels) for alarm in standing)
            yield _gauge("fdd_alarms", "Alarms that stand.", labels, counts.items())
        yield from _of(self._service.sources(), "source", _SOURCES)
        yield from _of(self._service.outputs.status(), "target", _OUTPUTS)


def _figures(axis: AxisStatus) -> dict[str, float | None]:
    """What `_AXES` tells of an axis."""
    lost = ("dropped", "overrun", "late", "refused")
    estimates = {q: axis.estimates[q] for q in UNITS if q in axis.estimates}
    return {
        "up": not axis.silent and axis.state not in ("silent", "failed"), "samples": axis.samples,
        "dropped": sum(axis.quality.get(name, 0) for name in lost), "lag": axis.lag_s,
        "rate": axis.rate_hz, "last": axis.last_wall,
        **{q: e.value for q, e in estimates.items()}, **{f"{q}_std": e.std for q, e in estimates.items()},
    }  # fmt: skip


def _of(statuses: Statuses, label: str, metrics: _Metrics) -> Iterable[Metric]:
    """One metric for each key of the statuses, by the name of what has it."""
    for key, (name, help) in metrics.items():
        rows = (((what,), status.get(key)) for what, status in statuses.items())
        yield _gauge(name, help, [label], rows, CounterMetricFamily if key in _COUNTED else GaugeMetricFamily)


def _gauge(name: str, help: str, labels: list[str], rows: _Rows, kind: Any = GaugeMetricFamily) -> Metric:
    metric = kind(name, help, labels=labels)
    for values, value in rows:
        if value is not None and math.isfinite(value):
            metric.add_metric(values, value)
    return metric
