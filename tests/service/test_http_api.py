"""The API: what it answers is what its document says, and what is done to an alarm reaches the fleet."""

from __future__ import annotations

import json
import math
import re
import time
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from starlette.testclient import TestClient

from fdd.errors import InputError
from fdd.service.http.answers import Bands
from fdd.service.http.api import thinned
from tests.service.fake import FakeBus, FakeFleet, FakeStore, fake
from tests.service.fake_page import made_up
from tests.service.serving import PAGE, Folders, Trouble, client_of

ROOT = Path(__file__).parents[2]
World = tuple[FakeFleet, FakeStore, FakeBus]


@pytest.fixture
def world() -> World:
    return made_up()


@pytest.fixture
def client(world: World) -> TestClient:
    return client_of(world)


def answered(document: dict, method: str, path: str, body: object) -> None:
    """Hold an answer against the published document."""
    content = document["paths"][path][method]["responses"]["200"]["content"]["application/json"]
    schema = {**content["schema"], "components": document["components"]}
    Draft202012Validator(schema).validate(body)


@pytest.mark.parametrize(
    "path, asked",
    [
        ("/api/axes", "/api/axes"),
        ("/api/axes/{name}", "/api/axes/F7/aileron-R"),
        ("/api/axes/{name}", "/api/axes/F7%2Faileron-R?points=50"),
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
    found = client.get(asked)
    assert found.status_code == 200
    answered(document, "get", path, found.json())
    assert found.json() not in ({}, [])


def test_that_check_sees(client: TestClient) -> None:
    document = client.get("/openapi.json").json()
    body = client.get("/api/axes").json()
    body["axes"][0]["state"] = "fine"
    with pytest.raises(Exception, match="fine"):
        answered(document, "get", "/api/axes", body)


def test_the_document_has_the_addresses_that_there_are(client: TestClient, world: World) -> None:
    from tests.service.serving import app_of

    app, _ = app_of(*world)
    routes = {(m.lower(), re.sub(r":\w+", "", r.path)) for r in app._app.routes for m in r.methods or ()}
    there = {(m, p) for m, p in routes if p.startswith(("/api", "/metrics")) and m != "head"}
    document = client.get("/openapi.json").json()
    assert there == {(m, p) for p, methods in document["paths"].items() for m in methods}


def test_alarms_are_given_by_state(client: TestClient) -> None:
    def states(query: str) -> list[str]:
        return sorted({a["state"] for a in client.get(f"/api/alarms{query}").json()["alarms"]})

    assert states("") == ["ACKED", "SHELVED", "UNACK"]
    assert states("?state=all") == ["ACKED", "NORMAL", "SHELVED", "UNACK"]
    assert states("?state=UNACK,SHELVED") == ["SHELVED", "UNACK"]
    assert client.get("/api/alarms?state=whatever").status_code == 400


def test_acts_reach_the_fleet_with_who_and_note(client: TestClient, world: World) -> None:
    fleet = world[0]
    id = fleet.raise_alarm("F7/rudder", "coupling_wear", "motor", "low")
    done = client.post(f"/api/alarms/{id}/acknowledge", json={"note": "seen"}, headers=PAGE)
    assert done.status_code == 200
    assert (done.json()["state"], done.json()["acked_by"], done.json()["note"]) == ("ACKED", "local", "seen")
    again = client.post(f"/api/alarms/{id}/acknowledge", json={}, headers=PAGE)
    assert again.status_code == 409 and "ACKED" in again.json()["error"]
    shelved = client.post(f"/api/alarms/{id}/shelve", json={"minutes": 30, "note": "w"}, headers=PAGE)
    assert shelved.json()["state"] == "SHELVED"
    assert math.isclose(shelved.json()["shelved_until"], time.time() + 1800, abs_tol=5)
    assert client.post(f"/api/alarms/{id}/unshelve", headers=PAGE).json()["state"] == "UNACK"
    out = client.post(f"/api/alarms/{id}/out-of-service", json={}, headers=PAGE)
    assert out.json()["state"] == "OUT_OF_SERVICE"
    back = client.post(f"/api/alarms/{id}/out-of-service", json={"back": True}, headers=PAGE)
    assert back.json()["state"] == "UNACK"
    actions = [r["action"] for r in client.get(f"/api/audit?alarm={id}").json()["records"]]
    assert actions == ["IN_SERVICE", "OUT_OF_SERVICE", "UNSHELVED", "SHELVED", "ACKNOWLEDGED", "RAISED"]


@pytest.mark.parametrize(
    "body",
    [
        b"[1]",
        b"{",
        b'{"note": 3}',
        b'{"note": "x", "who": "boss"}',
        json.dumps({"note": "n" * 1001}).encode(),
        b"\xff",
    ],
)
def test_a_body_that_is_not_as_documented_is_refused_in_one_line(client: TestClient, body: bytes) -> None:
    refused = client.post("/api/alarms/4/acknowledge", content=body, headers=PAGE)
    assert refused.status_code == 400
    assert list(refused.json()) == ["error"] and "\n" not in refused.json()["error"]
    assert client.get("/api/alarms?state=UNACK").json()["alarms"][0]["id"] == 4


@pytest.mark.parametrize("minutes", [0, -5, 10081, "1", None, 1e400])
def test_a_shelf_ends_within_a_week(client: TestClient, minutes: object) -> None:
    text = json.dumps({"minutes": minutes, "note": ""})
    assert client.post("/api/alarms/4/shelve", content=text, headers=PAGE).status_code == 400


def test_a_store_that_somebody_must_mend_is_told(client: TestClient, world: World) -> None:
    def damaged(*args: object, **more: object) -> list[dict]:
        raise InputError("the store is damaged", where="fdd.db", mend="put a backup in its place")

    world[1].alarms = damaged  # type: ignore[method-assign]
    found = client.get("/api/alarms")
    assert found.status_code == 500
    assert found.json() == {"error": "fdd.db: the store is damaged; put a backup in its place"}


def test_the_stores_trouble_is_told_and_passes(client: TestClient, world: World) -> None:
    fleet = world[0]
    fleet.trouble = Trouble("fdd.db: the store is locked")
    refused = client.post("/api/alarms/4/acknowledge", headers=PAGE)
    assert refused.status_code == 503 and "the store is locked" in refused.json()["error"]
    fleet.trouble = None
    assert client.post("/api/alarms/4/acknowledge", headers=PAGE).status_code == 200


@pytest.mark.parametrize(
    "path, status",
    [
        ("/api/axes/nobody", 404),
        ("/api/axes/nobody/trend", 404),
        ("/api/nothing", 404),
        ("/api/axes/F7%2Frudder/trend?level=second", 400),
        ("/api/axes/F7%2Frudder/trend?since=x", 400),
        ("/api/axes/F7%2Frudder/trend?since=nan", 400),
        ("/api/axes/F7%2Frudder?points=1e9", 400),
        ("/api/axes/F7%2Frudder/trend?quantity=a'%20or%201", 400),
        ("/api/alarms?limit=-1", 400),
    ],
)
def test_wrong_questions_are_answered_in_one_line(client: TestClient, path: str, status: int) -> None:
    found = client.get(path)
    assert found.status_code == status
    assert list(found.json()) == ["error"]


def test_an_error_within_tells_nothing_of_the_inside(client: TestClient, world: World) -> None:
    fleet = world[0]
    fleet.axes = lambda: 1 / 0  # type: ignore[method-assign, assignment, return-value]
    found = client.get("/api/axes")
    assert (found.status_code, found.json()) == (500, {"error": "internal error"})
    assert found.headers["x-content-type-options"] == "nosniff"


def test_not_a_number_is_null(world: World) -> None:
    fleet = world[0]
    fleet.details["F7/rudder"].misfits.values["volume"][0] = math.nan
    found = client_of(world).get("/api/axes/F7%2Frudder").json()
    assert found["misfits"]["values"]["volume"][0] is None


def test_thinned_signals_keep_their_extremes() -> None:
    random = np.random.default_rng(5)
    low = random.standard_normal(6000)
    high = low + random.random(6000)
    when = np.arange(6000) / 10
    bands = thinned(
        Bands(time=when.tolist(), low={"position": low.tolist()}, high={"position": high.tolist()}), 400
    )
    assert len(bands.time) <= 400 and bands.time == sorted(bands.time)
    assert min(bands.low["position"]) == low.min() and max(bands.high["position"]) == high.max()
    for k, (least, most) in enumerate(zip(bands.low["position"], bands.high["position"], strict=True)):
        part = slice(15 * k, 15 * k + 15)
        assert (least, most) == (low[part].min(), high[part].max())


def test_metrics_are_handed_through(client: TestClient) -> None:
    found = client.get("/metrics")
    assert found.text == "fdd_axes 2\n"
    assert found.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"


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
        again = client.get(path, headers={"if-none-match": found.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
    assert (
        "<script>" not in page.text
        and "style=" not in page.text
        and " on" not in re.sub(r">[^<]*<", "><", page.text)
    )


def test_a_log_is_diagnosed_as_the_command_does(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import fdd.demo  # noqa: F401

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    (tmp_path / "rig.yaml").write_text("position: {column: pos}\n")
    client = client_of(fake(), folders=Folders(maps=tmp_path))
    log = next((ROOT / "fdd" / "demo").glob("*.mcap"))
    found = client.post("/api/diagnose?name=run%201.mcap&unit=axis_a", content=log.read_bytes(), headers=PAGE)
    assert found.status_code == 200, found.text
    answered(client.get("/openapi.json").json(), "post", "/api/diagnose", found.json())
    assert found.json()["log"] == "run 1.mcap" and found.json()["samples"] > 1000


@pytest.mark.parametrize(
    "query, body, said",
    [
        ("name=a.exe", b"x", "ends in none of"),
        ("name=", b"x", "ends in none of"),
        ("name=a.csv&unit=../../etc/passwd", b"x", "no unit of that name"),
        ("name=a.csv&map=/etc/passwd", b"x", "no map of that name; there are: rig"),
        ("name=../../tmp/a.csv", b"time,position\n1,2\n", "../../tmp/a.csv: "),
        ("name=a.mcap", b"not an mcap", "a.mcap: "),
        ("name=a.csv", b"", "a.csv: the file is empty"),
    ],
)
def test_a_log_that_cannot_be_used_is_refused_in_one_line(
    query: str, body: bytes, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    (tmp_path / "rig.yaml").write_text("position: {column: pos}\n")
    client = client_of(fake(), folders=Folders(units=tmp_path, maps=tmp_path))
    refused = client.post(f"/api/diagnose?{query}", content=body, headers=PAGE)
    assert refused.status_code == 400
    assert said in refused.json()["error"] and str(tmp_path) not in refused.json()["error"]


def test_a_diagnosis_that_takes_too_long_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    from fdd.service.http import uploads

    monkeypatch.setattr(uploads, "PROGRAM", "import time; time.sleep(60)")
    monkeypatch.setattr(uploads.Uploads.__init__, "__defaults__", (0.5,))
    begun = time.monotonic()
    found = client_of(fake()).post("/api/diagnose?name=a.csv", content=b"x", headers=PAGE)
    assert (found.status_code, time.monotonic() - begun < 20) == (504, True)
