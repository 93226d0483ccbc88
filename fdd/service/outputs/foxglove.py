"""Axes live in Foxglove: its WebSocket server, with the topics and types of an annotated MCAP."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.mcap_chunks import described
from fdd.logs.mcap_writing import (
    INFO,
    LOG_SCHEMA,
    diagnosis_columns,
    estimate_columns,
    events_of,
    log_message,
)
from fdd.logs.protobuf_rows import layout
from fdd.samples import Samples
from fdd.service.bus import Bus, Event
from fdd.service.config import FoxgloveOutput
from fdd.service.outputs.recorder import begins, plain, trajectories, wall_offset

BAND_S = 0.05
"""Of which each signal's least and largest are told, as two rows."""
MOST_WAITING = 4000
"""Events that wait; then the oldest are lost and counted."""
LOOK_S = 0.1


@dataclass
class _Topic:
    """A channel that was advertised, and how its messages are laid out."""

    channel: Any
    message: bytes
    places: np.dtype[np.void]


class Foxglove:
    """Serve all axes to whoever connects, in a thread of its own; what nobody asks for costs next to nothing.

    Parameters
    ----------
    config : where it listens, at once. bus : of samples, alarms and statuses.

    Attributes
    ----------
    port : that it listens on.

    Raises
    ------
    InputError : the package is missing, or the port is taken.
    """

    def __init__(self, config: FoxgloveOutput, bus: Bus) -> None:
        where = "outputs: foxglove"
        try:
            import foxglove
        except ImportError:
            raise InputError(
                "needs the package foxglove-sdk", where=where, mend="install fdd[foxglove]"
            ) from None
        self._sdk, self._context = foxglove, foxglove.Context()
        address = {"host": config.host, "port": config.port}
        try:
            self._server = foxglove.start_server(name="fdd", context=self._context, **address)
        except RuntimeError as error:
            why = str(error).removeprefix("FoxgloveError: ")
            raise InputError(
                f"cannot listen ({why})", where=where, mend="name a host and a free port"
            ) from None
        self.port: int = self._server.port
        self._topics: dict[str, _Topic] = {}
        self._offsets: dict[str, tuple[float, float]] = {}
        self._live = bus.subscribe(["samples", "status", "alarm"], MOST_WAITING)
        self.last_error = ""

    def status(self) -> dict[str, Any]:
        """Blocks lost, the last error."""
        return {"lost_blocks": self._live.lost, "last_error": self.last_error}

    def run(self, stop: threading.Event) -> None:
        """Tell what comes until `stop`."""
        while not stop.is_set():
            try:
                if event := self._live.get(LOOK_S):
                    self._tell(event)
            except Exception as error:  # one axis's trouble must not end it for all others
                self.last_error = f"{type(error).__name__}: {error}"
        self._live.close()
        self._server.stop()

    def _tell(self, event: Event) -> None:
        axis = event.axis
        if event.kind == "samples":
            samples = event.data["samples"]
            first, last = float(samples.time[0]), float(samples.time[-1])
            offset, before = self._offsets.get(axis, (0.0, np.inf))
            # A clock that was set back is another stream.
            self._offsets[axis] = (wall_offset(last) if first <= before else offset, last)
            self._events(axis)  # before there are any: who is connected must have it when the first comes
            self._add(axis, "measurement", thinned(samples))
        elif axis not in self._offsets:
            return
        elif event.kind == "status":
            told = trajectories([{**event.data, "time": event.time}], 0.0)
            self._add(axis, "estimate", estimate_columns(told))
            self._add(axis, "diagnosis", diagnosis_columns(told))
        else:
            alarm = event.data["alarm"]
            line = f"alarm {alarm['id']}, {alarm['fault']}: {event.data['action'].lower()}"
            said = events_of(alarm["body"]) if begins(event.data) else [(event.time, INFO, line)]
            for when, level, text in said:
                stamp = self._stamp(axis, when)
                self._events(axis).log(log_message(stamp, level, text, axis), log_time=stamp)

    def _stamp(self, axis: str, when: float) -> int:
        """Unix ns; not before 1970."""
        return max(0, round((when + self._offsets[axis][0]) * 1e9))

    def _events(self, axis: str) -> Any:
        name = f"/eha/{plain(axis)}/events"
        if name not in self._topics:
            channel = self._sdk.Channel(name, schema=LOG_SCHEMA, context=self._context)
            self._topics[name] = _Topic(channel, b"", np.dtype([]))
        return self._topics[name].channel

    def _add(self, axis: str, kind: str, columns: Mapping[str, Any]) -> None:
        """Send rows of a topic to whoever subscribed it."""
        name = f"/eha/{plain(axis)}/{kind}"
        topic = self._topics.get(name)
        if topic is None or set(topic.places.names or ()) != set(columns):
            topic = self._topics[name] = self._advertised(name, topic, columns)
        if not topic.channel.has_sinks():
            return
        size, times = len(topic.message), np.asarray(columns["time"]).tolist()
        body = bytearray(topic.message) * len(times)
        rows = np.frombuffer(body, topic.places)
        for field, column in columns.items():
            rows[field] = np.where(np.isinf(column), np.nan, column)
        for k, when in enumerate(times):
            topic.channel.log(bytes(body[k * size : (k + 1) * size]), log_time=self._stamp(axis, when))

    def _advertised(self, name: str, before: _Topic | None, columns: Mapping[str, Any]) -> _Topic:
        if before is not None:  # other channels than it had
            before.channel.close()
        title, about = described(name, columns)
        schema, message, places = layout(title, dict.fromkeys(columns, False))
        kind = self._sdk.Schema(name=title, encoding="protobuf", data=schema)
        channel = self._sdk.Channel(
            name, message_encoding="protobuf", schema=kind, context=self._context, metadata=about
        )
        return _Topic(channel, message, places)


def thinned(samples: Samples, band: float = BAND_S) -> dict[str, NDArray[np.float64]]:
    """Columns with each stretch's least and largest as two rows: as few as a plot needs, no peak lost.

    Examples
    --------
    >>> made = thinned(Samples(np.arange(100) / 1000, {"position": np.arange(100.0)}))
    >>> made["time"].round(3).tolist(), made["position"].tolist()
    ([0.0, 0.025, 0.05, 0.075], [0.0, 49.0, 50.0, 99.0])
    """
    place = np.floor(samples.time / band)
    starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
    if 2 * starts.size >= len(samples):
        return {"time": samples.time, **samples.columns}
    columns = {"time": np.stack([samples.time[starts], samples.time[starts] + band / 2], axis=1).ravel()}
    for name, values in samples.columns.items():
        low, high = (best.reduceat(values, starts) for best in (np.fmin, np.fmax))
        columns[name] = np.stack([low, high], axis=1).ravel()
    return columns
