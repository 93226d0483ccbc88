"""Healthy logs in, the unit's own profile out: identified, measured, judged, named by its origin."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pydantic import ValidationError

import fdd
from fdd.diagnosis.baseline import add_baseline
from fdd.errors import InputError
from fdd.identification.adding import add_logs
from fdd.identification.identify import identify_unit
from fdd.identification.judgement import Judgement, judge
from fdd.identification.profile import Identification
from fdd.logs import ChannelMap, Log, read_log
from fdd.progress import Progress, unseen
from fdd.samples import Samples
from fdd.unit import Origin, Unit

FIRST_STAMP_NS = 946_684_800 * 10**9
"""2000-01-01: a log that starts earlier counts from when its recorder was switched on."""


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
    unit = named(unit, name or name_of(origin, profile, start_ns))
    unit.origin = origin.model_copy(update={"limits": judged.limits, "accepted": judged.refusals})
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


def origin_of(
    profile: Unit, logs: Sequence[Path | Log | Samples], channel_map: ChannelMap | None, *, more: bool
) -> Origin:
    """Where a profile comes from: its logs by their hashes, its base, the map.

    Parameters
    ----------
    profile : the base, or the profile that the logs are added to. more : whether they are added.
    logs : files, or samples at hand, which are known by the hash of their values.

    Raises
    ------
    InputError : a log is missing, or there twice: it would count for two.
    """
    known = {} if not more or profile.origin is None else dict(profile.origin.logs)
    for number, log in enumerate(logs, 1):
        digest = _digest(log)
        name = f"log {number}" if isinstance(log, Samples) else log.name
        if digest in known:
            where = log if isinstance(log, Path) else name
            raise InputError(
                f"the same as {known[digest]}, which counts already", where=where, mend="give each log once"
            )
        known[digest] = name
    mapped = None if channel_map is None else _sha256(channel_map.model_dump_json())
    now = datetime.now(UTC).isoformat(timespec="seconds")
    if more and profile.origin is not None:
        update = {"date": now, "fdd": fdd.__version__, "logs": known}
        return profile.origin.model_copy(update=update)
    return Origin(
        base=profile.name, base_sha256=_sha256(profile.to_yaml()), date=now, fdd=fdd.__version__,
        map_sha256=mapped, logs=known,
    )  # fmt: skip


def name_of(origin: Origin, profile: Unit, start_ns: int) -> str:
    """``<base>-<date of the log, or today>-<8 hex of the hash of the logs>``.

    Parameters
    ----------
    profile : base, or profile that logs were added to; a name that a person gave it stays.
    start_ns : log time of the first log.
    """
    start = f"{origin.base[:44].strip()}-"
    if profile.name != origin.base and not profile.name.startswith(start):
        return profile.name
    stamp = start_ns / 1e9 if start_ns > FIRST_STAMP_NS else datetime.now(UTC).timestamp()
    day = datetime.fromtimestamp(stamp, UTC).date().isoformat()
    return f"{start}{day}-{_sha256(''.join(sorted(origin.logs)))[:8]}"


def named(unit: Unit, name: str | None) -> Unit:
    """The unit under a name; None leaves it its own.

    Raises
    ------
    InputError : that is no name.
    """
    copy = unit.model_copy()
    try:
        copy.name = unit.name if name is None else name
    except ValidationError:
        raise InputError(
            f"--name {name!r} is no name", mend="use 1 to 64 letters, digits, blanks, _ . and -"
        ) from None
    return copy


def _digest(log: Path | Log | Samples) -> str:
    if not isinstance(log, Path):
        samples = log if isinstance(log, Samples) else log.samples
        digest = hashlib.sha256(samples.time.tobytes())
        for name in sorted(samples.channels):
            digest.update(name.encode() + samples[name].tobytes())
        return digest.hexdigest()
    try:
        with log.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise InputError("no such file", where=log, mend="check the path") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=log) from None


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
