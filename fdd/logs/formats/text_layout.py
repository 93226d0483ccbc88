"""How a text is laid out: encoding, separator, decimal mark, titles, names, units, first row of numbers."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fdd.bounds import SNIFFED_BYTES
from fdd.errors import InputError
from fdd.logs.formats.dates import stamp_kind
from fdd.logs.formats.signals import damaged
from fdd.measures import MEASURES, find_measure

MISSING = ("", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "#N/A", "null", "NULL", "None", "--", "-")
_SEPARATORS = (";", "\t", ",", "|")
_SEP_LINE = re.compile(r"^\"?sep=(.)\"?$", re.IGNORECASE)
_NUMBER = re.compile(r"[-+]?(\d[\d.,' \u00a0\u202f]*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(inf|Inf|INF)(inity)?")
_GROUPED = {
    ",": re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d*|[-+]?\d{1,3}(,\d{3}){2,}"),
    ".": re.compile(r"[-+]?\d{1,3}(\.\d{3})+,\d*|[-+]?\d{1,3}(\.\d{3}){2,}"),
}
_UNIT_CELL = re.compile(r"^\s*[\[(].{0,20}[\])]\s*$")


def head_of(path: Path) -> tuple[bytes, bool, bool]:
    """The first bytes, unpacked; whether the file is packed; whether these are all."""
    import gzip
    import zlib

    with path.open("rb") as source:
        head = source.read(SNIFFED_BYTES + 1)
    if not head.startswith(b"\x1f\x8b"):
        return head[:SNIFFED_BYTES], False, len(head) <= SNIFFED_BYTES
    try:
        with gzip.open(path, "rb") as packed:
            head = packed.read(SNIFFED_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise damaged("damaged gzip file", path, error) from None
    return head[:SNIFFED_BYTES], True, len(head) <= SNIFFED_BYTES


def decoded(head: bytes, where: Path, whole: bool) -> tuple[str, str]:
    """The text and its encoding: UTF-16 by its mark, UTF-8 where it is that, else Windows-1252.

    Raises
    ------
    InputError : no text.
    """
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return head.decode("utf-16", errors="replace").lstrip("\ufeff"), "utf-16"
    if b"\0" in head:
        raise InputError(
            "of no known format, and no text",
            where=where,
            mend="give a log of a format that the README lists",
        )
    for cut in range(1 if whole else 4):  # the last character may be cut
        with suppress(UnicodeDecodeError):
            return head[: len(head) - cut].decode("utf-8-sig"), "utf-8"
    with suppress(UnicodeDecodeError):
        return head.decode("cp1252"), "cp1252"
    return head.decode("latin-1"), "latin-1"


@dataclass(frozen=True)
class Layout:
    """Where a table's parts stand.

    Attributes
    ----------
    separator, decimal : one character each.
    names, units : of the columns; a unit is "" where there is none.
    first_line : index of the first line of numbers, from 0.
    first_row : its cells.
    """

    separator: str
    decimal: str
    names: list[str]
    units: list[str]
    first_line: int
    first_row: list[str]


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with whatever marks, or says that one is missing.

    Examples
    --------
    >>> [is_number(c) for c in ("1.234,5", "-3e-4", "", "NaN", "Druck", "1/min")]
    [True, True, True, True, False, False]
    """
    bare = cell.strip()
    return bare in MISSING or _NUMBER.fullmatch(bare) is not None


def cells_of(line: str, separator: str) -> list[str]:
    """The cells of one line, without the blanks and quotes around them.

    Examples
    --------
    >>> cells_of('a, "b,c" ,d', ",")
    ['a', 'b,c', 'd']
    """
    try:
        return [c.strip() for c in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except (csv.Error, StopIteration):
        return [c.strip() for c in line.split(separator)]


def find_layout(
    lines: Sequence[str], separator: str | None = None, decimal: str | None = None, skip: int = 0
) -> Layout | None:
    """The layout of a text file by its first lines; None where no row of numbers stands below a row of names.

    Parameters
    ----------
    lines : the first some hundred lines. separator, decimal : where they are known.
    skip : lines that are no part of the table.

    Examples
    --------
    >>> found = find_layout(["Bench 3", "t;Druck A", "s;bar", "0,0;1,5", "0,1;1,6"])
    >>> found.names, found.units, found.decimal, found.first_line
    (['t', 'Druck A'], ['s', 'bar'], ',', 3)
    """
    start = skip
    if separator is None:
        for k in range(start, min(start + 3, len(lines))):
            if (declared := _SEP_LINE.match(lines[k].strip())) is not None:
                separator, start = declared.group(1), k + 1
                break
    tried = [separator] if separator else _SEPARATORS
    best: tuple[int, Layout] | None = None
    for one in tried:
        rows = [
            [] if not line.strip() or line.lstrip().startswith("#") else cells_of(line, one) for line in lines
        ]
        found = find_table(rows, start)
        if found is None:
            continue
        names, units, first = found
        mark = decimal or _decimal_of([c for row in rows[first : first + 50] for c in row], one)
        layout = Layout(one, mark, names, units, first, rows[first])
        if best is None or len(names) > best[0]:
            best = (len(names), layout)
    return None if best is None else best[1]


def find_table(rows: Sequence[Sequence[str]], start: int = 0) -> tuple[list[str], list[str], int] | None:
    """Names, units and the index of the first row of numbers of a sheet of cells.

    Parameters
    ----------
    rows : cells; an empty list is a line without any.
    start : rows before are no part of the table.

    Examples
    --------
    >>> find_table([["t", "p [bar]"], ["0", "1"], ["1", "2"]])
    (['t', 'p [bar]'], ['', ''], 1)
    """
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
    filled = [c for c in row if c.strip()]
    return bool(filled) and sum(is_number(c) or stamp_kind(c) != "" for c in filled) >= max(
        1, (len(filled) + 1) // 2
    )


def _header(
    rows: Sequence[Sequence[str]], above: Sequence[int], width: int
) -> tuple[list[str], list[str]] | None:
    fitting = [i for i in above if abs(len(rows[i]) - width) <= 1 and not _is_data(rows[i])]
    if width == 1:
        fitting = fitting[-1:]
    if not fitting or fitting[-1] != above[-1]:
        return None
    last = list(rows[fitting[-1]])
    if len(fitting) > 1 and _is_units(last):
        names = _to_width(rows[fitting[-2]], width)
        return names, _to_width([c.strip("[]() ") for c in last], len(names))[: len(names)]
    names = _to_width(last, width)
    return (names, [""] * len(names)) if any(c.strip() for c in last) else None


def _to_width(row: Sequence[str], width: int) -> list[str]:
    whole = [*row, *[""] * (width - len(row))]
    return whole if any(whole[width:]) else whole[:width]


def _is_units(row: Sequence[str]) -> bool:
    """Whether all cells that say anything are units, as no row of names is."""
    said = [c.strip() for c in row if c.strip() not in ("", "-")]
    dimensions = ("pressure", "length", "angular_speed", "temperature", "current", "time", "voltage", "force")
    bare = [c.strip("[]() ") for c in said if not _UNIT_CELL.match(c)]
    odd = [c for c in bare if c not in MEASURES and not any(find_measure(c, d) for d in dimensions)]
    return bool(said) and len(said) - len(odd) >= 0.7 * len(said)


def _decimal_of(cells: Sequence[str], separator: str) -> str:
    votes: Counter[str] = Counter()
    for cell in cells:
        if stamp_kind(cell):
            continue
        if _GROUPED[","].fullmatch(cell):
            votes["."] += 2
        elif _GROUPED["."].fullmatch(cell) or (
            separator != "," and re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell)
        ):
            votes[","] += 1
        elif "." in cell:
            votes["."] += 1
    return "," if votes[","] > votes["."] else "."
