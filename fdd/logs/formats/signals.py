"""An opened log: its signals, the unit that the file declares for each, and the clock that stamped them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import FREELY_DECLARED_BYTES, MAX_SIGNALS, MOST_PACKING, limit, raised
from fdd.errors import InputError, did_you_mean, listed
from fdd.samples import Column


@dataclass(frozen=True)
class Signal:
    """One signal of a log.

    Attributes
    ----------
    name : as a channel map writes it; parts of a path are joined by ``/``, fields of a message by dots.
    clock : signals of one clock have the same rows.
    unit : as the file declares it; None where it says nothing.
    topic, field : of a message; None elsewhere.
    """

    name: str
    clock: str = ""
    unit: str | None = None
    topic: str | None = None
    field: str | None = None


@dataclass
class LogFile(ABC):
    """A file of signals, opened: what it holds is known, the numbers are read when they are asked for.

    Attributes
    ----------
    signals : by name, in the order of the file.
    notes : what was odd, one line each.
    start_ns : ns since 1970, of t = 0 of its clocks; 0 where the file has no date.
    metadata : record name to key-value pairs (MCAP).
    truncated : whether the file ends before its data does.
    doubled : names that stand twice; nobody can say which is meant.
    """

    path: Path
    signals: dict[str, Signal] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    start_ns: int = 0
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: bool = False
    doubled: set[str] = field(default_factory=set)

    @abstractmethod
    def read(self, names: Iterable[str]) -> dict[str, Column]:
        """Columns of signals by their whole names, NaN where a value is missing.

        Raises InputError: a value is no number, or the file is damaged.
        """

    def stamps(self, clock: str) -> Column | None:
        """(n,) s of a clock's rows; None where the file does not tell: then a column has to be the time."""
        return None

    def place(self, row: int) -> str:
        """How a user finds row `row` (from 0) in the file."""
        return f"row {row}"

    def find(self, name: str) -> Signal:
        """The signal of this name; the last part of its path is enough where only one ends so.

        Raises InputError: no such signal, or several.
        """
        ends = [s for s in self.signals.values() if s.name.endswith(f"/{name}")]
        if name in self.doubled:
            problem, mend = f"column {name!r} stands twice in the header", "rename one"
        elif name in self.signals:
            return self.signals[name]
        elif len(ends) == 1:
            return ends[0]
        elif ends:
            problem = f"{len(ends)} columns are called {name!r}"
            mend = f"write one of: {listed(s.name for s in ends)}"
        else:
            problem = f"no column {name!r}{did_you_mean(name, self.signals)}"
            mend = f"the file has: {listed(self.signals) or 'none'}"
        raise InputError(problem, where=self.path, mend=mend)


def require_size(rows: int, columns: int, where: Path) -> None:
    """Refuse more numbers than are held (`fdd.bounds`), before they are read; `InputError` names both."""
    most, needed = limit("MAX_VALUES"), rows * max(columns, 1)
    if columns > MAX_SIGNALS:
        raise InputError(f"{columns} columns, at most {MAX_SIGNALS} are read", where=where, mend="split it")
    if needed > most:
        problem = f"{rows} rows and {columns} columns, at most {most} numbers are read"
        raise InputError(problem, where=where, mend=f"split it, {raised('MAX_VALUES', needed)}")


def require_stored(declared: int, stored: int, where: Path) -> None:
    """Refuse arrays that a damaged head declares far larger (bytes) than what is stored could unpack to."""
    if declared > max(FREELY_DECLARED_BYTES, MOST_PACKING * stored):
        problem = f"damaged: declares {declared} bytes of numbers and holds {stored}"
        raise InputError(problem, where=where, mend="copy it again")


def unit_among(attributes: Mapping[Any, Any]) -> str | None:
    """The unit in a signal's attributes, texts or bytes, by the keys that writers use."""

    def text(value: Any) -> str:
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)

    return next((text(v) for k, v in attributes.items() if text(k).lower() in ("unit", "units")), None)


@contextmanager
def readable(what: str, where: Path, mend: str = "copy it again") -> Iterator[None]:
    """Whatever a library raises of a damaged file as one line with its beginning; what is ours passes."""
    try:
        yield
    except (InputError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a library's panic in Rust is no Exception
        brief = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{what} ({brief})", where=where, mend=mend) from None


@contextmanager
def told_with(path: Path) -> Iterator[None]:
    """Refusals name the file, those of the system too."""
    try:
        yield
    except InputError as error:
        raise (error if error.where == str(path) else error.at(path)) from None
    except OSError as error:
        brief = " ".join(str(error.strerror or error).split())[:120]
        raise InputError(f"cannot be read ({brief})", where=path) from None


def seconds_since(stamps: NDArray[np.datetime64]) -> tuple[Column, int]:
    """Seconds since the first of (n,) stamps (NaN of NaT), and that stamp in ns since 1970 (0 without one).

    Examples
    --------
    >>> seconds_since(np.array(["1970-01-01T00:00:01.5", "1970-01-01T00:00:02"], "datetime64[ns]"))
    (array([0. , 0.5]), 1500000000)
    """
    counted = stamps.astype("datetime64[ns]", copy=False).view(np.int64)
    missing = np.isnat(stamps)
    if missing.all():
        return np.full(stamps.size, np.nan), 0
    first = int(counted.min(where=~missing, initial=np.iinfo(np.int64).max))
    seconds: Column = (counted - first) * np.float64(1e-9)  # subtracted before floats lose the nanoseconds
    seconds[missing] = np.nan
    return seconds, first


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
