"""What the service tells the outside: outputs and, when asked, metrics: between scrapes they cost nothing."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, get_args

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from fdd import __version__
from fdd.faults import FAMILIES
from fdd.service import config
from fdd.service.alarms import STANDING
from fdd.service.outputs.recorder import Recorder
from fdd.service.outputs.targets import KINDS, MqttPublisher, Target, Webhook
from fdd.service.queues import Bus
from fdd.service.status import AxisState, AxisStatus
from fdd.service.store import Store
from fdd.service.storing import Targets

if TYPE_CHECKING:
    from fdd.service.service import Service

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


class Outputs:
    """Everything that tells the outside what the fleet found: what must arrive is in the store's outbox, what
    may be lost comes by the bus. Raises InputError: a secret file or a folder that cannot be used."""

    def __init__(self, settings: config.Outputs, store: Store, bus: Bus) -> None:
        made: list[Target] = [] if settings.mqtt is None else [MqttPublisher(settings.mqtt, store)]
        made += [Webhook(hook, store) for hook in reversed(settings.webhooks)]
        self._bus, self._threads = bus, list[threading.Thread]()
        self._targets = {target.name: target for target in made}
        kept = settings.recording
        self._recorder = None if kept is None else Recorder(kept, bus)

    @property
    def targets(self) -> Targets:
        """Whom an event is sent to; webhooks hear nothing of what a chattering alarm does."""
        known = self._targets.values()
        return {
            (kind, notify): [t.name for t in known if kind in t.kinds and (notify or t.is_live)]
            for kind in KINDS
            for notify in (True, False)
        }

    def start(self, stop: threading.Event) -> None:
        """Begin, in threads of their own that end soon after `stop`."""
        work = [partial(target.run, self._bus, stop) for target in self._targets.values()]
        if self._recorder is not None:
            work.append(partial(self._recorder.run, stop))
        self._threads = [threading.Thread(target=run, daemon=True) for run in work]
        for thread in self._threads:
            thread.start()

    def join(self, timeout: float = 20.0) -> None:
        """Wait until all have ended, at most so many seconds; what was not delivered stays in the outbox."""
        until = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def status(self) -> dict[str, dict[str, Any]]:
        """Of each target delivered, failed, given_up, pending, lost, last_error; of the recorder its own."""
        told = {name: target.status() for name, target in self._targets.items()}
        return told if self._recorder is None else told | {"recording": self._recorder.status()}


class Metrics(Collector):
    """What `GET /metrics` answers: of axes and sources, alarms that stand, and outputs."""

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
