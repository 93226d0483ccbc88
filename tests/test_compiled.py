"""Compiled code on disk: used again as long as no source changed, never after one did."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from estimators.compiled import sources_key

ROOT = Path(__file__).parent.parent
# Each package that compiles, and all whose functions and constants its compiled code may hold.
COMPILING = {
    "estimators": ["estimators"],
    "reports.estimators": ["reports.estimators", "estimators"],
    "fdd.logs.wire": ["fdd.logs.wire"],
    "fdd.plant": ["fdd.plant"],
    "fdd.residuals": ["fdd.residuals", "estimators"],
    "fdd.sensors": ["fdd.sensors"],
}
MODULES = sorted(p for package in ("fdd", "estimators", "reports") for p in (ROOT / package).rglob("*.py"))

THIN = """
import numpy as np
from fdd.plant import conditions
from fdd.plant.integrator import MEMORIES, thin as called
from fdd.plant.details import Details
from fdd.plant.load import NoLoad
from fdd.plant.parameters import plant_parameters
from fdd.unit import Unit
now, par = np.ones((1, conditions.COLUMNS)), plant_parameters(Unit.load("axis_a"), Details(), NoLoad())
called(now, 0, 40.0, np.array([[8.0, -3.1, 30.0]]), np.zeros(MEMORIES), 0, par)
result = now[0, conditions.CROSS_LEAKAGE]
"""
SENSORS = """
import numpy as np
from estimators.eha import layout, model as eha
from estimators.eha.redundancy import PAIRS, compare_sensors as called
x, P, memory = np.zeros(eha.STATES), 1e-4 * np.eye(eha.STATES), np.zeros(1, layout.MEMORY)[0]
memory.pairs = PAIRS - 1
called(x, P, 10.0, 1e-4, memory)
result = x[eha.ZERO]
"""
CURVE = """
import numpy as np
from estimators.eha import model as eha
from reports.estimators.matched import _curve as called
q = np.ones(1, eha.PARAMETERS)[0]
q.static_forward = 2.0
result = called(np.array([0.5]), q)[0]
"""
# A program that calls a compiled function; then another module that is compiled into it, and an edit there.
LEVEL = (
    "estimators/eha/model.py",
    "    level = coulomb + excess\n",
    "    level = coulomb + 7.0 * excess\n",
)
EDITS = {
    "called by the benchmark": (CURVE, *LEVEL),
    "inlined by the plant": (
        THIN,
        "fdd/plant/laws.py",
        "inner = intercept + ",
        "inner = 1.01 * intercept + ",
    ),
    "a constant": (SENSORS, "estimators/eha/forces.py", "\nROBUST = 5.0", "\nROBUST = 7.0"),
}


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder with copies of all packages, that was never compiled."""
    for package in ("estimators", "fdd", "reports"):
        kept_out = shutil.ignore_patterns("__pycache__", "*.mcap")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=kept_out)
    return tmp_path


def run(installed: Path, program: str, **environment: str) -> tuple[float, int, str]:
    """What a new process computes, how often it found compiled code on disk, and what it complains of."""
    told = "\nprint(float(result), sum(called.stats.cache_hits.values()))"
    plain = {
        name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "NUMBA_CACHE_DIR")
    }
    done = subprocess.run(
        [sys.executable, "-c", program + told],
        cwd=installed,
        env=plain | environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    value, hits = done.stdout.split()
    return float(value), int(hits), done.stderr


def uncompiled(installed: Path, program: str) -> float:
    """What the sources say, by the interpreter alone."""
    interpreted = program + "\nclass called:\n    class stats:\n        cache_hits = {}\n"
    return run(installed, interpreted, NUMBA_DISABLE_JIT="1")[0]


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text("utf-8")
    assert text.count(old) == 1, f"{path.name} changed: correct this test"
    path.write_text(text.replace(old, new), "utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_is_compiled_and_no_edit_is_not(edit: str, installed: Path, tmp_path: Path) -> None:
    program, module, old, new = EDITS[edit]
    kept = tmp_path / "kept"

    first, hits, _ = run(installed, program, NUMBA_CACHE_DIR=str(kept))
    assert hits == 0
    assert run(installed, program, NUMBA_CACHE_DIR=str(kept))[:2] == (first, 1)
    files = {path for path in kept.rglob("*") if path.is_file()}

    replace(installed / module, old, new)
    (installed / module).write_text(
        "\n" + (installed / module).read_text("utf-8"), "utf-8"
    )  # all lines shift
    edited, hits, _ = run(installed, program, NUMBA_CACHE_DIR=str(kept))
    assert hits == 0
    assert edited != pytest.approx(first, rel=1e-4)
    assert edited == pytest.approx(uncompiled(installed, program), rel=1e-9)
    assert run(installed, program, NUMBA_CACHE_DIR=str(kept))[:2] == (edited, 1)
    assert {path for path in kept.rglob("*") if path.is_file()} == files  # nothing old is left behind


@pytest.mark.slow
def test_where_sources_cannot_be_written_the_users_folder_serves(installed: Path, tmp_path: Path) -> None:
    (installed / "fdd/plant/__pycache__").write_text("no folder, so nothing can be kept here")
    user = {"XDG_CACHE_HOME": str(tmp_path / "user"), "HOME": str(tmp_path / "user")}
    first, hits, said = run(installed, THIN, **user)
    assert (hits, said) == (0, "")
    assert run(installed, THIN, **user)[:2] == (first, 1)


@pytest.mark.slow
def test_where_nothing_can_be_written_it_says_so_and_compiles(installed: Path) -> None:
    (installed / "fdd/plant/__pycache__").write_text("")
    (installed / "file").write_text("")
    user = {"XDG_CACHE_HOME": str(installed / "file"), "HOME": str(installed / "file")}
    for _ in range(2):
        value, hits, said = run(installed, THIN, **user)
        assert value == pytest.approx(uncompiled(installed, THIN), rel=1e-9)
        assert hits == 0
        assert said.count("set NUMBA_CACHE_DIR to a folder that can be written") == 1


def test_the_key_is_of_names_and_contents(tmp_path: Path) -> None:
    for copy in ("one", "two"):
        (tmp_path / copy / "below").mkdir(parents=True)
        (tmp_path / copy / "a.py").write_text("x = 1\n")
        (tmp_path / copy / "below/b.py").write_text("y = 2\n")
    one, two = tmp_path / "one", tmp_path / "two"
    assert sources_key(one) == sources_key(two)
    keys = {sources_key(one), sources_key(one, two), sources_key(one / "below")}
    (one / "below/b.py").write_text("y = 3\n")
    keys.add(sources_key(one))
    (one / "below/b.py").rename(one / "below/c.py")
    keys.add(sources_key(one))
    assert len(keys) == 5
    (tmp_path / "empty").mkdir()
    assert sources_key(tmp_path / "empty") is None


def package_of(module: str) -> str:
    return next((package for package in COMPILING if f"{module}.".startswith(f"{package}.")), module)


def foreign(tree: ast.Module) -> set[str]:
    """Modules of ours from which a module's compiled functions take a name."""
    compiled = [
        node
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(d) for d in node.decorator_list)
    ]
    used = {n.id for function in compiled for n in ast.walk(function) if isinstance(n, ast.Name)} - {"njit"}
    return {
        node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and node.module
        and node.module.split(".")[0] in ("fdd", "estimators")
        for alias in node.names
        if (alias.asname or alias.name) in used
    }


def test_compiled_functions_are_kept_by_all_that_they_hold() -> None:
    for path in MODULES:
        where, source = str(path.relative_to(ROOT)), path.read_text("utf-8")
        package = package_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
        if path.name != "compiled.py":
            assert "from numba import njit" not in source, where
            assert "numba.njit" not in source or "cache=True" not in source, where
        if "import njit" in source:
            assert f"from {package}.compiled import njit" in source, where
            assert {package_of(m) for m in foreign(ast.parse(source))} <= set(COMPILING[package]), where
