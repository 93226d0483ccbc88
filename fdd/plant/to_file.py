"""A run straight into a file, block by block: an hour passes through the memory of a minute."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from fdd.engines import Advance
from fdd.errors import InputError
from fdd.files import require_writable

if TYPE_CHECKING:
    from fdd.logs.mcap_writing import RunBlock
    from fdd.plant.scenario import Scenario
    from fdd.unit import Unit


def require_kind(path: Path) -> None:
    """Refuse a file that could not be written, with an `InputError`, before anything is simulated."""
    if path.suffix.lower() not in (".mcap", ".parquet", ".csv"):
        problem = f"files of kind {path.suffix or 'none'} are not written"
        raise InputError(problem, where=path, mend="use .mcap, .parquet, .csv")
    require_writable(path)


def write_simulation(
    path: Path, unit: Unit, scenario: Scenario, *, partner: Unit | None = None, truth: bool = True,
    advance: Advance = lambda done: None,
) -> None:  # fmt: skip
    """Simulate a run into a log, as `fdd.plant.simulate.simulate`.

    Parameters
    ----------
    path : MCAP, which holds both axes, or Parquet or CSV: one file for each, with the axis in its name.
    truth : write it beside the measurement (MCAP).
    advance : told how many milliseconds are done.

    Raises
    ------
    InputError : as `simulate`; both units are of one axis; or the file cannot be written.
    """
    require_kind(path)
    from fdd.logs.tabular_writing import axis_file, write_table_blocks

    units = [unit] if partner is None else [unit, partner]
    axes = [each.axis for each in units]
    if len(set(axes)) < len(axes):
        problem = f"both units are of axis {axes[0]}"
        raise InputError(problem, mend="give the partner's profile another axis name")
    table = path.suffix.lower() != ".mcap"
    for axis in axes if table else ():
        require_writable(axis_file(path, axis, axes))

    def made() -> Iterator[RunBlock]:
        # Its compiled code takes a second to load: not before everything is known to be right.
        from fdd.logs.mcap_writing import RunBlock
        from fdd.plant.simulate import BLOCK, stream

        for k, parts in enumerate(stream(unit, scenario, partner=partner)):
            for axis, part in zip(axes, parts, strict=True):
                beside = {"time": part.truth.time, **part.truth.as_columns()} if truth else None
                yield RunBlock(part.samples, beside, axis)
            advance(float(min((k + 1) * BLOCK, scenario.rows)))

    blocks = made()
    if table:
        write_table_blocks(path, blocks, axes=axes)
        return
    from fdd.logs.mcap_writing import write_blocks

    write_blocks(
        path, blocks, axes=axes, units={each.axis: each.to_yaml() for each in units},
        scenario_json=scenario.model_dump_json(), labels={"faults": [s.label() for s in scenario.faults]},
    )  # fmt: skip
