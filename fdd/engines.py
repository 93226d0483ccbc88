"""Independent pieces of work on what there is to run them, this machine's processes or Ray's on many; and how
work tells how far it is."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Literal, TypeVar

from fdd.errors import InputError

Engine = Literal["local", "ray"]
Job = TypeVar("Job")
Result = TypeVar("Result")
Advance = Callable[[float], None]
"""Told how much is done in all."""
Progress = Callable[..., AbstractContextManager[Advance]]
"""Opens a stage of the work: its title, and the total that `Advance` counts to where there is one. A library
call is silent."""


@contextmanager
def unseen(title: str, total: float | None = None) -> Iterator[Advance]:
    """Progress that nobody watches."""
    yield lambda done: None


class WorkerLost(InputError):
    """A process that worked has ended: killed, or out of memory."""

    def __init__(self) -> None:
        super().__init__("a worker process ended unexpectedly", mend="try again with fewer workers")


def map_unordered(
    function: Callable[[Job], Result], jobs: Sequence[Job], *, engine: Engine = "local",
    workers: int | None = None, begin: Callable[[], None] | None = None,
) -> Iterator[tuple[int, Result]]:  # fmt: skip
    """Work jobs, and give each one's number and result as they come.

    `function` and `jobs` are pickled where they leave this process: a function of a module, or a `partial` of
    one. The engine ``ray`` works on the cluster that RAY_ADDRESS names, or one begun here and ended with the
    work; all its machines need fdd, and the files, under the same paths. `workers`: jobs at a time; one for
    each core (of the cluster) else; one local worker is this process. `begin`: called first in each process
    that the local engine begins.

    What `function` raises is raised here, and the jobs left are dropped. Raises WorkerLost: a process ended;
    InputError: Ray is not installed, or there is no cluster at RAY_ADDRESS.
    """
    if engine == "ray":
        return _over_ray(_ray_package(), function, jobs, workers)
    workers = min(workers or os.cpu_count() or 1, len(jobs))
    if workers > 1:
        return _over_processes(function, jobs, workers, begin)
    return ((number, function(job)) for number, job in enumerate(jobs))


def _over_processes(
    function: Callable[[Job], Result], jobs: Sequence[Job], workers: int, begin: Callable[[], None] | None
) -> Iterator[tuple[int, Result]]:
    # Here: every command knows the engines' names, few have several jobs.
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    # Spawned: the parent may have threads (a progress bar, numba's), which a fork would break.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=begin) as pool:
        futures = {pool.submit(function, job): number for number, job in enumerate(jobs)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise WorkerLost from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _over_ray(
    ray: Any, function: Callable[[Job], Result], jobs: Sequence[Job], workers: int | None
) -> Iterator[tuple[int, Result]]:
    began = not ray.is_initialized()
    if began:
        try:
            ray.init(logging_level="ERROR", log_to_driver=False)
        except (ConnectionError, ValueError) as error:
            where = f"Ray at {os.environ.get('RAY_ADDRESS')}"
            raise InputError(f"cannot be reached ({error})", where=where) from None
    task = ray.remote(_task)
    most = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    waiting, running = iter(enumerate(jobs)), dict[Any, int]()
    try:
        while True:
            for number, job in islice(waiting, most - len(running)):
                running[task.remote(str(Path.cwd()), function, job)] = number
            if not running:
                return
            (done, *_), _ = ray.wait(list(running))
            yield running.pop(done), ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except ray.exceptions.RayError:
        raise WorkerLost from None
    finally:
        for left in running:
            ray.cancel(left, force=True)
        if began:
            ray.shutdown()


def _ray_package() -> Any:
    # Ray tells its makers how it is used unless it is told not to.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ModuleNotFoundError:
        raise InputError("the engine ray needs the package ray", mend="install fdd[ray]") from None
    return ray


def _task(folder: str, function: Callable[[Job], Result], job: Job) -> Result:
    """Work a job in a folder, so that relative paths mean what they mean where it was ordered."""
    try:
        os.chdir(folder)
    except OSError as error:
        mend = "Ray's machines need the same files under the same paths"
        raise InputError(f"cannot be worked in ({error.strerror})", where=folder, mend=mend) from None
    return function(job)
