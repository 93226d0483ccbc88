"""CSV and Parquet out, with the contract's column names: what `read_log` reads without a map.

A table holds one axis. Of a run with several, each goes into a file of its own, ``<stem>.<axis>.<suffix>``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow.csv import CSVWriter
from pyarrow.parquet import ParquetWriter

from fdd.errors import InputError
from fdd.files import whole_file
from fdd.logs.mcap_writing import RunBlock, require_axis
from fdd.samples import Samples

GROUP_ROWS = 100_000
"""Rows of a Parquet file's row group at most: 100 s at 1 kHz."""


def axis_file(path: str | Path, axis: str, axes: Sequence[str]) -> Path:
    """Where an axis of a run goes: `path` itself if it is the only one, else ``<stem>.<axis>.<suffix>``."""
    path = Path(path)
    require_axis(axis)
    return path if len(axes) == 1 else path.with_name(f"{path.stem}.{axis}{path.suffix}")


def write_tables(path: str | Path, blocks: Iterable[RunBlock], *, axes: Sequence[str]) -> list[Path]:
    """Write the measurements of a run, a file for each axis (`axis_file`), csv or parquet; gives the files.

    `blocks`: in time order for each axis; no more than one is held. The files appear once all are whole. A
    missing value is null in Parquet (zstd), an empty cell in CSV. An InputError where a file cannot be
    written, or the columns change from block to block.
    """
    paths = {axis: axis_file(path, axis, axes) for axis in axes}
    parquet = Path(path).suffix.lower() == ".parquet"
    with ExitStack() as stack:
        files = {axis: stack.enter_context(whole_file(own)) for axis, own in paths.items()}
        writers: dict[str, tuple[Any, Any]] = {}
        for block in blocks:
            axis, columns = block.axis, {"time": block.samples.time, **block.samples.columns}
            table = pa.table({n: pa.array(v, mask=np.isnan(v)) for n, v in columns.items()})
            if axis not in writers:
                whole = (files[axis], table.schema)
                opened = ParquetWriter(*whole, compression="zstd") if parquet else CSVWriter(*whole)
                # Closed after an error too, or the system keeps the file open.
                writers[axis] = stack.enter_context(opened), table.schema
            writer, schema = writers[axis]
            if table.schema != schema:
                told = f"columns {', '.join(columns)} after blocks with {', '.join(schema.names)}"
                raise InputError(told, where=paths[axis], mend="give all blocks the same columns")
            writer.write_table(table, GROUP_ROWS)
    return list(paths.values())


def write_table(path: str | Path, samples: Samples) -> None:
    """Write one axis's samples, see `write_tables`."""
    write_tables(path, [RunBlock(samples, None, "axis")], axes=["axis"])
