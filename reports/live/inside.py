"""What the fleet's work costs in this thread, from message to finding, and the pipeline alone."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from statistics import median
from typing import Any

from fdd.diagnosis.pipeline import Pipeline
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import SCHEMA, Decoder, arrow_payload
from fdd.service.bus import Bus
from fdd.service.config import Serve
from fdd.service.fleet import Fleet
from fdd.service.store import Store
from fdd.unit import Unit
from reports.service import resident

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
                    fleet.inbox.put(decoder.decode(payload, "load", axis=f"A{k}", patient=True))
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
