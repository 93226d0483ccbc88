"""The same work for each unit of a data set, in as many processes as are wanted."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypedDict, TypeVar, TypeVarTuple, Unpack

from fdd.campaign.dataset import Dataset
from fdd.engines import Engine, map_unordered
from fdd.errors import InputError

Progress = Callable[[int, int], None]
Job = TypeVar("Job")
Result = TypeVar("Result")
Given = TypeVarTuple("Given")


class How(TypedDict, total=False):
    """Where units are worked, see `fdd.engines.map_unordered`; `progress` is told (done, total) units."""

    workers: int | None
    progress: Progress | None
    engine: Engine


def over_units(
    work: Callable[[Dataset, str, *Given], list[Result]],
    directories: Sequence[str | Path],
    *given: *Given,
    **how: Unpack[How],
) -> list[Result]:
    """Join what `work` gives for the units of data sets, in their order; see `for_each_unit`.

    Parameters
    ----------
    work : data set, unit's name and what is `given` to its results; a function of a module.
    """
    folders = [data.directory / unit for data in map(Dataset.load, directories) for unit in data.units]
    return for_each_unit(partial(_opened, work, given), folders, **how)


def _opened(work: Callable[..., list[Result]], given: tuple[object, ...], folder: Path) -> list[Result]:
    return work(Dataset.load(folder.parent), folder.name, *given)


def for_each_unit(
    work: Callable[[Job], list[Result]], units: Sequence[Job], **how: Unpack[How]
) -> list[Result]:
    """Join what `work` gives for each unit, in the order of the units.

    Raises
    ------
    InputError : the last unit's, where all refuse. A unit that refuses alone, as a baseline that cannot be
        identified, is left out with a warning.
    """
    found: dict[int, list[Result]] = {}
    refused: list[InputError] = []
    progress = how.get("progress")
    engine, workers = how.get("engine", "local"), how.get("workers", 1)
    for number, told in map_unordered(partial(_tried, work), units, engine=engine, workers=workers):
        found[number] = [] if isinstance(told, InputError) else told
        if isinstance(told, InputError):
            refused.append(told)
            warnings.warn(f"{units[number]} left out: {told}", stacklevel=2)
        if progress is not None:
            progress(len(found), len(units))
    if refused and len(refused) == len(units):
        raise refused[-1]
    return [result for number in range(len(units)) for result in found[number]]


def _tried(work: Callable[[Job], list[Result]], unit: Job) -> list[Result] | InputError:
    try:
        return work(unit)
    except InputError as error:
        return error
