"""Formats of installed packages: found by entry point, and what they read is checked as it comes in.

A package's code can do anything; what reads its columns relies on numbers, of one length for each clock and
within the bounds (`fdd.bounds`). That is made sure of here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fdd.bounds import LONGEST_NAME
from fdd.errors import InputError
from fdd.logs.formats.signals import Format, LogFile, Signal, require_size
from fdd.packages import LOG_FORMATS, Addition, additions, left_out
from fdd.samples import Column

T = TypeVar("T")


def added_formats() -> list[Format]:
    """Formats of installed packages, each with its files checked."""
    found = []
    for addition in additions(LOG_FORMATS):
        try:
            given = addition.load()
            if not isinstance(given, Format) or not callable(given.opener):
                raise addition.wrong("is no Format with a function that opens a file")
        except InputError as error:
            left_out(error)
            continue
        opener = partial(CheckedLog, package=addition.package, opener=given.opener)
        found.append(replace(given, sniff=partial(_told_by, addition, given), opener=opener))
    return found


def _told_by(addition: Addition, given: Format, head: bytes) -> bool:
    try:
        return bool(given.sniff(head))
    except Exception as error:  # not every log may become unreadable
        left_out(addition.wrong(f"cannot tell its files ({type(error).__name__}: {error})"))
        return False


class CheckedLog(LogFile):
    """A package's file, of which every answer is checked.

    Parameters
    ----------
    path : the file. package : that reads it. opener : the package's.

    Raises
    ------
    InputError : from here and from all methods: whatever the package's code raises, and answers that nothing
        can be made of.
    """

    def __init__(self, path: Path, package: str, opener: Callable[[Path], LogFile]) -> None:
        self.path, self._package = path, package
        self._rows: dict[str, int] = {}
        self._own = self._asked(opener, path)
        if not isinstance(self._own, LogFile):
            raise self._wrong(f"gave a {type(self._own).__name__}, not a LogFile")
        super().__init__(path, dict(self._own.signals), doubled=set(self._own.doubled))
        for name, signal in self.signals.items():
            if not isinstance(signal, Signal) or signal.name != name or not 0 < len(name) <= LONGEST_NAME:
                raise self._wrong(f"gave a signal {str(name)[:40]!r} without a usable name")
        require_size(1, len(self.signals), path)
        self._take_over()

    def read(self, names: Iterable[str]) -> dict[str, Column]:
        """See `LogFile.read`."""
        wanted = list(dict.fromkeys(names))
        given = self._asked(self._own.read, wanted)
        out = {name: self._column(given, name) for name in wanted}
        for name, values in out.items():
            clock = self.signals[name].clock
            if values.size != self._rows.setdefault(clock, values.size):
                raise self._wrong(f"gave {values.size} and {self._rows[clock]} rows of one clock")
        require_size(max((v.size for v in out.values()), default=0), len(out), self.path)
        self._take_over()
        return out

    def stamps(self, clock: str) -> Column | None:
        """See `LogFile.stamps`."""
        given = self._asked(self._own.stamps, clock)
        self._take_over()
        found = None if given is None else self._column({"time": given}, "time")
        if found is not None and found.size != self._rows.get(clock, found.size):
            raise self._wrong(f"gave {found.size} times for {self._rows[clock]} rows")
        return found

    def clock_column(self, clock: str) -> str | None:
        """See `LogFile.clock_column`."""
        return self._asked(self._own.clock_column, clock)

    def place(self, row: int) -> str:
        """See `LogFile.place`."""
        return str(self._asked(self._own.place, row))

    def _take_over(self) -> None:
        """What a reader may learn only as it reads."""
        own = self._own
        self.notes, self.metadata = [str(note) for note in own.notes], own.metadata
        self.start_ns, self.truncated = int(own.start_ns), bool(own.truncated)

    def _column(self, given: dict[str, Column], name: str) -> Column:
        try:
            values = np.asarray(given[name], dtype=np.float64)
        except (KeyError, TypeError, ValueError):
            raise self._wrong(f"gave no numbers for {name!r}") from None
        if values.ndim != 1:
            raise self._wrong(f"gave {values.ndim} dimensions for {name!r}")
        return values

    def _asked(self, question: Callable[..., T], *of: Any) -> T:
        try:
            return question(*of)
        except (InputError, OSError, MemoryError):
            raise
        except Exception as error:
            brief = " ".join(str(error).split())[:120]
            raise self._wrong(f"stopped with {type(error).__name__}: {brief}") from None

    def _wrong(self, problem: str) -> InputError:
        problem = f"package {self._package}, which reads it, {problem}"
        return InputError(problem, where=self.path, mend="copy the file again, or mend the package")
