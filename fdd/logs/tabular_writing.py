"""CSV and Parquet out, with the contract's column names: what `read_log` reads without a map.

A table holds one axis. Of a run with several, each goes into a file of its own, ``<stem>.<axis>.<suffix>``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fdd.errors import InputError
from fdd.files import whole_file
from fdd.logs.mcap_writing import RunBlock, require_axis
from fdd.samples import Samples

GROUP_ROWS = 100_000
"""Rows that are written at once: what is held in memory at most, 100 s at 1 kHz."""


class TableWriter:
    """Takes a table's blocks; writes groups of exactly `GROUP_ROWS`, which do not depend on the blocks.

    Parameters
    ----------
    path : named in errors. temporary : what is written into. parquet : else CSV.
    """

    def __init__(self, path: str | Path, temporary: Path, *, parquet: bool) -> None:
        self._path, self._temporary, self._parquet = path, temporary, parquet
        self._waiting: list[Any] = []
        self._rows = 0
        self._writer: Any = None
        self._names: list[str] | None = None

    def add(self, time: ArrayLike, columns: Mapping[str, ArrayLike]) -> None:
        """The next rows: (n,) s and the columns (n,), the same ones in every block."""
        import pyarrow as pa

        arrays = {"time": np.asarray(time), **{n: np.asarray(v) for n, v in columns.items()}}
        names = self._names = self._names or list(arrays)
        if list(arrays) != names:
            problem = f"a block has the columns {', '.join(arrays)}, the ones before {', '.join(names)}"
            raise InputError(problem, where=self._path, mend="give all blocks the same columns")
        # A missing value is null, which an empty cell is read as too.
        self._waiting.append(pa.table({n: pa.array(v, mask=np.isnan(v)) for n, v in arrays.items()}))
        self._rows += arrays["time"].size
        if self._rows >= GROUP_ROWS:
            self._write(self._rows - self._rows % GROUP_ROWS)

    def close(self) -> None:
        """Write what is left."""
        if self._waiting and (self._rows or self._writer is None):
            self._write(self._rows)
        if self._writer is not None:
            self._writer.close()

    def _write(self, rows: int) -> None:
        import pyarrow as pa
        from pyarrow import csv, parquet

        # Chunks that the blocks left would show in the pages.
        joined = pa.concat_tables(self._waiting).combine_chunks()
        if self._writer is None and self._parquet:
            self._writer = parquet.ParquetWriter(self._temporary, joined.schema, compression="zstd")
        elif self._writer is None:
            self._writer = csv.CSVWriter(self._temporary, joined.schema)
        self._writer.write_table(joined.slice(0, rows), GROUP_ROWS)
        self._rows -= rows
        # Copied: a slice would keep the whole block alive.
        self._waiting = [joined.take(np.arange(rows, joined.num_rows))] if self._rows else []


@contextmanager
def table_file(path: str | Path, kind: str | None = None) -> Iterator[TableWriter]:
    """A table's file to add blocks to; it appears whole or not at all.

    Its bytes do not depend on how the rows are cut into blocks.

    Parameters
    ----------
    path : the file. kind : csv or parquet; None takes it from the suffix (anything else is csv).

    Raises
    ------
    InputError : it cannot be written, or the columns change from block to block.
    """
    parquet = (kind or Path(path).suffix.lower().lstrip(".")) == "parquet"
    # Closed after an error too, or the system keeps the file open; what it then writes is thrown away.
    with whole_file(path) as temporary, closing(TableWriter(path, temporary, parquet=parquet)) as writer:
        yield writer


def axis_file(path: str | Path, axis: str, axes: Sequence[str]) -> Path:
    """Where an axis of a run goes: `path` itself if it is the only one, else ``<stem>.<axis>.<suffix>``.

    Examples
    --------
    >>> axis_file("run.csv", "axis_b", ["axis_a", "axis_b"]).name
    'run.axis_b.csv'
    """
    path = Path(path)
    if axis not in axes:
        raise InputError(f"axis {axis!r} is none of {', '.join(axes)}", where=path, mend="name one of these")
    require_axis(axis)
    return path if len(axes) == 1 else path.with_name(f"{path.stem}.{axis}{path.suffix}")


def write_table_blocks(path: str | Path, blocks: Iterable[RunBlock], *, axes: Sequence[str]) -> list[Path]:
    """Write the measurements of a run from an iterator of blocks, a file for each axis; gives the files.

    The files appear once all of them are whole. Truth and metadata have no place in a table.

    Parameters
    ----------
    path : the file, or the name that each axis's is made of (see `axis_file`); csv or parquet by its suffix.
    blocks : in time order for each axis. axes : names of all of them.
    """
    paths = {axis: axis_file(path, axis, axes) for axis in axes}
    with ExitStack() as stack:
        files = {axis: stack.enter_context(table_file(p)) for axis, p in paths.items()}
        for block in blocks:
            files[block.axis_of(axes)].add(block.samples.time, block.samples.columns)
    return list(paths.values())


def write_csv(path: str | Path, samples: Samples) -> None:
    """Write a CSV file, whole or not at all; a missing value is an empty cell."""
    with table_file(path, "csv") as out:
        out.add(samples.time, samples.columns)


def write_parquet(path: str | Path, samples: Samples) -> None:
    """Write a Parquet file (zstd), whole or not at all; a missing value is null."""
    with table_file(path, "parquet") as out:
        out.add(samples.time, samples.columns)
