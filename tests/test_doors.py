"""What `import fdd` gives: quick, typed, and what docs/reference.md and the citation say of it."""

import ast
import doctest
import pkgutil
import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
import yaml

import fdd

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
FUNCTIONS = {"simulate", "read_log", "identify", "load_dataset", "diagnose"}


def test_importing_loads_no_numpy() -> None:
    program = (
        "import sys, fdd; assert set(fdd.__all__) <= set(dir(fdd))\n"
        "print({'numpy', 'pydantic', 'typing_extensions', 'fdd.unit', 'fdd.errors'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout == "set()\n", done.stderr


def test_each_door_is_what_its_name_says_and_no_room_hides_it() -> None:
    rooms = {found.name for found in pkgutil.iter_modules(fdd.__path__)}
    assert not rooms & set(fdd.__all__)
    for room in rooms:
        import_module(f"fdd.{room}")
    for name in fdd.__all__:
        assert getattr(fdd, name).__name__ == name
        assert callable(getattr(fdd, name)) and (name[0].isupper() or name in FUNCTIONS)
    with pytest.raises(AttributeError, match="nothing"):
        _ = fdd.nothing


@pytest.mark.slow
def test_the_example_in_the_help_holds() -> None:
    found = doctest.testmod(fdd)
    assert found.attempted == 7 and not found.failed


def test_type_checkers_see_the_doors_where_they_are() -> None:
    """What is imported for them alone, which `make lint` checks, is what is loaded when it is asked for."""
    (seen,) = (n for n in ast.parse(Path(fdd.__file__).read_text("utf-8")).body if isinstance(n, ast.If)
               and isinstance(n.test, ast.Name))  # fmt: skip
    imported = {a.name: n.module for n in seen.body if isinstance(n, ast.ImportFrom) for a in n.names}
    assert imported == fdd._HOMES and set(imported) == set(fdd.__all__)


def test_the_wheel_takes_the_marker_along() -> None:
    data = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]["package-data"]
    for package in ("fdd", "estimators"):
        assert "py.typed" in data[package] and (ROOT / package / "py.typed").is_file()


@pytest.mark.slow
def test_the_pages_code_runs(tmp_path: Path, monkeypatch, capsys) -> None:
    from fdd.cli.app import app

    monkeypatch.chdir(tmp_path)
    strokes = ["--profile", "constant_speed:amplitude=0.08,speeds=60/105,turn=5,dwell=0.3",
               "--load", "throttle:pressure=1.5e6", "--duration", "21"]  # fmt: skip
    for seed, name, more in (
        (6, "one", []), (7, "two", []), (8, "run", ["--fault", "internal_leakage:severity=0.8,onset=12"]),
    ):  # fmt: skip
        command = ["simulate", "-o", f"{name}.mcap", "--seed", str(seed), *strokes, *more]
        assert app(command, standalone_mode=False) == 0
    blocks = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    assert len(blocks) == 2
    shown: dict = {}
    exec(compile(blocks[0], "reference.md", "exec"), shown)
    assert fdd.Unit.load("unit.yaml").name == shown["unit"].name == shown["answer"].unit
    assert shown["over_time"].estimates["ekf"]["leakage"].shape == shown["over_time"].time.shape
    assert shown["answer"].faults[0].fault == "internal_leakage"
    printed = capsys.readouterr().out
    assert '"verdict": "faulty"' in printed and "internal_leakage 12.0" in printed
    exec(compile(blocks[1], "reference.md", "exec"), shown)
    assert len(shown["run"].partner.truth) == len(shown["run"].partner.samples)


def test_the_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert cited["cff-version"] == "1.2.0" and cited["version"] == fdd.__version__
    assert cited["authors"] == [{"name": "The fdd developers"}]
    modules = [p for room in ("fdd", "estimators") for p in (ROOT / room).rglob("*.py")]
    sources = "".join(p.read_text("utf-8") for p in modules)
    for reference in cited["references"]:
        assert reference["doi"] in sources, "no code names this source"
