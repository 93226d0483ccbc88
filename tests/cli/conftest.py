"""Simulated logs for the commands, made by the command itself."""

import functools
import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from typer.testing import CliRunner, Result

from fdd.cli.app import app


@pytest.fixture(scope="session")
def run():
    """Run a command in this process; gives its result (exit_code, stdout, stderr)."""
    runner = CliRunner()

    def invoke(*arguments: object, input: bytes | str | None = None) -> Result:
        return runner.invoke(app, [str(a) for a in arguments], input=input)

    return invoke


@pytest.fixture(scope="session")
def ran(run):
    """The same, of a command that must succeed."""

    def invoke(*arguments: object, **given: object) -> Result:
        result = run(*arguments, **given)
        assert result.exit_code == 0, result.stderr
        return result

    return invoke


@pytest.fixture(scope="session")
def logs(ran, tmp_path_factory) -> dict[str, Path]:
    """One healthy and one leaking run of axis_a, as MCAP, and the leaking one as CSV and Parquet."""
    folder = tmp_path_factory.mktemp("logs")
    common = ["--profile", "steps:amplitude=0.04,hold=1", "--load", "spring", "--duration", 20, "--seed", 4]
    leak = ["--fault", "internal_leakage:severity=0.8,onset=8"]
    paths = [folder / name for name in ("healthy.mcap", "leaking.mcap", "leaking.csv", "leaking.parquet")]
    for path in paths:
        ran("simulate", "-o", path, *common, *leak * (path.stem == "leaking"))
    return dict(zip(("healthy", "leaking", "csv", "parquet"), paths, strict=True))


@pytest.fixture(scope="session")
def tiny_model_file(tiny_model, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("model") / "model.json"
    tiny_model.save(path)
    return path


@pytest.fixture(scope="session")
def validator(ran):
    """Another library's validator of a published schema, by the kind of file."""

    @functools.cache
    def of(kind: str) -> Draft202012Validator:
        schema = json.loads(ran("schema", kind).stdout)
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
