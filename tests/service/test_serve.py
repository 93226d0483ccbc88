"""`fdd serve` as a whole: a log replayed, its alarm over HTTP, acknowledged, and kept over a restart."""

import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from fdd.cli import serve
from fdd.cli.app import app
from fdd.errors import InputError
from fdd.logs import read_log
from fdd.logs.tabular_writing import write_table
from fdd.service.config import Serve
from fdd.service.fleet import Fleet
from fdd.service.service import Service
from fdd.service.store import Store
from tests.service.senders import serving, until
from tests.service.servers import postgres_server, postgres_url

BASE = "schema: fdd.serve/1\nfallback: axis_a\nlisten: {port: 0}\n"
UDP = f"{BASE}sources: [{{type: udp, port: 0}}]\n"


def ask(service: Service, path: str, body: dict[str, Any] | None = None) -> Any:
    address = f"{service.address}api/{path}"
    with httpx.Client(timeout=20, trust_env=False, headers={"x-fdd": "1"}) as client:
        answer = client.get(address) if body is None else client.post(address, json=body)
    return answer.raise_for_status().json()


def test_a_leak_is_told_acknowledged_recorded_and_kept_and_what_is_refused_is_told(log, tmp_path, caplog):
    write_table(tmp_path / "run.parquet", log)
    sources = "[{type: tcp, port: 0, name: line}, {type: replay, speed: max, logs: {A1: run.parquet}}]"
    text = f"{BASE}outputs: {{recording: {{folder: kept}}}}\nsources: {sources}"
    config = Serve.from_yaml(text, folder=tmp_path)
    with serving(config) as service:
        (alarm,) = until(lambda: ask(service, "alarms")["alarms"])
        assert (alarm["axis"], alarm["fault"], alarm["state"]) == ("A1", "internal_leakage", "UNACK")
        acknowledge = f"alarms/{alarm['id']}/acknowledge"
        ask(service, acknowledge, {"note": "on my way"})
        (alarm,) = ask(service, "alarms")["alarms"]  # from the store, before anything else is done
        assert (alarm["state"], alarm["acked_by"], alarm["note"]) == ("ACKED", "local", "on my way")
        with pytest.raises(httpx.HTTPStatusError, match="409"):
            ask(service, acknowledge, {})
        assert ask(service, "axes")["axes"][0]["state"] == "in alarm"
        assert ask(service, "axes/A1")["findings"][0]["fault"] == "internal_leakage"
        until(lambda: service.outputs.status()["recording"]["running"])
        with pytest.raises(InputError, match="another fdd serve"):
            Service(config)
        with socket.create_connection(("127.0.0.1", service.sources()["line"]["port"])) as line:
            line.sendall(b'{"schema": "fdd.block/1", "axis": "A1", "colums": {}}\n')
        refused = "source line refused messages: unknown key 'colums' in a block"
        health = until(lambda: refused in str((h := ask(service, "health"))["problems"]) and h)
        assert health["sources"]["line"]["refused"] == 1 and health["status"] == "degraded"
        metrics = httpx.get(f"{service.address}metrics", timeout=20).text
        assert 'fdd_source_refused_total{source="line"} 1.0' in metrics
        assert "source line: 1 refused, the last one: unknown key 'colums'" in caplog.text
    [path] = (tmp_path / "kept").glob("A1_*.mcap")
    assert read_log(path).samples.time[-1] > 5.0, "a stop leaves what there is"
    with serving(config) as service:
        (alarm,) = until(lambda: ask(service, "alarms")["alarms"])
        assert (alarm["state"], alarm["note"]) == ("ACKED", "on my way")
        done = [r["action"] for r in ask(service, "audit")["records"]]
        assert done.count("RAISED") == 1 and "ACKNOWLEDGED" in done


@pytest.mark.slow
def test_a_server_that_is_away_at_the_start_or_killed_later_loses_nothing(log, whole, tmp_path, monkeypatch):
    write_table(tmp_path / "run.parquet", log)
    url = postgres_url()
    text = f"{BASE}store: {url}\nsources: [{{type: replay, speed: 10, logs: {{A1: run.parquet}}}}]"
    monkeypatch.setattr("fdd.service.service.AGAIN_S", 0.2)
    postgres_server().kill()
    coming_back = threading.Timer(1.0, postgres_server().start)
    coming_back.start()
    with serving(Serve.from_yaml(text, folder=tmp_path)) as service:
        coming_back.join()
        samples = lambda: sum(a["samples"] for a in ask(service, "axes")["axes"])  # noqa: E731
        trouble = lambda: "store cannot be written" in str(ask(service, "health"))  # noqa: E731
        for already in (5_000, 33_000):  # before the fault, and while it is being told
            until(lambda already=already: samples() > already)
            postgres_server().kill()
            until(trouble)
            with pytest.raises(httpx.HTTPStatusError, match="503"):
                ask(service, "alarms")
            postgres_server().start()
            until(lambda: not trouble())
        until(lambda: samples() == len(log))
        until(lambda: ask(service, "alarms")["alarms"])
    store = Store(url)
    assert [(f["onset"], f["severity"]) for f in store.findings()] == [(f.onset_s, f.severity) for f in whole]
    assert [a["action"] for a in store.audit()] == ["RAISED"] * len(whole) == ["RAISED"]
    assert store.journal("A1") == [] and store.axes()[0]["last_time"] == log.time[-1]
    store.close()


def test_the_command_checks_a_file_and_makes_tokens(tmp_path, monkeypatch):
    run, path = CliRunner().invoke, tmp_path / "serve.yaml"
    path.write_text(UDP)
    checked = run(app, ["serve", str(path), "--check"])
    assert checked.exit_code == 0 and "1 source, store" in checked.output
    made = run(app, ["serve", "--token", "ann:acknowledge"])
    assert made.exit_code == 0 and "ann acknowledge " in made.output
    for wrong in (["serve"], ["serve", "--token", "ann:boss"], ["serve", str(tmp_path / "none.yaml")]):
        assert run(app, wrong).exit_code == 2
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for arguments in (["--demo"], ["--token", "ann:view"]):
        refused = run(app, ["serve", *arguments])
        assert refused.exit_code == 2 and "install fdd[serve]" in refused.output


def test_a_fleet_that_fails_ends_the_service(tmp_path, monkeypatch):
    """Not with status 0, by which nobody would start it again."""
    for error in (InputError("the store is damaged"), RuntimeError("a fault of fdd")):

        def failing(self: Fleet, stop: threading.Event, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr(Fleet, "run", failing)
        with pytest.raises(type(error), match=str(error)):
            Service(Serve.from_yaml(UDP, folder=tmp_path)).run(threading.Event())


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends signals")
def test_two_signals_at_once_end_it(tmp_path):
    """A process manager and its wrapper may both send one: it must not wait for itself."""
    (tmp_path / "serve.yaml").write_text(UDP)
    program = "import sys; from fdd.cli import main; sys.argv[0] = 'fdd'; main()"
    command = [sys.executable, "-c", program, "serve", tmp_path / "serve.yaml"]
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, **pipes, env=env, text=True)
    assert process.stdout is not None and "Page:" in process.stdout.readline()
    for _ in range(2):
        process.send_signal(signal.SIGTERM)
    _, told = process.communicate(timeout=60)
    assert process.returncode in (0, 130) and "Traceback" not in told


@pytest.mark.parametrize(
    "line",
    [
        *("units: none", "fallback: none", "units: {A1: none}", "model: none.json", "tokens: none.txt"),
        "listen: {port: 0, tls: {cert: none.pem, key: none.key}}",
        "listen: {port: 0, tls: {cert: serve.yaml, key: serve.yaml}}",
        "state: serve.yaml/state",
        "sources: [{type: folder, folder: none}]",
        "sources: [{type: replay, logs: {A1: none.csv}}]",
        "sources: [{type: udp, port: 0, map: none.yaml}]",
        "sources: [{type: mqtt, host: h, topics: [t], user: u, password_file: none}]",
        "sources: [{type: mqtt, host: h, topics: [t], tls: {ca: none.pem}}]",
        "outputs: {mqtt: {host: h, user: u, password_file: none}}",
        "outputs: {webhooks: [{url: 'http://h', secret_file: none}]}",
        "outputs: {recording: {folder: serve.yaml/none}}",
    ],
)
def test_whatever_the_file_names_is_opened_before_anything_is_made(line, tmp_path):
    path = tmp_path / "serve.yaml"
    sources = "" if line.startswith("sources") else "sources: [{type: udp, port: 0}]\n"
    path.write_text(f"schema: fdd.serve/1\n{line}\n{sources}")
    refused = CliRunner().invoke(app, ["serve", str(path), "--check"])
    assert refused.exit_code == 2 and ("none" in refused.output or "serve.yaml" in refused.output)
    with pytest.raises(InputError):
        Service(Serve.load(path))
    assert [p.name for p in tmp_path.iterdir()] == ["serve.yaml"], "nothing half-made"


def test_a_demo_removes_what_a_killed_one_has_left(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "fdd-demo-killed").mkdir()
    (tmp_path / "fdd-demo-killed" / ".lock").touch()
    with serve._demo_folder() as mine:
        assert [p.name for p in tmp_path.iterdir()] == [mine.name]
        with serve._demo_folder() as other:
            assert sorted(p.name for p in tmp_path.iterdir()) == sorted([mine.name, other.name])
    assert list(tmp_path.iterdir()) == []
