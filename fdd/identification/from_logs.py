"""Healthy logs in, the unit's own profile out: identified, measured, judged, named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fdd.diagnosis.baseline import add_baseline
from fdd.errors import InputError
from fdd.identification.adding import add_logs
from fdd.identification.identify import identify_unit
from fdd.identification.judgement import Judgement, judge
from fdd.identification.origin import named, origin_of
from fdd.identification.profile import Identification
from fdd.logs import ChannelMap, Log, read_log
from fdd.progress import Progress, unseen
from fdd.samples import Samples
from fdd.unit import Unit


@dataclass(frozen=True)
class Identified:
    """A profile, and all that is known of how it came about.

    Attributes
    ----------
    unit : the profile, with its healthy baseline and origin.
    found : what changed against the base, and why the rest did not. judged : whether it may be used.
    """

    unit: Unit
    found: Identification
    judged: Judgement


def identify(
    logs: Sequence[str | Path | Log | Samples] | str | Path | Log | Samples,
    base: Unit | str | Path = "axis_a",
    map: ChannelMap | str | Path | None = None,
    *,
    add: Unit | str | Path | None = None,
    axis: str | None = None,
    name: str | None = None,
    accept: bool = False,
) -> Unit:
    """Identify a unit from its healthy logs, so that its own spread is no fault.

    The same as ``fdd identify``. What a user must know of the profile stands in its ``origin.limits``.

    Parameters
    ----------
    logs : one or more healthy logs of the unit: files, what `read_log` gave, or samples. Three with strokes
        at several speeds and under some load tell most.
    base : profile of a similar unit: a `Unit`, a shipped one's name or a YAML file.
    map, axis : of files, as for `read_log`.
    add : identified profile that the logs narrow; `base` is not used then.
    name : of the new profile; by default base, date and hash.
    accept : give a profile that would be refused.

    Returns
    -------
    Unit : the profile; `Unit.save` writes it.

    Raises
    ------
    InputError : a log cannot be used, or the profile not be trusted, and why.

    Examples
    --------
    >>> unit = identify(["one.mcap", "two.mcap"], base="axis_a")  # doctest: +SKIP
    >>> unit.save("unit.yaml")  # doctest: +SKIP
    """
    several = logs if isinstance(logs, Sequence) and not isinstance(logs, str) else [logs]
    return identify_logs(several, base, map, add=add, axis=axis, name=name, accept=accept).unit


def identify_logs(
    logs: Sequence[str | Path | Log | Samples],
    base: Unit | str | Path,
    map: ChannelMap | str | Path | None = None,
    *,
    add: Unit | str | Path | None = None,
    axis: str | None = None,
    name: str | None = None,
    accept: bool = False,
    progress: Progress = unseen,
) -> Identified:
    """As `identify`, with everything behind the profile; `progress` is told of the stages.

    Raises
    ------
    InputError : as `identify`.
    """
    given = base if add is None else add
    profile = given if isinstance(given, Unit) else Unit.load(given)
    named(profile, name)
    channel_map = map if isinstance(map, ChannelMap | None) else ChannelMap.load(map)
    known = [Path(log) if isinstance(log, str) else log for log in logs]
    origin = origin_of(profile, known, channel_map, more=add is not None)
    samples, start_ns = _read(known, channel_map, axis, progress)
    labels = [str(log) if isinstance(log, Path) else f"log {k}" for k, log in enumerate(known, 1)]
    try:
        if add is None:
            with progress("identifying"):
                found = identify_unit(samples, profile, labels=labels)
            with progress("measuring the healthy baseline"):
                unit = add_baseline(found.unit, samples)
        else:
            with progress("adding"):
                found, unit = add_logs(samples, profile, labels)
    except InputError as error:
        inner = error.problem if error.where is None else f"{error.where}: {error.problem}"
        raise InputError(f"not usable, because {inner}", mend=error.mend) from None
    with progress("judging"):
        judged = judge(found, unit, profile, samples, labels, more=add is not None)
    if judged.refusals and not accept:
        raise InputError(
            judged.sentence,
            mend="mend or leave out what is named, or --accept (accept=True) makes the profile all the same",
        )
    unit = named(unit, name or origin.name_for(profile, start_ns))
    unit.origin = origin.section.model_copy(update={"limits": judged.limits, "accepted": judged.refusals})
    return Identified(unit, found, judged)


def _read(
    logs: Sequence[Path | Log | Samples], channel_map: ChannelMap | None, axis: str | None, progress: Progress
) -> tuple[list[Samples], int]:
    """The logs' samples, and when the first one started (ns since 1970, 0 where nothing tells)."""
    read: list[Log | Samples] = []
    with progress("reading", len(logs)) as advance:
        for log in logs:
            read.append(read_log(log, channel_map, axis) if isinstance(log, Path) else log)
            advance(len(read))
    start_ns = read[0].start_ns if read and isinstance(read[0], Log) else 0
    return [log.samples if isinstance(log, Log) else log for log in read], start_ns
