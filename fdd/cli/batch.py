"""Many logs at once: in parallel, none of them able to end the others, each worked once."""

from __future__ import annotations

import os
import signal
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from types import FrameType
from typing import TYPE_CHECKING

from fdd.cli.diagnosing import Diagnoser, Job, Settings, printable
from fdd.cli.failures import INTERRUPTED, prepare_process
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis


def worked(
    jobs: Sequence[tuple[int, Job]], settings: Settings, workers: int
) -> Iterator[tuple[int, Diagnosis]]:
    """Work jobs, each in one of several processes; gives answers as they come.

    Parameters
    ----------
    jobs : with a number each, which comes back with the answer.
    settings : known to be usable.
    workers : processes; with 1, this one.

    Yields
    ------
    The number, and the answer: that of a log that could not be read has an `error`.
    """
    if workers <= 1:
        diagnoser = Diagnoser(settings)
        for number, job in jobs:
            yield number, answer_of(diagnoser, job)
        return
    # Spawned: the parent may have threads (a progress bar, numba's), which a fork would break.
    with ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_begin, initargs=(settings,)
    ) as pool:
        futures = {pool.submit(_work, job): number for number, job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def answer_of(diagnoser: Diagnoser, job: Job) -> Diagnosis:
    """The job's answer, its outputs written; whatever is wrong with the log is in the answer."""
    from fdd.diagnosis.findings import Diagnosis

    try:
        found = diagnoser.diagnose(job, diagnoser.read(job), keep_trajectories=job.shows_trajectories)
        diagnoser.write(job, found)
        return found.diagnosis
    except InputError as error:
        line = str(error)
    except MemoryError:
        line = f"{job.path}: not enough memory for this log; split it, or give fewer --workers"
    except Exception as error:
        if os.environ.get("FDD_DEBUG"):
            traceback.print_exc()
        line = f"{job.path}: internal error: {type(error).__name__}: {error}"[:500]
    try:
        hashes = diagnoser.hashes(job.path)
    except InputError:
        hashes = {}
    return Diagnosis.unreadable(printable(job.name), printable(" ".join(line.split())), hashes)


class _Worker:
    """What a process of the pool keeps from log to log."""

    diagnoser: Diagnoser
    stopped = False


def _begin(settings: Settings) -> None:
    prepare_process()
    signal.signal(signal.SIGINT, _stop)
    _Worker.diagnoser = Diagnoser(settings)


def _work(job: Job) -> Diagnosis:
    if _Worker.stopped:  # what the pool had already handed out
        raise SystemExit(INTERRUPTED)
    return answer_of(_Worker.diagnoser, job)


def _stop(number: int, frame: FrameType | None) -> None:
    # Raised as an exit, so that temporary files are cleared away and nothing is printed.
    _Worker.stopped = True
    raise SystemExit(INTERRUPTED)
