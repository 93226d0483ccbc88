"""Logs through the pipeline, one by one, with what they share read once."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis, Quality, Trajectories
    from fdd.diagnosis.model import Model
    from fdd.diagnosis.pipeline import Pipeline
    from fdd.logs import DataQuality, Log
    from fdd.unit import Unit

DEFAULT_UNIT = "axis_a"
BLOCK_ROWS = 10_000

Advance = Callable[[float], None]


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
        return self.pipeline.trajectories(self.diagnosis)


@dataclass(frozen=True)
class Settings:
    """What all logs of a command are diagnosed with, as the command line names it."""

    unit: str | None = None
    map: Path | None = None
    model: Path | None = None
    axis: str | None = None


@dataclass(frozen=True)
class Job:
    """One log and what is written of it.

    Attributes
    ----------
    name : of the log in its answer.
    report : page with plotly.js in it. page : one that loads plotly.js from beside it.
    """

    path: Path
    name: str
    report: Path | None = None
    page: Path | None = None
    mcap: Path | None = None

    @property
    def shows_trajectories(self) -> bool:
        """Whether any of its outputs does."""
        return any(path is not None for path in (self.report, self.page, self.mcap))


class Diagnoser:
    """Model, channel map and profile, read once for all logs.

    Parameters
    ----------
    settings : which.

    Raises
    ------
    InputError : one of them cannot be used.
    """

    def __init__(self, settings: Settings) -> None:
        from fdd.diagnosis.model import Model
        from fdd.logs import ChannelMap
        from fdd.unit import Unit, shipped_units

        self.settings = settings
        self.unit = None if settings.unit is None else Unit.load(settings.unit)
        self.map = None if settings.map is None else ChannelMap.load(settings.map)
        self.model = Model.load(settings.model)
        self._shared = {} if settings.map is None else {"map": sha256_of(settings.map)}
        if settings.unit is not None:
            shipped = resources.files("fdd") / "units" / f"{settings.unit}.yaml"
            with resources.as_file(shipped) as file:
                known = settings.unit in shipped_units()
                self._shared["profile"] = sha256_of(file if known else Path(settings.unit))

    def hashes(self, path: Path) -> dict[str, str]:
        """SHA-256 of what a log's answer depends on, as the answer tells it.

        Raises
        ------
        InputError : the log cannot be read.
        """
        return {"log": sha256_of(path), **self._shared, "model": self.model.sha256}

    def read(self, job: Job) -> Log:
        """The job's log.

        Raises
        ------
        InputError : it cannot be used.
        """
        from fdd.logs import read_log

        return read_log(job.path, self.map, self.settings.axis)

    def diagnose(
        self, job: Job, log: Log, advance: Advance = lambda done: None, *, keep_trajectories: bool = True
    ) -> Diagnosed:
        """Diagnose the log; see `diagnose_log`.

        Raises
        ------
        InputError : its channels do not suffice, or the profile in it cannot be used.
        """
        from fdd.identify.signs import check_senses

        unit, note = (self.unit, None) if self.unit is not None else unit_of(log, None)
        check_senses(log.samples, unit, str(job.path))
        notes = (note,) if note else ()
        found = diagnose_log(log, unit, self.model, job.name, notes, advance, keep_trajectories)
        found.diagnosis.sha256 = self.hashes(job.path)
        return found

    def write(self, job: Job, found: Diagnosed) -> None:
        """Write what is wanted of a log.

        Raises
        ------
        InputError : it cannot be written.
        """
        from fdd.report import write_report

        settings = {
            "model": str(self.settings.model or "shipped"), "profile": found.unit.name, "log": found.log.name,
        }  # fmt: skip
        for path, alone in ((job.report, True), (job.page, False)):
            if path is not None:
                write_report(
                    path, found.diagnosis, found.trajectories, found.log.samples, found.unit, settings,
                    alone=alone,
                )  # fmt: skip
        if job.mcap is not None:
            from fdd.logs.mcap_writing import write_annotated

            write_annotated(
                job.mcap,
                found.log.samples,
                vars(found.trajectories),
                found.diagnosis.model_dump_json(by_alias=True),
                axis=found.diagnosis.axis,
                unit_yaml=found.unit.to_yaml(),
                start_ns=found.log.start_ns,
            )


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
    from fdd.bounds import MAX_UNIT_BYTES
    from fdd.unit import Unit, shipped_units

    if given is not None:
        return Unit.load(given), None
    text = None if log is None else log.metadata.get("unit", {}).get("yaml")
    if text is not None and log is not None:
        where = f"{log.name}, unit profile in its metadata"
        if len(text) > MAX_UNIT_BYTES:
            raise InputError(f"larger than {MAX_UNIT_BYTES} bytes", where=where, mend="give --unit")
        try:
            return _parsed(text), None
        except InputError as error:
            raise InputError(error.problem, where=where, mend=error.mend) from None
    axis = None if log is None else log.axis
    taken = axis if axis in shipped_units() else DEFAULT_UNIT
    note = f"no unit profile given: taken for {taken} (give --unit, or make one with fdd identify)"
    return Unit.load(taken), note


@lru_cache(maxsize=4)
def _parsed(text: str) -> Unit:
    """The logs of one rig carry the same profile."""
    from fdd.unit import Unit

    return Unit.from_yaml(text, where="")


def diagnose_log(
    log: Log,
    unit: Unit,
    model: Model,
    name: str,
    notes: tuple[str, ...] = (),
    advance: Advance = lambda done: None,
    keep_trajectories: bool = True,
) -> Diagnosed:
    """Diagnose one log.

    Parameters
    ----------
    name : of the log in the answer.
    notes : for the answer's quality, beside the reader's.
    advance : told how many samples are done.
    keep_trajectories : for outputs that show them; they take a third of the memory of the log.

    Raises
    ------
    InputError : its channels do not suffice.
    """
    from fdd.diagnosis.pipeline import Pipeline

    pipeline = Pipeline(
        unit, model, axis=log.axis or unit.axis, log=printable(name), keep_trajectories=keep_trajectories
    )
    try:
        done = 0
        for block in log.samples.blocks(BLOCK_ROWS):
            pipeline.push(block)
            done += len(block)
            advance(done)
        diagnosis = pipeline.finish(quality_of(log.quality, notes))
    except InputError as error:
        raise error.at(name) from None
    if log.start_ns > 0:
        diagnosis.started_at = utc(log.start_ns)
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


def printable(name: str) -> str:
    """A file's name as text that can be written anywhere."""
    return name.encode("utf-8", "replace").decode("utf-8")


def utc(ns: int) -> str:
    """Nanoseconds since 1970 as ISO 8601, no digit lost and none added.

    Examples
    --------
    >>> utc(1_700_000_000_000_000_000), utc(1_700_000_000_120_000_007)
    ('2023-11-14T22:13:20Z', '2023-11-14T22:13:20.120000007Z')
    """
    seconds, rest = divmod(ns, 1_000_000_000)
    fraction = f".{rest:09d}".rstrip("0").rstrip(".")
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}{fraction}Z"


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal.

    Raises
    ------
    InputError : it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=path) from None
