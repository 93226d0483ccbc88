"""What watching costs, and how many axes one core carries in real time; harder cases; twice as many."""

from __future__ import annotations

import heapq
import json
import math
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPException
from importlib import resources
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import paho.mqtt.client as paho

from fdd.diagnosis.pipeline import Pipeline
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import SCHEMA, Decoder, arrow_payload
from fdd.service.config import Serve
from fdd.service.fleet import Fleet
from fdd.service.queues import Bus
from fdd.service.store import Store
from fdd.unit import Unit
from reports.service import MOSQUITTO, Process, broker, opened, resident, until

ROWS = 100
"""Of a block: 100 ms at 1 kHz."""
BLOCK_S = 0.1
DUTIES: tuple[dict[str, Any], ...] = (
    {"duty": {"name": "flight"}},
    {"duty": {"name": "flight"}, "faults": [{"fault": "internal_leakage", "severity": 0.6, "onset": 30.0}]},
    {"duty": {"name": "sines"}, "load": {"name": "spring"}},
    {"duty": {"name": "steps"}, "load": {"name": "constant"}},
)
LEAKING = 1
"""Of `DUTIES`."""
TOGETHER = 500
"""Samples that the service gives the pipeline at once."""


def profile_text() -> str:
    """The profile (YAML) of the demo's actuator, with its baseline."""
    return (resources.files("fdd") / "demo" / "unit.yaml").read_text("utf-8")


def logs(seconds: float) -> list[Samples]:
    """The eleven channels of the demo's rig, 1 kHz, of each of `DUTIES`; one leaks from 30 s on."""
    unit = Unit.from_yaml(profile_text(), where="demo")
    whole = {"duration": seconds, "recording": Recording.perfect()}
    scenarios = (Scenario(**{**whole, **duty, "seed": 4 + k}) for k, duty in enumerate(DUTIES))
    return [simulate(unit, scenario).samples for scenario in scenarios]


def messages(log: Samples) -> list[bytes]:
    """Arrow messages of 100 ms; the topic names the axis, so that they serve any number of axes."""
    return [
        arrow_payload({"time": part.time, **part.columns}, {"schema": SCHEMA, "sequence": number})
        for number, part in enumerate(log.blocks(ROWS)) if len(part) == ROWS
    ]  # fmt: skip


@dataclass(frozen=True)
class Inside:
    """Processor time of one thread, µs a sample: message to finding, and the pipeline alone.

    `axis_bytes`: memory that an axis takes after `aged_s` s of data.
    """

    axes: int
    seconds: float
    whole: float
    alone: float
    axis_bytes: float = float("nan")
    aged_s: float = 0.0


def inside(recorded: Sequence[Samples], axes: int, seconds: float, repeats: int, aged_s: float) -> Inside:
    """Measure in this thread; what is loaded and compiled late is so before.

    The logs are dealt to the axes, `seconds` of each; memory is measured after `aged_s` s, or not at 0.
    """
    parts = [log.rows(0, round(1000.0 * max(seconds, aged_s))) for log in recorded]
    payloads, decoder = [messages(part) for part in parts], Decoder()
    blocks, costs, alone, grown = round(seconds / BLOCK_S), [], [], float("nan")
    with tempfile.TemporaryDirectory(prefix="fdd-load-") as name:
        profile = Path(name) / "unit.yaml"
        profile.write_text(profile_text(), "utf-8")
        config = Serve.from_yaml(
            f"schema: fdd.serve/1\nfallback: {profile}\nsources: [{{type: udp, port: 0}}]"
        )

        def worked(store: str, axes: int, blocks: int) -> tuple[Fleet, float]:
            """A new fleet that has worked so many blocks of all axes, and the s of processor time it took."""
            fleet = Fleet(config, Store(f"sqlite:///{name}/{store}.db"), Bus())
            fleet.resume()
            begun = time.thread_time()
            for number in range(blocks):
                for k in range(axes):
                    payload = payloads[k % len(payloads)][number]
                    fleet.inbox.put(decoder.decode(payload, axis=f"A{k}", patient=True))
                while fleet.step(0.0):
                    pass
            return fleet, time.thread_time() - begun

        worked("first", 1, min(blocks, 150))
        for k in range(repeats):  # in turn: other work on the machine slows both alike
            costs.append(worked(f"{k}", axes, blocks)[1])
            alone.append(sum(_alone(part.rows(0, blocks * ROWS)) for part in parts) / len(parts))
        if aged_s > 0.0:
            before = resident()
            kept, _ = worked("aged", axes, round(aged_s / BLOCK_S))
            grown = (resident() - before) / len(kept.axes())
    us = 1e6 / (blocks * ROWS)
    return Inside(axes, seconds, us * median(costs) / axes, us * median(alone), grown, aged_s)


def _alone(log: Samples) -> float:
    """s of processor time that the pipeline takes by itself."""
    pipeline = Pipeline(Unit.from_yaml(profile_text(), where="demo"), keep_trajectories=False)
    begun = time.thread_time()
    for part in log.blocks(TOGETHER):
        pipeline.push(part)
        pipeline.now()
    return time.thread_time() - begun


LAG_S = 1.0
"""s in which 99 % of the looks, and so of the findings, must be told."""
SETTLE_S = 20.0
"""s of a stage before it is measured: new axes are made and make their first look."""
LOOKS_EVERY_S = 5.0
GOLDEN = 0.618034
"""Spreads the axes' starts evenly over the time between two looks."""
CAUGHT_UP_S = 600.0
"""s that the service has to work what was put off."""


@dataclass(frozen=True)
class Stage:
    """What was measured with a number of axes.

    `cpu_us`: µs a sample, of the whole process. `busy`: share of its core. `lag`, `lag_99`: s from the
    sending of a look's last sample until the look was told. `finding_lag`: s, the latest. `dropped`: samples
    in no diagnosis. `behind`: s of data not worked at the end. `late`: s, of the publisher, 99 %. `rss`: B.
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


def why_not() -> str | None:
    """Why the service cannot be measured here; None where it can."""
    if MOSQUITTO is None:
        return "no mosquitto here, the broker of the measurement: install it (Debian: mosquitto)"
    if not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < 2:
        return "the service needs a core of its own: no two cores, or no Linux"
    return None


@contextmanager
def served_by_broker(
    profile: str | None = None, core: int | None = None, *, cold: bool = False
) -> Iterator[tuple[Process, int]]:
    """A service that has started, pinned to a core or not, and the port of its broker.

    `profile`: YAML, the demo's where none is given. `cold`: its compiled code is not in the cache.
    """
    with tempfile.TemporaryDirectory(prefix="fdd-load-") as name, broker(Path(name)) as port:
        (Path(name) / "unit.yaml").write_text(profile or profile_text(), "utf-8")
        source = {"type": "mqtt", "host": "127.0.0.1", "port": port, "topics": ["rig/{axis}/blocks"]}
        served = Process(Path(name), [source], core, fallback=str(Path(name) / "unit.yaml"))
        if cold:
            served.environ["NUMBA_CACHE_DIR"] = str(Path(name) / "cache")
        try:
            served.start()
            yield served, port
        finally:
            served.kill()


class _Watched:
    """A service on a core of its own, to which blocks are sent when their last sample is due, and its events.

    `sent`: by axis, Unix s of its blocks. `heard`: kind, axis, time of the stream and Unix s of each event.
    """

    def __init__(self, served: Process, port: int, recorded: Sequence[Samples], spread_s: float) -> None:
        self.served, self.spread_s, self._due = served, spread_s, list[tuple[float, int]]()
        self.sent, self.late = dict[str, list[float]](), list[float]()
        self.heard: list[tuple[str, str, float, float]] = []
        self._payloads = [messages(log) for log in recorded]
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        self._client.max_inflight_messages_set(60_000)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        events = f"http://127.0.0.1:{self.served.port}/api/events"
        with suppress(OSError, HTTPException, ValueError), opened(events, timeout=60.0) as lines:
            for line in lines:  # until the service is ended
                if line.startswith(b'data: {"kind":'):
                    event, now = json.loads(line[6:]), time.time()
                    if event["kind"] in ("status", "finding"):
                        self.heard.append((event["kind"], event["axis"], event["time"], now))

    def add(self, axes: int) -> None:
        """Begin with axes up to this number."""
        now = time.time()
        for k in range(len(self.sent), axes):
            self.sent[f"A{k}"] = []
            heapq.heappush(self._due, (now + self.spread_s * (k * GOLDEN % 1.0) + BLOCK_S, k))

    def run(self, seconds: float) -> None:
        """Publish for so long."""
        end = time.time() + seconds
        while self._due and self._due[0][0] < end:
            due, k = heapq.heappop(self._due)
            time.sleep(max(0.0, due - time.time()))
            times, mine = self.sent[f"A{k}"], self._payloads[k % len(self._payloads)]
            times.append(time.time())
            self.late.append(times[-1] - due)
            self._client.publish(f"rig/A{k}/blocks", mine[len(times) - 1], qos=1)
            if len(times) < len(mine):
                heapq.heappush(self._due, (due + BLOCK_S, k))
        time.sleep(max(0.0, end - time.time()))

    def stop(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def worked(self) -> int:
        """Samples in all diagnoses."""
        return sum(axis["samples"] for axis in self.served.axes())

    def lags(self, kind: str, begun: float) -> dict[str, list[float]]:
        """By axis, s from the sending of each look's last sample until it was heard, since `begun`."""
        lags: dict[str, list[float]] = {}
        for what, axis, at, heard in list(self.heard):
            last = round(at / BLOCK_S) - 1
            if what == kind and heard >= begun and last < len(self.sent[axis]):
                lags.setdefault(axis, []).append(heard - self.sent[axis][last])
        return lags

    def stage(self, axes: int, seconds: float) -> Stage:
        """Send of so many axes, and measure once they have settled."""
        self.add(axes)
        settle = min(SETTLE_S, seconds / 2.0)
        self.run(settle)
        self.late.clear()
        before, begun, cpu = self.worked(), time.time(), self.served.cpu_s
        self.run(seconds - settle)
        span, cpu, after = time.time() - begun, self.served.cpu_s - cpu, self.served.axes()
        worked = sum(a["samples"] for a in after) - before
        lags, findings = (
            [lag for of in self.lags(kind, begun).values() for lag in of] for kind in ("status", "finding")
        )
        looks = np.array(lags or [np.nan])
        return Stage(
            axes=axes, cpu_us=1e6 * cpu / max(worked, 1), busy=cpu / span, lag=float(np.median(looks)),
            lag_99=float(np.quantile(looks, 0.99)), looks=len(lags), findings=len(findings),
            finding_lag=max(findings, default=np.nan),
            dropped=sum(a["quality"][why] for a in after for why in ("overrun", "dropped", "late")),
            behind=sum(BLOCK_S * len(self.sent[a["name"]]) - 1e-3 * a["samples"] for a in after)
            / max(len(after), 1),
            late=float(np.quantile(self.late, 0.99)), rss=self.served.resident,
        )  # fmt: skip


@contextmanager
def _watched(recorded: Sequence[Samples], spread_s: float = LOOKS_EVERY_S, **how: Any) -> Iterator[_Watched]:
    """The service has one core, what sends to it and hears it the others; axes begin within `spread_s`."""
    core, *others = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, others)
    try:
        with served_by_broker(core=core, **how) as (served, port):
            watched = _Watched(served, port, recorded, spread_s)
            try:
                yield watched
            finally:
                watched.stop()
    finally:
        os.sched_setaffinity(0, {core, *others})


def ramp(
    recorded: Sequence[Samples], axes: Sequence[int], seconds: float, told: Callable[[str], None]
) -> list[Stage]:
    """Measure each number of axes, `seconds` each, until one is too many; `told` hears of each."""
    stages: list[Stage] = []
    with _watched(recorded) as watched:
        for n in axes:
            stages.append(watched.stage(n, seconds))
            told(stages[-1].line)
            if not stages[-1].in_time:
                break
    return stages


def harder(
    recorded: Sequence[Samples], axes: int, seconds: float, told: Callable[[str], None]
) -> dict[str, Stage]:
    """The same number of axes where each costs more; `told` hears of each."""
    plain = Unit.from_yaml(profile_text(), where="demo").model_copy(update={"baseline": None}).to_yaml()
    cases: dict[str, tuple[Sequence[Samples], dict[str, Any]]] = {
        "every axis leaks": ([recorded[LEAKING]], {}),
        "all axes begin at once": (recorded, {"spread_s": 0.0}),
        "no axis has a baseline": (recorded, {"profile": plain}),
        "nothing is compiled yet": (recorded, {"cold": True}),
    }
    found = {}
    for name, (logs, how) in cases.items():
        with _watched(logs, **how) as watched:
            found[name] = watched.stage(axes, seconds)
        told(f"{name}: {found[name].line}")
    return found


@dataclass(frozen=True)
class Overload:
    """More axes than the service can watch.

    `followed`: axes that gave all their looks in the second half, `lag`: s, median of these. `rss`: bytes,
    the most seen. `worked`: samples, when all was caught up or time was over, `caught_up_s` after the end.
    """

    axes: int
    seconds: float
    followed: int
    lag: float
    told: str
    rss: int
    sent: int
    worked: int
    caught_up_s: float


def overload(recorded: Sequence[Samples], axes: int, seconds: float) -> Overload:
    """Send of so many axes, and then let it catch up."""
    with _watched(recorded) as watched:
        served = watched.served
        watched.add(axes)
        watched.run(seconds / 2.0)
        begun, rss, middle = time.time(), served.resident, served.problems()
        watched.run(seconds / 2.0)
        rss, told, ended = max(rss, served.resident), served.problems() or middle, time.time()
        least = int((ended - begun) / LOOKS_EVERY_S) - 1
        whole = [lags for lags in watched.lags("status", begun).values() if len(lags) >= least]
        lag = float(np.median(np.concatenate(whole))) if whole else math.nan
        sent = sum(ROWS * len(times) for times in watched.sent.values())
        # The last half second of an axis waits for a frame's end, and then for silence.
        until(lambda: watched.worked() >= sent, CAUGHT_UP_S)
        worked, took, rss = watched.worked(), time.time() - ended, max(rss, served.resident)
    return Overload(axes, seconds, len(whole), lag, "; ".join(told), rss, sent, worked, took)
