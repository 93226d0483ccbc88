"""Webhooks against a server that fails, drips and redirects."""

from __future__ import annotations

import hashlib
import hmac
import json
import threading
import time
from collections.abc import Iterator
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fdd.service import config
from fdd.service.outputs import delivery, targets
from fdd.service.outputs.delivery import Undelivered
from fdd.service.outputs.targets import Webhook
from fdd.service.store import Store
from reports.service import free_port
from tests.service.senders import message, sent, transition

MESSAGE = message("alarm", transition())
SECRET = b"a key of thirty-two characters..."


class Receiver(ThreadingHTTPServer):
    """Answers each request by the next of `answers`: status and headers; notes what came."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.answers: list[tuple[int, dict[str, str], bytes]] = []
        self.came: list[tuple[str, dict[str, str], bytes]] = []
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
        try:
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(said)
        except OSError:
            pass

    do_GET = do_POST

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    server = Receiver()
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def hook(url: str, store: Any = None, secret: Path | None = None) -> Webhook:
    return Webhook(config.Webhook(url=url, secret_file=secret), store)


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    (tmp_path / "secret").write_bytes(SECRET)
    return tmp_path / "secret"


def test_a_message_is_signed_and_whole(receiver: Receiver, secret: Path) -> None:
    """And verified as the page tells receivers to do it."""
    page = (Path(__file__).parents[2] / "docs" / "serve-outputs.md").read_text("utf-8")
    names: dict[str, Any] = {"hmac": hmac, "hashlib": hashlib, "time": time}
    exec(page.split("```python\n")[1].split("```")[0], names)
    verified = names["verified"]
    hook(f"{receiver.url}/in?to=fdd", secret=secret).deliver(MESSAGE)
    [(path, headers, body)] = receiver.came
    assert path == "/in?to=fdd"
    assert headers["Content-Type"] == "application/json"
    assert json.loads(body) == {"schema": "fdd.event/1", "id": 7, "kind": "alarm", "data": transition()}
    assert verified(headers, body, SECRET)
    assert not verified(headers, body + b" ", SECRET)
    assert not verified(headers, body, SECRET[:-1])
    assert not verified({**headers, "X-Fdd-Timestamp": str(int(time.time()) - 9)}, body, SECRET)
    hook(receiver.url).deliver(MESSAGE)
    assert not any(name.startswith("X-Fdd") for name in receiver.came[1][1]), "no secret, no signature"


def test_an_answer_that_is_cut_is_none(receiver: Receiver) -> None:
    sender, ok = hook(receiver.url), b"HTTP/1.1 200 OK\r\n"
    for cut in (b"", b"Server: x\r\nContent-Le", b"Content-Length: 10\r\n\r\n{}",
                b"Transfer-Encoding: chunked\r\n\r\n5\r\n{}"):  # fmt: skip
        receiver.cut = ok + cut
        with pytest.raises(Undelivered) as caught:
            sender.deliver(MESSAGE)
        assert caught.value.down and not caught.value.final, cut
    receiver.cut = ok + b"\r\nwhatever, to the end of the connection"
    sender.deliver(MESSAGE)


def test_it_comes_again_with_the_same_key_until_it_is_taken(
    receiver: Receiver, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver.answers = [(500, {}, b"broken"), (429, {"Retry-After": "7"}, b""), (200, {}, b"thanks")]
    now = [1000.0]
    monkeypatch.setattr(delivery, "time", SimpleNamespace(monotonic=lambda: now[0]))
    worker = hook(receiver.url, store)
    for id in (1, 2):
        sent(store, "alarm", transition(id=id), worker.name)
    worker.once()
    assert "500 Internal Server Error broken" in worker.last_error
    now[0] += 2.1
    worker.once()
    now[0] += 6.5
    worker.once()
    assert worker.counts["failed"] == 2, "Retry-After is longer than the wait"
    now[0] += 1.0
    worker.once()
    assert worker.counts["delivered"] == 2
    keys = [headers["Idempotency-Key"] for _, headers, _ in receiver.came]
    assert keys[0] == keys[1] == keys[2] != keys[3]
    assert receiver.came[0][2] == receiver.came[2][2]


def test_answers_say_whether_and_when_to_try_again(receiver: Receiver) -> None:
    sender = hook(receiver.url)
    final = dict.fromkeys((400, 401, 404, 410, 301, 302, 307, 308), (True, False))
    later = dict.fromkeys((408, 500, 502), (False, False)) | dict.fromkeys((429, 503), (False, True))
    for status, wanted in (final | later).items():
        receiver.answers = [(status, {"Location": f"{receiver.url}/elsewhere"}, b"x" * 100_000)]
        with pytest.raises(Undelivered, match=str(status)) as caught:
            sender.deliver(MESSAGE)
        assert (caught.value.final, caught.value.down) == wanted and len(str(caught.value)) <= 300, status
    assert {path for path, _, _ in receiver.came} == {"/"} and len(receiver.came) == len(final | later)
    dates = [formatdate(time.time() + ahead, usegmt=True) for ahead in (600, -60)]
    asked = {dates[0]: (570.0, 601.0), "9" * 9: (86400.0, 86400.0)}
    asked |= dict.fromkeys((dates[1], "soon", "-5", "9" * 400), (0.0, 0.0))
    for text, (least, most) in asked.items():
        receiver.answers = [(503, {"Retry-After": text}, b"")]
        with pytest.raises(Undelivered) as caught:
            sender.deliver(MESSAGE)
        assert least <= caught.value.wait_s <= most, text


def test_a_silent_receiver_takes_a_bounded_time(receiver: Receiver, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(targets, "TIMEOUT_S", 0.3)
    receiver.delay_s = 2.0
    for url, words in ((f"http://127.0.0.1:{free_port()}", "refused"), (receiver.url, None)):
        begun = time.monotonic()
        with pytest.raises(Undelivered, match=words) as caught:
            hook(url).deliver(MESSAGE)
        assert caught.value.down and not caught.value.final
    assert time.monotonic() - begun < 1.0
    one, two = (hook(f"https://hooks.example.com/{path}").name for path in ("token-1", "token-2"))
    assert one != two and one.startswith("webhook:hooks.example.com-") and "token" not in one + two
