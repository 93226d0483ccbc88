"""Metrics as Prometheus reads them; recordings as fdd.logs reads them, whatever cuts them off."""

import json
import math
import os
import re
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_open
from prometheus_client.parser import text_string_to_metric_families as parse

from fdd.bounds import MOST_AXES
from fdd.logs import read_log
from fdd.samples import Samples
from fdd.service.config import Recording
from fdd.service.outputs import UNITS, Metrics
from fdd.service.outputs import recorder as recorder_module
from fdd.service.outputs.recorder import Recorder, keep_within
from fdd.service.queues import Bus, Event
from fdd.service.status import AxisStatus
from tests.service.senders import full_disk, measured, transition

DASHBOARD = Path(__file__).parents[2] / "deploy" / "grafana" / "fdd.json"
OUTPUTS = {
    "mqtt": {"delivered": 5, "failed": 2, "given_up": 1, "pending": 3, "lost": 4, "last_error": "away"},
    "recording": {"files": 2, "running": 1, "lost_blocks": 6, "last_error": ""},
}
SOURCES = {"mqtt": {"name": "mqtt", "connected": True, "received": 9, "refused": 2, "reconnects": 1}}


def estimate(*given: Any) -> dict[str, Any]:
    return dict(zip(("unit", "baseline", "value", "std", "observable"), given, strict=True))


def axis(name: str = "A1", **given: Any) -> AxisStatus:
    estimates = {
        "leakage": estimate("m^3/(s*Pa)", 6.5e-12, 9.8e-12, 1e-13, True),
        "bulk_modulus": estimate("Pa", 1e9, 8.5e8, 2e7, False),
        "coulomb_friction": estimate("N", 3e2, None, None, False),
        "viscous_friction": estimate("N*s/m", 2e3, 2.1e3, math.nan, True),
    }
    usual = {
        "name": name, "unit": "axis_a", "headline": "", "state": "healthy", "last_wall": 1.7e9, "lag_s": 0.3,
        "samples": 60000, "rate_hz": 1000.0, "probabilities": {"healthy": 0.9, "leakage": 0.1},
        "estimates": estimates, "quality": {"dropped": 1, "overrun": 2},
    }  # fmt: skip
    return AxisStatus.model_validate({**usual, **given})


def metrics_of(*axes: AxisStatus, alarms: Any = lambda states: [transition()["alarm"]]) -> Metrics:
    fleet = SimpleNamespace(axes=lambda: axes, writer=SimpleNamespace(errors=2.0))
    store, outputs = SimpleNamespace(alarms=alarms), SimpleNamespace(status=lambda: OUTPUTS)
    service = SimpleNamespace(fleet=fleet, store=store, outputs=outputs, sources=lambda: SOURCES)
    return Metrics(service)


def samples(*axes: AxisStatus, **given: Any) -> list[Any]:
    metrics = metrics_of(*axes, **given)()[0].decode()
    return [sample for family in parse(metrics) for sample in family.samples]


def scraped(*axes: AxisStatus, **given: Any) -> dict[tuple[str, ...], float]:
    """Name and label values, in the order of the labels' names, to value."""
    told = samples(*axes, **given)
    return {(one.name, *(one.labels[label] for label in sorted(one.labels))): one.value for one in told}


def test_values_arrive_and_what_is_not_known_is_not_told():
    found = scraped(axis())
    wanted: dict[tuple[str, ...], float] = {
        ("fdd_samples_total", "A1"): 60000,
        ("fdd_dropped_samples_total", "A1"): 3,
        ("fdd_block_lag_seconds", "A1"): 0.3,
        ("fdd_axis_up", "A1"): 1,
        ("fdd_axis_state", "A1", "healthy"): 1,
        ("fdd_axis_state", "A1", "silent"): 0,
        ("fdd_leakage_cubic_meters_per_pascal_second", "A1"): 9.8e-12,
        ("fdd_bulk_modulus_stddev_pascals", "A1"): 2e7,
        ("fdd_estimate_observable", "A1", "bulk_modulus"): 0,
        ("fdd_fault_probability", "A1", "leakage"): 0.1,
        ("fdd_store_errors_total",): 2,
        ("fdd_output_failures_total", "mqtt"): 2,
        ("fdd_output_pending", "mqtt"): 3,
        ("fdd_output_lost_blocks_total", "recording"): 6,
        ("fdd_source_connected", "mqtt"): 1,
        ("fdd_source_blocks_total", "mqtt"): 9,
        ("fdd_source_refused_total", "mqtt"): 2,
        ("fdd_source_reconnects_total", "mqtt"): 1,
    }
    assert {key: found[key] for key in wanted} == wanted
    assert found["process_resident_memory_bytes",] > 1e6
    assert ("fdd_coulomb_friction_newtons", "A1") not in found
    assert ("fdd_viscous_friction_stddev_newton_seconds_per_meter", "A1") not in found
    names = {key[0] for key in scraped(axis(rate_hz=None, last_wall=None, estimates={}))}
    assert not names & {"fdd_last_sample_timestamp_seconds", "fdd_sample_rate_hertz"}
    assert not any("leakage" in name for name in names)
    for state, up in (("healthy", 1), ("in alarm", 1), ("silent", 0), ("failed", 0)):
        assert scraped(axis(state=state))["fdd_axis_up", "A1"] == up
    found = scraped(axis(state="unacknowledged", silent=True))
    states = (found["fdd_axis_state", "A1", state] for state in ("silent", "unacknowledged"))
    assert found["fdd_axis_up", "A1"] == 0 and [*states] == [1, 1]
    assert scraped(axis(state="failed", quality={"refused": 7}))["fdd_dropped_samples_total", "A1"] == 7


def test_alarms_are_counted_and_a_store_in_trouble_takes_only_them_away():
    alarms = [transition(id=1)["alarm"], transition(id=2)["alarm"], transition(axis="gone")["alarm"]]
    found = scraped(axis(), alarms=lambda states: alarms)
    counts = {key[1:]: value for key, value in found.items() if key[0] == "fdd_alarms"}
    assert counts == {("A1", "leakage", "high", "UNACK"): 2}

    def fail(states: Any) -> Any:
        raise RuntimeError("locked")

    names = {sample.name for sample in samples(axis(), alarms=fail)}
    assert "fdd_alarms" not in names and {"fdd_store_errors_total", "fdd_samples_total"} <= names


def test_series_are_bounded_and_openmetrics_is_answered_where_it_is_asked_for():
    found = scraped(*(axis(f"axis-{k:05}") for k in range(MOST_AXES)))
    assert found["fdd_axes",] == MOST_AXES
    assert len({key[1] for key in found if key[0] == "fdd_samples_total"}) == MOST_AXES
    per_axis = sum("axis-00001" in key for key in found)
    assert per_axis <= 40 and len(found) <= MOST_AXES * per_axis + 60
    body, kind = metrics_of(axis())("application/openmetrics-text; version=1.0.0")
    assert kind.startswith("application/openmetrics-text") and body.endswith(b"# EOF\n")
    assert "fdd_axis_up" in {family.name for family in parse_open(body.decode())}


def expressions(node: Any) -> list[str]:
    if isinstance(node, dict):
        own = [node["expr"]] if "expr" in node else []
        own += [node["query"]["query"]] if isinstance(node.get("query"), dict) else []
        return own + [e for value in node.values() for e in expressions(value)]
    return [e for item in node for e in expressions(item)] if isinstance(node, list) else []


def test_the_dashboard_asks_for_metrics_that_exist_and_the_page_names_each():
    known = dict.fromkeys(UNITS, estimate("", 1.0, 1.0, 1.0, True))
    labels = dict[str, set[str]]()
    for sample in samples(axis(estimates=known)):
        labels.setdefault(sample.name, set()).update(sample.labels)
    asked, used = expressions(json.loads(DASHBOARD.read_text("utf-8"))), set[str]()
    assert len(asked) >= 15
    for expression in asked:
        names = set(re.findall(r"\b(?:fdd|process)_\w+", expression))
        assert names and names <= set(labels), expression
        used |= names
        for name, inside in re.findall(r"\b((?:fdd|process)_\w+)\{([^}]*)\}", expression):
            assert set(re.findall(r"(\w+)\s*(?:=|!)", inside)) <= labels[name], expression
        for inside in re.findall(r"\bby\s*\(([^)]*)\)", expression):
            words = {word.strip() for word in inside.split(",")}
            assert words <= set().union(*(labels[n] for n in names)), expression
    wanted = {f"fdd_{q}{part}_{unit}" for q, unit in UNITS.items() for part in ("", "_stddev")}
    wanted |= {"fdd_alarms", "fdd_axis_state", "fdd_block_lag_seconds", "fdd_dropped_samples_total"}
    assert wanted <= used
    page = (Path(__file__).parents[2] / "docs" / "serve-outputs.md").read_text("utf-8")
    ours = {sample.name for sample in samples(axis()) if "fdd_" in sample.name}
    assert {name for name in ours if f"`{name}`" not in page and "_stddev" not in name} == set()


RATE = 100
START = 1000.0
"""s of the stream's clock, which begins anywhere."""


def signal(first: float, last: float) -> Samples:
    """Rows from `first` to before `last`, s, the same however they are cut."""
    k = np.arange(round(first * RATE), round(last * RATE))
    time = k / RATE
    pressure_1 = np.where(k % 97 == 0, np.nan, 5e6 + 1e5 * np.cos(3 * time))
    pressure_2 = 4e6 + 1e5 * np.sin(3 * time)
    rest = {"position": 0.02 * np.sin(time), "pump_angle": 1e6 + 40.0 * time}
    return Samples(time, {**rest, "pressure_1": pressure_1, "pressure_2": pressure_2})


class Rig:
    """A recorder that is worked by hand, and its bus."""

    def __init__(self, folder: Path, **given: Any) -> None:
        usual = {"folder": folder, "before": 20.0, "after": 20.0, "most_bytes": 1 << 30}
        self.folder, self.bus = folder, Bus()
        self.recorder = Recorder(Recording(**{**usual, **given}), self.bus)

    def stream(self, first: float, last: float, axis: str = "A1", block: float = 0.3) -> None:
        for a, b in pairwise([*np.arange(first, last, block), last]):
            self.tell(measured(axis, signal(a, b)))

    def alarm(self, time: float, axis: str = "A1", **given: Any) -> None:
        told = transition(axis=axis, onset=time - 5, detected=time, **given)
        self.tell(Event("alarm", axis, time, told))

    def status(self, time: float, leakage: float) -> None:
        estimates = {"leakage": {"value": leakage, "std": 1e-13, "observable": True}}
        data = {"estimates": estimates, "probabilities": {"healthy": 0.75}, "samples": 5}
        self.tell(Event("status", "A1", time, data))

    def tell(self, event: Event) -> None:
        self.bus.publish(event)
        self.recorder.work()

    def files(self) -> list[Path]:
        return sorted(self.folder.glob("*.mcap"))


def messages(path: Path) -> dict[str, list[tuple[float, bytes]]]:
    found: dict[str, list[tuple[float, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time / 1e9, message.data))
    return found


def lasts(path: Path) -> float:
    return read_log(path).samples.duration


def same(samples: Samples, first: float) -> None:
    """The rows are those of the signal from `first` on."""
    wanted = signal(first, first + len(samples) / RATE)
    np.testing.assert_allclose(samples.time, wanted.time - wanted.time[0], atol=2e-9)
    for name in wanted.channels:
        np.testing.assert_array_equal(samples[name], wanted[name], err_msg=name)


def test_a_recording_is_what_was_measured_before_and_after(tmp_path):
    rig = Rig(tmp_path)
    rig.stream(START, START + 100)
    for k in range(10):
        rig.status(START + 10 * k, 6e-12 + k * 1e-13)
    rig.alarm(START + 100)
    assert not rig.files() and rig.recorder.status()["running"] == 1
    rig.stream(START + 100, START + 130)
    [path] = rig.files()
    log = read_log(path)
    same(log.samples, START + 80)
    assert 40.0 <= log.samples.duration <= 42.0
    found = messages(path)
    assert set(found) == {f"/eha/A1/{t}" for t in ("measurement", "estimate", "diagnosis", "events")}
    assert len(found["/eha/A1/estimate"]) == 2
    events = [json.loads(data) for _, data in found["/eha/A1/events"]]
    words = [" ".join(e["message"].split()[:5]) for e in events]
    assert words == [f"pump_wear or internal_leakage {done} (confidence" for done in ("begins", "detected")]
    begun = found["/eha/A1/measurement"][0][0]
    assert [time - begun for time, _ in found["/eha/A1/events"]] == pytest.approx([15.0, 20.0], abs=1e-3)
    with path.open("rb") as file:
        metadata = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    assert metadata["unit"] == {"yaml": "name: x\n"}
    assert json.loads(metadata["diagnosis"]["json"])["alarms"][0]["action"] == "RAISED"


def test_log_times_are_unix_times(tmp_path, monkeypatch):
    now = 1.8e9
    monkeypatch.setattr(recorder_module.time, "time", lambda: now)
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.stream(now - 40, now - 10, "A2")
    rig.alarm(START + 30, id=1)
    rig.alarm(now - 10, "A2", id=2)
    rig.stream(START + 30, START + 51)
    rig.stream(now - 10, now + 11, "A2")
    # The first file's clock was tied to ours at the alarm, 21 s of data before its end.
    for path, axis, end in zip(rig.files(), ("A1", "A2"), (now + 21, now + 11), strict=True):
        assert messages(path)[f"/eha/{axis}/measurement"][-1][0] == pytest.approx(end, abs=1.0)


def test_a_second_alarm_extends_the_file(tmp_path, monkeypatch):
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.alarm(START + 30, id=1)
    rig.stream(START + 30, START + 45)
    rig.alarm(START + 45, id=2)
    rig.alarm(START + 46, id=2, action="ACKNOWLEDGED", state="ACKED")
    rig.stream(START + 45, START + 60)
    assert not rig.files()
    rig.stream(START + 60, START + 70)
    [path] = rig.files()
    assert lasts(path) == pytest.approx(55.0, abs=1.5)
    assert len(messages(path)["/eha/A1/events"]) == 4
    monkeypatch.setattr(recorder_module, "LONGEST_S", 60.0)
    for k in range(10):
        rig.stream(START + 70 + 10 * k, START + 80 + 10 * k)
        rig.alarm(START + 80 + 10 * k, id=3 + k)
    lengths = [lasts(path) for path in rig.files()[1:]]
    assert lengths and max(lengths) <= 62.0


def test_what_is_no_new_alarm_records_nothing_and_a_silent_axis_leaves_its_file(tmp_path, monkeypatch):
    rig, name = Rig(tmp_path / "in"), "../../hall/A1"
    rig.stream(START, START + 30, name)
    rig.alarm(START + 30, name, action="ACKNOWLEDGED", state="ACKED")
    rig.alarm(START + 30, axis="never heard of")
    rig.stream(START + 30, START + 60, name)
    assert not rig.files()
    rig.alarm(START + 60, name)
    later = recorder_module.time.monotonic() + 21.0
    monkeypatch.setattr(recorder_module.time, "monotonic", lambda: later)
    rig.recorder.work()
    (path,) = rig.files()
    assert lasts(path) == pytest.approx(20.0, abs=1.5)
    assert path.name.split("_2")[0] == "_._.._hall_A1" and [p.name for p in tmp_path.iterdir()] == ["in"]


def test_a_clock_that_is_set_back_ends_the_recording(tmp_path):
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.alarm(START + 30)
    rig.stream(START + 30, START + 35)
    rig.stream(START - 500, START - 490)
    [path] = rig.files()
    assert lasts(path) == pytest.approx(25.0, abs=1.5)
    rig.alarm(START - 490, id=2)
    rig.stream(START - 490, START - 465)
    [*_, other] = rig.files()
    same(read_log(other).samples, START - 500)


def test_the_folder_stays_within_its_bound_and_others_files_stay(tmp_path):
    (tmp_path / "notes.mcap").write_bytes(b"x" * 5_000_000)
    most = 1 << 20
    rig = Rig(tmp_path, most_bytes=most, before=5.0, after=5.0)
    rig.stream(START, START + 10)
    for k in range(30):
        rig.alarm(START + 10 + 20 * k, id=k)
        rig.stream(START + 10 + 20 * k, START + 30 + 20 * k)
        ours = [p for p in rig.files() if p.name != "notes.mcap"]
        assert sum(p.stat().st_size for p in ours) <= most
    ids = sorted(int(p.stem.rpartition("_")[2]) for p in ours)
    assert rig.recorder.files == 30 > len(ids) > 1 and (tmp_path / "notes.mcap").exists()
    assert ids == list(range(30))[-len(ids) :], "the oldest went"
    for k, path in enumerate(ours):
        os.utime(path, (1000 + k, 1000 + k))
    keep_within(tmp_path, 1, newest=ours[0])
    assert sorted(p for p in rig.files() if p.name != "notes.mcap") == [ours[0]]


def test_a_full_disk_is_told_and_the_next_recording_is_whole(tmp_path):
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    with full_disk(20_000):
        rig.alarm(START + 30)
        rig.stream(START + 30, START + 60)
    assert str(tmp_path) in rig.recorder.status()["last_error"]
    assert rig.recorder.status()["running"] == 0 and not list(tmp_path.iterdir()), "nothing is half-written"
    rig.alarm(START + 60, id=2)
    rig.stream(START + 60, START + 82)
    assert lasts(rig.files()[-1]) == pytest.approx(40.0, abs=1.5)
    assert rig.recorder.status()["last_error"] == ""


def test_memory_is_bounded(tmp_path, monkeypatch):
    rig = Rig(tmp_path)
    rig.stream(START, START + 200)
    axis = rig.recorder._axes["A1"]
    held = lambda: sum(8 * len(part) * (1 + len(part.channels)) for part in axis.ring)  # noqa: E731
    assert held() == axis.size <= (20 + 10 + 1) * RATE * 8 * 5
    monkeypatch.setattr(recorder_module, "MOST_BYTES", 50_000)
    rig.stream(START + 200, START + 210)
    assert held() == axis.size <= 50_000
    rig.alarm(START + 210)
    rig.stream(START + 210, START + 230)
    assert len(rig.files()) == 1 and held() <= 51_000, "a recording ends at the bound"
    for k in range(5000):
        rig.bus.publish(measured("A1", signal(START + 300 + k, START + 300 + k + 0.05)))
    rig.recorder.work()
    assert rig.recorder.status()["lost_blocks"] == 1000
