"""The same work for each unit of a data set, in as many processes as are wanted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

Progress = Callable[[int, int], None]
Result = TypeVar("Result")


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

    Examples
    --------
    >>> for_each_unit(list, ["ab", "c"])
    ['a', 'b', 'c']
    """
    found: dict[str, list[Result]] = {}

    def keep(unit: str, results: list[Result]) -> None:
        found[unit] = results
        if progress is not None:
            progress(len(found), len(units))

    if workers <= 1:
        for unit in units:
            keep(unit, work(unit))
    else:
        # Spawned: the parent may have threads (a progress bar, numba's), which a fork would break.
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(work, unit): unit for unit in units}
            for future in as_completed(futures):
                keep(futures[future], future.result())
    return [result for unit in units for result in found[unit]]
