"""The API: what it answers is what its document says, and what is done to an alarm reaches the fleet."""

from __future__ import annotations

import json
import math
import time

import pytest
from jsonschema import Draft202012Validator
from starlette.testclient import TestClient

from fdd.errors import InputError
from fdd.service.store import StoreTrouble
from tests.service.fake import PAGE, World, client_of, made_up


@pytest.fixture
def world() -> World:
    return made_up()


@pytest.fixture
def client(world: World) -> TestClient:
    return client_of(world)


def test_answers_are_what_the_document_says_and_not_a_number_is_null(
    client: TestClient, world: World
) -> None:
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


def test_alarms_are_given_by_state(client: TestClient) -> None:
    def states(query: str) -> list[str]:
        return [a["state"] for a in client.get(f"/api/alarms{query}").json()["alarms"]]

    assert states("") == states("?state=all") == ["UNACK", "UNACK", "ACKED", "SHELVED"]
    assert client.post("/api/alarms/1/unshelve", headers=PAGE).status_code == 200
    assert states("?state=UNACK,SHELVED") == ["UNACK"] * 3 and states("?limit=1") == ["UNACK"]


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


def test_a_body_that_is_not_as_documented_is_refused_in_one_line(client: TestClient, world: World) -> None:
    bodies = [("acknowledge", body) for body in (b"[1]", b"{", b'{"note": 3}', b"\xff",
              b'{"note": "x", "who": "boss"}', json.dumps({"note": "n" * 1001}).encode())]  # fmt: skip
    minutes = (b"0", b"-5", b"10081", b'"1"', b"null", b"Infinity")
    for act, body in (*bodies, ("shelve", b""), *(("shelve", b'{"minutes": %s}' % m) for m in minutes)):
        refused = client.post(f"/api/alarms/4/{act}", content=body, headers=PAGE)
        assert refused.status_code == 400, body
        assert list(refused.json()) == ["error"] and "\n" not in refused.json()["error"]
    assert world.state_of(4) == "UNACK"


def test_troubles_are_told_and_tell_nothing_of_the_inside(
    client: TestClient, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_wrong_questions_are_answered_in_one_line(client: TestClient) -> None:
    for path in (
        "/api/axes/nobody",
        "/api/axes/nobody/trend",
        "/api/nothing",
        "/page/none.js",
        "/page/../app.py",
    ):
        found = client.get(path)
        assert found.status_code == 404 and list(found.json()) == ["error"], path
    trend = "/api/axes/F7%2Frudder/trend?"
    for path in (f"{trend}level=second", f"{trend}since=x", f"{trend}since=nan", "/api/alarms?limit=-1",
                 f"{trend}quantity=a'%20or%201", "/api/alarms?state=whatever"):  # fmt: skip
        found = client.get(path)
        assert found.status_code == 400 and list(found.json()) == ["error"], path
    for id in ("77", "0", str(1 << 70), "x"):
        assert client.post(f"/api/alarms/{id}/acknowledge", headers=PAGE).status_code in (400, 404)
