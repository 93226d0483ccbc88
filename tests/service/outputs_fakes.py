"""Made-up transitions, and an outbox, for the tests of the outputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fdd.samples import Samples
from fdd.service.bus import Event
from fdd.service.store import OutboxMessage, Store


def message(kind: str, body: dict[str, Any], target: str = "t", id: int = 7) -> OutboxMessage:
    return OutboxMessage(id, kind, body, target, 0)


def sent(store: Store, kind: str, body: Mapping[str, Any], target: str) -> int:
    with store.transaction() as t:
        return t.send(kind, body, target, 1.7e9)


def measured(axis: str, samples: Samples) -> Event:
    return Event("samples", axis, float(samples.time[-1]), {"samples": samples})


def finding(onset: float = 3.0, detected: float = 15.0) -> dict[str, Any]:
    return {
        "fault": "pump_wear", "family": "leakage", "ambiguity": ["pump_wear", "internal_leakage"],
        "confidence": 0.9, "onset_s": onset, "detected_s": detected, "severity": 0.6,
        "evidence": ["leakage rose"],
    }  # fmt: skip


def transition(
    action: str = "RAISED", state: str = "UNACK", id: int = 1, axis: str = "A1", **of_finding: float
) -> dict[str, Any]:
    alarm = {
        "id": id, "axis": axis, "state": state, "family": "leakage", "fault": "pump_wear", "priority": "high",
        "body": finding(**of_finding),
    }  # fmt: skip
    return {"action": action, "alarm": alarm, "before": "NORMAL", "wall": 1.7e9, "who": "fdd", "note": ""}
