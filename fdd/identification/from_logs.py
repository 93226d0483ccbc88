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
from fdd.engines import Progress, unseen
from fdd.errors import InputError
from fdd.files import sha256_of
from fdd.identification import Identification
from fdd.identification.identify import identify_unit
from fdd.identification.judgement import Judgement, judge
from fdd.logs import ChannelMap, Log, read_log
from fdd.samples import Samples
from fdd.unit import Origin, Unit

FIRST_STAMP_NS = 946_684_800 * 10**9
"""2000-01-01: a log that starts earlier counts from when its recorder was switched on."""


@dataclass(frozen=True)
class Identified:
    """A profile with its healthy baseline, what changed against the base, and whether it may be used."""

    unit: Unit
    found: Identification
    judged: Judgement


def identify(
    logs: Sequence[str | Path | Log | Samples] | str | Path | Log | Samples,
    base: Unit | str | Path = "axis_a", map: ChannelMap | str | Path | None = None, *,
    axis: str | None = None, name: str | None = None, accept: bool = False,
) -> Unit:  # fmt: skip
    """Identify a unit from its healthy logs, so that its own spread is no fault.

    The same as ``fdd identify``. What a user must know of the profile stands in its ``origin.limits``.

    Parameters
    ----------
    logs : one or more healthy logs of the unit: files, what `read_log` gave, or samples. Three with strokes
        at several speeds and under some load tell most.
    base : profile of a similar unit: a `Unit`, a shipped one's name or a YAML file.
    map, axis : of files, as for `read_log`.
    name : of the new profile; by default base, date and hash.
    accept : give a profile that would be refused.

    Raises InputError: a log cannot be used, or the profile not be trusted, and why.

    Examples
    --------
    >>> unit = identify(["one.mcap", "two.mcap"], base="axis_a")  # doctest: +SKIP
    >>> unit.save("unit.yaml")  # doctest: +SKIP
    """
    several = logs if isinstance(logs, Sequence) and not isinstance(logs, str) else [logs]
    return identify_logs(several, base, map, axis=axis, name=name, accept=accept).unit


def identify_logs(
    logs: Sequence[str | Path | Log | Samples], base: Unit | str | Path,
    map: ChannelMap | str | Path | None = None, *, axis: str | None = None, name: str | None = None,
    accept: bool = False, progress: Progress = unseen,
) -> Identified:  # fmt: skip
    """As `identify`, with everything behind the profile; `progress` is told of the stages."""
    profile = base if isinstance(base, Unit) else Unit.load(base)
    _named(profile, name)
    channel_map = map if isinstance(map, ChannelMap | None) else ChannelMap.load(map)
    known = [Path(log) if isinstance(log, str) else log for log in logs]
    origin = _origin_of(profile, known, channel_map)
    read: list[Log | Samples] = []
    with progress("reading", len(known)) as advance:
        for log in known:
            read.append(read_log(log, channel_map, axis) if isinstance(log, Path) else log)
            advance(len(read))
    samples = [log.samples if isinstance(log, Log) else log for log in read]
    labels = [str(log) if isinstance(log, Path) else f"log {k}" for k, log in enumerate(known, 1)]
    try:
        with progress("identifying"):
            found = identify_unit(samples, profile, labels=labels)
        with progress("measuring the healthy baseline"):
            unit = add_baseline(found.unit, samples)
    except InputError as error:
        inner = error.problem if error.where is None else f"{error.where}: {error.problem}"
        raise InputError(f"not usable, because {inner}", mend=error.mend) from None
    with progress("judging"):
        judged = judge(found, unit, profile, samples, labels)
    if judged.refusals and not accept:
        mend = "mend or leave out what is named, or --accept (accept=True) makes the profile all the same"
        raise InputError(judged.sentence, mend=mend)
    start_ns = read[0].start_ns if isinstance(read[0], Log) else 0
    unit = _named(unit, name or _name_of(origin, start_ns))
    unit.origin = origin.model_copy(update={"limits": judged.limits, "accepted": judged.refusals})
    return Identified(unit, found, judged)


def _origin_of(profile: Unit, logs: Sequence[Path | Log | Samples], channel_map: ChannelMap | None) -> Origin:
    """Where a profile comes from: its logs by their hashes (of samples at hand by that of their values), its
    base, the map. A log that is there twice would count for two, and is refused."""
    known: dict[str, str] = {}
    for number, log in enumerate(logs, 1):
        digest = _digest(log)
        name = f"log {number}" if isinstance(log, Samples) else log.name
        if digest in known:
            same = f"the same as {known[digest]}, which counts already"
            raise InputError(same, where=log if isinstance(log, Path) else name, mend="give each log once")
        known[digest] = name
    now = datetime.now(UTC).isoformat(timespec="seconds")
    mapped = None if channel_map is None else _sha256(channel_map.model_dump_json())
    return Origin(
        base=profile.name, base_sha256=_sha256(profile.to_yaml()), date=now, fdd=fdd.__version__,
        map_sha256=mapped, logs=known,
    )  # fmt: skip


def _name_of(origin: Origin, start_ns: int) -> str:
    """``<base>-<date of the first log, or today>-<8 hex of the hash of the logs>``."""
    stamp = start_ns / 1e9 if start_ns > FIRST_STAMP_NS else datetime.now(UTC).timestamp()
    day = datetime.fromtimestamp(stamp, UTC).date().isoformat()
    return f"{origin.base[:44].strip()}-{day}-{_sha256(''.join(sorted(origin.logs)))[:8]}"


def _named(unit: Unit, name: str | None) -> Unit:
    """The unit under a name; None leaves it its own."""
    copy = unit.model_copy()
    try:
        copy.name = unit.name if name is None else name
    except ValidationError:
        mend = "use 1 to 64 letters, digits, blanks, _ . and -"
        raise InputError(f"--name {name!r} is no name", mend=mend) from None
    return copy


def _digest(log: Path | Log | Samples) -> str:
    if isinstance(log, Path):
        return sha256_of(log)
    samples = log if isinstance(log, Samples) else log.samples
    digest = hashlib.sha256(samples.time.tobytes())
    for name in sorted(samples.channels):
        digest.update(name.encode() + samples[name].tobytes())
    return digest.hexdigest()


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
