"""File formats of logs, told by what is in a file and not by what it is called: each a module that opens it
as signals with units and clocks.

Installed packages add others as entry points of the group ``fdd.log_formats`` (docs/extending.md).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fdd.bounds import FREELY_DECLARED_BYTES, LONGEST_NAME, MAX_SIGNALS, MOST_PACKING, limit, raised
from fdd.errors import InputError, did_you_mean, listed
from fdd.packages import LOG_FORMATS, Addition, additions, left_out
from fdd.samples import Column

if TYPE_CHECKING:
    from fdd.logs.channel_map import CsvLayout


@dataclass(frozen=True)
class Signal:
    """One signal of a log; signals of one `clock` have the same rows.

    `name`: as a channel map writes it; parts of a path are joined by ``/``, fields of a message by dots.
    `unit`: as the file declares it; None where it says nothing. `topic`, `field`: of a message.
    """

    name: str
    clock: str = ""
    unit: str | None = None
    topic: str | None = None
    field: str | None = None


@dataclass
class LogFile(ABC):
    """A file of signals, opened: what it holds is known, the numbers are read when they are asked for.

    `signals`: by name, in the order of the file. `notes`: what was odd, one line each. `start_ns`: ns since
    1970, of t = 0 of its clocks; 0 where the file has no date. `metadata`: record name to key-value pairs
    (MCAP). `truncated`: whether the file ends before its data does. `doubled`: names that stand twice; nobody
    can say which is meant.
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
        """Columns of signals by whole names, NaN where there is no value. Raises InputError: text, damage."""

    def stamps(self, clock: str) -> Column | None:
        """(n,) s of a clock's rows; None where the file does not tell: then a column has to be the time."""
        return None

    def place(self, row: int) -> str:
        """How a user finds row `row` (from 0) in the file."""
        return f"row {row}"

    def find(self, name: str) -> Signal:
        """The signal of this name, or of the only path that ends so. Raises InputError: none, or several."""
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


SNIFFED = 1024


@dataclass(frozen=True)
class Format:
    """One format: its name for people, and what its files are usually called.

    `sniff`: tells it by a file's first `SNIFFED` bytes (fewer of a shorter file). `opener`: takes a path and
    gives a `LogFile`; of ours ``module:function``, so that only what is needed is loaded. `extra`: of fdd,
    that installs what it needs; None where it is always there.
    """

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    opener: str | Callable[[Path], LogFile]
    extra: str | None = None


def _starts(*magic: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(magic)


_HDF5 = b"\x89HDF\r\n\x1a\n"
"""A MATLAB 7.3 file has it behind 512 bytes of its own."""
FORMATS: tuple[Format, ...] = (
    Format("MCAP", (".mcap",), _starts(b"\x89MCAP0\r\n"), "mcap:open_mcap"),
    Format("Parquet", (".parquet", ".pq"), _starts(b"PAR1"), "arrow:open_parquet"),
    Format("Feather", (".feather", ".arrow"), _starts(b"ARROW1"), "arrow:open_feather"),
    Format("HDF5", (".h5", ".hdf5", ".hdf"), lambda h: _HDF5 in (h[:8], h[512:520]), "hdf5:open_hdf5"),
    Format("MATLAB", (".mat",), _starts(b"MATLAB 5.0 MAT-file"), "matlab:open_matlab"),
    Format("MDF", (".mf4", ".mdf", ".dat"), _starts(b"MDF     ", b"UnFinMF "), "mdf:open_mdf", "mdf"),
    Format("TDMS", (".tdms",), _starts(b"TDSm"), "tdms:open_tdms"),
    Format("Excel", (".xlsx", ".xlsm"), _starts(b"PK\x03\x04"), "excel:open_excel"),
    Format("CSV", (".csv", ".txt", ".tsv", ".asc", ".csv.gz", ".txt.gz"), _starts(b""), "csv_file:open_csv"),
)
"""In the order in which they are tried: text is whatever is none of the others, nor of a package."""
_OTHERS = ((b"PK\x03\x04", "zip"), (b"\x28\xb5\x2f\xfd", "zstd"), (b"BZh", "bzip2"), (b"\xfd7zXZ", "xz"))


@cache
def _formats() -> tuple[Format, ...]:
    """Ours, and before text those of installed packages, each with its files checked."""
    added = []
    for addition in additions(LOG_FORMATS):
        try:
            given = addition.load()
            if not isinstance(given, Format) or not callable(given.opener):
                raise addition.wrong("is no Format with a function that opens a file")
        except InputError as error:
            left_out(error)
            continue
        opener = partial(_checked, package=addition.package, opener=given.opener)
        added.append(replace(given, sniff=partial(_told_by, addition, given), opener=opener))
    return (*FORMATS[:-1], *added, FORMATS[-1])


def _told_by(addition: Addition, given: Format, head: bytes) -> bool:
    try:
        return bool(given.sniff(head))
    except Exception as error:  # not every log may become unreadable
        left_out(addition.wrong(f"cannot tell its files ({type(error).__name__}: {error})"))
        return False


def suffixes() -> tuple[str, ...]:
    """What logs are called, of all formats."""
    return tuple(dict.fromkeys(s for f in _formats() for s in f.suffixes))


def open_log(path: str | Path, layout: CsvLayout | None = None) -> LogFile:
    """Open a log of any format; `layout` tells how a CSV file is written, where that is known. An InputError
    where there is no such file, it is damaged or of no known format, or what it needs is not installed."""
    path = Path(path)
    with told_with(path):
        found = format_of(path)
        if callable(found.opener):
            return found.opener(path)
        module, function = found.opener.split(":")
        try:
            opener = getattr(import_module(f"fdd.logs.formats.{module}"), function)
            return opener(path, layout) if found.name == "CSV" else opener(path)
        except ImportError as error:
            if found.extra is None:
                raise
            mend = f"pip install 'fdd[{found.extra}]'"
            raise InputError(f"{found.name} files need {error.name}", mend=mend) from None


def format_of(path: Path) -> Format:
    """The format of a file by its first bytes. Raises InputError: it is absent, empty, too large, packed."""
    if path.is_dir():
        raise InputError("is a folder, not a log", where=path, mend="give the files in it")
    if not path.is_file():
        raise InputError("no such file", where=path, mend="check the path")
    size = path.stat().st_size
    with path.open("rb") as source:
        head = source.read(SNIFFED)
    if size == 0:
        raise InputError("the file is empty", where=path, mend="record or copy it again")
    if size > (most := limit("MAX_LOG_BYTES")):
        mend = f"split the log, {raised('MAX_LOG_BYTES', size)}"
        raise InputError(f"{size} bytes, at most {most} are read", where=path, mend=mend)
    found, suffix = next(f for f in _formats() if f.sniff(head)), path.suffix.lower()
    for magic, what in _OTHERS:
        if head.startswith(magic) and suffix not in (".xlsx", ".xlsm"):
            raise InputError(f"is compressed ({what})", where=path, mend="unpack it first")
    # What is called a binary log and does not begin like one would only be told to be odd text.
    named = next((f for f in (*FORMATS, *_formats()) if suffix in f.suffixes), None)
    if found.name == "CSV" and named is not None and named is not found and suffix != ".dat":
        article = "an" if named.name in ("MCAP", "HDF5", "MDF", "Excel") else "a"
        problem = f"not {article} {named.name} file (wrong first bytes)"
        raise InputError(problem, where=path, mend="record or copy it again")
    return found


def _checked(path: Path, package: str, opener: Callable[[Path], LogFile]) -> LogFile:
    """The file that a package's `opener` gives, of which every answer is checked: what reads its columns
    relies on numbers, of one length for each clock and within the bounds (`fdd.bounds`).

    Raises InputError, as its methods do: whatever the package's code raises, and answers that nothing can be
    made of.
    """
    mend = "copy the file again, or mend the package"
    guarded = partial(readable, f"package {package}, which reads it, stopped", path, mend)
    rows: dict[str, int] = {}

    def column(values: Any, clock: str) -> Column:
        found = np.asarray(values, dtype=np.float64)
        if found.shape != (rows.setdefault(clock, found.size),):
            raise ValueError(f"numbers of shape {found.shape} on a clock of {rows[clock]} rows")
        return found

    @guarded()
    def read(names: Iterable[str]) -> dict[str, Column]:
        wanted = list(dict.fromkeys(names))
        given = own_read(wanted)
        out = {name: column(given[name], log.signals[name].clock) for name in wanted}
        require_size(max((v.size for v in out.values()), default=0), len(out), path)
        return out

    @guarded()
    def stamps(clock: str) -> Column | None:
        given = own_stamps(clock)
        return None if given is None else column(given, clock)

    with guarded():
        log = opener(path)
        if not isinstance(log, LogFile):
            raise TypeError(f"it gave a {type(log).__name__}, not a LogFile")
        for name, signal in log.signals.items():
            if not isinstance(signal, Signal) or signal.name != name or not 0 < len(name) <= LONGEST_NAME:
                raise ValueError(f"it gave a signal {str(name)[:40]!r} without a usable name")
    require_size(1, len(log.signals), path)
    own_read, own_stamps = log.read, log.stamps
    for method, checked in {"read": read, "stamps": stamps, "place": guarded()(log.place)}.items():
        setattr(log, method, checked)
    return log
