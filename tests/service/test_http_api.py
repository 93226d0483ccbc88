"""The API: what it answers is what its document says, and what is done to an alarm reaches the fleet."""

from __future__ import annotations

import json
import math
import re
import time
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from starlette.testclient import TestClient

from fdd.errors import InputError
from fdd.service.store import StoreTrouble
from tests.service.fake import PAGE, World, client_of, made_up

ROOT = Path(__file__).parents[2]


@pytest.fixture
def world() -> World:
    return made_up()


@pytest.fixture
def client(world: World) -> TestClient:
    return client_of(world)


def answered(document: dict, path: str, body: object) -> None:
    """Hold an answer against the published document."""
    content = document["paths"][path]["get"]["responses"]["200"]["content"]["application/json"]
    schema = {**content["schema"], "components": document["components"]}
    Draft202012Validator(schema).validate(body)


@pytest.mark.parametrize(
    "path, asked",
    [
        ("/api/axes", "/api/axes"),
        ("/api/axes/{name}", "/api/axes/F7/aileron-R"),
        ("/api/axes/{name}", "/api/axes/F7%2Faileron-R"),
        ("/api/axes/{name}/trend", "/api/axes/F7%2Faileron-R/trend?quantity=leakage&level=day"),
        ("/api/alarms", "/api/alarms"),
        ("/api/alarms", "/api/alarms?state=all"),
        ("/api/audit", "/api/audit"),
        ("/api/health", "/api/health"),
        ("/api/session", "/api/session"),
    ],
)
def test_answers_are_what_the_document_says(client: TestClient, path: str, asked: str) -> None:
    document = client.get("/openapi.json").json()
    assert document["openapi"] == "3.1.0" and "422" not in json.dumps(document)
    found = client.get(asked)
    assert found.status_code == 200
    answered(document, path, found.json())
    assert found.json() not in ({}, [])


def test_alarms_are_given_by_state(client: TestClient) -> None:
    def states(query: str) -> list[str]:
        return [a["state"] for a in client.get(f"/api/alarms{query}").json()["alarms"]]

    assert states("") == states("?state=all") == ["UNACK", "UNACK", "ACKED", "SHELVED"]
    assert client.post("/api/alarms/1/unshelve", headers=PAGE).status_code == 200
    assert states("?state=UNACK,SHELVED") == ["UNACK"] * 3 and states("?limit=1") == ["UNACK"]
    assert client.get("/api/alarms?state=whatever").status_code == 400


def test_acts_reach_the_fleet_with_who_and_note(client: TestClient, world: World) -> None:
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


@pytest.mark.parametrize(
    "act, body",
    [
        ("acknowledge", b"[1]"),
        ("acknowledge", b"{"),
        ("acknowledge", b'{"note": 3}'),
        ("acknowledge", b'{"note": "x", "who": "boss"}'),
        ("acknowledge", json.dumps({"note": "n" * 1001}).encode()),
        ("acknowledge", b"\xff"),
        ("shelve", b""),
        *(("shelve", b'{"minutes": %s}' % m) for m in (b"0", b"-5", b"10081", b'"1"', b"null", b"Infinity")),
    ],
)
def test_a_body_that_is_not_as_documented_is_refused_in_one_line(
    client: TestClient, world: World, act: str, body: bytes
) -> None:
    refused = client.post(f"/api/alarms/4/{act}", content=body, headers=PAGE)
    assert refused.status_code == 400
    assert list(refused.json()) == ["error"] and "\n" not in refused.json()["error"]
    assert world.state_of(4) == "UNACK"


def test_a_damaged_store_is_told(client: TestClient, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(*args: object, **more: object) -> list[dict]:
        raise InputError("the store is damaged", where="fdd.db", mend="put a backup in its place")

    monkeypatch.setattr(world.store, "alarms", damaged)
    found = client.get("/api/alarms")
    assert found.status_code == 500
    assert found.json() == {"error": "fdd.db: the store is damaged; put a backup in its place"}


def test_the_stores_trouble_is_told_and_passes(client: TestClient, world: World) -> None:
    world.trouble = StoreTrouble("the store is locked", where="fdd.db")
    refused = client.post("/api/alarms/4/acknowledge", headers=PAGE)
    assert refused.status_code == 503 and "the store is locked" in refused.json()["error"]
    world.trouble = None
    assert client.post("/api/alarms/4/acknowledge", headers=PAGE).status_code == 200


@pytest.mark.parametrize(
    "path, status",
    [
        ("/api/axes/nobody", 404),
        ("/api/axes/nobody/trend", 404),
        ("/api/nothing", 404),
        ("/page/none.js", 404),
        ("/page/../app.py", 404),
        ("/api/axes/F7%2Frudder/trend?level=second", 400),
        ("/api/axes/F7%2Frudder/trend?since=x", 400),
        ("/api/axes/F7%2Frudder/trend?since=nan", 400),
        ("/api/axes/F7%2Frudder/trend?quantity=a'%20or%201", 400),
        ("/api/alarms?limit=-1", 400),
    ],
)
def test_wrong_questions_are_answered_in_one_line(client: TestClient, path: str, status: int) -> None:
    found = client.get(path)
    assert found.status_code == status
    assert list(found.json()) == ["error"]


@pytest.mark.parametrize("id", ["77", "0", str(1 << 70), "x"])
def test_an_alarm_that_there_is_not(client: TestClient, id: str) -> None:
    assert client.post(f"/api/alarms/{id}/acknowledge", headers=PAGE).status_code in (400, 404)


def test_an_error_within_tells_nothing_of_the_inside(client: TestClient, world: World) -> None:
    world.axes = lambda: 1 / 0  # type: ignore[method-assign, assignment, return-value]
    found = client.get("/api/axes")
    assert (found.status_code, found.json()) == (500, {"error": "internal error"})
    assert found.headers["x-content-type-options"] == "nosniff"


def test_not_a_number_is_null(client: TestClient, world: World) -> None:
    world.details["F7/rudder"].misfits.values["volume"][0] = math.nan
    found = client.get("/api/axes/F7%2Frudder").json()
    assert found["misfits"]["values"]["volume"][0] is None


def test_the_page_is_whole_and_asks_nobody_else(client: TestClient) -> None:
    page = client.get("/")
    files = set(re.findall(r'(?:src|href)="(/page/[^"]+)"', page.text))
    names = {f.name for f in (ROOT / "fdd/service/http/page").iterdir()} - {"index.html"}
    for path in files | {f"/page/{name}" for name in names} | {"/page/words.js"}:
        found = client.get(path)
        assert found.status_code == 200, path
        wanted = set(re.findall(r'from "\./([^"]+)"', found.text)) if path.endswith(".js") else set()
        assert wanted <= names | {"words.js"}
        hosts = set(re.findall(r"https?://([^/\"' ]+)", found.text))
        assert hosts <= {"www.w3.org"}
    assert (
        "<script>" not in page.text
        and "style=" not in page.text
        and " on" not in re.sub(r">[^<]*<", "><", page.text)
    )
