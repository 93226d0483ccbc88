"""CSV and Parquet: named columns of numbers, with the layout of a CSV file detected."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.channel_map import CsvLayout
from fdd.logs.near_misses import did_you_mean, listed

if TYPE_CHECKING:
    import pyarrow

Column = NDArray[np.float64]

SNIFFED_BYTES = 262_144
MAX_COLUMNS = 4096
MAX_ROWS = 400_000_000
_MISSING = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "#N/A", "null", "NULL", "None"]
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
_ZONE = re.compile(r"(Z|[+-]\d\d:?\d\d)$")


class Table(Protocol):
    """A file of named columns."""

    names: list[str]
    notes: list[str]

    def read(self, wanted: Iterable[str]) -> dict[str, Column]:
        """The columns as float64; NaN where a cell is empty."""

    def place(self, row: int) -> str:
        """How a user finds row `row` (from 0) in the file."""


def require_columns(names: list[str], wanted: Iterable[str], where: Path, key: str = "column") -> None:
    """Refuse a name that the file does not have, or has twice."""
    for name in wanted:
        if names.count(name) == 1:
            continue
        if name in names:
            raise InputError(f"{key} {name!r} stands twice in the header", where=where, mend="rename one")
        raise InputError(
            f"no {key} {name!r}{did_you_mean(name, names)}",
            where=where,
            mend=f"the file has: {listed(names)}",
        )


@dataclass
class CsvTable:
    """A CSV file; `header_line` counts from 1."""

    path: Path
    names: list[str]
    delimiter: str
    decimal: str
    header_line: int
    encoding: str
    first_row: list[str]
    notes: list[str] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path, layout: CsvLayout | None = None) -> CsvTable:
        """Detect delimiter, decimal mark, encoding and header of a CSV file.

        Raises
        ------
        InputError : binary content, no header row, or too many columns.
        """
        layout = layout or CsvLayout()
        with path.open("rb") as source:
            head = source.read(SNIFFED_BYTES)
        text, encoding = _decoded(head, path)
        lines = text.splitlines()
        at = layout.skip_rows
        while at < len(lines) and (not lines[at].strip() or lines[at].lstrip().startswith("#")):
            at += 1
        if at >= len(lines):
            raise InputError("no header row", where=path, mend="the first row must name the columns")
        delimiter = layout.delimiter or _delimiter_of(lines[at])
        names = _cells(lines[at], delimiter)
        following = [line for line in lines[at + 1 : at + 51] if line.strip()]
        rows = [_cells(line, delimiter) for line in following]
        if len(names) > MAX_COLUMNS:
            raise InputError(f"{len(names)} columns, at most {MAX_COLUMNS} are read", where=path)
        if all(_is_number(c) for c in names):
            raise InputError(
                f"line {at + 1}: no header row, it starts with numbers ({lines[at][:40].strip()})",
                where=path,
                mend="put the column names into the first line",
            )
        if rows and len(rows[0]) == len(names) + 1 and not rows[0][-1]:
            names = [*names, ""]  # a delimiter after the last cell of each row
        decimal = layout.decimal or _decimal_of(rows, delimiter)
        return cls(path, names, delimiter, decimal, at + 1, encoding, rows[0] if rows else [])

    def place(self, row: int) -> str:
        """The line of row `row`."""
        return f"line {self.header_line + 1 + row}"

    def read(self, wanted: Iterable[str]) -> dict[str, Column]:
        """Read columns; a cell that is no number is named by line and column."""
        import pyarrow as pa

        wanted = list(dict.fromkeys(wanted))
        require_columns(self.names, wanted, self.path)
        types: dict[str, Any] = {name: self._type_of(name) for name in wanted}
        try:
            table = self._parsed(wanted, types)
        except pa.ArrowInvalid as error:
            raise self._explained(wanted, str(error)) from None
        except (pa.ArrowException, UnicodeError, MemoryError) as error:
            raise InputError(f"cannot be read ({str(error)[:120]})", where=self.path) from None
        if table.num_rows == 0:
            raise InputError("no rows below the header", where=self.path, mend="record at least 5 s")
        return {name: as_numbers(table.column(name), name, self.path) for name in wanted}

    def _type_of(self, name: str) -> Any:
        import pyarrow as pa

        at = self.names.index(name)
        first = self.first_row[at] if at < len(self.first_row) else ""
        if not _DATE.match(first):
            return pa.float64()
        return pa.timestamp("ns", tz="UTC" if _ZONE.search(first) else None)

    def _parsed(self, wanted: list[str], types: dict[str, Any]) -> pyarrow.Table:
        from pyarrow import csv as arrow_csv

        odd: list[Any] = []

        def count_odd(row: Any) -> str:
            odd.append(row)
            return "skip" if len(odd) <= 1 else "error"

        unique = [n if self.names.count(n) == 1 else f"{n}\0{i}" for i, n in enumerate(self.names)]
        table = arrow_csv.read_csv(
            self.path,
            read_options=arrow_csv.ReadOptions(
                column_names=unique,
                skip_rows=self.header_line,
                encoding=self.encoding,
                use_threads=False,
                block_size=4 << 20,
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=self.delimiter, invalid_row_handler=count_odd),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=wanted,
                column_types=types,
                null_values=_MISSING,
                strings_can_be_null=False,
                decimal_point=self.decimal,
            ),
        )
        if odd:
            # One odd row is forgiven where it is the last: the logger was cut off while it wrote.
            row = odd[0]
            if row.number is not None and row.number != self.header_line + table.num_rows + 1:
                counts = f"{row.actual_columns} cells where the header has {row.expected_columns}"
                raise InputError(
                    f"line {row.number}: {counts}",
                    where=self.path,
                    mend="repair or remove that line",
                )
            note = f"the last line is incomplete and was left out (line {row.number})"
            if note not in self.notes:
                self.notes.append(note)
        return table

    def _explained(self, wanted: list[str], message: str) -> InputError:
        """Find the cell that is no number: a second pass, on the way out only."""
        import pyarrow as pa

        try:
            table = self._parsed(wanted, {name: pa.string() for name in wanted})
        except InputError as error:
            return error
        except (pa.ArrowException, UnicodeError):
            brief = " ".join(message.split())[:160]
            return InputError(f"not a table of numbers ({brief})", where=self.path, mend="repair that row")
        first: tuple[int, str, str] | None = None
        for name in wanted:
            for row, cell in enumerate(table.column(name).to_pylist()):
                if not self._readable(cell, pa.types.is_timestamp(self._type_of(name))):
                    if first is None or row < first[0]:
                        first = (row, name, cell)
                    break
        if first is None:
            return InputError(f"not numbers ({' '.join(message.split())[:160]})", where=self.path)
        row, name, cell = first
        return InputError(
            f"{self.place(row)}, column {name!r}: {cell[:40]!r} is not a number",
            where=self.path,
            mend="write numbers, and leave the cell empty where one is missing",
        )

    def _readable(self, cell: str | None, dated: bool) -> bool:
        if dated and cell is not None and _DATE.match(cell):
            return True
        return cell is None or cell in _MISSING or _is_number(cell.replace(self.decimal, "."))


@dataclass
class ParquetTable:
    """A Parquet file with flat columns of numbers."""

    path: Path
    names: list[str]
    notes: list[str] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path) -> ParquetTable:
        """Read the schema.

        Raises
        ------
        InputError : damaged file, no rows, or far too many.
        """
        import pyarrow as pa
        from pyarrow import parquet

        try:
            with parquet.ParquetFile(path) as source:
                names, rows = list(source.schema_arrow.names), source.metadata.num_rows
        except (pa.ArrowException, OSError) as error:
            brief = " ".join(str(error).split())[:120]
            raise InputError(f"not readable as Parquet ({brief})", where=path, mend="copy it again") from None
        if rows == 0:
            raise InputError("no rows", where=path, mend="record at least 5 s")
        if rows > MAX_ROWS or len(names) > MAX_COLUMNS:
            raise InputError(
                f"{rows} rows and {len(names)} columns, at most {MAX_ROWS} and {MAX_COLUMNS} are read",
                where=path,
                mend="split it",
            )
        return cls(path, names)

    def place(self, row: int) -> str:
        """The row, counted from 0 as data frames do."""
        return f"row {row}"

    def read(self, wanted: Iterable[str]) -> dict[str, Column]:
        """Read columns; NaN where a value is null."""
        import pyarrow as pa
        from pyarrow import parquet

        wanted = list(dict.fromkeys(wanted))
        require_columns(self.names, wanted, self.path)
        try:
            with parquet.ParquetFile(self.path) as source:
                table = source.read(columns=wanted)
        except (pa.ArrowException, OSError, MemoryError) as error:
            brief = " ".join(str(error).split())[:120]
            raise InputError(
                f"damaged Parquet file ({brief})", where=self.path, mend="copy it again"
            ) from None
        return {name: as_numbers(table.column(name), name, self.path) for name in wanted}


def as_numbers(column: Any, name: str, where: Path) -> Column:
    """An Arrow column as float64: null becomes NaN, dates become seconds since the first."""
    import pyarrow as pa
    import pyarrow.compute as pc

    try:
        if pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type):
            nanoseconds = column.cast(
                pa.duration("ns") if pa.types.is_duration(column.type) else pa.timestamp("ns", column.type.tz)
            ).cast(pa.int64())
            # Seconds after the first stamp, before the floats lose the nanoseconds.
            first = pc.min(nanoseconds)
            return np.asarray(pc.subtract(nanoseconds, first).cast(pa.float64()).to_numpy()) * 1e-9
        if any(
            test(column.type)
            for test in (pa.types.is_string, pa.types.is_large_string, pa.types.is_dictionary)
        ):
            raise InputError(
                f"column {name!r} holds text, not numbers", where=where, mend="store it as numbers"
            )
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.int8())
        return np.array(column.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)
    except pa.ArrowException:
        raise InputError(f"column {name!r} holds {column.type}, not numbers", where=where) from None


def _decoded(head: bytes, where: Path) -> tuple[str, str]:
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return head.decode("utf-16", errors="replace").lstrip("\ufeff"), "utf-16"
    if b"\0" in head:
        raise InputError(
            "neither MCAP, nor Parquet, nor text", where=where, mend="give an MCAP, Parquet or CSV file"
        )
    try:
        # A character may be cut in two at the end of what was read.
        return head.decode("utf-8-sig", errors="strict" if len(head) < SNIFFED_BYTES else "ignore"), "utf-8"
    except UnicodeDecodeError:
        return head.decode("latin-1"), "latin-1"


def _delimiter_of(header: str) -> str:
    bare = re.sub(r'"[^"]*"', "", header)
    for candidate in (";", "\t", ",", "|"):
        if candidate in bare:
            return candidate
    return ","


def _decimal_of(rows: list[list[str]], delimiter: str) -> str:
    if delimiter == ",":
        return "."
    cells = [c for row in rows for c in row]
    return "," if any(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", c) for c in cells) else "."


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    except (csv.Error, StopIteration):
        return [cell.strip() for cell in line.split(delimiter)]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
