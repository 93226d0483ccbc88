"""Every target for itself, whatever others, the store and a receiver do; what must arrive does, in order."""

import hashlib
import hmac
import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import ValidationError

from fdd.errors import InputError
from fdd.service import config, outputs
from fdd.service.outputs import LONGEST_WAIT_S, MOST_ATTEMPTS, Target, Undelivered, targets
from fdd.service.outputs.targets import Outputs, Webhook
from fdd.service.queues import Bus, Event
from fdd.service.store import OutboxMessage, Store
from reports.service import free_port
from tests.service.senders import finding, message, sent, transition, until

SLOW, QUICK = "http://slow.example/in", "http://quick.example/in"
MESSAGE = message("alarm", transition())
SECRET = b"a key of thirty-two characters..."


def made_of(store: Store, bus: Bus, **given: Any) -> Outputs:
    return Outputs(config.Outputs(**given), store, bus)


def hook(url: str, *kinds: Any, secret_file: Path | None = None) -> config.Webhook:
    return config.Webhook(url=url, kinds=kinds or ("alarm", "finding"), secret_file=secret_file)


def test_one_that_hangs_or_is_away_holds_up_no_other(store, stop, monkeypatch):
    hang = threading.Event()
    quick, slow = (Webhook(hook(url), store).name for url in (QUICK, SLOW))

    def deliver(self: Webhook, message: Any) -> None:
        if self.name == slow and not hang.wait(20):
            raise Undelivered("too slow")

    monkeypatch.setattr(Webhook, "deliver", deliver)
    bus, away = Bus(), {"host": "127.0.0.1", "port": free_port()}
    made = made_of(store, bus, mqtt=away, webhooks=(hook(SLOW, "alarm"), hook(QUICK)))
    assert sorted(made.targets["alarm", True]) == sorted(["mqtt", slow, quick])
    assert sorted(made.targets["finding", True]) == sorted(["mqtt", quick])
    assert not {slow, quick} & set(made.targets["alarm", False]), "of chatter people hear nothing"
    made.start(stop)
    begun = time.monotonic()
    for target in made.targets["alarm", True]:
        sent(store, "alarm", transition(), target)
    until(lambda: len(bus._subscriptions) >= 3)
    for subscription in bus._subscriptions:
        subscription.lost = 7
    bus.publish(Event("alarm", "A1", 1.0, transition()))
    until(lambda: made.status()[quick]["delivered"] == 1 and made.status()[quick]["lost"] == 7)
    assert time.monotonic() - begun < 10 and made.status()[slow]["delivered"] == 0
    until(lambda: made.status()["mqtt"]["failed"])
    assert made.status()["mqtt"]["last_error"] and not made.status()["mqtt"]["connected"]
    hang.set()
    until(lambda: made.status()[slow]["delivered"] == 1)
    begun = time.monotonic()
    stop.set()
    made.join(10)
    assert time.monotonic() - begun < 5 and not any(thread.is_alive() for thread in made._threads)


def test_a_store_in_trouble_is_waited_for(store, stop, monkeypatch):
    taken: list[OutboxMessage] = []
    monkeypatch.setattr(Webhook, "deliver", lambda self, message: taken.append(message))
    monkeypatch.setattr(outputs, "TROUBLE_S", 0.05)
    made, name = made_of(store, Bus(), webhooks=(hook(QUICK),)), Webhook(hook(QUICK), store).name
    sent(store, "finding", {"axis": "A1", **finding()}, name)

    def locked(limit: int, target: str) -> Any:
        raise OSError("the database is locked")

    with monkeypatch.context() as trouble:
        trouble.setattr(store, "outbox", locked)
        made.start(stop)
        until(lambda: "locked" in made.status()[name]["last_error"])
    until(lambda: made.status()[name]["delivered"] and not made.status()[name]["last_error"])
    assert [message.body["fault"] for message in taken] == ["pump_wear"]


def test_addresses_topics_and_secrets_that_cannot_be_used(store, tmp_path):
    for url in ("ftp://a/b", "file:///etc/passwd", "https://", "http:///x", "http://u:p@a/", "http://a/ b",
                "x", "", "http://a:99999/", "http://a:0/", "http://[::1", "http://a/#b", "http://a/\r\nX: y",
                "http://a/ü"):  # fmt: skip
        with pytest.raises(ValidationError):
            config.Webhook(url=url)
    for prefix in ("", "a/+", "#", "/a", "$SYS", "a\0"):
        with pytest.raises(ValidationError):
            config.MqttOutput(host="a", prefix=prefix)
    path = tmp_path / "password"
    for content in (None, b"", b" \n", b"x" * 5000, b"\xff"):
        if content is not None:
            path.write_bytes(content)
        for given in (
            {"webhooks": [hook(QUICK, secret_file=path)]},
            {"mqtt": {"host": "a", "user": "fdd", "password_file": path}},
        ):
            with pytest.raises(InputError, match=str(path)):
                made_of(store, Bus(), **given)
    path.write_text("no certificate")
    for files in ({"ca": path}, {"cert": path, "key": path}, {"ca": tmp_path / "none"}):
        with pytest.raises(InputError, match="TLS cannot be set up"):
            made_of(store, Bus(), mqtt={"host": "a", "tls": files})


@pytest.fixture
def clock(monkeypatch) -> SimpleNamespace:
    made = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(outputs, "time", SimpleNamespace(monotonic=lambda: made.now))
    monkeypatch.setattr(outputs, "random", SimpleNamespace(uniform=lambda low, high: high))
    return made


class Moody(Target):
    """Takes messages, or fails as it is told to, by the message's id."""

    def __init__(self, store: Store, failures: dict[int, list[Any]]) -> None:
        super().__init__("t", store)
        self.failures, self.taken, self.tried = failures, list[int](), list[int]()

    def deliver(self, message: OutboxMessage) -> None:
        self.tried.append(message.id)
        if waiting := self.failures.get(message.id):
            raise waiting.pop(0)
        self.taken.append(message.id)


def given_up(store: Store) -> list[str]:
    return [r["note"] for r in store.audit() if r["action"] == "GIVEN_UP"]


def test_a_failure_holds_back_what_comes_after_it(store, clock):
    first, second = (sent(store, "alarm", transition(id=id), "t") for id in (1, 2))
    sent(store, "alarm", transition(), "another target")
    target = Moody(store, {second: [Undelivered("500")]})
    target.once()
    assert target.taken == [first]
    counts = {"delivered": 1, "failed": 1, "given_up": 0, "pending": 1, "lost": 0}
    assert target.status() == {**counts, "last_error": "500"}
    target.once()
    assert target.tried == [first, second], "nothing is tried before its time"
    clock.now += 2.1
    target.once()
    assert target.taken == [first, second] and target.counts["pending"] == 0 and not target.last_error
    assert store.outbox(9, "t") == [] and len(store.outbox(9, "another target")) == 1


def attempts(store: Store, clock: SimpleNamespace, target: Target, most: int) -> list[float]:
    times: list[float] = []
    while store.outbox(1, "t") and len(times) < most:
        failed = target.counts["failed"]
        target.once()
        times += [clock.now] * (target.counts["failed"] > failed)
        clock.now += 0.5 if len(times) < 6 else 50.0
    return times


def test_waits_double_up_to_a_bound_and_an_end_that_is_audited(store, clock):
    id = sent(store, "finding", {"axis": "A1"}, "t")
    target = Moody(store, {id: [Undelivered("500 no")] * MOST_ATTEMPTS})
    times = attempts(store, clock, target, 10 * MOST_ATTEMPTS)
    for k, (a, b) in enumerate(pairwise(times), 1):
        wanted = min(2.0**k, LONGEST_WAIT_S)
        assert wanted <= b - a <= wanted + 50.0 * (k > 5), "a step of the clock later at most"
    assert target.counts["given_up"] == 1
    assert given_up(store) == [f"finding {id} never arrived at t ({MOST_ATTEMPTS} attempts: 500 no)"]
    again = sent(store, "finding", {"axis": "A1"}, "t")
    for _ in range(MOST_ATTEMPTS):  # counted over restarts too
        Moody(store, {again: [Undelivered("500")]}).once()
    assert len(given_up(store)) == 2


def test_while_the_target_is_down_nothing_is_given_up(store, clock):
    id = sent(store, "finding", {"axis": "A1"}, "t")
    down = [Undelivered("refused", down=True) for _ in range(3 * MOST_ATTEMPTS)]
    target = Moody(store, {id: down})
    assert len(attempts(store, clock, target, 3 * MOST_ATTEMPTS)) == 3 * MOST_ATTEMPTS
    assert target.counts["given_up"] == 0 and store.outbox(1, "t")[0].attempts == 0
    clock.now += LONGEST_WAIT_S
    target.once()
    assert store.outbox(1, "t") == [] and target.counts["delivered"] == 1


@pytest.mark.parametrize("final", [True, False])
def test_what_will_never_arrive_is_given_up_and_the_next_goes_on(store, clock, monkeypatch, final):
    monkeypatch.setattr(outputs, "MOST_ATTEMPTS", 1)
    first, second = (sent(store, "alarm", transition(a), "t") for a in ("RAISED", "RETURNED"))
    error = Undelivered("400 not like this", final=True) if final else KeyError("axis")
    target = Moody(store, {first: [error]})
    target.once()
    assert target.taken == [second]
    assert ("400 not like this" if final else "KeyError: 'axis'") in given_up(store)[0]


class Receiver(ThreadingHTTPServer):
    """Answers each request by the next of `answers`: status and headers; notes what came."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.answers = list[tuple[int, dict[str, str], bytes]]()
        self.came = list[tuple[str, dict[str, str], bytes]]()
        self.delay_s, self.cut = 0.0, b""

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    server: Any

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.came.append((self.path, dict(self.headers), body))
        time.sleep(self.server.delay_s)
        status, headers, said = self.server.answers.pop(0) if self.server.answers else (204, {}, b"")
        if self.server.cut:
            self.wfile.write(self.server.cut)
            self.close_connection = True
            return
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(said)

    do_GET = do_POST


@pytest.fixture
def receiver():
    server = Receiver()
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def sender_of(receiver: Receiver, store: Any = None, **more: Any) -> Webhook:
    return Webhook(hook(receiver.url, **more), store)


def test_a_message_is_signed_and_whole(receiver, tmp_path):
    """And verified as the page tells receivers to do it."""
    page = (Path(__file__).parents[2] / "docs" / "serve-outputs.md").read_text("utf-8")
    names: dict[str, Any] = {"hmac": hmac, "hashlib": hashlib, "time": time}
    exec(page.split("```python\n")[1].split("```")[0], names)
    verified = names["verified"]
    (tmp_path / "secret").write_bytes(SECRET)
    Webhook(hook(f"{receiver.url}/in?to=fdd", secret_file=tmp_path / "secret"), None).deliver(MESSAGE)
    [(path, headers, body)] = receiver.came
    assert path == "/in?to=fdd" and headers["Content-Type"] == "application/json"
    assert json.loads(body) == {"schema": "fdd.event/1", "id": 7, "kind": "alarm", "data": transition()}
    assert verified(headers, body, SECRET)
    assert not verified(headers, body + b" ", SECRET)
    assert not verified(headers, body, SECRET[:-1])
    assert not verified({**headers, "X-Fdd-Timestamp": str(int(time.time()) - 9)}, body, SECRET)
    sender_of(receiver).deliver(MESSAGE)
    assert not any(name.startswith("X-Fdd") for name in receiver.came[1][1]), "no secret, no signature"


def test_an_answer_that_is_cut_is_none(receiver):
    sender, ok = sender_of(receiver), b"HTTP/1.1 200 OK\r\n"
    for cut in (b"", b"Server: x\r\nContent-Le", b"Content-Length: 10\r\n\r\n{}",
                b"Transfer-Encoding: chunked\r\n\r\n5\r\n{}"):  # fmt: skip
        receiver.cut = ok + cut
        with pytest.raises(Undelivered) as caught:
            sender.deliver(MESSAGE)
        assert caught.value.down and not caught.value.final, cut
    receiver.cut = ok + b"\r\nwhatever, to the end of the connection"
    sender.deliver(MESSAGE)


def test_it_comes_again_with_the_same_key_until_it_is_taken(receiver, store, clock):
    receiver.answers = [(500, {}, b"broken"), (429, {}, b""), (200, {}, b"thanks")]
    worker = sender_of(receiver, store)
    for id in (1, 2):
        sent(store, "alarm", transition(id=id), worker.name)
    worker.once()
    assert "500 Internal Server Error broken" in worker.last_error
    for wait in (2.1, 4.1):
        clock.now += wait
        worker.once()
    assert (worker.counts["failed"], worker.counts["delivered"]) == (2, 2)
    keys = [headers["Idempotency-Key"] for _, headers, _ in receiver.came]
    assert keys[0] == keys[1] == keys[2] != keys[3]
    assert receiver.came[0][2] == receiver.came[2][2]


def test_answers_say_whether_to_try_again(receiver):
    sender = sender_of(receiver)
    final = dict.fromkeys((400, 401, 404, 410, 301, 302, 307, 308), (True, False))
    later = dict.fromkeys((408, 500, 502), (False, False)) | dict.fromkeys((429, 503), (False, True))
    for status, wanted in (final | later).items():
        receiver.answers = [(status, {"Location": f"{receiver.url}/elsewhere"}, b"x" * 100_000)]
        with pytest.raises(Undelivered, match=str(status)) as caught:
            sender.deliver(MESSAGE)
        assert (caught.value.final, caught.value.down) == wanted and len(str(caught.value)) <= 300, status
    assert {path for path, _, _ in receiver.came} == {"/"} and len(receiver.came) == len(final | later)


def test_a_silent_receiver_takes_a_bounded_time(receiver, monkeypatch):
    monkeypatch.setattr(targets, "TIMEOUT_S", 0.3)
    receiver.delay_s = 2.0
    for url, words in ((f"http://127.0.0.1:{free_port()}", "refused"), (receiver.url, None)):
        begun = time.monotonic()
        with pytest.raises(Undelivered, match=words) as caught:
            Webhook(hook(url), None).deliver(MESSAGE)
        assert caught.value.down and not caught.value.final
    assert time.monotonic() - begun < 1.0
    one, two = (Webhook(hook(f"https://hooks.example.com/token-{k}"), None).name for k in (1, 2))
    assert one != two and one.startswith("webhook:hooks.example.com-") and "token" not in one + two
