"""A real server on a port: events, TLS, and clients that are slow on purpose."""

from __future__ import annotations

import json
import shutil
import socket
import ssl
import subprocess
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from fdd.bounds import MAX_HEAD_BYTES, MOST_IDLE_HTTP_CONNECTIONS, MOST_LISTENERS
from fdd.service.http import Listen, Server, connections
from tests.service.fake import FakeBus, FakeFleet, FakeStore, fake
from tests.service.serving import PAGE, app_of, on_a_port

POST = b"POST /api/%s HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Fdd: 1\r\n"
World = tuple[FakeFleet, FakeStore, FakeBus]


@pytest.fixture
def world() -> World:
    return fake(2)


@pytest.fixture
def server(world: World) -> Iterator[Server]:
    with on_a_port(world) as made:
        yield made


def connected(server: Server, source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection((server.host, server.port), timeout=20, source_address=(source, 0))


def seconds_of(server: Server) -> float:
    begun = time.monotonic()
    with urllib.request.urlopen(f"{server.address}api/health", timeout=5) as found:
        assert json.load(found)["status"] == "ok"
    return time.monotonic() - begun


class Listener:
    """One listener on the events, with what it heard."""

    def __init__(self, server: Server, last: str | None = None) -> None:
        self.client = httpx.Client(timeout=20, trust_env=False)
        headers = {} if last is None else {"last-event-id": last}
        self.request = self.client.stream("GET", f"{server.address}api/events", headers=headers)
        self.response = self.request.__enter__()
        self.status = self.response.status_code
        self.lines = self.response.iter_lines() if self.status == 200 else iter(())
        if self.status == 200:
            self.until(": connected")

    def until(self, begins: str) -> str:
        return next(line for line in self.lines if line.startswith(begins))

    def event(self) -> tuple[str, dict]:
        return self.until("id: ")[4:], json.loads(self.until("data: ")[6:])

    def close(self) -> None:
        self.request.__exit__(None, None, None)
        self.client.close()


def test_small_answers_go_out_at_once(server: Server) -> None:
    """Head and body are two packets: held back for an acknowledgement, each answer would take 40 ms."""
    taken = []
    with httpx.Client(trust_env=False) as client:
        for _ in range(25):
            begun = time.perf_counter()
            assert client.get(f"{server.address}api/health").status_code == 200
            taken.append(time.perf_counter() - begun)
    assert sorted(taken)[12] < 0.03


def test_events_come_as_they_happen_and_are_caught_up_with(server: Server, world: World) -> None:
    bus = world[2]
    listener = Listener(server)
    bus.publish("alarm", "rig/axis-1", note="a\nevent: evil\n\ndata: {}")
    id, event = listener.event()
    assert (event["kind"], event["axis"]) == ("alarm", "rig/axis-1")
    assert event["data"]["note"] == "a\nevent: evil\n\ndata: {}"
    listener.close()
    for k in range(5):
        bus.publish("status", "rig/axis-2", k=k)
    time.sleep(1.0)
    again = Listener(server, last=id)
    assert [again.event()[1]["data"]["k"] for _ in range(5)] == list(range(5))
    again.close()


@pytest.mark.parametrize("last", ["0-0", "x", "-", "99999999", "a" * 200])
def test_who_cannot_catch_up_is_told_to_begin_anew(server: Server, last: str) -> None:
    listener = Listener(server, last=last)
    assert listener.until("event: ") == "event: reset"
    listener.close()


def test_who_falls_behind_is_told_to_begin_anew(world: World) -> None:
    from fdd.service.http.events import KEPT, Hub

    hub = Hub(world[2])
    for k in range(KEPT + 10):
        hub.tell(type("Event", (), {"kind": "status", "axis": "A", "time": 0.0, "data": {"k": k}}))
    assert hub._place(f"{hub._run}-{KEPT + 8}") == KEPT + 9
    assert len(hub._row) == KEPT

    async def first(last: str) -> bytes:
        stream = hub.stream(last)
        await anext(stream)
        told = await anext(stream)
        await stream.aclose()  # type: ignore[attr-defined]
        return told

    import asyncio

    assert b"event: reset" in asyncio.run(first(f"{hub._run}-3"))
    assert asyncio.run(first(f"{hub._run}-{KEPT}")).count(b"data: ") == 9


def test_listeners_are_bounded_and_leave_room_when_they_go(server: Server) -> None:
    listeners = [Listener(server) for _ in range(MOST_LISTENERS)]
    refused = Listener(server)
    assert refused.status == 503
    for one in (refused, *listeners):
        one.close()
    until = time.monotonic() + 20
    while (again := Listener(server)).status != 200:
        again.close()
        assert time.monotonic() < until
        time.sleep(0.2)
    again.close()


def test_hundreds_of_slow_clients_keep_nobody_out(server: Server) -> None:
    """Slowloris from many addresses: heads and bodies that never end, silence, a byte now and then."""
    begun = [
        b"GET /api/axes HTTP/1.1\r\nHost: 127.0.0.1\r\nX-",
        b"",
        b"GET /api/health HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET /api",
        POST % b"alarms/1/acknowledge" + b"Content-Length: 100\r\n\r\n{",
        POST % b"login" + b"Transfer-Encoding: chunked\r\n\r\n1\r\n{\r\n",
    ]
    slow = []
    for k in range(600):
        one = connected(server, f"127.0.1.{k % 50 + 1}")
        one.sendall(begun[k % 5])
        slow.append(one)
    taken = []
    for _ in range(20):
        for one in slow[::6]:
            try:
                one.sendall(b"a")
            except OSError:
                continue
        taken.append(seconds_of(server))
    assert max(taken) < 3.0, taken
    time.sleep(1.0)
    for one in slow:
        one.setblocking(False)
    still = sum(is_open(one) for one in slow)
    assert still <= MOST_IDLE_HTTP_CONNECTIONS
    for one in slow:
        one.close()


def is_open(one: socket.socket) -> bool:
    try:
        while data := one.recv(65536):
            del data
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def test_a_crowd_of_one_address_closes_its_own_connections(server: Server) -> None:
    """However new they are: who else began a request before them is answered."""
    other = socket.create_connection((server.host, server.port), 10, source_address=("127.0.0.2", 0))
    other.sendall(b"GET /api/axes HTTP/1.1\r\nHost: 127.0.0.1\r\n")
    time.sleep(0.2)
    crowd = [
        socket.create_connection((server.host, server.port), 10)
        for _ in range(2 * MOST_IDLE_HTTP_CONNECTIONS)
    ]
    time.sleep(0.5)
    other.sendall(b"\r\n")
    assert other.recv(12) == b"HTTP/1.1 200"
    for one in (other, *crowd):
        one.close()


def test_a_head_that_never_ends_has_its_time(monkeypatch: pytest.MonkeyPatch, server: Server) -> None:
    monkeypatch.setattr(connections, "REQUEST_S", 1.0)
    with connected(server) as one:
        begun = time.monotonic()
        one.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-")
        try:
            while time.monotonic() - begun < 15 and one.recv(1) != b"":
                pass
        except ConnectionResetError:
            pass
        assert 0.5 < time.monotonic() - begun < 8


def test_a_body_that_never_ends_has_its_time(monkeypatch: pytest.MonkeyPatch, server: Server) -> None:
    from fdd.service.http import guard

    monkeypatch.setattr(guard, "BODY_S", 0.5)
    with connected(server) as one:
        one.sendall(POST % b"alarms/1/shelve" + b"Content-Length: 99\r\n\r\n{")
        assert b" 408 " in one.recv(4096)


def test_who_does_not_read_is_let_go(monkeypatch: pytest.MonkeyPatch, server: Server, world: World) -> None:
    monkeypatch.setattr(connections, "REQUEST_S", 1.0)
    bus = world[2]
    with socket.socket() as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        one.connect((server.host, server.port))
        one.sendall(b"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        time.sleep(0.5)
        assert len(server._server.server_state.connections) == 1
        until = time.monotonic() + 40
        while server._server.server_state.connections:
            for _ in range(20):
                bus.publish("status", "rig/axis-1", filling="x" * 20_000)
            assert time.monotonic() < until, "is still there"
            time.sleep(0.1)
    assert seconds_of(server) < 3.0


@pytest.mark.parametrize(
    "sent, status",
    [
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * MAX_HEAD_BYTES * 2 + b"\r\n\r\n", b" 431 "),
        (b"GET /" + b"a" * MAX_HEAD_BYTES * 2 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", b" 431 "),
        (b"GET /api/axes/x%0d%0aSet-Cookie:%20a=b HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", b" 404 "),
        (b"GET / HTTP/1.1\r\n\r\n", b" 400 "),
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n", b" 400 "),
        (b"GET / HTTP/1.0\r\n\r\n", b" 421 "),
        (b"\x16\x03\x01\x02\x00\x01\x00", b" 400 "),
        (POST % b"logout" + b"Content-Length: 1\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", None),
        (b"OPTIONS /api/axes HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://evil.example\r\n\r\n", b" 403 "),
        (b"TRACE / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", b" 403 "),
    ],
)
def test_what_is_no_proper_request_is_refused(server: Server, sent: bytes, status: bytes | None) -> None:
    with connected(server) as one:
        one.sendall(sent)
        head = one.recv(65536)
        said = head.splitlines()[0]
        # A long head is refused as a whole, or by the parser when it comes in pieces.
        assert status is None or status in said or (status == b" 431 " and b" 400 " in said)
        assert b"set-cookie: a" not in head.lower() and b"access-control" not in head.lower()
    assert seconds_of(server) < 3.0


def test_tls_by_certificate_and_key(world: World, tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl to make a certificate")
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    subprocess.run(
        [
            "openssl",
            "req",
            "-x509",
            "-newkey",
            "ec",
            "-pkeyopt",
            "ec_paramgen_curve:prime256v1",
            "-nodes",
            "-days",
            "2",
            "-subj",
            "/CN=localhost",
            "-addext",
            "subjectAltName=IP:127.0.0.1",
            "-keyout",
            key,
            "-out",
            cert,
        ],
        check=True,
        capture_output=True,
    )
    app, _ = app_of(*world, secure=True)
    server, stop = Server(app, Listen(port=0, cert=cert, key=key), has_tokens=False), threading.Event()
    thread = server.start(stop)
    trusted = ssl.create_default_context(cafile=str(cert))
    with httpx.Client(verify=trusted, trust_env=False) as client:
        found = client.get(f"{server.address}api/axes")
        assert found.status_code == 200 and "strict-transport-security" in found.headers
        assert client.post(f"{server.address}api/logout", headers=PAGE).status_code == 200
    with pytest.raises(OSError):
        urllib.request.urlopen(f"http://{server.host}:{server.port}/", timeout=5)
    stop.set()
    thread.join(15)
    assert not thread.is_alive()
