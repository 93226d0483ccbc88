"""Fixtures that tests of the service share."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from types import SimpleNamespace

import pytest
from watched import leaking

from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.service.sources import Source
from fdd.service.store import Store
from fdd.unit import Unit
from tests.service.senders import Taker


@pytest.fixture(scope="session")
def log():
    """A minute of an axis that leaks from half a minute on."""
    return leaking()


@pytest.fixture(scope="session")
def whole(log):
    found = Pipeline(Unit.load("axis_a"), Model.load(), keep_trajectories=False).push(log)
    assert [f.fault for f in found] == ["internal_leakage"], "else tests with it show nothing"
    return found


@pytest.fixture
def store(tmp_path) -> Iterator[Store]:
    with closing(Store(f"sqlite:///{tmp_path / 'fdd.db'}")) as made:
        yield made


@pytest.fixture
def stop() -> Iterator[threading.Event]:
    """Set at the end, for what runs in threads."""
    event = threading.Event()
    yield event
    event.set()


@pytest.fixture
def taker() -> Taker:
    return Taker()


@pytest.fixture
def start(taker, stop) -> Callable[[Source], Source]:
    """Starts a source, which gives the taker what comes."""

    def started(source: Source) -> Source:
        source.start(taker.put, stop)
        return source

    return started


@pytest.fixture
def ticking(monkeypatch) -> list[float]:
    """The fleet's monotonic clock, s, which the test advances."""
    now = [0.0]
    real = {name: getattr(time, name) for name in ("perf_counter", "time", "sleep")}
    clock = SimpleNamespace(monotonic=lambda: now[0], **real)
    monkeypatch.setattr("fdd.service.fleet.time", clock)
    return now
