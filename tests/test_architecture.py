"""Rules about the code itself: what may not be loaded, how long a module is, docstrings, bounds."""

import ast
import doctest
import gzip
import importlib
import inspect
import pkgutil
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

import estimators
import fdd
from fdd import bounds
from fdd.logs.formats import open_log
from tests.refusal import refused

ROOT = Path(__file__).parent.parent
FILES = [p for package in ("fdd", "estimators", "reports") for p in sorted((ROOT / package).rglob("*"))]
MODULES = [p for p in FILES if p.suffix == ".py"]
LINKING = {".py", ".j2", ".yaml", ".md", ".json", ".html", ".css", ".js", ".toml"}
LONGEST = 450
# Readers of papers follow DOIs; anything else the product fetches or links is a decision to be taken here.
HOSTS = {"127.0.0.1", "doi.org", "filterpy.readthedocs.io", "json-schema.org", "www.w3.org"}


def imported(tree: ast.AST) -> set[str]:
    """Modules that a module imports anywhere, within functions too."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_no_room_goes_through_the_doors() -> None:
    """The import contracts do not see what is taken from the root package."""
    doors = {f"fdd.{door}" for door in fdd.__all__}
    ours = {of(p): imported(ast.parse(p.read_text("utf-8"))) for p in MODULES if of(p).startswith("fdd/")}
    assert [path for path, names in ours.items() if names & doors] == []


def test_nothing_runs_code_from_a_file() -> None:
    """Ruff refuses what does (S, TID251), but not this argument."""
    assert [of(p) for p in MODULES if "allow_pickle=True" in p.read_text("utf-8")] == []


def test_modules_can_be_read_in_one_sitting() -> None:
    lengths = {of(p): len(p.read_text("utf-8").splitlines()) for p in MODULES}
    assert {path: n for path, n in lengths.items() if n > LONGEST} == {}


def test_no_links_but_known_ones() -> None:
    texts = {of(p): p.read_text("utf-8") for p in FILES if p.suffix in LINKING}
    found = {path: set(re.findall(r"https?://([A-Za-z0-9.-]+)", text)) for path, text in texts.items()}
    assert {path: hosts - HOSTS for path, hosts in found.items() if hosts - HOSTS} == {}


# Examples run on imported modules: a module run as a script would leave compiled functions in
# Numba's cache that belong to `__main__`.
NAMES = sorted(
    found.name
    for package in (fdd, estimators)
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
)
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public(module: ModuleType) -> dict[str, object]:
    """Functions and classes that a module defines and does not hide."""
    found = {}
    for name, value in vars(module).items():
        plain = inspect.unwrap(value) if callable(value) else value
        defined_here = getattr(plain, "__module__", None) == module.__name__
        if not name.startswith("_") and defined_here and (inspect.isroutine(plain) or inspect.isclass(plain)):
            found[name] = plain
    return found


def undocumented(name: str) -> list[str]:
    """Of a module, what lacks a docstring."""
    module = importlib.import_module(name)
    bare = [] if (module.__doc__ or "").strip() else [name]
    for label, value in public(module).items():
        if not (value.__doc__ or "").strip():
            bare.append(f"{name}.{label}")
        methods = vars(value).items() if inspect.isclass(value) else ()
        shown = [(m, code) for m, code in methods if inspect.isfunction(code) and not m.startswith("_")]
        bare += [f"{name}.{label}.{m}" for m, code in shown if not inspect.getdoc(code)]
    exported = getattr(module, "__all__", [])
    return bare + [f"{name}.{x}" for x in exported if not inspect.getdoc(getattr(module, x))]


def test_public_names_are_documented() -> None:
    assert [bare for name in NAMES for bare in undocumented(name)] == []


@pytest.mark.parametrize("room", sorted({".".join(name.split(".")[:2]) for name in NAMES}))
def test_examples_hold(room: str, monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.chdir(str(tmp_path))
    runner = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False)
    said: list[str] = []
    for name in (n for n in NAMES if f"{n}.".startswith(f"{room}.")):
        for example in doctest.DocTestFinder(exclude_empty=True).find(importlib.import_module(name), name):
            runner.run(example, out=said.append)
    assert runner.failures == 0, "".join(said)


def test_examples_are_found_in_compiled_and_in_plain_functions() -> None:
    finder = doctest.DocTestFinder()

    def examples(name: str) -> set[str]:
        return {t.name for t in finder.find(importlib.import_module(name)) if t.examples}

    assert "estimators.kernels.kalman_update_correlated" in examples("estimators.kernels")
    assert "fdd.measures.find_measure" in examples("fdd.measures")


BOUNDS = {name: value for name, value in vars(bounds).items() if name.isupper() and name != "RAISABLE"}


def test_the_page_says_what_the_module_says() -> None:
    page = (ROOT / "docs" / "bounds.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([\d,]+) \|", page, flags=re.M)
    assert {name: int(value.replace(",", "")) for name, value in rows} == bounds.RAISABLE | BOUNDS


def test_every_bound_is_used() -> None:
    sources = [p.read_text(encoding="utf-8") for p in (ROOT / "fdd").rglob("*.py") if p.name != "bounds.py"]
    used = set(re.findall(r"[A-Z0-9_]+", "\n".join(sources)))
    assert {*bounds.RAISABLE, *BOUNDS} <= used


def log_of(path: Path, rows: int) -> Path:
    pd.DataFrame({"time": np.arange(rows) * 1e-3, "position": 0.1}).to_parquet(path)
    return path


def test_numbers_beyond_the_bound_can_be_let_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = log_of(tmp_path / "a.parquet", 500)
    monkeypatch.setenv("FDD_MAX_VALUES", "999")
    line = refused(lambda: open_log(path))
    assert "500 rows and 2 columns, at most 999" in line and "set FDD_MAX_VALUES=1000" in line
    monkeypatch.setenv("FDD_MAX_VALUES", "1000")
    assert open_log(path).read(["time"])["time"].size == 500


@pytest.mark.parametrize("packed", [False, True])
def test_bytes_beyond_the_bound_can_be_let_in(packed, tmp_path, monkeypatch):
    text = ("time,position\n" + "".join(f"{k * 1e-3},0.1\n" for k in range(500))).encode()
    path = tmp_path / "a.csv"
    path.write_bytes(gzip.compress(text) if packed else text)
    monkeypatch.setenv("FDD_MAX_LOG_BYTES", str(len(text) - 1))
    line = refused(lambda: open_log(path).read(["time"]))
    assert "or, where memory allows, set FDD_MAX_LOG_BYTES=" in line
    monkeypatch.setenv("FDD_MAX_LOG_BYTES", str(len(text)))
    assert open_log(path).read(["time"])["time"].size == 500


@pytest.mark.parametrize("text", ["0", "-1", "1e9", "x", "9" * 30, "٣"])
def test_a_bound_that_is_no_number(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FDD_MAX_VALUES", text)
    line = refused(lambda: open_log(log_of(tmp_path / "a.parquet", 5)))
    assert re.search("FDD_MAX_VALUES: .* is no whole number above 0", line)
