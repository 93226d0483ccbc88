"""The same work for each unit of a data set, in as many processes as are wanted."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from fdd.campaign.dataset import Dataset
from fdd.diagnosis.model import Model
from fdd.errors import InputError

Progress = Callable[[int, int], None]
Result = TypeVar("Result")


def over_units(
    work: Callable[[str, str | None, str], list[Result]],
    directory: str | Path,
    model: str | None,
    *,
    workers: int,
    progress: Progress | None,
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
    bound = partial(work, str(data.directory), model)
    return for_each_unit(bound, data.units, workers=workers, progress=progress)


def for_each_unit(
    work: Callable[[str], list[Result]],
    units: Sequence[str],
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> list[Result]:
    """Join what `work` gives for each unit, in the order of the units.

    Parameters
    ----------
    work : unit's name to its results; with more than one worker it is pickled, so a
        function of a module or a `functools.partial` of one.
    workers : processes; with one, the work is done in this one.
    progress : called with (done, total) units.

    Raises
    ------
    InputError : the last unit's, where all refuse. A unit that refuses alone, as a baseline that cannot be
        identified, is left out with a warning.

    Examples
    --------
    >>> for_each_unit(list, ["ab", "c"])
    ['a', 'b', 'c']
    """
    found: dict[str, list[Result]] = {}
    refused: list[InputError] = []

    def keep(unit: str, get: Callable[[], list[Result]]) -> None:
        try:
            found[unit] = get()
        except InputError as error:
            refused.append(error)
            warnings.warn(f"{unit} left out: {error}", stacklevel=2)
            found[unit] = []
        if progress is not None:
            progress(len(found), len(units))

    if workers <= 1:
        for unit in units:
            keep(unit, partial(work, unit))
    else:
        # Spawned: the parent may have threads (a progress bar, numba's), which a fork would break.
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(work, unit): unit for unit in units}
            for future in as_completed(futures):
                keep(futures[future], future.result)
    if len(refused) == len(units) and refused:
        raise refused[-1]
    return [result for unit in units for result in found[unit]]
