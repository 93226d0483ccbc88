"""More and more axes in real time, until the service lags."""

from __future__ import annotations

import heapq
import json
import os
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from http.client import HTTPConnection, HTTPException
from pathlib import Path

import numpy as np
import paho.mqtt.client as paho

from fdd.samples import Samples
from reports.live.inside import BLOCK_S, ROWS, messages, profile_text
from reports.service import MOSQUITTO, Broker, Process

LAG_S = 1.0
"""s in which 99 % of the looks, and so of the findings, must be told."""
SETTLE_S = 20.0
"""s of a stage before it is measured: new axes are made and make their first look."""
LOOKS_EVERY_S = 5.0
GOLDEN = 0.618034
"""Spreads the axes' starts evenly over the time between two looks."""


@dataclass(frozen=True)
class Stage:
    """What was measured with a number of axes.

    `cpu_us`: µs of processor time a sample, of the whole process. `busy`: share of its core that the service
    had. `lag`, `lag_99`: s from the sending of a look's last sample until the look was told; median and 99 %.
    `findings`: of the leaking axes, that came while it was measured. `finding_lag`: s, the latest of them.
    `dropped`: samples that were sent and are in no diagnosis. `behind`: s of data that were not worked at the
    end, mean of the axes. `late`: s, 99 % of how late the publisher itself was. `rss`: bytes at the end.
    `rss_growth`: bytes a second over the stage's second half.
    """

    axes: int
    cpu_us: float
    busy: float
    lag: float
    lag_99: float
    looks: int
    findings: int
    finding_lag: float
    dropped: int
    behind: float
    late: float
    rss: int
    rss_growth: float

    @property
    def line(self) -> str:
        """What is told of it meanwhile."""
        return (
            f"{self.axes} axes: {self.cpu_us:.1f} µs a sample, {100 * self.busy:.0f} % of a core, "
            f"lag {self.lag:.2f} s, 99 % {self.lag_99:.2f} s, {self.rss / 1e6:.0f} MB"
        )

    @property
    def in_time(self) -> bool:
        """Whether the service kept up."""
        return self.lag_99 <= LAG_S and not self.dropped and self.looks > 0


@dataclass
class _Sender:
    """Publishes each axis's blocks when their last sample is due; remembers when it did."""

    broker: int
    payloads: Sequence[Sequence[bytes]]
    sent: dict[str, list[float]] = field(default_factory=dict)
    late: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._due: list[tuple[float, int]] = []
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        self._client.max_inflight_messages_set(60_000)
        self._client.connect("127.0.0.1", self.broker)
        self._client.loop_start()

    def add(self, axes: int) -> None:
        """Begin with axes up to this number."""
        now = time.time()
        for k in range(len(self.sent), axes):
            self.sent[f"A{k}"] = []
            heapq.heappush(self._due, (now + LOOKS_EVERY_S * (k * GOLDEN % 1.0) + BLOCK_S, k))

    def run(self, seconds: float) -> None:
        """Publish for so long."""
        end = time.time() + seconds
        while self._due and self._due[0][0] < end:
            due, k = heapq.heappop(self._due)
            time.sleep(max(0.0, due - time.time()))
            times, mine = self.sent[f"A{k}"], self.payloads[k % len(self.payloads)]
            times.append(time.time())
            self.late.append(times[-1] - due)
            self._client.publish(f"rig/A{k}/blocks", mine[len(times) - 1], qos=1)
            if len(times) < len(mine):
                heapq.heappush(self._due, (due + BLOCK_S, k))
        time.sleep(max(0.0, end - time.time()))

    def stop(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class _Listener(threading.Thread):
    """Hears the service's events: (kind, axis, time of the stream, Unix seconds)."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.heard: list[tuple[str, str, float, float]] = []
        self._link = HTTPConnection("127.0.0.1", port, timeout=60.0)

    def run(self) -> None:
        self._link.request("GET", "/api/events")
        answer = self._link.getresponse()
        try:
            for line in iter(answer.readline, b""):
                if line.startswith(b'data: {"kind":'):
                    event, now = json.loads(line[6:]), time.time()
                    if event["kind"] in ("status", "finding"):
                        self.heard.append((event["kind"], event["axis"], event["time"], now))
        except (OSError, HTTPException, ValueError):
            return  # the service was ended


def why_not() -> str | None:
    """Why the service cannot be measured here; None where it can."""
    if MOSQUITTO is None:
        return "no mosquitto here, the broker of the measurement: install it (Debian: mosquitto)"
    if not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < 2:
        return "the service needs a core of its own: no two cores, or no Linux"
    return None


def ramp(
    recorded: Sequence[Samples], axes: Sequence[int], seconds: float, told: Callable[[str], None]
) -> list[Stage]:
    """Measure each number of axes, `seconds` each, until one is too many; `told` hears of each."""
    core, *others = sorted(os.sched_getaffinity(0))
    stages: list[Stage] = []
    payloads = [messages(log) for log in recorded]
    with tempfile.TemporaryDirectory(prefix="fdd-load-") as name:
        os.sched_setaffinity(0, others)
        broker = Broker(Path(name))
        served = sender = None
        try:
            source = {
                "type": "mqtt",
                "host": "127.0.0.1",
                "port": broker.port,
                "topics": ["rig/{axis}/blocks"],
            }
            (Path(name) / "unit.yaml").write_text(profile_text(), "utf-8")
            served = Process(Path(name), [source], core, fallback=str(Path(name) / "unit.yaml"))
            served.start()
            sender, listener = _Sender(broker.port, payloads), _Listener(served.port)
            listener.start()
            for n in axes:
                stages.append(_stage(served, sender, listener, n, seconds))
                told(stages[-1].line)
                if not stages[-1].in_time:
                    break
        finally:
            if sender is not None:
                sender.stop()
            if served is not None:
                served.kill()
            broker.stop()
            os.sched_setaffinity(0, {core, *others})
    return stages


def _stage(served: Process, sender: _Sender, listener: _Listener, axes: int, seconds: float) -> Stage:
    sender.add(axes)
    settle = min(SETTLE_S, seconds / 2.0)
    sender.run(settle)
    sender.late.clear()
    half = (seconds - settle) / 2.0
    before, begun, cpu = served.axes(), time.time(), served.cpu_s
    sender.run(half)
    middle = served.resident
    sender.run(half)
    span, cpu = time.time() - begun, served.cpu_s - cpu
    rss, after = served.resident, served.axes()
    worked = sum(a["samples"] for a in after) - sum(a["samples"] for a in before)
    sent = {axis: ROWS * len(times) for axis, times in sender.sent.items()}
    lags: dict[str, list[float]] = {"status": [], "finding": []}
    for kind, axis, at, heard in list(listener.heard):
        last = round(at / BLOCK_S) - 1
        if heard >= begun and last < len(sender.sent[axis]):
            lags[kind].append(heard - sender.sent[axis][last])
    looks = np.array(lags["status"] or [np.nan])
    return Stage(
        axes=axes, cpu_us=1e6 * cpu / max(worked, 1), busy=cpu / span, lag=float(np.median(looks)),
        lag_99=float(np.quantile(looks, 0.99)), looks=len(lags["status"]), findings=len(lags["finding"]),
        finding_lag=max(lags["finding"], default=np.nan),
        dropped=sum(a["quality"]["overrun"] + a["quality"]["dropped"] + a["quality"]["late"] for a in after),
        behind=1e-3 * sum(sent[a["name"]] - a["samples"] for a in after) / max(len(after), 1),
        late=float(np.quantile(sender.late, 0.99)), rss=rss, rss_growth=(rss - middle) / half,
    )  # fmt: skip
