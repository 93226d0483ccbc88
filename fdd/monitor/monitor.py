"""The monitor's loop, from a source through the pipeline to events."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding
from fdd.diagnosis.pipeline import Pipeline
from fdd.identification.log_scales import StreamScales
from fdd.monitor.sources import JsonLines, Replay, WallClock


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
    source: JsonLines | Replay,
    pipeline: Pipeline,
    emit: Callable[[Event], None],
    *,
    clock: WallClock,
    stopped: Callable[[], bool] = lambda: False,
    duration: float | None = None,
    status_every: float | None = None,
    scales: StreamScales | None = None,
) -> Diagnosis:
    """Diagnose what a source gives until it ends, or until told to stop; the answer on everything seen.

    Parameters
    ----------
    source : blocks of samples.
    pipeline : made with ``keep_trajectories=False``, else its memory grows for ever.
    emit : takes each event as it happens.
    clock : tells when a status is due.
    stopped : asked after each block.
    duration : s of the stream after which to end; None goes on.
    status_every : s between `Status` events; None gives none.
    scales : holds the stream against its profile.

    Raises InputError: channels that do not suffice, or are in another unit of measure.
    """
    first = last = math.nan
    status_due = clock.now()
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
        if status_every is not None and (now := clock.now()) >= status_due and not math.isnan(last):
            status_due = now + status_every
            told = pipeline.finish()
            emit(Status(last, told.samples, told.verdict, told.probabilities, told.estimates))
        if stopped() or (duration is not None and last - first >= duration - 1e-9):
            break
    for text in source.remarks():
        emit(Noted(last, text))
    return pipeline.finish(source.quality())
