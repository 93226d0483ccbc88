"""What there is to say of a file format; a package adds one as an entry point of ``fdd.log_formats``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fdd.logs.formats.signals import LogFile

SNIFFED = 1024


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes
    ----------
    name : for people.
    suffixes : what its files are usually called.
    sniff : tells it by a file's first `SNIFFED` bytes (fewer of a shorter file).
    opener : takes a path and gives a `LogFile`; of ours ``module:function``, so that only what is needed is
        loaded.
    extra : of fdd, that installs what it needs; None where it is always there.
    """

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    opener: str | Callable[[Path], LogFile]
    extra: str | None = None
