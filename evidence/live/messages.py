"""Simulated logs as messages, encoded before anything is measured."""

from __future__ import annotations

from importlib import resources
from typing import Any

from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.arrow import arrow_payload
from fdd.service.blocks import SCHEMA
from fdd.unit import Unit

ROWS = 100
"""Of a block: 100 ms at 1 kHz."""
BLOCK_S = 0.1
LEAK = {"fault": "internal_leakage", "severity": 0.6, "onset": 30.0}
DUTIES: tuple[dict[str, Any], ...] = (
    {"duty": {"name": "flight"}},
    {"duty": {"name": "flight"}, "faults": [LEAK]},
    {"duty": {"name": "sines"}, "load": {"name": "spring"}},
    {"duty": {"name": "steps"}, "load": {"name": "constant"}},
)


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
    parts = (log.rows(start, start + ROWS) for start in range(0, len(log) - ROWS + 1, ROWS))
    return [
        arrow_payload({"time": part.time, **part.columns}, {"schema": SCHEMA, "sequence": number})
        for number, part in enumerate(parts)
    ]
