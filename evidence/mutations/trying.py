"""Try slips, each in a process of its own that is forked from one where all else is loaded.

mutmut and cosmic-ray write each change to a file and start Python anew, which costs more here than most
tests; and as Numba's compiled code is kept by the contents of its package's files, any change would compile
all of a package. Here a changed module is compiled in memory, what imports it is loaded again, and plants
that were simulated for the unchanged code are not simulated again.
"""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType
from typing import Any

import coverage
import pytest

import estimators.compiled
import fdd
import fdd.plant.simulate as plant
from evidence.mutations.slips import Slip, changed, slips

ROOT = Path(__file__).parents[2]
ROOMS = ("residuals", "diagnosis", "campaign", "monitor")
ABOVE = tuple(
    f"fdd.{x}"
    for x in (*ROOMS, "report", "identification", "history", "learning", "offline", "service", "cli")
)
"""What may hold something of the rooms."""
MORE = {
    "decision", "standing", "lookout", "evidence", "fitting", "ledger", "account", "epochs", "rows",
    "balances", "effects", "baseline", "calibration", "stream_clock",
}  # fmt: skip
"""Modules of which twice as many slips are tried."""
CPU_S, PATIENCE_S = 120, 900.0
"""Of processor time, and of time, after which a slip is taken for one that never ends."""
MOST_TESTS_S = 30.0
"""Of processor time that a slip's tests take on the unchanged code."""
OPTIONS = ["--no-header", "--tb=no", "-m", "not slow", "-p", "no:cacheprovider"]
UNNOTICED = ("none", "never run")


def drawn(room: str, each: int, seed: int) -> list[Slip]:
    """A sample of a room's slips, the same for a seed; of compiled ones two a module at most."""
    found: list[tuple[int, Slip]] = []
    for path in sorted((ROOT / "fdd" / room).glob("*.py")):
        known = slips(f"fdd.{room}.{path.stem}", path.read_text(encoding="utf-8"))
        random.Random(f"{seed} {room}.{path.stem}").shuffle(known)
        twice = path.stem in MORE
        chosen = [s for s in known if not s.compiled][: 2 * each if twice else each]
        found += [(k if twice else 2 * k, s) for k, s in enumerate(chosen)]
        found += [(1000, s) for s in [s for s in known if s.compiled][:2]]
    return [s for _, s in sorted(found, key=lambda x: x[0])]


class Tests:
    """A pytest plugin: runs tests of some names alone (all where None), in their order, and notes what each
    takes (s of processor time), which lines it runs and which fails first."""

    def __init__(self, names: Sequence[str] | None = None, cover: coverage.Coverage | None = None) -> None:
        self.order = None if names is None else {n: k for k, n in enumerate(names)}
        self.cover, self.failed, self.took, self.since = cover, "", dict[str, float](), 0.0

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        if (order := self.order) is not None:
            items[:] = sorted((i for i in items if i.nodeid in order), key=lambda i: order[i.nodeid])

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.since = time.process_time()
        if self.cover is not None:
            self.cover.switch_context(nodeid)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.took[nodeid] = time.process_time() - self.since

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.failed = self.failed or (report.nodeid if report.failed else "")

    pytest_collectreport = pytest_runtest_logreport


class Covered:
    """What the unchanged code's tests take and run: module to line to tests."""

    def __init__(self, files: Sequence[str]) -> None:
        simulated: dict[str, plant.Simulation] = {}
        once = plant.simulate

        def kept(*arguments: Any, **more: Any) -> plant.Simulation:
            key = repr((arguments, more))
            if key not in simulated:
                simulated[key] = once(*arguments, **more)
            return simulated[key]

        plant.simulate = kept
        rooms = [f"{ROOT}/fdd/{room}/*" for room in ROOMS]
        self.cover = coverage.Coverage(data_file=None, branch=True, include=rooms)
        told = Tests(cover=self.cover)
        with self.cover.collect():
            pytest.main([*files, *OPTIONS], plugins=[told])
        if told.failed:
            raise SystemExit(f"{told.failed} fails on the unchanged code: mend it first")
        self.took = told.took
        self.lines: dict[str, dict[int, set[str]]] = defaultdict(dict)
        for file in self.cover.get_data().measured_files():
            module = ".".join(Path(file).relative_to(ROOT).with_suffix("").parts)
            for line, names in self.cover.get_data().contexts_by_lineno(file).items():
                self.lines[module][line] = set(names) - {""}

    def tests(self, slip: Slip) -> list[str]:
        """Tests that may notice a slip: those that run its line before the others of their files, for which a
        fixture may have run it, its room's before others', and quick ones first.
        What is compiled is not seen to run."""
        lines = self.lines[slip.module]
        if slip.line not in lines and not slip.compiled:
            return []
        runs = lines.get(slip.line) or set().union(*lines.values()) or set(self.took)
        files = {name.partition("::")[0] for name in runs}
        room = f"tests/{slip.module.split('.')[1]}/"
        beside = (n for n in self.took if n.partition("::")[0] in files)
        out: list[str] = []
        total = 0.0
        for name in sorted(beside, key=lambda n: (n not in runs, not n.startswith(room), self.took[n])):
            total += self.took[name]
            if total <= MOST_TESTS_S or not out:
                out.append(name)
        return out


class Slipped(SourceFileLoader):
    """Loads one module with a slip."""

    place = 0

    def get_code(self, fullname: str) -> CodeType:
        tree = changed(Path(self.path).read_text(encoding="utf-8"), self.place)
        return self.source_to_code(tree, str(self.path))

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        return spec_from_file_location(fullname, self.path, loader=self) if fullname == self.name else None


def _child(slip: Slip, tests: Sequence[str], out: int) -> None:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nothing, stream)
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None) or ""
        if name.startswith(ABOVE) or file.startswith(f"{ROOT}/tests/"):
            del sys.modules[name]
    for door in fdd.__all__:  # or the package would keep what stands behind it
        vars(fdd).pop(door, None)
    loader = Slipped(slip.module, f"{ROOT}/{slip.module.replace('.', '/')}.py")
    loader.place = slip.place
    sys.meta_path.insert(0, loader)
    if slip.compiled:
        estimators.compiled._keep = lambda *_: None
    told = Tests(tests)
    files = dict.fromkeys(t.partition("::")[0] for t in tests)
    code = pytest.main([*files, *OPTIONS, "-x"], plugins=[told])
    os.write(out, (told.failed or (f"pytest's status {code}" if code else UNNOTICED[0])).encode())


def tried(slip: Slip, covered: Covered) -> str:
    """Which test notices a slip, or one of `UNNOTICED`."""
    tests = covered.tests(slip)
    if not tests:
        return UNNOTICED[1]
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            _child(slip, tests, write)
        finally:
            os._exit(0)
    os.close(write)
    end = time.monotonic() + PATIENCE_S
    while not os.waitpid(pid, os.WNOHANG)[0]:
        if time.monotonic() > end:
            os.killpg(pid, signal.SIGKILL)
        time.sleep(0.05)
    with os.fdopen(read) as said:
        return said.read() or "no end, or a crash"


def all_tried(rooms: Sequence[str], each: int, seed: int, kept: Path) -> Iterator[tuple[Slip, str]]:
    """Try samples of rooms' slips, some of each module at a time; what `kept` has is not tried again."""
    rows = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    known = {Slip(*slip): noticed for slip, noticed in map(json.loads, rows)}
    wanted = [s for room in rooms for s in drawn(room, each, seed)]
    fresh = [s for s in wanted if s not in known]
    if fresh:
        examples = (f"tests/test_docstrings.py::test_examples_hold[{m}]" for m in {s.module for s in fresh})
        covered = Covered([*(f"tests/{room}" for room in (*ROOMS, "learning")), *sorted(examples)])
    for slip in fresh:
        known[slip] = tried(slip, covered)
        with kept.open("a", encoding="utf-8") as file:
            file.write(json.dumps([slip, known[slip]]) + "\n")
        print(f"{slip.module}:{slip.line} {slip.change}: {known[slip]}", flush=True)
    yield from ((s, known[s]) for s in wanted)
