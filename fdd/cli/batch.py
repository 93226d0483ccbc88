"""Many logs at once: in parallel, none of them able to end the others, each worked once."""

from __future__ import annotations

import os
import signal
import traceback
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from types import FrameType
from typing import TYPE_CHECKING

from fdd.cli.failures import INTERRUPTED, prepare_process
from fdd.engines import Engine, map_unordered
from fdd.errors import InputError
from fdd.offline.diagnoser import Diagnoser, Job, Settings, printable

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis


def worked(
    jobs: Sequence[tuple[int, Job]], settings: Settings, workers: int | None, engine: Engine = "local"
) -> Iterator[tuple[int, Diagnosis]]:
    """Work jobs; gives answers as they come.

    Parameters
    ----------
    jobs : with a number each, which comes back with the answer.
    settings : known to be usable.
    workers, engine : see `fdd.engines.map_unordered`.

    Yields
    ------
    The number, and the answer: that of a log that could not be read has an `error`.
    """
    _diagnoser.cache_clear()  # its files may have changed since the last call in this process
    work = partial(_work, settings)
    plain = [job for _, job in jobs]
    for k, answer in map_unordered(work, plain, engine=engine, workers=workers, begin=_begin):
        yield jobs[k][0], answer


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
    """What a process of the pool knows."""

    stopped = False


def _begin() -> None:
    prepare_process()
    signal.signal(signal.SIGINT, _stop)


@lru_cache(maxsize=1)
def _diagnoser(settings: Settings) -> Diagnoser:
    """What the logs that a process works share."""
    return Diagnoser(settings)


def _work(settings: Settings, job: Job) -> Diagnosis:
    if _Worker.stopped:  # what the pool had already handed out
        raise SystemExit(INTERRUPTED)
    return answer_of(_diagnoser(settings), job)


def _stop(number: int, frame: FrameType | None) -> None:
    # Raised as an exit, so that temporary files are cleared away and nothing is printed.
    _Worker.stopped = True
    raise SystemExit(INTERRUPTED)
