"""The same work for each unit of a data set, in as many processes as are wanted."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypedDict, TypeVar, Unpack

from fdd.campaign.dataset import Dataset
from fdd.diagnosis.model import Model
from fdd.engines import Engine, map_unordered
from fdd.errors import InputError

Progress = Callable[[int, int], None]
Result = TypeVar("Result")


class How(TypedDict, total=False):
    """Where units are worked, see `fdd.engines.map_unordered`; `progress` is told (done, total) units."""

    workers: int | None
    progress: Progress | None
    engine: Engine


def over_units(
    work: Callable[[str, str | None, str], list[Result]],
    directory: str | Path,
    model: str | None,
    **how: Unpack[How],
) -> list[Result]:
    """Join what `work` gives for the units of a data set, after a look at both data set and model.

    Parameters
    ----------
    work : data set's folder, model file and unit's name to its results; a function of a module.

    Raises
    ------
    InputError : not a data set, or an unusable model.
    """
    Model.load(model)
    data = Dataset.load(directory)
    return for_each_unit(partial(work, str(data.directory), model), data.units, **how)


def for_each_unit(
    work: Callable[[str], list[Result]], units: Sequence[str], **how: Unpack[How]
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
        if isinstance(told, InputError):
            refused.append(told)
            warnings.warn(f"{units[number]} left out: {told}", stacklevel=2)
        found[number] = [] if isinstance(told, InputError) else told
        if progress is not None:
            progress(len(found), len(units))
    if len(refused) == len(units) and refused:
        raise refused[-1]
    return [result for number in range(len(units)) for result in found[number]]


def _tried(work: Callable[[str], list[Result]], unit: str) -> list[Result] | InputError:
    try:
        return work(unit)
    except InputError as error:
        return error
