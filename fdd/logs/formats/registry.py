"""Which format a file has: by what is in it, not by what it is called."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from fdd.bounds import limit, raised
from fdd.errors import InputError
from fdd.logs.formats.added import added_formats
from fdd.logs.formats.signals import SNIFFED, Format, LogFile

if TYPE_CHECKING:
    from fdd.logs.channel_map import CsvLayout


def _starts(*magic: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(magic)


_HDF = b"\x89HDF\r\n\x1a\n"
FORMATS: tuple[Format, ...] = (
    Format("MCAP", (".mcap",), _starts(b"\x89MCAP0\r\n"), "mcap:open_mcap"),
    Format("Parquet", (".parquet", ".pq"), _starts(b"PAR1"), "arrow:open_parquet"),
    Format("Feather", (".feather", ".arrow"), _starts(b"ARROW1"), "arrow:open_feather"),
    # A MATLAB 7.3 file is HDF5 behind 512 bytes of its own.
    Format(
        "HDF5", (".h5", ".hdf5", ".hdf"), lambda head: _HDF in (head[:8], head[512:520]), "hdf5:open_hdf5"
    ),
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
    """Ours, and before text those of installed packages."""
    return (*FORMATS[:-1], *added_formats(), FORMATS[-1])


def suffixes() -> tuple[str, ...]:
    """What logs are called, of all formats."""
    return tuple(dict.fromkeys(s for f in _formats() for s in f.suffixes))


def open_log(path: str | Path, layout: CsvLayout | None = None) -> LogFile:
    """Open a log of any format.

    Parameters
    ----------
    layout : how a CSV file is written, where that is known.

    Raises
    ------
    InputError : one line: no such file, damaged, of no known format, or what it needs is not installed.
    """
    path = Path(path)
    found = format_of(path)
    try:
        if callable(found.opener):
            return found.opener(path)
        module, function = found.opener.split(":")
        opener = getattr(import_module(f"fdd.logs.formats.{module}"), function)
        return opener(path, layout) if found.name == "CSV" else opener(path)
    except ImportError as error:
        if found.extra is None:
            raise
        mend = f"pip install 'fdd[{found.extra}]'"
        raise InputError(f"{found.name} files need {error.name}", where=path, mend=mend) from None
    except InputError as error:
        raise (error if error.where == str(path) else error.at(path)) from None
    except OSError as error:
        raise InputError(f"cannot be read ({_brief(error)})", where=path) from None


def format_of(path: Path) -> Format:
    """The format of a file by its first bytes.

    Raises
    ------
    InputError : no file, an empty one, one that is too large, or packed.
    """
    if path.is_dir():
        raise InputError("is a folder, not a log", where=path, mend="give the files in it")
    if not path.is_file():
        raise InputError("no such file", where=path, mend="check the path")
    try:
        size = path.stat().st_size
        with path.open("rb") as source:
            head = source.read(SNIFFED)
    except OSError as error:
        raise InputError(f"cannot be read ({_brief(error)})", where=path) from None
    if size == 0:
        raise InputError("the file is empty", where=path, mend="record or copy it again")
    if size > (most := limit("MAX_LOG_BYTES")):
        mend = f"split the log, {raised('MAX_LOG_BYTES', size)}"
        raise InputError(f"{size} bytes, at most {most} are read", where=path, mend=mend)
    found = next(f for f in _formats() if f.sniff(head))
    for magic, what in _OTHERS:
        if head.startswith(magic) and path.suffix.lower() not in (".xlsx", ".xlsm"):
            raise InputError(f"is compressed ({what})", where=path, mend="unpack it first")
    # What is called a binary log and does not begin like one would only be told to be odd text.
    named = next((f for f in (*FORMATS, *_formats()) if path.suffix.lower() in f.suffixes), None)
    if found.name == "CSV" and named is not None and named is not found and path.suffix.lower() != ".dat":
        article = "an" if named.name in ("MCAP", "HDF5", "MDF", "Excel") else "a"
        problem = f"not {article} {named.name} file (wrong first bytes)"
        raise InputError(problem, where=path, mend="record or copy it again")
    return found


def _brief(error: OSError) -> str:
    return " ".join(str(error.strerror or error).split())[:120]
