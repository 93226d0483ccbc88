"""``fdd features``: what the diagnosis knows of a data set's logs, as a table for other learners."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.options import EngineOption, ModelOption, WorkersOption


def features(
    dataset: Annotated[Path, typer.Argument(help="Folder that fdd generate made.", show_default=False)],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="FILE.parquet", show_default=False,
            help="Table to write; as features.parquet in the data set's folder it is found there.",
        ),
    ],
    window: Annotated[
        float | None,
        typer.Option(min=1.0, metavar="S", help="A row for each so many seconds, not for each log.",
                     show_default=False),
    ] = None,
    model: ModelOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = "local",
) -> None:  # fmt: skip
    """Make a table of features and truth of a data set: a row for each log or window."""
    from fdd.files import require_writable

    require_writable(out)

    from fdd.campaign.feature_table import feature_table, write_features
    from fdd.cli.console import progress

    with progress(f"features of {dataset.name}", 1.0) as advance:
        table = feature_table(
            dataset,
            model=None if model is None else str(model),
            window=window,
            workers=workers,
            engine=engine,
            progress=lambda done, total: advance(done / max(total, 1)),
        )
    write_features(table, out)
    print(f"{table.num_rows} rows of {table.num_columns} columns written to {out}")
