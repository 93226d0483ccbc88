"""CSV and Parquet out, with the contract's column names: what `read_log` reads without a map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fdd.files import whole_file
from fdd.samples import Samples


def write_csv(path: str | Path, samples: Samples) -> None:
    """Write a CSV file, whole or not at all; a missing value is an empty cell.

    Examples
    --------
    >>> write_csv("run.csv", samples)  # doctest: +SKIP
    """
    from pyarrow import csv

    with whole_file(path) as temporary:
        csv.write_csv(_table(samples), temporary)


def write_parquet(path: str | Path, samples: Samples) -> None:
    """Write a Parquet file (zstd), whole or not at all; a missing value is null.

    Examples
    --------
    >>> write_parquet("run.parquet", samples)  # doctest: +SKIP
    """
    from pyarrow import parquet

    with whole_file(path) as temporary:
        parquet.write_table(_table(samples), temporary, compression="zstd")


def _table(samples: Samples) -> Any:
    import pyarrow as pa

    columns = {"time": samples.time, **samples.columns}
    return pa.table({n: pa.array(v, mask=np.isnan(v)) for n, v in columns.items()})
