"""The code's size and structure, and how fast it starts, of two commits side by side."""

from __future__ import annotations

import ast
import io
import os
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import grimp

from fdd.markdown import table

PRODUCT = ("fdd", "estimators")
STARTS = 5
"""Runs of which the median is told."""


def report_text(before: str, after: str, progress: Callable[[float], None] = lambda part: None) -> str:
    """What ``reports/house.md`` says (Markdown).

    Parameters
    ----------
    before, after : commits. progress : told the share that is done.
    """
    measured = []
    for commit in (before, after):
        with tempfile.TemporaryDirectory(prefix="fdd-house-") as name:
            folder = Path(name)
            _unpack(commit, folder)
            measured.append((_rooms(folder), _figures(folder)))
            progress(0.5 * len(measured))
    (rooms, figures), (new_rooms, new_figures) = measured
    lines = [
        "# The house, before and after", "",
        f"Made by `python -m evidence house --before {before} --after {after}`: lines with comments and "
        "docstrings; arrows are imports from one room to another, circles modules that import each other. "
        f"Times are of whole processes, medians of {STARTS} (cold: one run, nothing compiled).", "",
        *table(["", "before", "after"], [[n, figures.get(n, "–"), v] for n, v in new_figures.items()], "lr"),
    ]  # fmt: skip
    cells = []
    for room in sorted({*rooms, *new_rooms}):
        sizes = (r.get(room, (0, 0)) for r in (rooms, new_rooms))
        cells.append([room, *(f"{n:,}" if n else "–" for size in sizes for n in size)])
    lines += table(["room", "lines before", "modules", "lines after", "modules"], cells, "lr")
    return "\n".join(lines)


def _unpack(commit: str, folder: Path) -> None:
    packed = subprocess.run(["git", "archive", commit], capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")


def _rooms(folder: Path) -> dict[str, tuple[int, int]]:
    """Room to its lines and modules."""
    rooms: dict[str, tuple[int, int]] = {}
    for path in folder.rglob("*.py"):
        parts = path.relative_to(folder).parts
        if parts[0] in (*PRODUCT, "evidence", "tests"):
            room = "/".join(parts[: 2 if len(parts) > 2 and parts[0] in PRODUCT else 1])
            lines, modules = rooms.get(room, (0, 0))
            rooms[room] = lines + len(path.read_text("utf-8").splitlines()), modules + 1
    return rooms


def _figures(folder: Path) -> dict[str, str]:
    modules = [p for name in PRODUCT for p in (folder / name).rglob("*.py")]
    lines = {p: len(p.read_text("utf-8").splitlines()) for p in modules}
    largest = max(lines, key=lambda p: lines[p])
    names = {p: _imported(p) for p in modules}
    heaviest = max(names, key=lambda p: names[p])
    arrows, circles = _imports(folder)
    run = _Runner(folder)
    demo = ["-c", "from fdd.cli import main; main()", "diagnose", str(folder / "fdd/demo/demo.mcap")]
    demo += ["--unit", str(folder / "fdd/demo/unit.yaml")]
    cold = run.seconds(*demo)
    return {
        "lines of what is installed": f"{sum(lines.values()):,}",
        "modules": str(len(modules)),
        "arrows between rooms": str(arrows),
        "circles of modules": str(circles),
        "largest module": f"{largest.relative_to(folder)}, {lines[largest]}",
        "most names imported": f"{heaviest.relative_to(folder)}, {names[heaviest]}",
        "wheel": f"{run.wheel() / 1e6:.2f} MB",
        "`import fdd`": run.told("-c", "import fdd"),
        "`fdd --help`": run.told("-c", "from fdd.cli import main; main()", "--help"),
        "`fdd diagnose`, 30 s log, cold": f"{cold:.1f} s",
        "the same, warm": run.told(*demo),
    }


def _imported(path: Path) -> int:
    """Names that a module takes from others of the project."""
    tree = ast.parse(path.read_text("utf-8"))
    own = (n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module)
    return sum(len(n.names) for n in own if str(n.module).partition(".")[0] in PRODUCT)


def _imports(folder: Path) -> tuple[int, int]:
    """Arrows between rooms, and circles of modules."""
    sys.path.insert(0, str(folder))
    try:
        graph = grimp.build_graph(*PRODUCT, cache_dir=None, exclude_type_checking_imports=True)
    finally:
        sys.path.remove(str(folder))
    pairs = {(_room(a), _room(b)) for a in graph.modules for b in graph.find_modules_directly_imported_by(a)}
    above = {a: graph.find_upstream_modules(a) for a in graph.modules}
    circles = {frozenset({a, *(b for b in above[a] if a in above[b])}) for a in above}
    return sum(a != b for a, b in pairs), sum(len(c) > 1 for c in circles)


def _room(module: str) -> str:
    parts = module.split(".")
    return ".".join(parts[: 2 if parts[0] == "fdd" else 1])


class _Runner:
    """Runs Python on a copy of the project, with compiled code of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        own = {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / ".compiled"), "COLUMNS": "100"}
        self.environment = {**os.environ, **own}

    def seconds(self, *arguments: str) -> float:
        begun = time.perf_counter()
        subprocess.run([sys.executable, *arguments], cwd=self.folder, env=self.environment, check=True,
                       capture_output=True)  # fmt: skip
        return time.perf_counter() - begun

    def told(self, *arguments: str) -> str:
        return f"{median(self.seconds(*arguments) for _ in range(STARTS)):.2f} s"

    def wheel(self) -> int:
        out = self.folder / "wheel"
        self.seconds(
            "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", ".", "-w", str(out)
        )
        return next(out.glob("*.whl")).stat().st_size
