"""Simulated logs for the commands, made by the command itself."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from typer.testing import CliRunner, Result

from fdd.cli.app import app
from fdd.diagnosis.model import Model


@pytest.fixture(scope="session")
def run():
    """Run a command in this process; gives its result (exit_code, stdout, stderr)."""
    runner = CliRunner()

    def invoke(*arguments: object, input: bytes | str | None = None) -> Result:
        return runner.invoke(app, [str(a) for a in arguments], input=input)

    return invoke


@pytest.fixture(scope="session")
def logs(run, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One healthy and one leaking run of axis_a, as MCAP, and the leaking one as CSV and Parquet."""
    folder = tmp_path_factory.mktemp("logs")
    leak = "internal_leakage:severity=0.8,onset=8"
    common = ["--profile", "steps:amplitude=0.04,hold=1", "--load", "spring", "--duration", 20, "--seed", 4]
    made = {
        "healthy": (folder / "healthy.mcap", []),
        "leaking": (folder / "leaking.mcap", ["--fault", leak]),
        "csv": (folder / "leaking.csv", ["--fault", leak]),
        "parquet": (folder / "leaking.parquet", ["--fault", leak]),
    }
    for path, more in made.values():
        result = run("simulate", "-o", path, *common, *more)
        assert result.exit_code == 0, result.stderr
    return {name: path for name, (path, _) in made.items()}


@pytest.fixture(scope="session")
def tiny_model_file(tiny_model: Model, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`tiny_model` as ``fdd train`` would write it."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    tiny_model.save(path)
    return path


@pytest.fixture(scope="session")
def validator(run):
    """Another library's validator of a published schema, by the kind of file."""

    @functools.cache
    def of(kind: str) -> Draft202012Validator:
        result = run("schema", kind)
        assert result.exit_code == 0, result.stderr
        schema = json.loads(result.stdout)
        Draft202012Validator.check_schema(schema)
        return Draft202012Validator(schema)

    return of


@pytest.fixture(scope="session")
def one_line():
    """The contract's way to refuse: status 2 and one line that names what is wrong."""

    def check(result: Result, *words: str) -> None:
        assert result.exit_code == 2, (result.exit_code, result.stdout, result.stderr)
        (line,) = result.stderr.splitlines()
        assert line.startswith("fdd: error: ") and all(word in line for word in words), line

    return check
