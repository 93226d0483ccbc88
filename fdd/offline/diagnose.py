"""One log in, its answer out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.logs import ChannelMap, Log, as_log
from fdd.offline.diagnoser import Diagnosed, Diagnoser, Job, Settings
from fdd.samples import Samples
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def diagnose(
    log: str | Path | Log | Samples,
    unit: Unit | str | Path | None = None,
    map: ChannelMap | str | Path | None = None,
    *,
    model: Model | str | Path | None = None,
    axis: str | None = None,
    trackers: Sequence[str] = (),
    keep_signals: bool = True,
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
    keep_signals : what `Diagnosis.plot` draws stays with the answer; False where many answers are kept.

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
    of_file = isinstance(log, str | Path)
    if not of_file and not isinstance(log, Log | Samples):
        raise InputError(
            f"{type(log).__name__} is no log", mend="give a file, what read_log gave, or Samples"
        )
    if map is not None and not of_file:
        raise InputError("a channel map is for files", mend="give it to read_log")
    diagnoser = Diagnoser(Settings(unit, map, model, axis, tuple(dict.fromkeys(trackers))))
    if isinstance(log, str | Path):
        job = Job(Path(log), Path(log).name)
        found = diagnoser.diagnose(job, diagnoser.read(job), keep_trajectories=keep_signals)
    else:
        read = as_log(log, axis) if isinstance(log, Samples) else log
        read = read if axis is None else replace(read, axis=axis)
        found = diagnoser.answer(read, read.name, read.name, keep_trajectories=keep_signals)
    if keep_signals:
        found.diagnosis.draw_with(partial(_figure, found))
    return found.diagnosis


def _figure(found: Diagnosed) -> Figure:
    from fdd.report.figure import draw_diagnosis

    return draw_diagnosis(found.diagnosis, found.trajectories, found.log.samples)
