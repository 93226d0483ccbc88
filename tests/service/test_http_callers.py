"""Who may call what: roles, tokens, sessions, and where the service listens at all."""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import SimpleNamespace

import pytest

from fdd.errors import InputError
from fdd.service.http import Listen, Server, Tokens, new_token
from fdd.service.http.callers import MOST_SESSIONS, Caller, Sessions
from tests.service.fake import FakeBus, FakeFleet, FakeStore, fake
from tests.service.serving import PAGE, app_of, bearer, client_of, three_tokens

World = tuple[FakeFleet, FakeStore, FakeBus]


@pytest.fixture
def world() -> World:
    made = fake(2)
    made[0].raise_alarm("rig/axis-1", "internal_leakage", "leakage", "high")
    return made


def state_of(world: World) -> str:
    return str(world[1].rows[1]["state"])


# Who may what

ADDRESSES = [
    ("GET", "/api/axes", "view"),
    ("GET", "/api/axes/rig%2Faxis-1", "view"),
    ("GET", "/api/axes/rig%2Faxis-1/trend", "view"),
    ("GET", "/api/alarms", "view"),
    ("GET", "/api/audit", "view"),
    ("GET", "/metrics", "view"),
    ("GET", "/api/session", "view"),
    ("GET", "/api/events", "view"),
    ("POST", "/api/alarms/1/acknowledge", "acknowledge"),
    ("POST", "/api/alarms/1/shelve", "acknowledge"),
    ("POST", "/api/alarms/1/unshelve", "acknowledge"),
    ("POST", "/api/diagnose?name=a.exe", "acknowledge"),
    ("POST", "/api/alarms/1/out-of-service", "admin"),
]
ROLES = ("view", "acknowledge", "admin")


@pytest.mark.parametrize("method, path, needed", ADDRESSES)
def test_each_address_asks_for_its_role(world: World, method: str, path: str, needed: str) -> None:
    tokens, text = three_tokens()
    client = client_of(world, tokens=tokens)
    bare = client.request(method, path, headers=PAGE)
    assert bare.status_code == 401 and list(bare.json()) == ["error"]
    for wrong in ("Bearer guess", f"Basic {text['admin']}", "Bearer", f"Bearer {text['admin'][:-1]}"):
        assert client.request(method, path, headers={"authorization": wrong, **PAGE}).status_code == 401
    for role in ROLES[: ROLES.index(needed)]:
        refused = client.request(method, path, headers=bearer(text[role]))
        assert refused.status_code == 403 and needed in refused.json()["error"]
    assert state_of(world) == "UNACK"
    if path != "/api/events":  # has no end
        allowed = client.request(method, path, headers=bearer(text[needed]))
        assert allowed.status_code not in (401, 403)


def test_every_address_is_in_that_list(world: World) -> None:
    app, _ = app_of(world[0], world[1], world[2])
    routes = {(m, r.path) for r in app._app.routes for m in r.methods or () if m != "HEAD"}
    open_to_all = {p for _, p in routes if p.startswith("/page/")} | {"/", "/openapi.json"}
    open_to_all |= {"/api/health", "/api/login", "/api/logout"}
    assert len([r for r in routes if r[1] not in open_to_all]) == len(ADDRESSES)


def test_health_tells_strangers_the_status_alone(world: World) -> None:
    tokens, text = three_tokens()
    client = client_of(
        world, tokens=tokens, health=lambda: {"status": "degraded", "problems": ["fdd.db is full"]}
    )
    assert client.get("/api/health").json() == {"status": "degraded"}
    assert client.get("/api/health", headers=bearer(text["view"])).json()["problems"] == ["fdd.db is full"]


def test_a_token_is_changed_for_a_cookie_that_scripts_and_other_sites_never_get(world: World) -> None:
    tokens, text = three_tokens()
    client = client_of(world, tokens=tokens, secure=True)
    client.base_url = "https://127.0.0.1:8080"
    assert client.post("/api/login", json={"token": "guess"}, headers=PAGE).status_code == 401
    found = client.post("/api/login", json={"token": text["acknowledge"]}, headers=PAGE)
    assert found.json() == {"name": "acknowledge-person", "role": "acknowledge", "tokens": True}
    cookie = found.headers["set-cookie"]
    assert all(part in cookie for part in ("HttpOnly", "SameSite=strict", "Secure", "Path=/"))
    assert text["acknowledge"] not in cookie
    assert client.post("/api/alarms/1/acknowledge", headers=PAGE).json()["acked_by"] == "acknowledge-person"
    taken = client.cookies["fdd_session"]
    assert client.post("/api/logout", headers=PAGE).status_code == 200
    client.cookies.set("fdd_session", taken)
    assert client.get("/api/axes").status_code == 401


@pytest.mark.parametrize("body", [b"", b"[]", b'"x"', b"{", b'{"token": null}', b'{"token": {"a": 1}}'])
def test_odd_logins_are_refused(world: World, body: bytes) -> None:
    client = client_of(world, tokens=three_tokens()[0])
    assert client.post("/api/login", content=body, headers=PAGE).status_code in (400, 401)


def test_guessing_is_slowed_down_and_shuts_nobody_out(world: World) -> None:
    tokens, text = three_tokens()
    client = client_of(world, tokens=tokens)
    found = [client.get("/api/axes", headers=bearer(f"guess{k}")).status_code for k in range(20)]
    assert found[:10] == [401] * 10 and found[-1] == 429
    assert client.post("/api/login", json={"token": "x"}, headers=PAGE).status_code == 429
    assert client.get("/api/axes", headers=bearer(text["view"])).status_code == 200


def test_many_requests_are_slowed_down(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    now = SimpleNamespace(monotonic=lambda: 1000.0)
    monkeypatch.setattr("fdd.service.http.guard.time", now)  # all at one instant
    client = client_of(world)
    found = [client.get("/api/health").status_code for _ in range(400)]
    assert found[:100] == [200] * 100 and found[-1] == 429


def test_sessions_are_bounded_and_end() -> None:
    sessions = Sessions()
    first = sessions.begin(Caller("ann", "view"), 0.0)
    for _ in range(MOST_SESSIONS):
        last = sessions.begin(Caller("bob", "view"), 0.0)
    assert sessions.caller(first, 1.0) is None
    assert sessions.caller(last, 1.0) == Caller("bob", "view")


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "no token"),
        ("# nothing\n", "no token"),
        ("ann view", "tokens:1: not: name role"),
        ("ann boss " + "a" * 64, "tokens:1: unknown role"),
        ("ann view " + "g" * 64, "tokens:1"),
        ("ok view " + "a" * 64 + "\na<b view " + "a" * 64, "tokens:2"),
    ],
)
def test_a_file_of_tokens_that_is_wrong_is_told_by_its_line(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Tokens.parse(text)


def test_the_file_holds_hashes_alone(tmp_path: Path) -> None:
    token, line = new_token("ann", "admin")
    assert token not in line and line.split()[2] == hashlib.sha256(token.encode()).hexdigest()
    (tmp_path / "tokens").write_text(f"# people\n{line}  # till May\n")
    assert Tokens.load(tmp_path / "tokens").caller(token) == Caller("ann", "admin")
    with pytest.raises(InputError, match="cannot be read"):
        Tokens.load(tmp_path / "none")


# Where it listens


def test_without_tokens_only_this_machine_is_let_in(world: World) -> None:
    app, _ = app_of(*world)
    for host in ("0.0.0.0", "::", "192.0.2.1"):
        with pytest.raises(InputError, match="no tokens are set; give a file of tokens"):
            Server(app, Listen(host=host, port=0), has_tokens=False)


def test_what_cannot_be_listened_on_is_told_in_one_line(world: World, tmp_path: Path) -> None:
    app, _ = app_of(*world)
    taken = Server(app, Listen(port=0), has_tokens=False)
    with pytest.raises(InputError, match="cannot be listened on"):
        Server(app, Listen(port=taken.port), has_tokens=False)
    taken._socket.close()
    (tmp_path / "cert.pem").write_text("no certificate")
    for cert, said in (
        (tmp_path / "none.pem", "cannot be used for TLS"),
        (tmp_path / "cert.pem", "cannot be used"),
    ):
        with pytest.raises(InputError, match=said):
            Server(app, Listen(port=0, cert=cert, key=cert), has_tokens=False)
    with pytest.raises(InputError, match="both cert and key"):
        Server(app, Listen(port=0, cert=tmp_path / "cert.pem"), has_tokens=False)
