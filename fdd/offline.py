"""Whole logs through the pipeline, with what they share read once: `fdd.diagnose`, ``fdd diagnose``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from importlib import resources
from pathlib import Path

from fdd import logs
from fdd.bounds import MAX_UNIT_BYTES
from fdd.diagnosis.answering import versions_of
from fdd.diagnosis.findings import Diagnosis, Quality, Trajectories
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.engines import Advance
from fdd.errors import InputError
from fdd.files import sha256_of, write_text
from fdd.identification.log_scales import check_scales
from fdd.logs import ChannelMap, DataQuality, Log, as_log
from fdd.residuals.added_tracker import tracker_named
from fdd.samples import Samples
from fdd.unit import Unit, shipped_units

BLOCK_ROWS = 10_000
DEFAULT_UNIT = "axis_a"


def diagnose(
    log: str | Path | Log | Samples,
    unit: Unit | str | Path | None = None,
    map: ChannelMap | str | Path | None = None,
    *,
    model: Model | str | Path | None = None,
    axis: str | None = None,
    trackers: Sequence[str] = (),
) -> Diagnosis:
    """Diagnose a log: is there a fault, since when, which one, how severe, and how sure is that.

    The same as ``fdd diagnose LOG --json -``.

    Parameters
    ----------
    log : a file of any format, what `read_log` gave, or samples at hand.
    unit : profile of the actuator: a `Unit`, a shipped one's name or a YAML file; best one that `identify`
        made. None takes the one that the log carries, else axis_a, and a note says so.
    map : channel map of a file whose columns have other names than `fdd.samples.CHANNELS`.
    model : learnt layer, or its file; None takes the shipped one.
    axis : of a file with several. trackers : of installed packages, that run beside ours (docs/extending.md).

    Returns
    -------
    Diagnosis : verdict, faults, probabilities, estimates and the quality of the data.

    Raises
    ------
    InputError : one line that names the file, what is wrong and what would mend it.

    Examples
    --------
    >>> answer = diagnose("run.mcap", unit="unit.yaml")  # doctest: +SKIP
    >>> answer.verdict, [(f.fault, f.onset_s, f.confidence) for f in answer.faults]  # doctest: +SKIP
    ('faulty', [('internal_leakage', 16.0, 0.99)])
    """
    if not isinstance(log, str | Path | Log | Samples):
        mend = "give a file, what read_log gave, or Samples"
        raise InputError(f"{type(log).__name__} is no log", mend=mend)
    if map is not None and not isinstance(log, str | Path):
        raise InputError("a channel map is for files", mend="give it to read_log")
    diagnoser = Diagnoser(Settings(unit, map, model, axis, tuple(dict.fromkeys(trackers))))
    if isinstance(log, str | Path):
        job = Job(Path(log), Path(log).name)
        return diagnoser.diagnose(job, diagnoser.read(job), keep_trajectories=False).diagnosis
    read = as_log(log, axis) if isinstance(log, Samples) else log
    read = read if axis is None else replace(read, axis=axis)
    return diagnoser.answer(read, read.name, read.name, keep_trajectories=False).diagnosis


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
    """What all logs are diagnosed with: named, as on the command line, or at hand, as `diagnose` takes them.

    `classifier` is the file of one that is asked, too, `prior` the share of such logs that is faulty; None
    takes the model's.
    """

    unit: Unit | str | Path | None = None
    map: ChannelMap | str | Path | None = None
    model: Model | str | Path | None = None
    axis: str | None = None
    trackers: tuple[str, ...] = ()
    classifier: Path | None = None
    prior: float | None = None

    def load_unit(self) -> Unit | None:
        """The profile, where one is given; an InputError where it cannot be used."""
        return self.unit if isinstance(self.unit, Unit | None) else Unit.load(self.unit)


@dataclass(frozen=True)
class Job:
    """One log, its name in the answer, and what is written of it: `report` is a page with plotly.js in it,
    `page` one that loads it from beside it."""

    path: Path
    name: str
    report: Path | None = None
    page: Path | None = None
    mcap: Path | None = None

    @property
    def outputs(self) -> list[Path]:
        """What is written of it; all of them show trajectories."""
        return [path for path in (self.report, self.page, self.mcap) if path is not None]


class Diagnoser:
    """Model, channel map and profile, read once for all logs; an InputError where one cannot be used."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.versions = versions_of({name: tracker_named(name).package for name in settings.trackers})
        unit, map_, model = settings.unit, settings.map, settings.model
        self.unit = settings.load_unit()
        self.map = map_ if isinstance(map_, ChannelMap | None) else ChannelMap.load(map_)
        loaded = model if isinstance(model, Model) else Model.load(model)
        self.model = loaded if settings.prior is None else loaded.with_prior(settings.prior)
        self._shared = {"map": sha256_of(Path(map_))} if isinstance(map_, str | Path) else {}
        if isinstance(unit, str | Path):
            with resources.as_file(resources.files("fdd") / "units" / f"{unit}.yaml") as shipped:
                known = unit in shipped_units()
                self._shared["profile"] = sha256_of(shipped if known else Path(unit))
        self.classifier = None
        if settings.classifier is not None:
            from fdd.learning.stored import load_classifier, require_usable

            self.classifier = load_classifier(settings.classifier)
            require_usable(self.classifier, str(settings.classifier))
            self._shared["classifier"] = sha256_of(settings.classifier)

    def hashes(self, path: Path) -> dict[str, str]:
        """SHA-256 of what a log's answer depends on, as the answer tells it; an InputError where it cannot
        be read."""
        return {"log": sha256_of(path), **self._shared, "model": self.model.sha256}

    def read(self, job: Job) -> Log:
        """The job's log; an InputError where it cannot be used."""
        return logs.read_log(job.path, self.map, self.settings.axis)

    def diagnose(
        self, job: Job, log: Log, advance: Advance = lambda done: None, *, keep_trajectories: bool = True
    ) -> Diagnosed:
        """Diagnose the job's log, see `answer`."""
        found = self.answer(log, job.name, str(job.path), advance, keep_trajectories=keep_trajectories)
        found.diagnosis.sha256 = self.hashes(job.path)
        return found

    def answer(
        self, log: Log, name: str, where: str, advance: Advance = lambda done: None, *,
        keep_trajectories: bool = True,
    ) -> Diagnosed:  # fmt: skip
        """Diagnose a log that need not be a file; an InputError where its channels do not suffice, or the
        profile in it cannot be used.

        The answer calls it `name`, errors of scale `where`; `advance` is told how many samples are done.
        Trajectories are kept for outputs that show them; they take a third of the log's memory.
        """
        unit, note = (self.unit, None) if self.unit is not None else unit_of(log, None)
        notes = (*((note,) if note else ()), *check_scales(log.samples, unit, where))
        pipeline = Pipeline(
            unit, self.model, axis=log.axis or unit.axis, log=printable(name),
            keep_trajectories=keep_trajectories, trackers=self.settings.trackers,
        )  # fmt: skip
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
        if self.classifier is not None:
            from fdd.learning.stored import opinion

            file = Path(str(self.settings.classifier)).name
            diagnosis.second_opinion = opinion(self.classifier, file, pipeline, diagnosis, log.samples)
        diagnosis.sha256 = {**self._shared, "model": self.model.sha256}
        return Diagnosed(log, unit, diagnosis, pipeline)

    def write(self, job: Job, found: Diagnosed) -> None:
        """Write what is wanted of a log; an InputError where that cannot be."""
        diagnosis, samples = found.diagnosis, found.log.samples
        told = {"profile": found.unit.name, "log": found.log.name}
        told["model"] = str(self.settings.model or "shipped")
        for path, alone in ((job.report, True), (job.page, False)):
            if path is not None:
                from fdd.report import render_report

                shown = diagnosis, found.trajectories, samples, found.unit, told
                write_text(path, render_report(*shown, alone=alone))
        if job.mcap is not None:
            from fdd.logs.mcap_writing import write_annotated

            write_annotated(
                job.mcap, samples, vars(found.trajectories), diagnosis.model_dump_json(by_alias=True),
                axis=diagnosis.axis, unit_yaml=found.unit.to_yaml(), start_ns=found.log.start_ns,
            )  # fmt: skip


def unit_of(log: Log | None, given: str | None) -> tuple[Unit, str | None]:
    """The profile to diagnose with (`given` by name or path, else the one in the log's metadata), and a note
    where nobody chose it; an InputError where there is no such profile, or an unusable one."""
    if given is not None:
        return Unit.load(given), None
    axis = None if log is None else log.axis
    if log is not None and (text := log.metadata.get("unit", {}).get("yaml")) is not None:
        where = f"{log.name}, unit profile in its metadata"
        if len(text) > MAX_UNIT_BYTES:
            raise InputError(f"larger than {MAX_UNIT_BYTES} bytes", where=where, mend="give --unit")
        return Unit.from_yaml(text, where), None
    taken = axis if axis in shipped_units() else DEFAULT_UNIT
    note = f"no unit profile given: taken for {taken} (give --unit, or make one with fdd identify)"
    return Unit.load(taken), note


def quality_of(found: DataQuality, notes: tuple[str, ...] = ()) -> Quality:
    """The reader's counts and notes as the answer carries them."""
    counts = {name: getattr(found, name) for name in ("dropped_samples", "nan_samples", "time_jumps")}
    return Quality(**counts, notes=[*found.notes, *notes])


def printable(name: str) -> str:
    """A file's name as text that can be written anywhere."""
    return name.encode("utf-8", "replace").decode("utf-8")


def utc(ns: int) -> str:
    """Nanoseconds since 1970 as ISO 8601, no digit lost and none added."""
    seconds, rest = divmod(ns, 1_000_000_000)
    fraction = f".{rest:09d}".rstrip("0").rstrip(".")
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}{fraction}Z"
