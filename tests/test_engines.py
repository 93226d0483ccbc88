"""Work over an engine: results with their numbers, errors and lost processes told alike on each."""

import os
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from fdd.engines import Engine, WorkerLost, map_unordered
from fdd.errors import InputError


@pytest.fixture(scope="module", params=["here", "local", "ray"])
def over(request: pytest.FixtureRequest) -> Iterator[partial[Iterator[tuple[int, object]]]]:
    """The engine with two workers, begun once."""
    engine: Engine = "local"
    if request.param == "ray":
        ray = pytest.importorskip("ray", reason="no ray here: install fdd[ray]")
        engine = "ray"
        ray.init(num_cpus=2, object_store_memory=80 << 20, log_to_driver=False, include_dashboard=False,
                 runtime_env={"env_vars": {"PYTHONPATH": os.pathsep.join(WHERE)}})  # fmt: skip
    yield partial(map_unordered, engine=engine, workers=1 if request.param == "here" else 2)
    if engine == "ray":
        ray.shutdown()


WHERE = (str(Path(__file__).parents[1]), str(Path(__file__).parent))


def squared(number: int) -> tuple[int, int, str]:
    return number**2, os.getpid(), str(Path.cwd())


def refuses(number: int) -> int:
    if number == 1:
        raise InputError("too short", where="log.csv", mend="record more")
    return number


def dies(number: int) -> None:
    time.sleep(0.1)
    os._exit(1)


def test_each_job_comes_back_once_with_its_number(over, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = dict(over(squared, range(6)))
    assert {k: v[0] for k, v in found.items()} == {k: k**2 for k in range(6)}
    assert {v[2] for v in found.values()} == {str(tmp_path)}, "relative paths mean what they mean here"
    alone = over.keywords["engine"] == "local" and over.keywords["workers"] == 1
    assert ({v[1] for v in found.values()} == {os.getpid()}) == alone
    assert list(over(refuses, [])) == []


def test_what_the_work_raises_is_raised_here(over) -> None:
    with pytest.raises(InputError) as told:
        list(over(refuses, range(3)))
    assert str(told.value) == "log.csv: too short; record more" and told.value.mend == "record more"
    assert type(told.value) is InputError


def test_a_process_that_dies_is_told(over) -> None:
    if over.keywords["workers"] == 1:
        pytest.skip("it is this one")
    with pytest.raises(WorkerLost, match="ended unexpectedly"):
        list(over(dies, range(2)))
