"""Compiled code on disk: used again as long as no source changed, never after one did."""

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
    "fdd.logs.grid": ["fdd.logs.grid"],
    "fdd.plant": ["fdd.plant"],
    "fdd.residuals": ["fdd.residuals", "estimators"],
    "fdd.sensors": ["fdd.sensors"],
}
MODULES = sorted(p for package in ("fdd", "estimators", "reports") for p in (ROOT / package).rglob("*.py"))
# Calls a compiled function of one package that holds one of another.
CURVE = """
import numpy as np
from estimators.eha import model as eha
from reports.estimators.matched import _curve as called
q = np.ones(1, eha.PARAMETERS)[0]
q.static_forward = 2.0
result = called(np.array([0.5]), q)[0]
"""
COMPILED = """
import numpy as np
from pathlib import Path
from typing import NamedTuple
from estimators.compiled import compiler
@compiler(Path(__file__).parent / "estimators")()
"""


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
    plain = {name: v for name, v in os.environ.items() if name not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
    done = subprocess.run(
        [sys.executable, "-c", program + told], cwd=installed, env=plain | environment, capture_output=True,
        text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    value, hits = done.stdout.split()
    return float(value), int(hits), done.stderr


@pytest.mark.slow
def test_an_edit_is_compiled_and_no_edit_is_not(installed: Path, tmp_path: Path) -> None:
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    first, hits, _ = run(installed, CURVE, **kept)
    assert hits == 0 and run(installed, CURVE, **kept)[:2] == (first, 1)
    files = {path for path in (tmp_path / "kept").rglob("*") if path.is_file()}

    module, old = installed / "estimators/eha/model.py", "    level = coulomb + excess\n"
    text = module.read_text("utf-8")
    assert text.count(old) == 1, "it changed: correct this test"
    edit = old.replace("excess", "7.0 * excess")
    module.write_text("\n" + text.replace(old, edit), "utf-8")  # all lines shift
    edited, hits, _ = run(installed, CURVE, **kept)
    assert hits == 0 and edited != pytest.approx(first, rel=1e-4)
    interpreted = CURVE + "\nclass called:\n    class stats:\n        cache_hits = {}\n"
    assert edited == pytest.approx(run(installed, interpreted, NUMBA_DISABLE_JIT="1")[0], rel=1e-9)
    assert run(installed, CURVE, **kept)[:2] == (edited, 1)
    assert {path for path in (tmp_path / "kept").rglob("*") if path.is_file()} == files, "nothing old is left"


@pytest.mark.slow
def test_where_sources_cannot_be_written_the_users_folder_serves(installed: Path, tmp_path: Path) -> None:
    (installed / "halved.py").write_text(COMPILED + "def called(x):\n    return x / 2\n")
    (installed / "__pycache__").write_text("no folder, so nothing can be kept here")
    program = "from halved import called\nresult = called(3)"
    for hits in (0, 1):
        user = str(tmp_path / "user")
        assert run(installed, program, XDG_CACHE_HOME=user, HOME=user) == (1.5, hits, "")
    (installed / "file").write_text("")
    nowhere = str(installed / "file")
    for _ in range(2):
        value, hits, said = run(installed, program, XDG_CACHE_HOME=nowhere, HOME=nowhere)
        assert (value, hits) == (1.5, 0)
        assert said.count("set NUMBA_CACHE_DIR to a folder that can be written") == 1


@pytest.mark.slow
def test_a_file_of_another_signature_is_not_used(installed: Path, tmp_path: Path) -> None:
    """Numba numbers its files by an index that two processes may write at once."""
    (installed / "halved.py").write_text(COMPILED + "def called(x):\n    return x / 2\n")
    kept = tmp_path / "kept"
    for argument, half in (("3", 1.5), ("5.0", 2.5)):
        program = f"from halved import called\nresult = called({argument})"
        assert run(installed, program, NUMBA_CACHE_DIR=str(kept))[0] == half
    one, two = sorted(kept.rglob("halved.*.nbc"))
    shutil.copy(one, two)
    assert run(installed, program, NUMBA_CACHE_DIR=str(kept))[:2] == (2.5, 0)


@pytest.mark.slow
def test_a_list_of_kept_code_with_a_type_that_is_gone_is_made_anew(installed: Path, tmp_path: Path) -> None:
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for name, hits in (("Old", 0), ("New", 0), ("New", 1)):
        pair = f"class {name}(NamedTuple):\n    x: float\n"
        (installed / "halved.py").write_text(COMPILED + f"def called(pair):\n    return pair.x / 2\n{pair}")
        program = f"from halved import called, {name}\nresult = called({name}(3.0))"
        assert run(installed, program, **kept)[:2] == (1.5, hits)


@pytest.mark.slow
def test_kept_code_runs_without_the_compiler_and_new_code_finds_it(installed: Path, tmp_path: Path) -> None:
    solve = "def called(a, b):\n    return np.linalg.solve(a, b @ np.ones(2))\n"
    (installed / "solved.py").write_text(COMPILED + solve)
    program = (
        "import sys, numba, numpy as np\n"
        "from solved import called\n"
        "a = np.diag([2.0, 4.0])\n"
        "result = called(a, np.ones((2, 2))).sum()\n"
        "result += 10.0 * ('numba.np.arraymath' not in sys.modules)\n"
        "result += numba.njit(lambda x: np.linalg.inv(x)[0, 0])(a)\n"
    )
    kept = str(tmp_path / "kept")
    assert run(installed, program, NUMBA_CACHE_DIR=kept)[:2] == (1.5 + 0.5, 0)
    assert run(installed, program, NUMBA_CACHE_DIR=kept)[:2] == (1.5 + 10.0 + 0.5, 1)


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
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    compiled = [f for f in functions if any("njit" in ast.unparse(d) for d in f.decorator_list)]
    used = {n.id for function in compiled for n in ast.walk(function) if isinstance(n, ast.Name)} - {"njit"}
    return {
        node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and node.module
        and node.module.split(".")[0] in ("fdd", "estimators")
        and {alias.asname or alias.name for alias in node.names} & used
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
        if "@njit(" in source:
            assert {package_of(m) for m in foreign(ast.parse(source))} <= set(COMPILING[package]), where
