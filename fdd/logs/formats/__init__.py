"""Which format a file has, by what is in it, not by what it is called; those of installed packages too."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fdd.bounds import LONGEST_NAME, limit, raised
from fdd.errors import InputError
from fdd.logs.formats.signals import SNIFFED, Format, LogFile, Signal, require_size, told_with
from fdd.packages import LOG_FORMATS, Addition, additions, left_out
from fdd.samples import Column

if TYPE_CHECKING:
    from fdd.logs.channel_map import CsvLayout


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
        opener = partial(CheckedLog, package=addition.package, opener=given.opener)
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
    """Open a log of any format; `layout` tells how a CSV file is written, where that is known.

    Raises InputError: one line: no such file, damaged, of no known format, or what it needs is not installed.
    """
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
    """The format of a file by its first bytes.

    Raises InputError: no file, an empty one, one that is too large, or packed.
    """
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


class CheckedLog(LogFile):
    """The file at `path` that a package's `opener` gives, of which every answer is checked.

    A package's code can do anything; what reads its columns relies on numbers, of one length for each clock
    and within the bounds (`fdd.bounds`).

    Raises InputError: from here and from all methods: whatever the package's code raises, and answers that
    nothing can be made of.
    """

    def __init__(self, path: Path, package: str, opener: Callable[[Path], LogFile]) -> None:
        super().__init__(path)
        self._package, self._rows = package, dict[str, int]()
        self._own: Any = None
        self._own = self._asked(opener, path)
        if not isinstance(self._own, LogFile):
            raise self._wrong(f"gave a {type(self._own).__name__}, not a LogFile")
        self.signals, self.doubled = dict(self._own.signals), set(self._own.doubled)
        for name, signal in self.signals.items():
            if not isinstance(signal, Signal) or signal.name != name or not 0 < len(name) <= LONGEST_NAME:
                raise self._wrong(f"gave a signal {str(name)[:40]!r} without a usable name")
        require_size(1, len(self.signals), path)

    def read(self, names: Iterable[str]) -> dict[str, Column]:
        wanted = list(dict.fromkeys(names))
        given = self._asked(self._own.read, wanted)
        out = {name: self._column(given, name) for name in wanted}
        for name, values in out.items():
            clock = self.signals[name].clock
            if values.size != self._rows.setdefault(clock, values.size):
                raise self._wrong(f"gave {values.size} and {self._rows[clock]} rows of one clock")
        require_size(max((v.size for v in out.values()), default=0), len(out), self.path)
        return out

    def stamps(self, clock: str) -> Column | None:
        given = self._asked(self._own.stamps, clock)
        found = None if given is None else self._column({"time": given}, "time")
        if found is not None and found.size != self._rows.get(clock, found.size):
            raise self._wrong(f"gave {found.size} times for {self._rows[clock]} rows")
        return found

    def place(self, row: int) -> str:
        return str(self._asked(self._own.place, row))

    def _column(self, given: dict[str, Column], name: str) -> Column:
        try:
            values = np.asarray(given[name], dtype=np.float64)
        except (KeyError, TypeError, ValueError):
            raise self._wrong(f"gave no numbers for {name!r}") from None
        if values.ndim != 1:
            raise self._wrong(f"gave {values.ndim} dimensions for {name!r}")
        return values

    def _asked(self, question: Callable[..., Any], *of: Any) -> Any:
        own: Any = self._own
        try:
            answer = question(*of)
            if own is not None:  # what a reader may learn only as it reads
                self.notes, self.metadata = [str(note) for note in own.notes], own.metadata
                self.start_ns, self.truncated = int(own.start_ns), bool(own.truncated)
            return answer
        except (InputError, OSError, MemoryError):
            raise
        except Exception as error:
            brief = " ".join(str(error).split())[:120]
            raise self._wrong(f"stopped with {type(error).__name__}: {brief}") from None

    def _wrong(self, problem: str) -> InputError:
        problem = f"package {self._package}, which reads it, {problem}"
        return InputError(problem, where=self.path, mend="copy the file again, or mend the package")
