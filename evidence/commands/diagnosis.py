"""``python -m evidence disturbed``, ``left-out``, ``identification``: what results on a data set rest on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from fdd.cli.options import EngineOption, WorkersOption

DatasetArgument = Annotated[Path, typer.Argument(help="Folder that fdd generate made.", show_default=False)]
ModelOption = Annotated[
    str | None,
    typer.Option(help="Of fdd train; the shipped one else.", show_default=False),
]


def disturbed(
    dataset: DatasetArgument,
    model: ModelOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = "local",
) -> None:
    """Compare the answers on logs that are cut, holed, mirrored or kept in other units."""
    from evidence.diagnosis import disturbed as room

    _told(room.disturbed, room.table, dataset, model=model, workers=workers, engine=engine)


def left_out(
    dataset: DatasetArgument,
    model: ModelOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = "local",
) -> None:
    """Diagnose each faulty log without its own fault's signatures."""
    from evidence.diagnosis import left_out as room

    _told(room.left_out, room.table, dataset, model=model, workers=workers, engine=engine)


def budget(
    dataset: DatasetArgument,
    model: ModelOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = "local",
) -> None:
    """Where visible faults are lost, and what healthy logs differ by over what is stated."""
    from evidence.diagnosis import budget as room

    _told(room.budget, room.table, dataset, model=model, workers=workers, engine=engine)


def scales(dataset: DatasetArgument, workers: WorkersOption = None, engine: EngineOption = "local") -> None:
    """Read healthy logs in wrong units of measure: which are refused or warned of, and which sound ones."""
    from evidence.diagnosis import scales as room

    _told(room.scales, room.table, dataset, what="checking", workers=workers, engine=engine)


def identification(
    dataset: DatasetArgument, workers: WorkersOption = None, engine: EngineOption = "local"
) -> None:
    """Identify each unit from its data sheet: refusals, single rods, and whether deviations come true."""
    from evidence.diagnosis import identification as room

    _told(room.identified, room.table, dataset, what="identifying", workers=workers, engine=engine)


def _told(measure: Callable[..., Any], table: Callable[[Any], str], dataset: Path, what: str = "diagnosing",
          **how: Any) -> None:  # fmt: skip
    from fdd.cli.console import progress

    with progress(f"{what} {dataset.name}", 1.0) as advance:
        found = measure(dataset, progress=lambda done, total: advance(done / max(total, 1)), **how)
    print(table(found), end="")
