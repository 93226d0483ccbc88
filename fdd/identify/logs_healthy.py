"""Was a unit healthy in the logs that its profile is made of: the pipeline's own word on each."""

from __future__ import annotations

from collections.abc import Sequence

from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import fault
from fdd.samples import Samples
from fdd.unit import Unit

FALSE_ALARM = 0.01
"""Share of healthy sets of logs that are refused by chance."""


def unhealthy(unit: Unit, logs: Sequence[Samples], labels: Sequence[str]) -> list[str]:
    """What the pipeline finds wrong in the logs, in words; nothing where it finds them healthy.

    A fault that comes within a log, or a sensor's, shows even though the log is part of the profile.

    Parameters
    ----------
    unit : profile with the baseline of all logs. logs, labels : with what to call them.
    """
    strict = unit.model_copy(deep=True)
    hours = sum(log.duration for log in logs) / 3600.0
    # Where the alarm rate of the exponential tail gives 0.01 alarms in all of these hours.
    strict.monitoring.false_alarms_per_hour = FALSE_ALARM / max(hours, 1e-3) / 3600.0
    out = []
    for log, label in zip(logs, labels, strict=True):
        pipeline = Pipeline(strict, keep_trajectories=False)
        pipeline.push(log)
        answer = pipeline.finish()
        if answer.verdict == "faulty":
            first = answer.faults[0]
            name = fault(first.fault).title.lower()
            channel = f" of {first.channel}" if first.channel else ""
            out.append(f"{label} does not look healthy: {name}{channel} since {first.onset_s:.1f} s")
    return out
