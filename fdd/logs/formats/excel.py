"""Excel workbooks: each sheet with a row of names above numbers is a group of signals."""

from __future__ import annotations

import re
import zipfile
from datetime import date, datetime, time, timedelta
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
import python_calamine
from numpy.typing import NDArray

from fdd.bounds import HEAD_ROWS, MAX_CELLS, MAX_WORKBOOK_BYTES, MAX_WORKBOOK_UNPACKED
from fdd.errors import InputError
from fdd.logs.formats import readable, require_size
from fdd.logs.formats.text_layout import find_table, is_number
from fdd.logs.formats.trees import Group, Leaf, TreeFile, tree_file

_PLACE = re.compile(rb"""\br\s*=\s*["']([A-Za-z]{0,4})(\d{0,9})["']""")
"""Where a cell or row stands."""


def open_excel(path: Path) -> TreeFile:
    """Signals of a workbook: the column's name, with the sheet's before it where there are several.

    Raises InputError: damaged, too large, or without a table of numbers.
    """
    if path.stat().st_size > MAX_WORKBOOK_BYTES:
        raise InputError(f"larger than {MAX_WORKBOOK_BYTES} bytes", where=path, mend="save it as CSV")
    tables = {}
    with readable("not readable as Excel", path, "save it again"):
        _require_bounded(path)
        book = python_calamine.CalamineWorkbook.from_path(str(path))
        for name in book.sheet_names:
            rows = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            if (found := _table(path, rows)) is not None:
                tables[name] = found
    if not tables:
        problem = "no sheet has a row of names above rows of numbers"
        raise InputError(problem, where=path, mend="put the names into one row")
    alone = len(tables) == 1
    return tree_file(path, {"" if alone else name: Group(leaves) for name, leaves in tables.items()})


def _require_bounded(path: Path) -> None:
    """Refuse what would take all memory: the library lays a sheet out in full up to its last cell."""
    left = MAX_WORKBOOK_UNPACKED
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            rows, columns, tail = 0, 0, b""
            with archive.open(entry) as part:
                while block := part.read(1 << 20):
                    left -= len(block)
                    if left < 0:
                        problem = f"more than {MAX_WORKBOOK_UNPACKED} bytes unpacked"
                        raise InputError(problem, where=path, mend="save it as CSV")
                    if "sheet" not in entry.filename.lower():
                        continue
                    for letters, digits in _PLACE.findall(tail + block):
                        rows = max(rows, int(digits or 0))
                        number = reduce(lambda n, letter: 26 * n + letter - 64, letters.upper(), 0)
                        columns = max(columns, number)
                    tail = block[-40:]
            if rows * columns > MAX_CELLS:
                problem = f"a sheet of {rows} rows and {columns} columns, at most {MAX_CELLS} cells are read"
                raise InputError(problem, where=path, mend="remove stray cells, or save it as CSV")


def _table(path: Path, rows: list[list[Any]]) -> dict[str, Leaf] | None:
    texts = [[_text(c) for c in row] for row in rows[:HEAD_ROWS]]
    found = find_table([row if any(row) else [] for row in texts])
    if found is None:
        return None
    names, units, first = found
    data = rows[first:]
    while data and not any(c not in ("", None) for c in data[-1]):
        data.pop()
    require_size(len(data), len(names), path)
    leaves = {}
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        if name:
            values = [row[k] if k < len(row) else "" for row in data]
            leaves[name] = Leaf(len(values), partial(_numbers, values), unit or None)
    return leaves


def _text(cell: Any) -> str:
    if isinstance(cell, int | float):
        return repr(float(cell))
    if isinstance(cell, date | time | timedelta):
        return "2000-01-01 00:00:00"
    return str(cell).strip()


def _numbers(values: list[Any]) -> NDArray[np.generic]:
    first = next((v for v in values if v not in ("", None)), "")
    if isinstance(first, date):
        return np.array([v if isinstance(v, date) else "NaT" for v in values], dtype="datetime64[ns]")
    if isinstance(first, time):
        values = [datetime.combine(date.min, v) - datetime.min if isinstance(v, time) else v for v in values]
    if isinstance(first, time | timedelta):
        return np.array([v.total_seconds() if isinstance(v, timedelta) else np.nan for v in values])
    return np.array([_number(v) for v in values])


def _number(value: Any) -> float:
    if isinstance(value, int | float):
        return float(value)
    text = str(value).strip().replace(",", ".")
    return float(text) if text and is_number(text) and text[0] in "+-.0123456789" else np.nan
