"""CSV in all its habits: any separator, decimal comma, thousands marks, titles, units row, dates, gzip."""

from __future__ import annotations

import gzip
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from fdd.bounds import limit, raised
from fdd.errors import InputError
from fdd.logs.channel_map import CsvLayout
from fdd.logs.formats import LogFile, Signal, readable, require_size
from fdd.logs.formats.arrow import doubles
from fdd.logs.formats.text_layout import MISSING, Layout, layout_of, stamp_kind, stamps_to_seconds
from fdd.samples import Column

_MARKS = ",.' \u00a0\u202f"
"""Between thousands."""


class _Bounded(gzip.GzipFile):
    """A packed file that says so when more comes out of it than is read."""

    def read(self, size: int | None = -1) -> bytes:
        data, most = super().read(size), limit("MAX_LOG_BYTES")
        if self.tell() > most:
            mend = f"split the log, {raised('MAX_LOG_BYTES', 2 * most)}"
            raise InputError(f"more than {most} bytes when unpacked", where=str(self.name), mend=mend)
        return data


@dataclass
class CsvFile(LogFile):
    """A CSV file whose layout and encoding are known; `packed` by gzip.

    `cells`: the columns in the order of the file, each with its first cell; a name that stands twice has its
    number behind it. `dated`: name of a joint column to those of its date and clock.
    """

    layout: Layout = field(kw_only=True)
    encoding: str = "utf-8"
    packed: bool = False
    cells: dict[str, str] = field(default_factory=dict)
    dated: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def place(self, row: int) -> str:
        return f"line {self.layout.first_line + 1 + row}"

    def read(self, names: Iterable[str]) -> dict[str, Column]:
        parts = {name: self.dated.get(name, (name,)) for name in names}
        stamped = {n for n in parts if n in self.dated or stamp_kind(self.cells[n])}
        columns = list(dict.fromkeys(c for of in parts.values() for c in of))
        texts = {c for n in stamped for c in parts[n]}
        with readable("not a table of numbers", self.path, "repair that row"):
            try:
                table = self._parsed(columns, texts)
            except pa.ArrowInvalid:  # a cell is no plain number
                texts = set(columns)
                table = self._parsed(columns, texts)
        if table.num_rows == 0:
            raise InputError("no rows below the header", where=self.path, mend="record at least 5 s")
        require_size(table.num_rows, len(columns), self.path)
        out: dict[str, Column] = {}
        for name, of in parts.items():
            if name in stamped:
                out[name] = self._dates([table.column(c).to_pylist() for c in of], name)
            elif name in texts:
                out[name] = self._cleaned(table.column(name), name)
            else:
                out[name] = doubles(table.column(name))
        return out

    def _parsed(self, columns: list[str], texts: set[str]) -> Any:
        odd: list[Any] = []

        def count_odd(row: Any) -> str:
            odd.append(row)
            return "skip" if len(odd) <= 1 else "error"

        packed: Any = _Bounded(self.path, "rb") if self.packed else None
        table = arrow_csv.read_csv(
            pa.PythonFile(packed, mode="r") if self.packed else self.path,
            read_options=arrow_csv.ReadOptions(
                column_names=list(self.cells), skip_rows=self.layout.first_line, encoding=self.encoding,
                use_threads=False, block_size=4 << 20,
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=self.layout.separator, invalid_row_handler=count_odd
            ),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=columns,
                column_types={c: pa.string() if c in texts else pa.float64() for c in columns},
                null_values=list(MISSING), strings_can_be_null=True, decimal_point=self.layout.decimal,
            ),
        )  # fmt: skip
        if odd:
            # One odd row is forgiven where it is the last: the logger was cut off while it wrote.
            row = odd[0]
            if row.number is not None and row.number != self.layout.first_line + table.num_rows + 1:
                counts = f"{row.actual_columns} cells where the header has {row.expected_columns}"
                problem, mend = f"line {row.number}: {counts}", "repair or remove that line"
                raise InputError(problem, where=self.path, mend=mend)
            note = f"the last line is incomplete and was left out (line {row.number})"
            self.notes += [note] if note not in self.notes else []
        return table

    def _dates(self, parts: list[list[str | None]], name: str) -> Column:
        """Stamps of the texts of a column, or of its date and clock."""
        texts = [None if None in cells else " ".join(map(str, cells)) for cells in zip(*parts, strict=True)]
        seconds, start, notes = stamps_to_seconds(texts)
        row = int(np.isnan(seconds).argmax()) if np.isnan(seconds).any() else -1
        if row >= 0 and texts[row]:
            raise self._no_number(row, name, str(texts[row]), "write all stamps alike")
        self.start_ns = self.start_ns or start
        self.notes += [n for n in notes if n not in self.notes]
        return seconds

    def _cleaned(self, column: Any, name: str) -> Column:
        """Numbers with thousands marks, or with blanks around them."""
        import pyarrow.compute as pc

        text, decimal = pc.utf8_trim_whitespace(column), self.layout.decimal
        for mark in _MARKS.replace(decimal, ""):
            form = f"^[-+]?\\d{{1,3}}([{mark}]\\d{{3}})+([{decimal}]\\d*)?$"
            grouped = pc.fill_null(pc.match_substring_regex(text, form), False)
            text = pc.if_else(grouped, pc.replace_substring(text, mark, ""), text)
        text = pc.replace_substring(text, decimal, ".")
        missing = pc.is_in(text, value_set=pa.array(MISSING))
        text = pc.if_else(missing, pa.scalar(None, pa.string()), text)
        try:
            return doubles(text.cast(pa.float64()))
        except pa.ArrowException:
            mend = "write numbers, and leave the cell empty where one is missing"
            for row, cell in enumerate(text.to_pylist()):
                try:
                    float(cell or 0)
                except ValueError:
                    raise self._no_number(row, name, str(column[row]), mend) from None
            raise InputError(f"column {name!r}: not numbers", where=self.path) from None

    def _no_number(self, row: int, name: str, cell: str, mend: str) -> InputError:
        problem = f"{self.place(row)}, column {name!r}: {cell[:40]!r} is not a number"
        return InputError(problem, where=self.path, mend=mend)


def open_csv(path: Path, layout: CsvLayout | None = None) -> CsvFile:
    """Detect encoding, separator, decimal mark, title lines, names and units of a CSV file. An InputError
    where its content is binary, it has no header row, or too many columns."""
    found, encoding, packed = layout_of(path, layout or CsvLayout())
    names = [n or f"column {k + 1}" for k, n in enumerate(found.names)]
    if names and not found.names[-1] and not found.first_row[-1]:
        names[-1] = ""  # a separator after the last cell of each row
    require_size(0, len(names), path)
    doubled = {n for n in names if names.count(n) > 1}
    keys = [n if n not in doubled else f"{n}\0{k}" for k, n in enumerate(names)]
    cells = dict(zip_longest(keys, found.first_row[: len(keys)], fillvalue=""))
    units = zip(keys, names, found.units, strict=True)
    signals = {k: Signal(k, unit=u or None) for k, n, u in units if n and n not in doubled}
    log = CsvFile(path, signals, doubled=doubled, layout=found, encoding=encoding, packed=packed, cells=cells)
    days, clocks = ([k for k, c in cells.items() if stamp_kind(c) == kind] for kind in ("day", "clock"))
    if len(days) == 1 and len(clocks) == 1:  # they make one column of stamps
        name = f"{days[0]} {clocks[0]}"
        log.dated[name] = (days[0], clocks[0])
        log.signals = {name: Signal(name), **log.signals}
    return log
