"""How a text is laid out: encoding, separator, decimal mark, titles, names, units, first row, stamps."""

from __future__ import annotations

import csv
import gzip
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import SNIFFED_BYTES
from fdd.errors import InputError
from fdd.logs.channel_map import CsvLayout
from fdd.logs.formats import readable
from fdd.measures import MEASURES, find_measure
from fdd.samples import Column

MISSING = ("", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "#N/A", "null", "NULL", "None", "--", "-")
_SEPARATORS = (";", "\t", ",", "|")
_SEP_LINE = re.compile(r"^\"?sep=(.)\"?$", re.IGNORECASE)
_NUMBER = re.compile(r"[-+]?(\d[\d.,' \u00a0\u202f]*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(inf|Inf|INF)(inity)?")
_UNIT_CELL = re.compile(r"^\s*[\[(].{0,20}[\])]\s*$")
_DIMENSIONS = ("pressure", "length", "angular_speed", "temperature", "current", "time", "voltage", "force")

_CLOCK = r"(?P<clock>\d{1,2}:\d\d(?::\d\d(?P<part>[.,]\d+)?)?)(?P<half> ?[AaPp][Mm])?"
_DAY = r"(?P<a>\d{1,4})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<c>\d{2,4})"
_STAMP = re.compile(rf"(?:{_DAY})?(?P<gap>[T ]|, )?(?:{_CLOCK})?(?P<zone> ?(?:Z|UTC|[+-]\d\d:?\d\d))?")
DAY_S = 86_400.0


def layout_of(path: Path, given: CsvLayout) -> tuple[Layout, str, bool]:
    """A file's layout as far as it is not given, its encoding, and whether it is packed by gzip. An
    InputError where it is no text, or has no rows of numbers below a header."""
    with path.open("rb") as source:
        head = source.read(SNIFFED_BYTES + 1)
    packed = head.startswith(b"\x1f\x8b")
    if packed:
        with readable("damaged gzip file", path), gzip.open(path, "rb") as unpacked:
            head = unpacked.read(SNIFFED_BYTES + 1)
    whole = len(head) <= SNIFFED_BYTES
    text, encoding = _decoded(head[:SNIFFED_BYTES], path, whole)
    lines = text.splitlines()[: None if whole else -1][: given.skip_rows + 400]
    found = find_layout(lines, given.delimiter, given.decimal, given.skip_rows)
    if found is None:
        raise _no_table(lines, given, path)
    return found, encoding, packed


def _decoded(head: bytes, where: Path, whole: bool) -> tuple[str, str]:
    """The text and its encoding: UTF-16 by its mark, UTF-8 where it is that, else Windows-1252."""
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return head.decode("utf-16", errors="replace").lstrip("\ufeff"), "utf-16"
    if b"\0" in head:
        mend = "give a log of a format that the README lists"
        raise InputError("of no known format, and no text", where=where, mend=mend)
    for cut in range(1 if whole else 4):  # the last character may be cut
        with suppress(UnicodeDecodeError):
            return head[: len(head) - cut].decode("utf-8-sig"), "utf-8"
    with suppress(UnicodeDecodeError):
        return head.decode("cp1252"), "cp1252"
    return head.decode("latin-1"), "latin-1"


def _no_table(lines: list[str], layout: CsvLayout, path: Path) -> InputError:
    for at, line in enumerate(lines[layout.skip_rows :], layout.skip_rows + 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if all(is_number(c) for c in line.split(layout.delimiter or ";" if ";" in line else ",")):
            problem = f"line {at}: no header row, it starts with numbers ({line[:40].strip()})"
            return InputError(problem, where=path, mend="put the column names into the first line")
        problem = "no rows of numbers below a header"
        return InputError(problem, where=path, mend="give a table with names in one row")
    return InputError("no header row", where=path, mend="the first row must name the columns")


@dataclass(frozen=True)
class Layout:
    """Where a table's parts stand; a unit is "" where there is none, `first_line` of the numbers from 0."""

    separator: str
    decimal: str
    names: list[str]
    units: list[str]
    first_line: int
    first_row: list[str]


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with whatever marks, or says that one is missing."""
    bare = cell.strip()
    return bare in MISSING or _NUMBER.fullmatch(bare) is not None


def _cells(line: str, separator: str) -> list[str]:
    """The cells of one line, without the blanks and quotes around them; none of a comment."""
    if not line.strip() or line.lstrip().startswith("#"):
        return []
    try:
        return [c.strip() for c in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except (csv.Error, StopIteration):
        return [c.strip() for c in line.split(separator)]


def find_layout(
    lines: Sequence[str], separator: str | None = None, decimal: str | None = None, skip: int = 0
) -> Layout | None:
    """The layout of a text file by its first lines; None where no row of numbers stands below a row of names.
    The first `skip` lines are no part of the table."""
    if separator is None:
        for k, line in enumerate(lines[skip : skip + 3], skip + 1):
            if (declared := _SEP_LINE.match(line.strip())) is not None:
                separator, skip = declared.group(1), k
                break
    best: Layout | None = None
    for one in [separator] if separator else _SEPARATORS:
        rows = [_cells(line, one) for line in lines]
        found = find_table(rows, skip)
        if found is not None and (best is None or len(found[0]) > len(best.names)):
            names, units, first = found
            mark = decimal or _decimal_of([c for row in rows[first : first + 50] for c in row], one)
            best = Layout(one, mark, names, units, first, rows[first])
    return best


def find_table(rows: Sequence[Sequence[str]], start: int = 0) -> tuple[list[str], list[str], int] | None:
    """Names, units and the index of the first row of numbers of a sheet of cells. An empty row is a line
    without cells; rows before `start` are no part of the table."""
    for k in range(start, len(rows)):
        if _is_data(rows[k]):
            above = [i for i in range(start, k) if rows[i]]
            found = _header(rows, above, len(rows[k]))
            if found is not None:
                return (*found, k)
            # Rows alike after it are numbers without a header; else it is a title that happens to be one.
            after = [r for r in rows[k + 1 : k + 4] if r]
            if above or all(len(r) == len(rows[k]) and _is_data(r) for r in after):
                return None
    return None


def _is_data(row: Sequence[str]) -> bool:
    """Whether at least half of the cells that are filled are numbers or stamps."""
    filled = [c for c in row if c.strip()]
    told = sum(is_number(c) or stamp_kind(c) != "" for c in filled)
    return bool(filled) and told >= (len(filled) + 1) // 2


def _header(
    rows: Sequence[Sequence[str]], above: Sequence[int], width: int
) -> tuple[list[str], list[str]] | None:
    """Names and units by the rows above the numbers, which have so many columns."""

    def to_width(row: Sequence[str]) -> list[str]:
        whole = [*row, *[""] * (width - len(row))]
        return whole if any(whole[width:]) else whole[:width]

    fitting = [i for i in above if abs(len(rows[i]) - width) <= 1 and not _is_data(rows[i])]
    if width == 1:
        fitting = fitting[-1:]
    if not fitting or fitting[-1] != above[-1]:
        return None
    last = list(rows[fitting[-1]])
    if len(fitting) > 1 and _is_units(last):
        names = to_width(rows[fitting[-2]])
        return names, to_width([c.strip("[]() ") for c in last])[: len(names)]
    names = to_width(last)
    return (names, [""] * len(names)) if any(c.strip() for c in last) else None


def _is_units(row: Sequence[str]) -> bool:
    """Whether most cells that say anything are units, as those of a row of names are not."""
    said = [c.strip() for c in row if c.strip() not in ("", "-")]
    units = [c for c in said if _UNIT_CELL.match(c) or _is_unit(c.strip("[]() "))]
    return bool(said) and len(units) >= 0.7 * len(said)


def _is_unit(text: str) -> bool:
    return text in MEASURES or any(find_measure(text, d) for d in _DIMENSIONS)


def _decimal_of(cells: Sequence[str], separator: str) -> str:
    """The decimal mark that most cells have, which are no stamps."""
    votes: Counter[str] = Counter()
    for cell in (c for c in cells if is_number(c) and not stamp_kind(c)):
        marks = re.sub("[^,.]", "", cell)
        if marks and (marks != "," or separator != ","):  # else thousands, in quotes
            last, other = marks[-1], "." if marks[-1] == "," else ","
            votes[last if marks.count(last) == 1 else other] += len(set(marks))
    return "," if votes[","] > votes["."] else "."


def stamp_kind(cell: str) -> str:
    """Whether a cell is a ``day``, a ``clock`` time, ``both``, or (empty) no stamp."""
    found = _STAMP.fullmatch(cell.strip())
    if found is None or not (found["a"] or found["clock"]):
        return ""
    return "clock" if not found["a"] else "both" if found["clock"] else "day"


def stamps_to_seconds(texts: Sequence[str | None]) -> tuple[Column, int, list[str]]:
    """Stamps that are written alike (the first tells how), as seconds since the first.

    Gives (n,) s, NaN where a stamp is missing (None) or written otherwise; ns since 1970 of the first (0
    without a date); notes.

    Examples
    --------
    >>> stamps_to_seconds(["04.03.2026 10:15:00,25", "04.03.2026 10:15:01"])[:2]
    (array([0.  , 0.75]), 1772619300250000000)
    >>> stamps_to_seconds(["23:59:59.5", "0:00:00.5"])[0].tolist()
    [0.0, 1.0]
    """
    import pandas as pd

    first = next((t for t in texts if t), "")
    found = _STAMP.fullmatch(first.strip())
    if found is None:
        return np.full(len(texts), np.nan), 0, []
    series: Any = pd.Series(list(texts), dtype="str").str.strip().str.replace(",", ".", regex=False)
    clock, half, zone = (found[name] or "" for name in ("clock", "half", "zone"))
    to_the_second = clock.count(":") == 2
    if found["a"] is None:
        elapsed = pd.to_timedelta(series if to_the_second else series + ":00", errors="coerce").to_numpy()
        seconds = elapsed.astype("timedelta64[ns]").astype(np.float64) * 1e-9
        seconds[np.isnat(elapsed)] = np.nan
        # A clock without a date begins again at midnight.
        back = np.nan_to_num(np.diff(seconds, prepend=seconds[:1])) < -0.5 * DAY_S
        seconds = seconds + DAY_S * np.cumsum(back)
        return seconds - np.nanmin(seconds), 0, []
    notes: list[str] = []
    order = ["%Y", "%m", "%d"]
    if len(found["a"]) != 4:
        # Whether 4/3 is the fourth of March: a dot is German, a slash tells by a number above twelve.
        day_first = True
        if found["mark"] == "/":
            parts = series.str.extract(r"^(\d{1,2})/(\d{1,2})/").astype("Float64").max()
            day_first = float(parts[0]) > 12
            if not day_first and not float(parts[1]) > 12:
                notes = [f"dates such as {found['a']}/{found['b']}/{found['c']} are read as month/day/year"]
        order = [*(("%d", "%m") if day_first else ("%m", "%d")), "%y" if len(found["c"]) == 2 else "%Y"]
    form = found["mark"].join(order)
    if clock:
        form += (found["gap"] or "").replace(",", ".") + ("%I" if half else "%H") + ":%M"
        form += ":%S" if to_the_second else ""
    after = f"{' ' * half.startswith(' ')}%p" if half else ""
    after += f"{' ' * zone.startswith(' ')}%z" if zone else ""
    read: Any = None
    # A logger leaves the parts of a second out where they are zero.
    for part in (".%f", "") if to_the_second else ("",):
        tried = pd.to_datetime(series, format=form + part + after, errors="coerce", utc=bool(zone))
        read = tried if read is None else read.fillna(tried)
    read = read.dt.tz_localize(None) if zone else read
    return *seconds_since(np.asarray(read.to_numpy(), dtype="datetime64[ns]")), notes


def seconds_since(stamps: NDArray[np.datetime64]) -> tuple[Column, int]:
    """Seconds since the first of (n,) stamps (NaN of NaT), and that one in ns since 1970 (0 without one)."""
    counted = stamps.astype("datetime64[ns]", copy=False).view(np.int64)
    missing = np.isnat(stamps)
    if missing.all():
        return np.full(stamps.size, np.nan), 0
    first = int(counted.min(where=~missing, initial=np.iinfo(np.int64).max))
    seconds: Column = (counted - first) * np.float64(1e-9)  # subtracted before floats lose the nanoseconds
    seconds[missing] = np.nan
    return seconds, first
