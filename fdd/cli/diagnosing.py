"""One log through the pipeline, and which profile it is diagnosed with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from fdd.cli.console import progress
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis, Quality, Trajectories
    from fdd.diagnosis.model import Model
    from fdd.diagnosis.pipeline import Pipeline
    from fdd.logs import DataQuality, Log
    from fdd.unit import Unit

DEFAULT_UNIT = "axis_a"
BLOCK_ROWS = 50_000


@dataclass
class Diagnosed:
    """A diagnosed log with everything that its outputs need."""

    log: Log
    unit: Unit
    diagnosis: Diagnosis
    pipeline: Pipeline

    @cached_property
    def trajectories(self) -> Trajectories:
        """What is behind the answer over time; worked out where an output shows it."""
        return self.pipeline.trajectories()


def unit_of(log: Log | None, given: str | None) -> tuple[Unit, str | None]:
    """The profile to diagnose with, and a note where nobody chose it.

    Parameters
    ----------
    log : its metadata may carry the profile of the unit that it was recorded on.
    given : name or path on the command line; goes first.

    Raises
    ------
    InputError : no such profile, or an unusable one.
    """
    from fdd.unit import MAX_UNIT_BYTES, Unit

    if given is not None:
        return Unit.load(given), None
    text = None if log is None else log.metadata.get("unit", {}).get("yaml")
    if text is not None and log is not None:
        where = f"{log.name}, unit profile in its metadata"
        if len(text) > MAX_UNIT_BYTES:
            raise InputError(f"larger than {MAX_UNIT_BYTES} bytes", where=where, mend="give --unit")
        return Unit.from_yaml(text, where=where), None
    note = f"no unit profile given: taken for {DEFAULT_UNIT} (give --unit, or make one with fdd identify)"
    return Unit.load(DEFAULT_UNIT), note


def diagnose_log(log: Log, unit: Unit, model: Model, *, name: str, notes: tuple[str, ...] = ()) -> Diagnosed:
    """Diagnose one log.

    Parameters
    ----------
    name : of the log in the answer.
    notes : for the answer's quality, beside the reader's.

    Raises
    ------
    InputError : its channels do not suffice.
    """
    from fdd.diagnosis.pipeline import Pipeline

    shown = name.encode("utf-8", "replace").decode("utf-8")
    pipeline = Pipeline(unit, model, axis=log.axis or unit.axis, log=shown)
    try:
        with progress(f"diagnosing {shown}", max(len(log.samples), 1)) as advance:
            done = 0
            for block in log.samples.blocks(BLOCK_ROWS):
                pipeline.push(block)
                done += len(block)
                advance(done)
            diagnosis = pipeline.finish(quality_of(log.quality, notes))
    except InputError as error:
        raise error.at(name) from None
    return Diagnosed(log, unit, diagnosis, pipeline)


def quality_of(found: DataQuality, notes: tuple[str, ...] = ()) -> Quality:
    """The reader's counts and notes as the answer carries them."""
    from fdd.diagnosis.findings import Quality

    return Quality(
        dropped_samples=found.dropped_samples,
        nan_samples=found.nan_samples,
        time_jumps=found.time_jumps,
        notes=[*found.notes, *notes],
    )
