"""Slow wear over an axis's life: found where it is, and not where only days differ."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.answering import Span
from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.hypotheses import hypotheses
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import EPOCHS
from fdd.diagnosis.sequential_detector import SequentialDetector
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S
from fdd.residuals.effects import Effects, usual_conditions
from fdd.residuals.epochs import EPOCH_FRAMES, Epochs
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
MODEL = Model.load()
THRESHOLD = MODEL.tail.threshold(UNIT.monitoring.false_alarms_per_hour * 3600.0)
EFFECTS = effects_of(UNIT)
FAULTS = hypotheses(UNIT, EFFECTS)
SEEN = ("volume", "force")
LEAK = next(h for h in FAULTS if h.fault == "internal_leakage")


def day_of(rng: np.random.Generator, effects: Effects, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What an hour tells: its own draw of what differs from log to log, known to a tenth of that."""
    size = np.sqrt(effects.between_logs(usual_conditions(effects.noise)))
    sharp = 100.0 / size / size[:, None] * (np.eye(size.size) + 0.3)
    true = effects.mean + size * rng.normal(size=size.size) + change
    return sharp, sharp @ true + np.linalg.cholesky(sharp) @ rng.normal(size=size.size)


def life(seed: int, hours: int, severity: float, begins: int, grows: int) -> list[tuple[int, set[str]]]:
    """Hours at which alarms were raised, and of which families."""
    rng, epochs = np.random.default_rng(seed), Epochs()
    detector, raised = SequentialDetector(FAULTS, THRESHOLD, MODEL), []
    for hour in range(hours):
        size = severity * min(max(hour - begins, 0) / grows, 1.0)
        told = {}
        for name in SEEN:
            change = size * LEAK.columns.get(name, np.zeros(len(BALANCES[name].columns)))
            told[name] = day_of(rng, EFFECTS[name], change)
        epochs.add(range(hour * EPOCH_FRAMES, (hour + 1) * EPOCH_FRAMES), told)
        effects = Epochs.effects(EFFECTS)
        evidence = Evidence(epochs.marginalised(effects), effects, from_start=False, stretches=EPOCHS)
        span = Span(epochs.starts().tolist(), (hour + 1) * EPOCH_FRAMES * FRAME_S, "stretches", None)
        fresh, _ = detector.take(detector.evaluate(evidence, span, 0.0), 0.0)
        if fresh:
            raised.append((hour, {f.fault for f in fresh}))
    return raised


@pytest.mark.slow
def test_hours_that_differ_as_healthy_logs_do_raise_nothing() -> None:
    """Ten lives of 120 hours. At one alarm in 1,000 hours one of them is expected; more than four come once
    in 280 times."""
    assert sum(len(life(seed, 120, 0.0, 0, 1)) for seed in range(10)) <= 4


def test_a_leak_that_grows_over_days_is_found() -> None:
    """It grows by 0.5 % of a gross leak an hour; after the first ten hours, and below a third of one."""
    for seed in (1, 2):
        (hour, found), *more = life(seed, 90, 0.3, 10, 60)
        assert found == {"internal_leakage"} and 10 < hour < 70 and not more
