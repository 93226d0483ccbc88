"""The dispatcher: every target for itself, whatever the others and the store do."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from outputs_fakes import FakeBus, FakeEvent, FakeStore, finding, free_port, transition, until

from fdd.errors import InputError
from fdd.samples import Samples
from fdd.service.outputs import Outputs, outputs
from fdd.service.outputs.courier import Undelivered
from fdd.service.outputs.webhook import Webhook

SLOW, QUICK = "http://slow.example/in", "http://quick.example/in"


def settings_of(**given: Any) -> Any:
    return SimpleNamespace(
        **{"mqtt": None, "webhooks": [], "jsonl": None, "recording": None, "foxglove": None, **given}
    )


def hook(url: str, *kinds: str, secret_file: Path | None = None) -> Any:
    return SimpleNamespace(url=url, kinds=kinds or ("alarm", "finding"), secret_file=secret_file)


@pytest.fixture
def stop() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


def test_who_is_told_what(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    made = Outputs(
        settings_of(jsonl=path, webhooks=[hook(SLOW, "alarm"), hook(QUICK)]), FakeStore(), FakeBus()
    )
    slow, quick = Webhook(SLOW).name, Webhook(QUICK).name
    assert made.targets("alarm") == ["jsonl", slow, quick]
    assert made.targets("finding") == ["jsonl", quick]
    assert made.targets("alarm", notify=False) == ["jsonl"], "of chatter people hear nothing"


def test_one_that_hangs_holds_up_no_other(
    tmp_path: Path, stop: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    hang = threading.Event()
    quick, slow = Webhook(QUICK).name, Webhook(SLOW).name

    def deliver(self: Webhook, parcel: Any) -> None:
        if self.name == slow and not hang.wait(20):
            raise Undelivered("too slow")

    monkeypatch.setattr(Webhook, "deliver", deliver)
    store, bus, path = FakeStore(), FakeBus(), tmp_path / "events.jsonl"
    made = Outputs(settings_of(jsonl=path, webhooks=[hook(SLOW), hook(QUICK)]), store, bus)
    made.start(stop)
    until(lambda: len(bus.subscriptions) == 3)
    begun = time.monotonic()
    for target in made.targets("alarm"):
        store.send("alarm", transition(), target)
    bus.publish(FakeEvent("alarm", "A1", 1.0, transition()))
    until(lambda: {p.target for p in store.arrived} == {quick, "jsonl"})
    assert time.monotonic() - begun < 10
    assert made.status()[slow]["delivered"] == 0 and made.status()[quick]["delivered"] == 1
    hang.set()
    until(lambda: not store.rows)
    stop.set()
    made.join(5)
    assert not any(thread.is_alive() for thread in made._threads)


def test_a_store_in_trouble_is_waited_for(
    tmp_path: Path, stop: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outputs, "TROUBLE_S", 0.05)
    store, path = FakeStore(trouble=OSError("the database is locked")), tmp_path / "events.jsonl"
    made = Outputs(settings_of(jsonl=path), store, FakeBus())
    store.send("finding", {"axis": "A1", **finding()}, "jsonl")
    made.start(stop)
    until(lambda: "locked" in made.status()["jsonl"]["last_error"])
    store.trouble = None
    until(lambda: not store.rows and not made.status()["jsonl"]["last_error"])
    assert json.loads(path.read_text("utf-8"))["data"]["fault"] == "pump_wear"


def test_live_states_that_cannot_be_written_are_counted(
    tmp_path: Path, stop: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus, path = FakeBus(), tmp_path / "events.jsonl"
    made = Outputs(settings_of(jsonl=path), FakeStore(), bus)
    made.start(stop)
    until(lambda: bus.subscriptions)
    bus.publish(FakeEvent("status", "A1", 1.0, {"state": "healthy"}))
    until(lambda: path.exists() and json.loads(path.read_text("utf-8"))["axis"] == "A1")
    path.write_bytes(b"no line of ours")
    path.rename(tmp_path / "away")
    path.mkdir()
    bus.publish(FakeEvent("status", "A2", 1.0, {"state": "healthy"}))
    bus.subscriptions[0].lost = 7
    until(lambda: made.status()["jsonl"]["lost"] == 8)


def test_the_recorder_takes_samples(tmp_path: Path, stop: threading.Event) -> None:
    bus = FakeBus()
    recording = SimpleNamespace(folder=tmp_path / "rec", before=10.0, after=10.0, most_bytes=1 << 30)
    made = Outputs(settings_of(recording=recording), FakeStore(), bus)
    assert made.recorder is not None and made.targets("alarm") == []
    made.start(stop)
    time_ = np.arange(500) * 0.01
    made.recorder.push("A1", Samples(time_, {"position": np.sin(time_)}))
    until(lambda: made.recorder and not made.recorder._waiting and len(bus.subscriptions) == 2)
    bus.publish(FakeEvent("alarm", "A1", 5.0, transition()))
    until(lambda: made.status()["recording"]["running"] == 1)
    stop.set()
    made.join(10)
    assert made.status()["recording"]["files"] == 1
    assert len(list((tmp_path / "rec").glob("A1_*.mcap"))) == 1


def test_settings_that_cannot_work_are_refused_at_once(tmp_path: Path) -> None:
    for given in (
        {"webhooks": [hook("ftp://x")]},
        {"webhooks": [hook(QUICK, secret_file=tmp_path / "none")]},
        {"jsonl": tmp_path / "none" / "x.jsonl"},
    ):
        with pytest.raises(InputError):
            Outputs(settings_of(**given), FakeStore(), FakeBus())


def test_a_broker_that_is_away_stops_nothing(tmp_path: Path, stop: threading.Event) -> None:
    broker = SimpleNamespace(
        host="127.0.0.1", chosen_port=free_port(), prefix="fdd", user=None, password_file=None, tls=None,
        version="5", client_id=None, keepalive=30,
    )  # fmt: skip
    store = FakeStore()
    made = Outputs(settings_of(mqtt=broker, jsonl=tmp_path / "x.jsonl"), store, FakeBus())
    for target in made.targets("alarm"):
        store.send("alarm", transition(), target)
    made.start(stop)
    until(lambda: store.arrived and made.status()["mqtt"]["failed"])
    assert [p.target for p in store.arrived] == ["jsonl"]
    assert made.status()["mqtt"]["last_error"] and not made.status()["mqtt"]["connected"]
    begun = time.monotonic()
    stop.set()
    made.join(10)
    assert time.monotonic() - begun < 5
