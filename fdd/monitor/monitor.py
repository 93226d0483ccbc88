"""The monitor's loop, from a source through the pipeline to events, and its state on disk."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fdd.bounds import MAX_STATE_BYTES
from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.identification.log_scales import StreamScales
from fdd.monitor.sources import JsonLines, Replay, WallClock

SAVE_EVERY_S = 60.0
CLOCK = "monitor/clock"
"""Of a state: last time given and the stream's clock offset, (2,) s."""


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
    save: Callable[[float], None] | None = None,
    scales: StreamScales | None = None,
) -> Diagnosis:
    """Diagnose what a source gives until it ends, or until told to stop; the answer on everything seen.

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

    Raises InputError: channels that do not suffice, or are in another unit of measure.
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
        if stopped() or (duration is not None and last - first >= duration - 1e-9):
            break
    for text in source.remarks():
        emit(Noted(last, text))
    if save is not None and not math.isnan(last):
        save(last)
    return pipeline.finish(source.quality())


def save_state(path: Path, pipeline: Pipeline, *, last_time: float, offset: float) -> None:
    """Write the pipeline's state, whole or not at all, from which a monitor goes on after a restart.

    Parameters
    ----------
    last_time, offset : s; of the last sample, and what is added to the stream's stamps.

    Raises InputError: it cannot be written.
    """
    arrays = {**pipeline.state(), CLOCK: np.array([last_time, offset])}
    # Into an open file: to a name, savez would add .npz.
    with whole_file(path) as temporary, temporary.open("wb") as out:
        np.savez(out, **arrays)  # type: ignore[arg-type]


def load_state(path: Path, pipeline: Pipeline) -> tuple[float, float]:
    """Put a saved state into a new pipeline of the same unit and model; last_time and offset as saved, s.

    Raises InputError: damaged, too large, or of another version, unit or model.
    """
    mend = "remove the file to start anew"
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_STATE_BYTES:
            raise InputError(f"{size} bytes, at most {MAX_STATE_BYTES} are read", where=path, mend=mend)
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        last_time, offset = (float(v) for v in arrays[CLOCK])
        pipeline.restore(arrays)
        return last_time, offset
    except InputError as error:
        raise (error if error.where == str(path) else error.at(path)) from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise InputError(f"not a monitor's state ({type(error).__name__})", where=path, mend=mend) from None
