"""``fdd features``: what the diagnosis knows of a data set's logs, as a table for other learners."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fdd.cli.options import DatasetArgument, EngineOption, ModelOption, WorkersOption, option


def features(
    dataset: DatasetArgument,
    out: Annotated[
        Path,
        option("Table to write; as features.parquet in the data set's folder it is found there.",
               "--out", "-o", metavar="FILE.parquet"),
    ],
    window: Annotated[
        float | None, option("A row for each so many seconds, not for each log.", min=1.0, metavar="S")
    ] = None,
    model: ModelOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = "local",
) -> None:  # fmt: skip
    """Make a table of features and truth of a data set: a row for each log or window."""
    from fdd.files import require_writable

    require_writable(out)

    from fdd.campaign.feature_table import feature_table, write_features
    from fdd.cli.console import counted

    asked = None if model is None else str(model)
    with counted(f"features of {dataset.name}") as step:
        table = feature_table(
            dataset, model=asked, window=window, workers=workers, engine=engine, progress=step
        )
    write_features(table, out)
    print(f"{table.num_rows} rows of {table.num_columns} columns written to {out}")
