"""What strangers and other sites' pages try: refused in one line, and nothing happens."""

from __future__ import annotations

from pathlib import Path

import pytest
from starlette.testclient import TestClient

from fdd.bounds import MAX_REQUEST_BYTES
from tests.service.fake import FakeBus, FakeFleet, FakeStore, fake
from tests.service.serving import PAGE, app_of, bearer, client_of, three_tokens

World = tuple[FakeFleet, FakeStore, FakeBus]
EVIL = """<script>alert('x')</script><img src=x onerror=alert(1)>"'\r\nX-Evil: 1"""


@pytest.fixture
def world() -> World:
    made = fake(2)
    made[0].raise_alarm("rig/axis-1", "internal_leakage", "leakage", "high")
    return made


def state_of(world: World) -> str:
    return str(world[1].rows[1]["state"])


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"origin": "http://evil.example"},
        {"origin": "null", **PAGE},
        {"origin": "http://evil.example", **PAGE},
        {"origin": "http://127.0.0.1:8081", **PAGE},
        {"sec-fetch-site": "cross-site", **PAGE},
        {"sec-fetch-site": "same-site", **PAGE},
        {"content-type": "text/plain"},
    ],
)
@pytest.mark.parametrize("path", ["/api/alarms/1/acknowledge", "/api/diagnose?name=a.csv", "/api/logout"])
def test_another_sites_page_does_nothing(world: World, path: str, headers: dict[str, str]) -> None:
    refused = client_of(world).post(path, headers=headers, content=b"{}")
    assert refused.status_code == 403
    assert state_of(world) == "UNACK"


def test_the_own_page_and_programs_with_a_token_do(world: World) -> None:
    own = {"origin": "http://127.0.0.1:8080", "sec-fetch-site": "same-origin", **PAGE}
    assert client_of(world).post("/api/alarms/1/acknowledge", headers=own).status_code == 200
    tokens, text = three_tokens()
    shelved = client_of(world, tokens=tokens).post(
        "/api/alarms/1/shelve", json={"minutes": 5}, headers=bearer(text["admin"])
    )
    assert shelved.status_code == 200


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8080",
        "localhost.evil.example",
        "",
        "a b",
        "[evil",
        "127.0.0.1.evil.example",
    ],
)
def test_a_rebound_name_is_refused(world: World, host: str) -> None:
    refused = client_of(world).get("/api/axes", headers={"host": host})
    assert refused.status_code == 421 and "axes" not in refused.json()


@pytest.mark.parametrize(
    "host", ["localhost:8080", "127.0.0.1", "[::1]:8080", "rig-7:8080", "RIG-7", "192.168.0.7:80"]
)
def test_own_names_and_addresses_are_answered(world: World, host: str) -> None:
    client = client_of(world, hosts=["rig-7"])
    assert client.get("/api/axes", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "path", ["/", "/page/app.js", "/api/axes", "/api/nothing", "/api/axes/none", "/nowhere"]
)
def test_every_answer_carries_what_browsers_need_to_protect_it(world: World, path: str) -> None:
    headers = client_of(world).get(path).headers
    policy = dict(p.strip().partition(" ")[::2] for p in headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'" and policy["frame-ancestors"] == "'none'"
    assert {policy["script-src"], policy["style-src"], policy["connect-src"]} == {"'self'"}
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff" and headers["referrer-policy"] == "no-referrer"
    assert "access-control-allow-origin" not in headers and "server" not in headers


# Names, notes, paths and bodies


def test_markup_in_names_and_notes_stays_text(world: World) -> None:
    fleet, store, _ = world
    fleet.add(EVIL, points=20)
    id = fleet.raise_alarm(EVIL, "aeration", "aeration", "low")
    client = client_of(world)
    done = client.post(f"/api/alarms/{id}/acknowledge", json={"note": EVIL}, headers=PAGE)
    assert done.headers["content-type"] == "application/json" and "x-evil" not in done.headers
    assert done.json()["note"] == EVIL and store.rows[id]["note"] == EVIL
    assert EVIL in [a["name"] for a in client.get("/api/axes").json()["axes"]]


@pytest.mark.parametrize(
    "path",
    [
        "/page/../../../../../../etc/passwd",
        "/page/..%2f..%2fapp.py",
        "/page/%2e%2e/app.py",
        "/page//etc/passwd",
        "/page/app.js%00.html",
        "/..%5c..%5cetc",
        "/api/axes/..%2F..%2F..%2Fetc%2Fpasswd",
        "/page/",
        "/page/app.py",
    ],
)
def test_no_path_reaches_the_file_system(world: World, path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    client = client_of(world)
    opened: list[str] = []
    real = Path.open
    monkeypatch.setattr(
        Path, "open", lambda self, *a, **k: (opened.append(str(self)), real(self, *a, **k))[1]
    )
    found = client.get(path)
    assert found.status_code == 404 and list(found.json()) == ["error"]
    assert opened == []


def test_a_body_beyond_the_bound_is_refused_before_it_is_read(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = client_of(world)
    large = client.post("/api/alarms/1/acknowledge", content=b" " * (MAX_REQUEST_BYTES + 1), headers=PAGE)
    assert large.status_code == 413

    def pieces() -> object:
        while True:
            given.append(1)
            yield b" " * 4096

    for path, most in (
        ("/api/alarms/1/acknowledge", MAX_REQUEST_BYTES),
        ("/api/diagnose?name=a.csv", 1 << 16),
    ):
        monkeypatch.setenv("FDD_MAX_UPLOAD_BYTES", str(1 << 16))
        given: list[int] = []
        found = client_sending(world, path, pieces)
        assert found == 413 and len(given) <= most // 4096 + 2
    assert state_of(world) == "UNACK"


def client_sending(world: World, path: str, pieces: object) -> int:
    """Status of a request whose body comes in pieces without end, through ASGI itself."""
    import asyncio

    app, _ = app_of(*world)
    source = iter(pieces())  # type: ignore[operator]
    sent: list[dict] = []

    async def receive() -> dict:
        return {"type": "http.request", "body": next(source), "more_body": True}

    async def send(message: dict) -> None:
        sent.append(message)

    at, _, query = path.partition("?")
    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": "POST",
        "path": at,
        "raw_path": at.encode(),
        "root_path": "",
        "query_string": query.encode(),
        "scheme": "http",
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 8080),
        "headers": [(b"host", b"127.0.0.1"), (b"x-fdd", b"1"), (b"transfer-encoding", b"chunked")],
    }
    asyncio.run(app(scope, receive, send))
    return int(sent[0]["status"])


@pytest.mark.parametrize("length", ["-1", "1e9", "99999999999999999999999", "x", "16385"])
def test_odd_lengths_are_refused(world: World, length: str) -> None:
    app, _ = app_of(*world)
    client = TestClient(app, base_url="http://127.0.0.1")
    found = client.post("/api/alarms/1/acknowledge", headers={**PAGE, "content-length": length})
    assert found.status_code == 413 and state_of(world) == "UNACK"
