"""The API answers as documented; who may call what, what other sites' pages try, and where it listens."""

import asyncio
import hashlib
import json
import math
import ssl
import threading
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
from fastapi.sse import ServerSentEvent
from jsonschema import Draft202012Validator

from fdd.bounds import MAX_REQUEST_BYTES, MOST_LISTENERS
from fdd.errors import InputError
from fdd.service.config import Tls
from fdd.service.http import Server
from fdd.service.http.api import KEPT, Hub
from fdd.service.queues import Event
from fdd.service.store import StoreTrouble
from fdd.service.tokens import Caller, Tokens, new_token
from tests.service.fake import PAGE, World, bearer, client_of, made_up, on_a_port, service_of, three_tokens
from tests.service.senders import certificate, until

AXIS = "/api/axes/F7%2Frudder"
VIEWS = ("axes", "alarms", "audit", "session", "events")
ADDRESSES = [
    *(("get", path, "view") for path in (AXIS, f"{AXIS}/trend", "/metrics", *(f"/api/{v}" for v in VIEWS))),
    *(("post", f"/api/alarms/3/{act}", "acknowledge") for act in ("acknowledge", "shelve", "unshelve")),
    ("delete", AXIS, "admin"),
]
ROLES = ("view", "acknowledge", "admin")
OPEN = {"/api/health", "/api/login", "/api/logout"}


@pytest.fixture
def world() -> World:
    """Axes in all states; nobody has seen alarm 3 yet."""
    return made_up()


@pytest.fixture(scope="module")
def served() -> World:
    """What `server` serves: tests with it change nothing there."""
    return made_up()


@pytest.fixture(scope="module")
def server(served):
    with on_a_port(served) as made:
        yield made


def test_metrics_are_served_unless_the_configuration_says_no(world):
    assert client_of(world).get("/metrics").text == "fdd_axes 2\n"
    assert client_of(world, told=False).get("/metrics").status_code == 404


def test_each_address_asks_for_its_role(world):
    tokens, text = three_tokens()
    client = client_of(world, tokens=tokens)
    paths = client_of(world).get("/openapi.json").json()["paths"]
    asked = [method for path in paths.keys() - OPEN for method in paths[path]]
    assert len(asked) == len(ADDRESSES), "each is in the list"
    for method, path, needed in ADDRESSES:
        bare = client.request(method, path, headers=PAGE)
        assert bare.status_code == 401 and list(bare.json()) == ["error"], path
        for wrong in ("Bearer guess", f"Basic {text['admin']}", "Bearer", f"Bearer {text['admin'][:-1]}"):
            found = client.request(method, path, headers={"authorization": wrong, **PAGE})
            assert found.status_code == 401, (path, wrong)
        for role in ROLES[: ROLES.index(needed)]:
            refused = client.request(method, path, headers=bearer(text[role]))
            assert refused.status_code == 403 and needed in refused.json()["error"], (path, role)
    assert world.state_of(3) == "UNACK"
    for method, path, needed in ADDRESSES:
        if path != "/api/events":  # has no end
            allowed = client.request(method, path, headers=bearer(text[needed]))
            assert allowed.status_code not in (401, 403), path
    world.health = {"status": "degraded", "problems": ["fdd.db is full"], "axes": 2}
    assert client.get("/api/health").json() == {"status": "degraded"}, "all that strangers are told"
    assert client.get("/api/health", headers=bearer(text["view"])).json()["problems"] == ["fdd.db is full"]


def test_a_token_is_kept_in_a_cookie_that_scripts_and_other_sites_never_get(world):
    tokens, text = three_tokens()
    client = client_of(world, tokens=tokens, tls=Tls(cert=Path(), key=Path()))
    client.base_url = "https://127.0.0.1:8080"
    for wrong in ({"token": "guess"}, {"token": None}, {}, [], "x"):
        assert client.post("/api/login", json=wrong, headers=PAGE).status_code in (400, 401)
    found = client.post("/api/login", json={"token": text["acknowledge"]}, headers=PAGE)
    assert found.json() == {"name": "acknowledge-person", "role": "acknowledge", "tokens": True}
    cookie = found.headers["set-cookie"]
    assert all(part in cookie for part in ("HttpOnly", "SameSite=strict", "Secure", "Path=/", "Max-Age="))
    assert client.post("/api/alarms/3/acknowledge").status_code == 403, "a form of another site"
    assert client.post("/api/alarms/3/acknowledge", headers=PAGE).json()["acked_by"] == "acknowledge-person"
    assert client.post("/api/logout", headers=PAGE).status_code == 204
    assert client.get("/api/axes").status_code == 401


def test_the_file_of_tokens_holds_hashes_alone_and_errors_name_its_line(tmp_path):
    token, line = new_token("ann", "admin")
    assert token not in line and line.split()[2] == hashlib.sha256(token.encode()).hexdigest()
    (tmp_path / "tokens").write_text(f"# people\n{line}  # till May\n")
    assert Tokens.load(tmp_path / "tokens").caller(token) == Caller("ann", "admin")
    with pytest.raises(InputError, match="cannot be read"):
        Tokens.load(tmp_path / "none")
    for text, said in (
        ("", "no token"),
        ("# nothing\n", "no token"),
        ("ann view", "tokens:1: not: name role"),
        ("ann boss " + "a" * 64, "tokens:1: unknown role"),
        ("ann view " + "g" * 64, "tokens:1"),
        ("ok view " + "a" * 64 + "\na<b view " + "a" * 64, "tokens:2"),
    ):
        with pytest.raises(InputError, match=said):
            Tokens.parse(text)


def test_another_sites_page_does_nothing_and_a_rebound_name_is_refused(world):
    client = client_of(world, names=["rig-7"])
    for path in ("/api/alarms/3/acknowledge", "/api/login", "/api/logout"):
        for headers in ({}, {"origin": "null"}, {"content-type": "text/plain"}):
            refused = client.post(path, headers=headers, content=b"{}")
            assert refused.status_code == 403 and list(refused.json()) == ["error"]
    assert world.state_of(3) == "UNACK"
    for host in ("evil.example", "localhost.evil.example:8080", "", "a b", "[evil", "192.0.2.7"):
        refused = client.get("/api/axes", headers={"host": host})
        assert refused.status_code == 400 and "axis" not in refused.text, host
    for host in ("localhost:8080", "127.0.0.1", "[::1]:8080", "rig-7:8080", "RIG-7"):
        assert client.get("/api/axes", headers={"host": host}).status_code == 200, host
    assert client_of(world).get("/api/axes", headers={"host": "rig-7"}).status_code == 400


def test_every_answer_carries_what_browsers_need_to_protect_it(world):
    client = client_of(world)
    for path in ("/", "/page/app.js", "/api/axes", "/api/nothing", "/api/axes/none", "/nowhere"):
        headers = client.get(path).headers
        policy = dict(p.strip().partition(" ")[::2] for p in headers["content-security-policy"].split(";"))
        assert policy["default-src"] == "'none'" and policy["frame-ancestors"] == "'none'"
        assert {policy["script-src"], policy["style-src"], policy["connect-src"]} == {"'self'"}
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "access-control-allow-origin" not in headers and "server" not in headers


def test_a_body_without_end_is_refused(server, served):
    def pieces():
        for _ in range(MAX_REQUEST_BYTES // 1000 + 5):
            yield b" " * 1000

    with httpx.Client(trust_env=False) as client:
        found = client.post(f"{server.address}api/alarms/3/acknowledge", content=pieces(), headers=PAGE)
    assert found.status_code == 413 and served.state_of(3) == "UNACK"


class Listener:
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

    def event(self) -> dict:
        return dict(json.loads(self.until("data: ")[6:]))

    def close(self) -> None:
        self.request.__exit__(None, None, None)
        self.client.close()


def test_small_answers_go_out_at_once(server):
    """Head and body are two packets: held back for an acknowledgement, each answer would take 40 ms."""
    taken = []
    with httpx.Client(trust_env=False) as client:
        for _ in range(25):
            begun = time.perf_counter()
            assert client.get(f"{server.address}api/health").status_code == 200
            taken.append(time.perf_counter() - begun)
    assert sorted(taken)[12] < 0.03


def test_events_come_as_they_happen(server, served):
    listener = Listener(server)
    served.bus.publish(Event("alarm", "rig/axis-1", 5.0, {"note": "a\nevent: evil\n\ndata: {}"}))
    event = listener.event()
    assert (event["kind"], event["axis"], event["time"]) == ("alarm", "rig/axis-1", 5.0)
    assert event["data"]["note"] == "a\nevent: evil\n\ndata: {}"
    listener.close()
    again = Listener(server, last="1")
    assert again.until("event: ") == "event: reset", "it may have missed something"
    again.close()


def test_who_falls_behind_is_told_to_begin_anew(world):
    async def heard() -> list[ServerSentEvent]:
        hub = Hub(world.bus, threading.Event())
        async with asynccontextmanager(hub.listener)() as mine:
            stream = hub.told(mine, again=False)
            await anext(stream)
            for k in range(KEPT + 10):
                world.bus.publish(Event("status", "A1", 0.0, {"k": k}))
            return [await anext(stream) for _ in range(KEPT + 1)]

    told = asyncio.run(heard())
    assert told[0].event == "reset" and f'{{"k":{KEPT + 9}}}' in str(told[-1].raw_data)


def test_listeners_are_bounded_and_leave_room_when_they_go(server):
    with ThreadPoolExecutor(MOST_LISTENERS + 20) as many:  # at once: none reads before the others are there
        listeners = list(many.map(lambda _: Listener(server), range(MOST_LISTENERS + 20)))
    assert sorted(one.status for one in listeners) == [200] * MOST_LISTENERS + [503] * 20
    for one in listeners:
        one.close()

    def one_more() -> bool:
        again = Listener(server)
        again.close()
        return again.status == 200

    until(one_more, 20.0)


def test_tls_by_certificate_and_key_and_a_port_that_is_taken_is_told_in_one_line(world, tmp_path):
    with on_a_port(world) as taken, pytest.raises(InputError, match=r"cannot be listened on.*--port"):
        Server(service_of(world, port=int(taken.address.rstrip("/").rpartition(":")[2])))
    cert, key = certificate(tmp_path, "localhost")
    trusted = ssl.create_default_context(cafile=str(cert))
    with on_a_port(world, tls=Tls(cert=cert, key=key)) as server:
        with httpx.Client(verify=trusted, trust_env=False) as client:
            assert client.get(f"{server.address}api/axes").status_code == 200
        with pytest.raises(OSError):
            urllib.request.urlopen(server.address.replace("https", "http"), timeout=5)


@pytest.fixture
def client(world):
    return client_of(world)


def test_answers_are_as_documented_and_not_a_number_is_null(client, world):
    world.details["F7/aileron-R"].misfits.values["volume"][0] = math.nan
    document = client.get("/openapi.json").json()
    assert document["openapi"] == "3.1.0" and "422" not in json.dumps(document)
    for path, asked in (
        ("/api/axes", "/api/axes"),
        ("/api/axes/{name}", "/api/axes/F7/aileron-R"),
        ("/api/axes/{name}", "/api/axes/F7%2Faileron-R"),
        ("/api/axes/{name}/trend", "/api/axes/F7%2Faileron-R/trend?quantity=leakage&level=day"),
        ("/api/alarms", "/api/alarms"),
        ("/api/alarms", "/api/alarms?state=all"),
        *((each, each) for each in ("/api/audit", "/api/health", "/api/session")),
    ):
        found = client.get(asked)
        assert found.status_code == 200 and found.json() not in ({}, []), asked
        content = document["paths"][path]["get"]["responses"]["200"]["content"]["application/json"]
        schema = {**content["schema"], "components": document["components"]}
        Draft202012Validator(schema).validate(found.json())
    assert client.get("/api/axes/F7/aileron-R").json()["misfits"]["values"]["volume"][0] is None


def test_alarms_are_given_by_state_and_acts_reach_the_fleet_with_who_and_note(client, world):
    def states(query: str) -> list[str]:
        return [a["state"] for a in client.get(f"/api/alarms{query}").json()["alarms"]]

    assert states("") == states("?state=all") == ["UNACK", "UNACK", "ACKED", "SHELVED"]
    assert client.post("/api/alarms/1/unshelve", headers=PAGE).status_code == 200
    assert states("?state=UNACK,SHELVED") == ["UNACK"] * 3 and states("?limit=1") == ["UNACK"]
    id = world.raise_alarm("F3/rudder", "low", fault="coupling_wear", family="motor")
    done = client.post(f"/api/alarms/{id}/acknowledge", json={"note": "seen"}, headers=PAGE)
    assert done.status_code == 200
    assert (done.json()["state"], done.json()["acked_by"], done.json()["note"]) == ("ACKED", "local", "seen")
    again = client.post(f"/api/alarms/{id}/acknowledge", json={}, headers=PAGE)
    assert again.status_code == 409 and "ACKED" in again.json()["error"]
    shelved = client.post(f"/api/alarms/{id}/shelve", json={"minutes": 30, "note": "w"}, headers=PAGE)
    assert shelved.json()["state"] == "SHELVED"
    assert math.isclose(shelved.json()["shelved_until"], time.time() + 1800, abs_tol=5)
    assert client.post(f"/api/alarms/{id}/unshelve", headers=PAGE).json()["state"] == "UNACK"
    actions = [r["action"] for r in client.get(f"/api/audit?alarm={id}").json()["records"]]
    assert actions == ["UNSHELVED", "SHELVED", "ACKNOWLEDGED", "RAISED"]


def test_a_body_that_is_not_as_documented_is_refused_in_one_line(client, world):
    bodies = [("acknowledge", body) for body in (b"[1]", b"{", b'{"note": 3}', b"\xff",
              b'{"note": "x", "who": "boss"}', json.dumps({"note": "n" * 1001}).encode())]  # fmt: skip
    minutes = (b"0", b"-5", b"10081", b'"1"', b"null", b"Infinity")
    for act, body in (*bodies, ("shelve", b""), *(("shelve", b'{"minutes": %s}' % m) for m in minutes)):
        refused = client.post(f"/api/alarms/4/{act}", content=body, headers=PAGE)
        assert refused.status_code == 400, body
        assert list(refused.json()) == ["error"] and "\n" not in refused.json()["error"]
    assert world.state_of(4) == "UNACK"


def test_troubles_are_told_and_tell_nothing_of_the_inside(client, world, monkeypatch):
    world.trouble = StoreTrouble("the store is locked", where="fdd.db")
    refused = client.post("/api/alarms/4/acknowledge", headers=PAGE)
    assert refused.status_code == 503 and "the store is locked" in refused.json()["error"]
    world.trouble = None
    assert client.post("/api/alarms/4/acknowledge", headers=PAGE).status_code == 200, "it passes"

    def damaged(*args: object, **more: object) -> list[dict]:
        raise InputError("the store is damaged", where="fdd.db", mend="put a backup in its place")

    monkeypatch.setattr(world.store, "alarms", damaged)
    found, told = client.get("/api/alarms"), "fdd.db: the store is damaged; put a backup in its place"
    assert (found.status_code, found.json()) == (500, {"error": told})
    monkeypatch.setattr(world, "axes", lambda: 1 / 0)
    found = client.get("/api/axes")
    assert (found.status_code, found.json()) == (500, {"error": "internal error"})
    assert found.headers["x-content-type-options"] == "nosniff"


def test_wrong_questions_are_answered_in_one_line(client):
    axes, trend = "/api/axes/nobody", "/api/axes/F7%2Frudder/trend?"
    missing = (axes, f"{axes}/trend", "/api/nothing", "/page/none.js", "/page/../app.py")
    wrong = [f"{trend}{asked}" for asked in ("level=second", "since=x", "since=nan", "quantity=a'%20or%201")]
    wrong += ["/api/alarms?limit=-1", "/api/alarms?state=whatever"]
    for path, status in (dict.fromkeys(missing, 404) | dict.fromkeys(wrong, 400)).items():
        found = client.get(path)
        assert found.status_code == status and list(found.json()) == ["error"], path
    for id in ("77", "0", str(1 << 70), "x"):
        assert client.post(f"/api/alarms/{id}/acknowledge", headers=PAGE).status_code in (400, 404)
