"""Rules about the code itself: which way imports run, what may not be loaded, how long a module is."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from importlinter.cli import lint_imports

import fdd

ROOT = Path(__file__).parent.parent
MODULES = sorted(p for package in ("fdd", "estimators", "reports") for p in (ROOT / package).rglob("*.py"))
PRODUCT = [
    p
    for package in ("fdd", "estimators", "reports")
    for p in sorted((ROOT / package).rglob("*"))
    if p.suffix in {".py", ".j2", ".yaml", ".md", ".json", ".html", ".css", ".js", ".toml"}
]
LONGEST = 450
UNSAFE_MODULES = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
UNSAFE_NAMES = {"eval", "exec", "compile", "__import__"}
UNSAFE_YAML = {"load", "load_all", "unsafe_load", "unsafe_load_all", "full_load", "full_load_all"}
UNSAFE_KEYWORDS = {"allow_pickle", "shell"}
# Readers of papers follow DOIs; anything else the product fetches or links is a decision to be taken here.
HOSTS = {"doi.org", "filterpy.readthedocs.io", "json-schema.org", "www.w3.org"}
# The plant simulates; what diagnoses may share a unit with it and nothing else.
DIAGNOSING = (
    "estimators",
    "fdd/sensors",
    "fdd/residuals",
    "fdd/diagnosis",
    "fdd/report",
    "fdd/identification",
    "fdd/history",
    "fdd/offline",
    "fdd/monitor",
)


def imported(tree: ast.AST) -> set[str]:
    """Modules that a module imports anywhere, within functions too."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def unsafe(source: str) -> list[str]:
    """What in a module could run code that stands in a file, as ``line: what``."""
    tree = ast.parse(source)
    found = [name for name in imported(tree) if name.split(".")[0] in UNSAFE_MODULES]
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        call = ast.unparse(node.func)
        if call in UNSAFE_NAMES or (call.startswith("yaml.") and call.split(".")[-1] in UNSAFE_YAML):
            found.append(f"{node.lineno}: {call}")
        for keyword in node.keywords:
            is_false = isinstance(keyword.value, ast.Constant) and keyword.value.value is False
            if keyword.arg in UNSAFE_KEYWORDS and not is_false:
                found.append(f"{node.lineno}: {call}({keyword.arg}=...)")
    return found


def of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def test_import_contracts_hold() -> None:
    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def test_what_diagnoses_never_imports_the_plant() -> None:
    for folder in DIAGNOSING:
        modules = [p for p in MODULES if of(p).startswith(f"{folder}/")]
        assert modules, f"{folder} is gone: correct this list"
        assert [of(p) for p in modules if any("plant" in name for name in imported(parsed(p)))] == []


def test_no_room_goes_through_the_doors() -> None:
    """The import contracts do not see what is taken from the root package."""
    doors = {f"fdd.{door}" for door in fdd.__all__}
    assert [of(p) for p in MODULES if of(p).startswith("fdd/") and imported(parsed(p)) & doors] == []


def test_nothing_runs_code_from_a_file() -> None:
    found = {of(p): unsafe(p.read_text("utf-8")) for p in MODULES}
    assert {path: lines for path, lines in found.items() if lines} == {}


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "def f():\n    from joblib import load",
        "import yaml\nyaml.load(text)",
        "numpy.load(path, allow_pickle=True)",
        "eval('1')",
        "subprocess.run(line, shell=True)",
    ],
)
def test_that_check_sees(source: str) -> None:
    assert len(unsafe(source)) >= 1


def test_modules_can_be_read_in_one_sitting() -> None:
    lengths = {of(p): len(p.read_text("utf-8").splitlines()) for p in MODULES}
    assert {path: n for path, n in lengths.items() if n > LONGEST} == {}


def test_no_links_but_known_ones() -> None:
    found = {of(p): set(re.findall(r"https?://([A-Za-z0-9.-]+)", p.read_text("utf-8"))) for p in PRODUCT}
    assert {path: hosts - HOSTS for path, hosts in found.items() if hosts - HOSTS} == {}


def test_help_imports_nothing_heavy(tmp_path: Path) -> None:
    program = (
        "import sys; sys.argv = ['fdd', '--help']\n"
        "from fdd.cli import main\n"
        "try:\n    main()\n"
        "except SystemExit as stop:\n    assert not stop.code\n"
        "heavy = {'numpy', 'numba', 'scipy', 'pandas', 'pyarrow', 'sklearn', 'pydantic', 'mcap', 'yaml'}\n"
        "print('HEAVY', sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert "diagnose" in done.stdout
    assert done.stdout.splitlines()[-1] == "HEAVY []"
