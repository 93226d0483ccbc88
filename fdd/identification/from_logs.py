"""Healthy logs in, the unit's own profile out: identified, measured, judged, named by its origin."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from pydantic import ValidationError

import fdd
from fdd.diagnosis.baseline import BASELINE_VERSION, add_baseline, baseline_of, histories_of
from fdd.engines import Progress, unseen
from fdd.errors import InputError
from fdd.files import sha256_of
from fdd.identification import Identification, TableRow
from fdd.identification.identify import identify_unit
from fdd.identification.judgement import Judgement, judge
from fdd.logs import ChannelMap, Log, read_log
from fdd.residuals.balances import BALANCES
from fdd.samples import Samples
from fdd.unit import Origin, Unit

FIRST_STAMP_NS = 946_684_800 * 10**9
"""2000-01-01: a log that starts earlier counts from when its recorder was switched on."""
SHOWN = {
    "travel per rad of the pump": ("volume", "gain"),
    "leakage": ("volume", "leak"),
    "compliance of the oil": ("volume", "compliance"),
    "friction extending": ("force", "friction_forward"),
    "friction retracting": ("force", "friction_reverse"),
    "torque per pressure": ("torque", "pressure"),
}
"""What the healthy balances know, as a multiple of the profile's number: balance and column."""


@dataclass(frozen=True)
class Identified:
    """A profile with its healthy baseline, what changed against the base, and whether it may be used."""

    unit: Unit
    found: Identification
    judged: Judgement


def identify(
    logs: Sequence[str | Path | Log | Samples] | str | Path | Log | Samples,
    base: Unit | str | Path = "axis_a", map: ChannelMap | str | Path | None = None, *,
    add: Unit | str | Path | None = None, axis: str | None = None, name: str | None = None,
    accept: bool = False,
) -> Unit:  # fmt: skip
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
    logs: Sequence[str | Path | Log | Samples], base: Unit | str | Path,
    map: ChannelMap | str | Path | None = None, *, add: Unit | str | Path | None = None,
    axis: str | None = None, name: str | None = None, accept: bool = False, progress: Progress = unseen,
) -> Identified:  # fmt: skip
    """As `identify`, with everything behind the profile; `progress` is told of the stages."""
    given, more = base if add is None else add, add is not None
    profile = given if isinstance(given, Unit) else Unit.load(given)
    _named(profile, name)
    channel_map = map if isinstance(map, ChannelMap | None) else ChannelMap.load(map)
    known = [Path(log) if isinstance(log, str) else log for log in logs]
    origin = _origin_of(profile, known, channel_map, more=more)
    read: list[Log | Samples] = []
    with progress("reading", len(known)) as advance:
        for log in known:
            read.append(read_log(log, channel_map, axis) if isinstance(log, Path) else log)
            advance(len(read))
    samples = [log.samples if isinstance(log, Log) else log for log in read]
    labels = [str(log) if isinstance(log, Path) else f"log {k}" for k, log in enumerate(known, 1)]
    try:
        if more:
            with progress("adding"):
                found, unit = add_logs(samples, profile, labels)
        else:
            with progress("identifying"):
                found = identify_unit(samples, profile, labels=labels)
            with progress("measuring the healthy baseline"):
                unit = add_baseline(found.unit, samples)
    except InputError as error:
        inner = error.problem if error.where is None else f"{error.where}: {error.problem}"
        raise InputError(f"not usable, because {inner}", mend=error.mend) from None
    with progress("judging"):
        judged = judge(found, unit, profile, samples, labels, more=more)
    if judged.refusals and not accept:
        mend = "mend or leave out what is named, or --accept (accept=True) makes the profile all the same"
        raise InputError(judged.sentence, mend=mend)
    start_ns = read[0].start_ns if isinstance(read[0], Log) else 0
    unit = _named(unit, name or _name_of(origin, profile, start_ns))
    unit.origin = origin.model_copy(update={"limits": judged.limits, "accepted": judged.refusals})
    return Identified(unit, found, judged)


def add_logs(
    logs: Sequence[Samples], profile: Unit, labels: Sequence[str] | None = None
) -> tuple[Identification, Unit]:
    """Add healthy logs, which errors call `labels`, to an identified profile.

    A profile's numbers are the scale in which its balances are written, so they stay; what the logs tell
    goes into the balances, whose statistics add up.

    Returns what the new logs alone identify, with the table of the balances before and after, and the profile
    with the narrowed baseline.

    Raises InputError: the profile has no baseline of this version, or a log cannot be used.
    """
    before = profile.baseline
    columns = {n: list(b.columns) for n, b in BALANCES.items()}
    if before is None or before.version != BASELINE_VERSION or any(
        columns.get(name) != balance.columns for name, balance in before.balances.items()
    ):  # fmt: skip
        problem = f"profile {profile.name} has no healthy baseline of this version of fdd"
        raise InputError(problem, mend="identify it anew from all logs")
    found = identify_unit(logs, profile, labels=labels)
    unit = profile.model_copy(deep=True)
    unit.baseline = after = baseline_of(histories_of(profile, logs), before)
    rows = []
    for quantity, (balance, column) in SHOWN.items():
        if balance not in before.balances or balance not in after.balances:
            continue
        both, k = (before.balances[balance], after.balances[balance]), columns[balance].index(column)
        # The gain's coefficient is the share of the pump's flow that moves nothing.
        old, new = (1.0 - b.mean[k] if column == "gain" else b.mean[k] for b in both)
        old_std, std = (float(np.sqrt(b.covariance[k][k])) for b in both)
        rows.append(TableRow(quantity, "of the profile's", old, new, std, f"± {1.96 * old_std:.2g} before"))
    return replace(found, balances=rows, leakage=None), unit


def _origin_of(
    profile: Unit, logs: Sequence[Path | Log | Samples], channel_map: ChannelMap | None, *, more: bool
) -> Origin:
    """Where a profile comes from: its logs by their hashes (of samples at hand by that of their values), its
    base, the map. A log that is there twice would count for two, and is refused."""
    known = {} if not more or profile.origin is None else dict(profile.origin.logs)
    for number, log in enumerate(logs, 1):
        digest = _digest(log)
        name = f"log {number}" if isinstance(log, Samples) else log.name
        if digest in known:
            same = f"the same as {known[digest]}, which counts already"
            raise InputError(same, where=log if isinstance(log, Path) else name, mend="give each log once")
        known[digest] = name
    now = datetime.now(UTC).isoformat(timespec="seconds")
    if more and profile.origin is not None:
        update = {"date": now, "fdd": fdd.__version__, "logs": known}
        return profile.origin.model_copy(update=update)
    mapped = None if channel_map is None else _sha256(channel_map.model_dump_json())
    return Origin(
        base=profile.name, base_sha256=_sha256(profile.to_yaml()), date=now, fdd=fdd.__version__,
        map_sha256=mapped, logs=known,
    )  # fmt: skip


def _name_of(origin: Origin, profile: Unit, start_ns: int) -> str:
    """``<base>-<date of the first log, or today>-<8 hex of the hash of the logs>``; a name that a person gave
    to the profile that logs are added to stays."""
    start = f"{origin.base[:44].strip()}-"
    if profile.name != origin.base and not profile.name.startswith(start):
        return profile.name
    stamp = start_ns / 1e9 if start_ns > FIRST_STAMP_NS else datetime.now(UTC).timestamp()
    day = datetime.fromtimestamp(stamp, UTC).date().isoformat()
    return f"{start}{day}-{_sha256(''.join(sorted(origin.logs)))[:8]}"


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
