"""What strangers and other sites' pages try: refused in one line, and nothing happens."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from fdd.bounds import MAX_REQUEST_BYTES
from fdd.errors import InputError
from fdd.service.http import Listen, Server, Tokens, new_token
from fdd.service.http.callers import MOST_SESSIONS, Caller, Sessions
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


# Who may what

ADDRESSES = [
    ("GET", "/api/axes", "view"), ("GET", "/api/axes/rig%2Faxis-1", "view"), ("GET", "/api/axes/rig%2Faxis-1/trend", "view"),
    ("GET", "/api/alarms", "view"), ("GET", "/api/audit", "view"), ("GET", "/metrics", "view"),
    ("GET", "/api/session", "view"), ("GET", "/api/events", "view"),
    ("POST", "/api/alarms/1/acknowledge", "acknowledge"), ("POST", "/api/alarms/1/shelve", "acknowledge"),
    ("POST", "/api/alarms/1/unshelve", "acknowledge"), ("POST", "/api/diagnose?name=a.exe", "acknowledge"),
    ("POST", "/api/alarms/1/out-of-service", "admin"),
]  # fmt: skip
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
    client = client_of(world, tokens=tokens, health=lambda: {"status": "degraded", "problems": ["fdd.db is full"]})
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


def test_many_requests_are_slowed_down(world: World) -> None:
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
        ("", "no token"), ("# nothing\n", "no token"), ("ann view", "tokens:1: not: name role"),
        ("ann boss " + "a" * 64, "tokens:1: unknown role"), ("ann view " + "g" * 64, "tokens:1"),
        ("ok view " + "a" * 64 + "\na<b view " + "a" * 64, "tokens:2"),
    ],
)  # fmt: skip
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


# Other sites

@pytest.mark.parametrize(
    "headers",
    [
        {}, {"origin": "http://evil.example"}, {"origin": "null", **PAGE}, {"origin": "http://evil.example", **PAGE},
        {"origin": "http://127.0.0.1:8081", **PAGE}, {"sec-fetch-site": "cross-site", **PAGE},
        {"sec-fetch-site": "same-site", **PAGE}, {"content-type": "text/plain"},
    ],
)  # fmt: skip
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


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "localhost.evil.example", "", "a b", "[evil", "127.0.0.1.evil.example"])  # fmt: skip
def test_a_rebound_name_is_refused(world: World, host: str) -> None:
    refused = client_of(world).get("/api/axes", headers={"host": host})
    assert refused.status_code == 421 and "axes" not in refused.json()


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1", "[::1]:8080", "rig-7:8080", "RIG-7", "192.168.0.7:80"])  # fmt: skip
def test_own_names_and_addresses_are_answered(world: World, host: str) -> None:
    client = client_of(world, hosts=["rig-7"])
    assert client.get("/api/axes", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("path", ["/", "/page/app.js", "/api/axes", "/api/nothing", "/api/axes/none", "/nowhere"])
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
        "/page/../../../../../../etc/passwd", "/page/..%2f..%2fapp.py", "/page/%2e%2e/app.py", "/page//etc/passwd",
        "/page/app.js%00.html", "/..%5c..%5cetc", "/api/axes/..%2F..%2F..%2Fetc%2Fpasswd", "/page/", "/page/app.py",
    ],
)  # fmt: skip
def test_no_path_reaches_the_file_system(world: World, path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    client = client_of(world)
    opened: list[str] = []
    real = Path.open
    monkeypatch.setattr(Path, "open", lambda self, *a, **k: (opened.append(str(self)), real(self, *a, **k))[1])
    found = client.get(path)
    assert found.status_code == 404 and list(found.json()) == ["error"]
    assert opened == []


def test_a_body_beyond_the_bound_is_refused_before_it_is_read(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    client = client_of(world)
    large = client.post("/api/alarms/1/acknowledge", content=b" " * (MAX_REQUEST_BYTES + 1), headers=PAGE)
    assert large.status_code == 413

    def pieces() -> object:
        while True:
            given.append(1)
            yield b" " * 4096

    for path, most in (("/api/alarms/1/acknowledge", MAX_REQUEST_BYTES), ("/api/diagnose?name=a.csv", 1 << 16)):
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
        "type": "http", "http_version": "1.1", "method": "POST", "path": at, "raw_path": at.encode(), "root_path": "",
        "query_string": query.encode(), "scheme": "http", "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8080),
        "headers": [(b"host", b"127.0.0.1"), (b"x-fdd", b"1"), (b"transfer-encoding", b"chunked")],
    }  # fmt: skip
    asyncio.run(app(scope, receive, send))
    return int(sent[0]["status"])


@pytest.mark.parametrize("length", ["-1", "1e9", "99999999999999999999999", "x", "16385"])
def test_odd_lengths_are_refused(world: World, length: str) -> None:
    app, _ = app_of(*world)
    client = TestClient(app, base_url="http://127.0.0.1")
    found = client.post("/api/alarms/1/acknowledge", headers={**PAGE, "content-length": length})
    assert found.status_code == 413 and state_of(world) == "UNACK"


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
    for cert, said in ((tmp_path / "none.pem", "cannot be used for TLS"), (tmp_path / "cert.pem", "cannot be used")):
        with pytest.raises(InputError, match=said):
            Server(app, Listen(port=0, cert=cert, key=cert), has_tokens=False)
    with pytest.raises(InputError, match="both cert and key"):
        Server(app, Listen(port=0, cert=tmp_path / "cert.pem"), has_tokens=False)
