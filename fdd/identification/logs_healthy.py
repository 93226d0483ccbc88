"""Was a unit healthy in the logs that its profile is made of: the pipeline's own word on each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import fault
from fdd.identification.logs_agree import disagreement
from fdd.samples import Samples
from fdd.unit import Unit

FALSE_ALARM = 0.01
"""Share of healthy sets of logs that are refused by chance."""


SHORTEST_PART = 10.0
"""s of a log on either side of an onset that can be identified by themselves."""


@dataclass(frozen=True)
class Suspicion:
    """What the pipeline finds wrong in a log, in words.

    Attributes
    ----------
    sure : a sensor failed, or the log's parts before and after disagree when each is identified alone. What
        the balances alone say of another maker's unit is no more than a doubt.
    """

    text: str
    sure: bool


def unhealthy(unit: Unit, logs: Sequence[Samples], labels: Sequence[str]) -> list[Suspicion]:
    """What the pipeline finds wrong in the logs; nothing where it finds them healthy.

    A fault that comes within a log, or a sensor's, shows even though the log is part of the profile.

    Parameters
    ----------
    unit : profile with the baseline of all logs. logs, labels : with what to call them.
    """
    strict = unit.model_copy(deep=True)
    hours = sum(log.duration for log in logs) / 3600.0
    # Where the alarm rate of the exponential tail gives 0.01 alarms in all of these hours.
    strict.monitoring.false_alarms_per_hour = FALSE_ALARM / max(hours, 1e-3) / 3600.0
    out: list[Suspicion] = []
    for log, label in zip(logs, labels, strict=True):
        pipeline = Pipeline(strict, keep_trajectories=False)
        pipeline.push(log)
        answer = pipeline.finish()
        if answer.verdict == "faulty":
            first = answer.faults[0]
            name = fault(first.fault).title.lower()
            channel = f" of {first.channel}" if first.channel else ""
            text = f"{label} does not look healthy: {name}{channel} since {first.onset_s:.1f} s"
            failed = first.fault in ("sensor_dropout", "position_sensor_slip")
            out.append(Suspicion(text, failed or _changes(unit, log, label, first.onset_s)))
    return out


def _changes(unit: Unit, log: Samples, label: str, onset: float) -> bool:
    """Whether what is identified before and after a time disagrees."""
    cut = int(np.searchsorted(log.time, onset))
    parts = [log.rows(0, cut), log.rows(cut, len(log))]
    if min(part.duration for part in parts) < SHORTEST_PART:
        return False
    compared = disagreement(unit, parts, [f"{label} before", f"{label} after"])
    return any(c.refused for c in compared)
