"""The monitor's loop: source to pipeline to events. It prints nothing and waits for nothing itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding
from fdd.diagnosis.pipeline import Pipeline
from fdd.identification.log_scales import StreamScales
from fdd.monitor.clock import Clock
from fdd.monitor.sources import Source

SAVE_EVERY_S = 60.0


@dataclass(frozen=True)
class Found:
    """A fault was detected at `time` (s of the stream)."""

    time: float
    finding: FaultFinding


@dataclass(frozen=True)
class Noted:
    """Something odd about the stream."""

    time: float
    text: str


@dataclass(frozen=True)
class Status:
    """How things stand: families' probabilities and the latest estimates."""

    time: float
    samples: int
    verdict: str
    probabilities: dict[str, float] = field(default_factory=dict)
    estimates: dict[str, Estimate] = field(default_factory=dict)


Event = Found | Noted | Status


def watch(
    source: Source,
    pipeline: Pipeline,
    emit: Callable[[Event], None],
    *,
    clock: Clock,
    stopped: Callable[[], bool] = lambda: False,
    duration: float | None = None,
    status_every: float | None = None,
    save: Callable[[float], None] | None = None,
    scales: StreamScales | None = None,
) -> Diagnosis:
    """Diagnose what a source gives until it ends, or until told to stop.

    Parameters
    ----------
    source : blocks of samples.
    pipeline : made with ``keep_trajectories=False``, else its memory grows for ever.
    emit : takes each event as it happens.
    clock : tells when status and state are due.
    stopped : asked after each block.
    duration : s of the stream after which to end; None goes on.
    status_every : s between `Status` events; None gives none.
    save : called with the last sample's time (s) every minute, and at the end.
    scales : holds the stream against its profile.

    Returns
    -------
    The answer on everything seen.

    Raises
    ------
    InputError : channels that do not suffice, or are in another unit of measure.
    """
    first = last = math.nan
    status_due = saved_at = clock.now()
    for block in source:
        for text in source.remarks():
            emit(Noted(last, text))
        if len(block):
            first = float(block.time[0]) if math.isnan(first) else first
            if duration is not None:
                # A stamp at the end itself still belongs to the span, whatever its last digit.
                block = block.rows(0, int((block.time <= first + duration + 1e-9).sum()))
        if len(block):
            last = float(block.time[-1])
            for text in scales.push(block) if scales is not None else ():
                emit(Noted(last, text))
            for finding in pipeline.push(block):
                emit(Found(finding.detected_s, finding))
        now = clock.now()
        if status_every is not None and now >= status_due and not math.isnan(last):
            status_due = now + status_every
            told = pipeline.finish()
            emit(Status(last, told.samples, told.verdict, told.probabilities, told.estimates))
        if save is not None and now - saved_at >= SAVE_EVERY_S and not math.isnan(last):
            saved_at = now
            save(last)
        over = duration is not None and last - first >= duration - 1e-9
        if over or stopped():
            break
    for text in source.remarks():
        emit(Noted(last, text))
    if save is not None and not math.isnan(last):
        save(last)
    return pipeline.finish(source.quality())
