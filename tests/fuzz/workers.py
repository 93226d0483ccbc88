"""Cases in processes of their own, with a bound on memory, watched by time and exit status.

``python -m tests.fuzz.workers`` is such a process: a task a line goes in, what came of it comes out.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from tests.fuzz.targets import KINDS, ROOT, case, run

MOST_SECONDS = 10
MOST_BYTES = 2 << 30
"""Of address space, beyond what the process has before its first case."""


class Task(NamedTuple):
    """A case by its number, or a file."""

    kind: str
    seed: int = 0
    number: int = 0
    file: str | None = None

    def content(self) -> tuple[str, bytes]:
        """Suffix and bytes."""
        if self.file is not None:
            return Path(self.file).suffix, Path(self.file).read_bytes()
        return case(self.kind, self.seed, self.number)


@dataclass
class Outcome:
    """What came of all tasks: counts by kind, and the finds with what happened."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    slowest: dict[str, float] = field(default_factory=dict)
    finds: list[tuple[Task, str]] = field(default_factory=list)


def fuzz(tasks: Iterable[Task], workers: int = 2) -> Outcome:
    """Carry out tasks; what is neither read nor refused in time is a find."""
    out, every = Outcome(), list(tasks)
    with ThreadPoolExecutor(workers) as pool:
        for done in pool.map(_carried_out, [every[k::workers] for k in range(workers)]):
            for task, result, spent in done:
                out.slowest[task.kind] = max(out.slowest.get(task.kind, 0.0), spent)
                good = result in ("read", "refused") and spent <= MOST_SECONDS
                out.counts[task.kind, result if good else "find"] += 1
                if not good:
                    out.finds.append((task, f"{result} ({spent:.1f} s)"))
    return out


def _carried_out(tasks: list[Task]) -> list[tuple[Task, str, float]]:
    """Results and seconds; where a process dies or hangs, another one goes on after that task."""
    done: list[tuple[Task, str, float]] = []
    while len(done) < len(tasks):
        left = tasks[len(done) :]
        lines = "".join(f"{json.dumps(task)}\n" for task in left)
        command = [sys.executable, "-m", "tests.fuzz.workers"]
        child = subprocess.run(command, input=lines, capture_output=True, text=True, cwd=ROOT)
        ready, *told = child.stdout.splitlines() or [""]
        assert ready == "ready", child.stderr
        done += [(task, *json.loads(line)) for task, line in zip(left, told, strict=False)]
        if len(told) < len(left):
            late = child.returncode == -signal.SIGALRM
            died = f"the process died (exit status {child.returncode})"
            done.append((left[len(told)], "not done in time" if late else died, float(MOST_SECONDS)))
    return done


def _serve() -> None:
    """Carry out the tasks on standard input."""
    warnings.simplefilter("ignore")
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no result
    with tempfile.TemporaryDirectory() as folder:
        # Libraries and compiled code are loaded before the memory is measured.
        for name, kind in KINDS.items():
            for path in kind.seeds(name):
                _result(Task(name, file=str(path)), Path(folder))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MOST_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        print("ready", file=out, flush=True)
        for line in sys.stdin:
            begun = time.monotonic()
            signal.alarm(MOST_SECONDS)  # ends the process, whatever it is at
            result = _result(Task(*json.loads(line)), Path(folder))
            signal.alarm(0)
            print(json.dumps([result, time.monotonic() - begun]), file=out, flush=True)


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


def tasks_of(kinds: Iterable[str], count: int, seed: int) -> Iterator[Task]:
    """`count` cases, the kinds in turn."""
    names = list(kinds)
    for k in range(count):
        yield Task(names[k % len(names)], seed, k // len(names))


if __name__ == "__main__":
    _serve()
