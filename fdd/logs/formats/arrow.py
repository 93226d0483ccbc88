"""Parquet and Feather (Arrow IPC): flat columns of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from fdd.errors import InputError
from fdd.logs.formats import LogFile, Signal, readable, require_size, unit_among
from fdd.logs.formats.text_layout import seconds_since
from fdd.samples import Column

BATCH_ROWS = 1 << 16
"""Rows that are held by Arrow and as columns at once."""


@dataclass
class ArrowFile(LogFile):
    """A file that pyarrow reads by column; `rows` as it declares them."""

    kind: str = "Parquet"
    rows: int = 0

    def read(self, names: Iterable[str]) -> dict[str, Column]:
        wanted = list(dict.fromkeys(names))
        dated: dict[str, list[Any]] = {}
        rows = 0
        with readable(f"damaged {self.kind} file", self.path):
            out = {name: np.empty(self.rows) for name in wanted}
            for batch in self._batches(wanted):
                batch.validate()  # columns of several lengths, for one
                start, rows = rows, rows + batch.num_rows
                if rows > self.rows:
                    raise pa.ArrowInvalid("more rows than it declares")
                for name in wanted:
                    column = batch.column(name)
                    if pa.types.is_timestamp(column.type):  # counted from the first of all
                        dated.setdefault(name, []).append(column)
                    else:
                        out[name][start:rows] = self._numbers(pa.chunked_array([column]), name)
        for name, parts in dated.items():
            out[name] = self._numbers(pa.chunked_array(parts), name)
        pa.default_memory_pool().release_unused()
        return {name: values[:rows] for name, values in out.items()}

    def _batches(self, names: list[str]) -> Iterator[Any]:
        """Record batches of these columns: never the whole file at once, beside the columns made of it."""
        from pyarrow import parquet

        if self.kind == "Parquet":
            # Buffered ahead, the whole file would stand in memory; threads keep what they have freed.
            with parquet.ParquetFile(self.path, pre_buffer=False) as source:
                yield from source.iter_batches(BATCH_ROWS, columns=names, use_threads=False)
            return
        with pa.memory_map(str(self.path)) as mapped:
            fields = [pa.ipc.open_file(mapped).schema.get_field_index(name) for name in names]
            with pa.ipc.open_file(mapped, options=pa.ipc.IpcReadOptions(included_fields=fields)) as source:
                for k in range(source.num_record_batches):
                    yield source.get_batch(k)

    def _numbers(self, column: Any, name: str) -> Column:
        """Null becomes NaN, dates become seconds since the first."""
        try:
            if pa.types.is_timestamp(column.type):
                stamps = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.timestamp("ns"))
                values, first = seconds_since(stamps.to_numpy().astype("datetime64[ns]"))
                self.start_ns = self.start_ns or first
                return values
            if pa.types.is_duration(column.type):
                counts = column.cast(pa.duration("ns")).cast(pa.int64())
                return doubles(counts.cast(pa.float64(), safe=False)) * 1e-9
            kind = column.type
            number = pa.types.is_primitive(kind) and not pa.types.is_temporal(kind)
            if not (number or pa.types.is_decimal(kind)):
                problem = f"column {name!r} holds {'text' if 'string' in str(kind) else kind}, not numbers"
                raise InputError(problem, where=self.path, mend="store it as numbers")
            # A cast imports Arrow's functions, some megabytes.
            return doubles(column if kind == pa.float64() else column.cast(pa.float64(), safe=False))
        except pa.ArrowException:
            raise InputError(f"column {name!r} holds {column.type}, not numbers", where=self.path) from None


def doubles(column: Any) -> Column:
    """A chunked column of doubles, NaN where it is null. Arrow's own `to_numpy` would import pandas."""
    out = np.empty(len(column))
    end = 0
    for chunk in column.chunks:
        start, end = end, end + len(chunk)
        validity, data = chunk.buffers()
        out[start:end] = np.frombuffer(data, np.float64)[chunk.offset : chunk.offset + len(chunk)]
        if chunk.null_count:
            bits = np.unpackbits(np.frombuffer(validity, np.uint8), bitorder="little")
            out[start:end][bits[chunk.offset : chunk.offset + len(chunk)] == 0] = np.nan
    return out


def open_parquet(path: Path) -> ArrowFile:
    """Read the schema of a Parquet file. Raises InputError: damaged, no rows, or far too many."""
    from pyarrow import parquet

    with readable("not readable as Parquet", path), parquet.ParquetFile(path) as source:
        return _opened(path, "Parquet", source.schema_arrow, source.metadata.num_rows)


def open_feather(path: Path) -> ArrowFile:
    """Read the schema of a Feather 2 (Arrow IPC) file. Raises InputError: damaged, no rows, far too many."""
    with (
        readable("not readable as Feather", path),
        pa.memory_map(str(path)) as source,
        pa.ipc.open_file(source) as reader,
    ):
        rows = sum(reader.get_batch(k).num_rows for k in range(reader.num_record_batches))
        return _opened(path, "Feather", reader.schema, rows)


def _opened(path: Path, kind: str, schema: Any, rows: int) -> ArrowFile:
    signals = {f.name: Signal(f.name, unit=unit_among(f.metadata or {})) for f in schema if f.name}
    if rows == 0:
        raise InputError("no rows", where=path, mend="record at least 5 s")
    require_size(rows, len(signals), path)
    return ArrowFile(path, signals, kind=kind, rows=rows)
