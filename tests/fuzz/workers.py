"""Cases in processes of their own, with a bound on memory, watched by time and exit status."""

import multiprocessing
import resource
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

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


def tasks_of(kinds: Iterable[str], count: int, seed: int) -> Iterator[Task]:
    """`count` cases, the kinds in turn."""
    names = list(kinds)
    for k in range(count):
        yield Task(names[k % len(names)], seed, k // len(names))


@dataclass
class Outcome:
    """What came of all tasks: counts by kind, and the finds with what happened."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    slowest: dict[str, float] = field(default_factory=dict)
    finds: list[tuple[Task, str]] = field(default_factory=list)

    def add(self, task: Task, result: str, spent: float) -> None:
        self.slowest[task.kind] = max(self.slowest.get(task.kind, 0.0), spent)
        sound = result in ("read", "refused")
        self.counts[task.kind, result if sound else "find"] += 1
        if not sound:
            self.finds.append((task, f"{result} ({spent:.1f} s)"))


def fuzz(tasks: Iterable[Task], workers: int = 2) -> Outcome:
    """Carry out tasks; a process that dies or hangs is a find, and another takes its place."""
    out, waiting, lock = Outcome(), iter(tasks), threading.Lock()

    def work() -> None:
        worker = _Worker()
        while True:
            with lock:
                task = next(waiting, None)
            if task is None:
                worker.end()
                return
            result, spent = worker.carry_out(task)
            with lock:
                out.add(task, result, spent)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return out


class _Worker:
    """A process that is handed one task at a time, and another one once it died or hung."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        self.connection, inner = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        self.process = context.Process(target=_serve, args=(inner,), daemon=True)
        self.process.start()
        inner.close()
        assert self.connection.recv() == "ready"

    def carry_out(self, task: Task) -> tuple[str, float]:
        """What came of it, and how long that took (s)."""
        begun = time.monotonic()
        try:
            self.connection.send(task)
            if self.connection.poll(MOST_SECONDS):
                result, spent = self.connection.recv()
                return result, spent
            result = f"not done after {MOST_SECONDS:g} s"
        except (EOFError, OSError):
            self.process.join(5)
            result = f"the process died (exit status {self.process.exitcode})"
        self.end()
        self.start()
        return result, time.monotonic() - begun

    def end(self) -> None:
        self.process.kill()
        self.process.join()


def _serve(connection: Connection) -> None:
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        # Libraries and compiled code are loaded before the memory is measured.
        for name, kind in KINDS.items():
            seeds = kind.seeds(name)
            assert seeds, f"no seeds of {name}"
            for path in seeds:
                copy = Path(folder) / path.name
                copy.write_bytes(path.read_bytes())
                assert run(name, copy) == "read", f"{path} is refused"
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
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-3:]
        places = " > ".join(f"{Path(f.filename).name}:{f.lineno}" for f in last)
        return f"{type(error).__name__}: {' '.join(str(error).split())[:200]} [{places}]"
    finally:
        path.unlink(missing_ok=True)
