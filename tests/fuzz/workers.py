"""Cases in processes of their own, with a bound on memory, watched by time and exit status."""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tests.fuzz.targets import KINDS, case, run

MOST_SECONDS = 10.0
MOST_BYTES = 2 << 30
"""Of address space, beyond what the process has before its first case."""


@dataclass(frozen=True)
class Task:
    """A case by its number, or a file."""

    kind: str
    seed: int = 0
    number: int = 0
    file: Path | None = None

    def content(self) -> tuple[str, bytes]:
        """Suffix and bytes."""
        if self.file is not None:
            return "".join(self.file.suffixes[-1:]), self.file.read_bytes()
        return case(self.kind, self.seed, self.number)


@dataclass
class Outcome:
    """What came of all tasks: counts by kind, and the finds with what happened."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    slowest: dict[str, float] = field(default_factory=dict)
    finds: list[tuple[Task, str]] = field(default_factory=list)


class _Worker:
    """A process that is handed one task at a time."""

    def __init__(self) -> None:
        self.connection, inner = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        self.process = context.Process(target=_serve, args=(inner,), daemon=True)
        self.process.start()
        inner.close()
        self.task: Task | None = None
        self.since = 0.0
        assert self.connection.recv() == "ready"

    def give(self, task: Task) -> None:
        self.task, self.since = task, time.monotonic()
        self.connection.send(task)

    def end(self) -> int | None:
        self.process.kill()
        self.process.join()
        return self.process.exitcode


def fuzz(tasks: Iterable[Task], workers: int = 2) -> Outcome:
    """Carry out tasks; a process that dies or hangs is a find, and another takes its place."""
    out, waiting = Outcome(), iter(tasks)
    idle, busy = [_Worker() for _ in range(workers)], list[_Worker]()
    try:
        while True:
            while idle and (task := next(waiting, None)) is not None:
                idle[-1].give(task)
                busy.append(idle.pop())
            if not busy:
                return out
            ready = wait([w.connection for w in busy], timeout=0.2)
            for worker in list(busy):
                result, spent = None, time.monotonic() - worker.since
                if worker.connection in ready:
                    try:
                        result, spent = worker.connection.recv()
                    except (EOFError, OSError):
                        worker.process.join(5)
                        result = f"the process died (exit status {worker.process.exitcode})"
                elif spent > MOST_SECONDS:
                    result = f"not done after {MOST_SECONDS:g} s"
                if result is None:
                    continue
                busy.remove(worker)
                _take(out, worker, result, spent)
                if worker.process.is_alive() and not result.startswith(("the process", "not done")):
                    idle.append(worker)
                else:
                    worker.end()
                    idle.append(_Worker())
    finally:
        for worker in [*idle, *busy]:
            worker.end()


def _take(out: Outcome, worker: _Worker, result: str, spent: float) -> None:
    assert worker.task is not None
    kind = worker.task.kind
    out.slowest[kind] = max(out.slowest.get(kind, 0.0), spent)
    if result in ("read", "refused") and spent <= MOST_SECONDS:
        out.counts[kind, result] += 1
    else:
        out.counts[kind, "find"] += 1
        out.finds.append((worker.task, f"{result} ({spent:.1f} s)"))


def _serve(connection: Connection[Any, Any]) -> None:
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        _warm_up(Path(folder))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MOST_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        connection.send("ready")
        while True:
            task: Task = connection.recv()
            begun = time.monotonic()
            connection.send((_result(task, Path(folder)), time.monotonic() - begun))


def _result(task: Task, folder: Path) -> str:
    suffix, raw = task.content()
    path = folder / f"case{suffix}"
    path.write_bytes(raw)
    try:
        return run(task.kind, path)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        last = traceback.extract_tb(error.__traceback__)[-3:]
        places = " > ".join(f"{Path(f.filename).name}:{f.lineno}" for f in last)
        return f"{type(error).__name__}: {' '.join(str(error).split())[:200]} [{places}]"
    finally:
        path.unlink(missing_ok=True)


def _warm_up(folder: Path) -> None:
    """Load libraries and compiled code before the memory is measured."""
    for name, kind in KINDS.items():
        for path in kind.seeds(name):
            copy = folder / path.name
            copy.write_bytes(path.read_bytes())
            run(name, copy)


def tasks_of(kinds: Iterable[str], count: int, seed: int) -> Iterator[Task]:
    """`count` cases, the kinds in turn."""
    names = list(kinds)
    for k in range(count):
        yield Task(names[k % len(names)], seed, k // len(names))
