"""The dispatcher: every target for itself, whatever the others and the store do."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outputs_fakes import finding, measured, sent, transition
from pydantic import ValidationError

from fdd.errors import InputError
from fdd.logs import read_log
from fdd.samples import Samples
from fdd.service import config
from fdd.service.bus import Bus, Event
from fdd.service.outputs import delivery
from fdd.service.outputs.delivery import Outputs
from fdd.service.outputs.targets import Undelivered, Webhook
from fdd.service.store import Store
from reports.service import free_port
from tests.service.senders import until

SLOW, QUICK = "http://slow.example/in", "http://quick.example/in"


def made_of(store: Store, bus: Bus, **given: Any) -> Outputs:
    return Outputs(config.Outputs(**given), store, bus, lambda axis: None)


def hook(url: str, *kinds: Any, secret_file: Path | None = None) -> config.Webhook:
    return config.Webhook(url=url, kinds=kinds or ("alarm", "finding"), secret_file=secret_file)


def test_who_is_told_what(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    made = made_of(store, Bus(), jsonl=path, webhooks=(hook(SLOW, "alarm"), hook(QUICK)))
    slow, quick = Webhook(SLOW).name, Webhook(QUICK).name
    assert made.targets["alarm", True] == ["jsonl", slow, quick]
    assert made.targets["finding", True] == ["jsonl", quick]
    assert made.targets["alarm", False] == ["jsonl"], "of chatter people hear nothing"


def test_one_that_hangs_holds_up_no_other(
    store: Store, tmp_path: Path, stop: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    hang = threading.Event()
    quick, slow = Webhook(QUICK).name, Webhook(SLOW).name

    def deliver(self: Webhook, message: Any) -> None:
        if self.name == slow and not hang.wait(20):
            raise Undelivered("too slow")

    monkeypatch.setattr(Webhook, "deliver", deliver)
    bus, path = Bus(), tmp_path / "events.jsonl"
    made = made_of(store, bus, jsonl=path, webhooks=(hook(SLOW), hook(QUICK)))
    made.start(stop)
    until(lambda: len(bus._subscriptions) == 3)
    begun = time.monotonic()
    for target in made.targets["alarm", True]:
        sent(store, "alarm", transition(), target)
    bus.publish(Event("alarm", "A1", 1.0, transition()))
    until(lambda: made.status()[quick]["delivered"] == made.status()["jsonl"]["delivered"] == 1)
    assert time.monotonic() - begun < 10
    assert made.status()[slow]["delivered"] == 0
    hang.set()
    until(lambda: made.status()[slow]["delivered"] == 1)
    stop.set()
    made.join(5)
    assert not any(thread.is_alive() for thread in made._threads)


def test_a_store_in_trouble_is_waited_for(
    store: Store, tmp_path: Path, stop: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delivery, "TROUBLE_S", 0.05)
    path = tmp_path / "events.jsonl"
    made = made_of(store, Bus(), jsonl=path)
    sent(store, "finding", {"axis": "A1", **finding()}, "jsonl")

    def locked(limit: int, target: str) -> Any:
        raise OSError("the database is locked")

    with monkeypatch.context() as trouble:
        trouble.setattr(store, "outbox", locked)
        made.start(stop)
        until(lambda: "locked" in made.status()["jsonl"]["last_error"])
    until(lambda: made.status()["jsonl"]["delivered"] and not made.status()["jsonl"]["last_error"])
    assert json.loads(path.read_text("utf-8"))["data"]["fault"] == "pump_wear"


def test_live_states_that_cannot_be_written_are_counted(
    store: Store, tmp_path: Path, stop: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus, path = Bus(), tmp_path / "events.jsonl"
    made = made_of(store, bus, jsonl=path)
    made.start(stop)
    until(lambda: bus._subscriptions)
    bus.publish(Event("status", "A1", 1.0, {"state": "healthy"}))
    until(lambda: path.exists() and json.loads(path.read_text("utf-8"))["axis"] == "A1")
    path.rename(tmp_path / "away")
    path.mkdir()
    next(iter(bus._subscriptions)).lost = 7
    bus.publish(Event("status", "A2", 1.0, {"state": "healthy"}))
    until(lambda: made.status()["jsonl"]["lost"] == 8)


def test_the_recorder_takes_samples(store: Store, tmp_path: Path, stop: threading.Event) -> None:
    bus = Bus()
    made = made_of(store, bus, recording=config.Recording(folder=tmp_path / "rec", before=10.0, after=10.0))
    assert made.targets["alarm", True] == []
    made.start(stop)
    time_ = np.arange(500) * 0.01
    sizes = {"position": 0.02, "pump_angle": 40.0, "pressure_difference": 1e6}
    columns = {name: size * np.sin(time_) for name, size in sizes.items()}
    bus.publish(measured("A1", Samples(time_, columns)))
    bus.publish(Event("alarm", "A1", 5.0, transition()))
    until(lambda: made.status()["recording"]["running"] == 1)
    stop.set()
    made.join(10)
    assert made.status()["recording"]["files"] == 1
    [path] = (tmp_path / "rec").glob("A1_*.mcap")
    assert read_log(path).samples.duration == pytest.approx(4.99, abs=1e-6), "a stop leaves what there is"


@pytest.mark.parametrize(
    "url",
    ["ftp://a/b", "file:///etc/passwd", "https://", "http:///x", "http://u:p@a/", "http://a/ b", "x", "",
     "http://a:99999/", "http://a:0/", "http://[::1", "http://a/#b", "http://a/\r\nX: y", "http://a/ü"],
)  # fmt: skip
def test_no_other_urls(url: str) -> None:
    with pytest.raises(ValidationError):
        config.Webhook(url=url)


@pytest.mark.parametrize("prefix", ["", "a/+", "#", "/a", "$SYS", "a\0"])
def test_prefixes_that_are_no_topics(prefix: str) -> None:
    with pytest.raises(ValidationError):
        config.MqttOutput(host="a", prefix=prefix)


def test_secrets_that_are_missing_empty_or_endless(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "password"
    for content in (None, b"", b" \n", b"x" * 5000, b"\xff"):
        if content is not None:
            path.write_bytes(content)
        for given in (
            {"webhooks": [hook(QUICK, secret_file=path)]},
            {"mqtt": {"host": "a", "user": "fdd", "password_file": path}},
        ):
            with pytest.raises(InputError) as caught:
                made_of(store, Bus(), **given)
            assert str(path) in str(caught.value)
    path.write_text("no certificate")
    for files in ({"ca": path}, {"cert": path, "key": path}, {"ca": tmp_path / "none"}):
        with pytest.raises(InputError, match="TLS cannot be set up"):
            made_of(store, Bus(), mqtt={"host": "a", "tls": files})
    with pytest.raises(InputError, match="no such folder"):
        made_of(store, Bus(), jsonl=tmp_path / "none" / "x.jsonl")


def test_a_broker_that_is_away_stops_nothing(store: Store, tmp_path: Path, stop: threading.Event) -> None:
    broker = {"host": "127.0.0.1", "port": free_port()}
    made = made_of(store, Bus(), mqtt=broker, jsonl=tmp_path / "x.jsonl")
    for target in made.targets["alarm", True]:
        sent(store, "alarm", transition(), target)
    made.start(stop)
    until(lambda: made.status()["jsonl"]["delivered"] and made.status()["mqtt"]["failed"])
    assert made.status()["mqtt"]["last_error"] and not made.status()["mqtt"]["connected"]
    begun = time.monotonic()
    stop.set()
    made.join(10)
    assert time.monotonic() - begun < 5
