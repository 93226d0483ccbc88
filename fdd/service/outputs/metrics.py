"""Metrics for Prometheus, read from the fleet when they are asked for: between scrapes they cost nothing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, get_args

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from fdd import __version__
from fdd.faults import FAMILIES
from fdd.service.status import AxisState, AxisStatus

MOST_AXES = 1000
"""With metrics of their own; a label's every value is a series that Prometheus keeps."""
UNITS = {
    "leakage": "cubic_meters_per_pascal_second",
    "bulk_modulus": "pascals",
    "coulomb_friction": "newtons",
    "viscous_friction": "newton_seconds_per_meter",
}
"""Estimated quantities and their units, as names of metrics spell them."""

Statuses = Mapping[str, Mapping[str, Any]]
_Family = type[GaugeMetricFamily] | type[CounterMetricFamily]
_SOURCES: dict[str, tuple[_Family, str, str]] = {
    "connected": (GaugeMetricFamily, "fdd_source_connected", "1 while a source can be read."),
    "received": (CounterMetricFamily, "fdd_source_blocks", "Blocks taken."),
    "refused": (CounterMetricFamily, "fdd_source_refused", "Messages that cannot be used."),
    "reconnects": (CounterMetricFamily, "fdd_source_reconnects", "Connections made anew."),
}
_OUTPUTS: dict[str, tuple[_Family, str, str]] = {
    "delivered": (CounterMetricFamily, "fdd_output_delivered", "Messages delivered."),
    "failed": (CounterMetricFamily, "fdd_output_failures", "Attempts that failed."),
    "given_up": (CounterMetricFamily, "fdd_output_given_up", "Messages given up."),
    "lost": (CounterMetricFamily, "fdd_output_lost_events", "Live events lost."),
    "pending": (GaugeMetricFamily, "fdd_output_pending", "Messages that wait."),
    "files": (CounterMetricFamily, "fdd_output_recordings", "Recordings written."),
    "lost_blocks": (CounterMetricFamily, "fdd_output_lost_blocks", "Blocks the recorder lost."),
}


class Metrics(Collector):
    """What `GET /metrics` answers.

    Parameters
    ----------
    axes : the fleet's `axes`. alarms : gives the alarms that stand.
    outputs : `Outputs.status`. sources : the fleet's. store_errors : how often the store failed so far.
    """

    def __init__(
        self,
        axes: Callable[[], Sequence[AxisStatus]],
        alarms: Callable[[], Sequence[Mapping[str, Any]]],
        outputs: Callable[[], Statuses],
        sources: Callable[[], Statuses],
        store_errors: Callable[[], float],
    ) -> None:
        self._axes, self._alarms = axes, alarms
        self._outputs, self._sources, self._store_errors = outputs, sources, store_errors
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
        axes = sorted(self._axes(), key=lambda axis: axis.name)
        yield GaugeMetricFamily("fdd_axes", "Axes that are watched.", len(axes))
        omitted = max(0, len(axes) - MOST_AXES)
        yield GaugeMetricFamily("fdd_axes_omitted", "Axes beyond the bound, without metrics.", omitted)
        build = GaugeMetricFamily("fdd_build_info", "Version of fdd.", labels=["version"])
        build.add_metric([__version__], 1)
        yield build
        yield CounterMetricFamily("fdd_store_errors", "Failures of the store.", self._store_errors())
        yield from _of_axes(axes[:MOST_AXES])
        # A store in trouble must not take the other metrics away, nor tell of no alarms.
        with suppress(Exception):
            yield _alarms(self._alarms(), {axis.name for axis in axes[:MOST_AXES]})
        yield from _counted(self._sources(), "source", _SOURCES)
        yield from _counted(self._outputs(), "target", _OUTPUTS)


_AXES: tuple[tuple[_Family, str, str, Callable[[AxisStatus], float | None]], ...] = (
    (GaugeMetricFamily, "fdd_axis_up", "1 while an axis sends and is diagnosed.",
     lambda axis: not axis.silent and axis.state not in ("silent", "failed")),
    (CounterMetricFamily, "fdd_samples", "Samples taken.", lambda axis: axis.samples),
    (CounterMetricFamily, "fdd_dropped_samples", "Samples lost on the way.",
     lambda axis: sum(axis.quality.get(name, 0) for name in ("dropped", "overrun", "late", "refused"))),
    (GaugeMetricFamily, "fdd_block_lag_seconds", "How far the diagnosis is behind.", lambda axis: axis.lag_s),
    (GaugeMetricFamily, "fdd_sample_rate_hertz", "Samples a second.", lambda axis: axis.rate_hz),
    (GaugeMetricFamily, "fdd_last_sample_timestamp_seconds", "Unix time of the last sample.",
     lambda axis: axis.last_wall),
)  # fmt: skip


def _of_axes(axes: Sequence[AxisStatus]) -> Iterable[Metric]:
    for family, name, help, of in _AXES:
        yield _filled(family(name, help, labels=["axis"]), (((axis.name,), of(axis)) for axis in axes))
    states = GaugeMetricFamily("fdd_axis_state", "1 for the state an axis is in.", labels=["axis", "state"])
    is_in = lambda a, s: a.state == s or (s == "silent" and a.silent)  # noqa: E731
    yield _filled(states, (((a.name, s), is_in(a, s)) for a in axes for s in get_args(AxisState)))
    chances = GaugeMetricFamily(
        "fdd_fault_probability", "Probability of a family of faults.", labels=["axis", "family"]
    )
    yield _filled(chances, (((a.name, f), a.probabilities.get(f)) for a in axes for f in FAMILIES))
    known = [(a.name, q, a.estimates[q]) for a in axes for q in UNITS if q in a.estimates]
    for quantity, unit in UNITS.items():
        title = quantity.replace("_", " ").capitalize()
        mine = [(name, estimate) for name, q, estimate in known if q == quantity]
        value = GaugeMetricFamily(f"fdd_{quantity}_{unit}", f"{title}.", labels=["axis"])
        yield _filled(value, (((name,), estimate.value) for name, estimate in mine))
        std = GaugeMetricFamily(
            f"fdd_{quantity}_stddev_{unit}", f"{title}, standard deviation.", labels=["axis"]
        )
        yield _filled(std, (((name,), estimate.std) for name, estimate in mine))
    observable = GaugeMetricFamily(
        "fdd_estimate_observable", "1 while a quantity can be estimated.", labels=["axis", "quantity"]
    )
    yield _filled(observable, (((name, q), estimate.observable) for name, q, estimate in known))


def _filled(
    metric: GaugeMetricFamily | CounterMetricFamily, rows: Iterable[tuple[tuple[str, ...], float | None]]
) -> Metric:
    for labels, value in rows:
        if value is not None and math.isfinite(value):
            metric.add_metric(labels, value)
    return metric


def _alarms(alarms: Sequence[Mapping[str, Any]], axes: set[str]) -> Metric:
    labels = ("axis", "family", "state", "priority")
    counts = Counter(tuple(alarm[label] for label in labels) for alarm in alarms if alarm["axis"] in axes)
    metric = GaugeMetricFamily("fdd_alarms", "Alarms that stand.", labels=labels)
    return _filled(metric, counts.items())


def _counted(
    statuses: Statuses, label: str, metrics: Mapping[str, tuple[_Family, str, str]]
) -> Iterable[Metric]:
    """One metric for each key of the statuses, by the name of what has it."""
    for key, (family, name, help) in metrics.items():
        metric = family(name, help, labels=[label])
        for what, status in statuses.items():
            if key in status:
                metric.add_metric([what], status[key])
        yield metric
