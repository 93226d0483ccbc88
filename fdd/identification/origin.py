"""Where a profile comes from: its logs by their hashes, its base, the map; and a name unique by them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

import fdd
from fdd.errors import InputError
from fdd.samples import Samples
from fdd.unit import Origin, Unit

if TYPE_CHECKING:
    from fdd.logs import ChannelMap, Log

FIRST_STAMP_NS = 946_684_800 * 10**9
"""2000-01-01: a log that starts earlier counts from when its recorder was switched on."""


@dataclass(frozen=True)
class Made:
    """A profile's origin, and the name that follows from it."""

    section: Origin

    def name_for(self, profile: Unit, start_ns: int) -> str:
        """``<base>-<date of the log, or today>-<8 hex of the hash of the logs>``.

        Parameters
        ----------
        profile : base, or profile that logs were added to; a name that a person gave it stays.
        start_ns : log time of the first log.
        """
        start = f"{self.section.base[:44].strip()}-"
        if profile.name != self.section.base and not profile.name.startswith(start):
            return profile.name
        stamp = start_ns / 1e9 if start_ns > FIRST_STAMP_NS else datetime.now(UTC).timestamp()
        day = datetime.fromtimestamp(stamp, UTC).date().isoformat()
        together = hashlib.sha256("".join(sorted(self.section.logs)).encode()).hexdigest()
        return f"{start}{day}-{together[:8]}"


def origin_of(
    profile: Unit, logs: Sequence[Path | Log | Samples], channel_map: ChannelMap | None, *, more: bool
) -> Made:
    """The origin of what is made from these logs.

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
        digest = _digest(log) if isinstance(log, Path) else _digest_of_values(log)
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
        return Made(profile.origin.model_copy(update=update))
    return Made(
        Origin(
            base=profile.name, base_sha256=_sha256(profile.to_yaml()), date=now, fdd=fdd.__version__,
            map_sha256=mapped, logs=known,
        )
    )  # fmt: skip


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


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise InputError("no such file", where=path, mend="check the path") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=path) from None


def _digest_of_values(log: Log | Samples) -> str:
    samples = log if isinstance(log, Samples) else log.samples
    digest = hashlib.sha256(samples.time.tobytes())
    for name in sorted(samples.channels):
        digest.update(name.encode() + samples[name].tobytes())
    return digest.hexdigest()


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
