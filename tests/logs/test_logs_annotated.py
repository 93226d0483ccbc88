"""The annotated MCAP: estimates, windows, events and the answer beside the measurement."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from made_up_logs import assert_same, strokes
from mcap.reader import make_reader

from fdd.logs import read_log
from fdd.logs.json_rows import json_rows
from fdd.logs.mcap_writing import Event, write_annotated

ANSWER = json.dumps(
    {
        "verdict": "faulty",
        "faults": [
            {
                "fault": "internal_leakage", "ambiguity": ["internal_leakage", "pump_wear"],
                "confidence": 0.97, "onset_s": 2.0, "detected_s": 2.9,
                "evidence": ["leakage rose to 9.8e-12 m³/(s·Pa)"],
            }
        ],
    }
)  # fmt: skip


def test_everything_of_a_diagnosis_is_there(tmp_path: Path) -> None:
    samples = strokes(5000)
    time, window = samples.time[::20], np.arange(1.0, 5.0)
    std = np.full(250, 1e-13)
    std[3] = np.nan
    trajectories = {
        "time": time,
        "estimates": {"ekf": {"leakage": np.full(250, 6e-12)}, "svsf": {"leakage": np.full(250, 7e-12)}},
        "stds": {"ekf": {"leakage": std}, "svsf": {}},
        "observable": {"leakage": np.arange(250) > 9},
        "held": {"leakage": np.where(np.arange(250) > 9, 6e-12, np.nan)},
        "held_std": {"leakage": np.where(np.arange(250) > 9, 2e-13, np.nan)},
        "information_std": {"leakage": np.where(np.arange(250) > 0, 3e-13, np.inf)},
        "nis": {"ekf": np.ones(250)},
        "window_time": window,
        "feature_names": ["bias", "ripple"],
        "features": np.arange(8.0).reshape(4, 2),
        "statistic": np.arange(4.0),
        "threshold": 12.0,
        "probabilities": {"healthy": np.full(4, 0.25)},
    }
    path = tmp_path / "out.mcap"
    write_annotated(path, samples, trajectories, ANSWER, axis="axis_a", unit_yaml="u: 1", start_ns=5 * 10**9)
    assert_same(read_log(path), samples)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        by_topic: dict[str, list[dict]] = {}
        stamps = []
        for _, channel, message in reader.iter_messages(log_time_order=False):
            by_topic.setdefault(channel.topic, []).append(json.loads(message.data))
            stamps.append(message.log_time)
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert stamps == sorted(stamps) and stamps[0] == 5 * 10**9
    assert metadata == {"unit": {"yaml": "u: 1"}, "diagnosis": {"json": ANSWER}}
    estimate = by_topic["/eha/axis_a/estimate"]
    assert estimate[0] == {
        "time": 0.0,
        "ekf": {"leakage": 6e-12, "leakage_std": 1e-13, "nis": 1.0},
        "svsf": {"leakage": 7e-12},
        "observable": {"leakage": False},
        "held": {},
        "held_std": {},
        "information_std": {},
    }
    assert estimate[10]["held"] == {"leakage": 6e-12} and estimate[10]["held_std"] == {"leakage": 2e-13}
    assert estimate[1]["information_std"] == {"leakage": 3e-13}
    assert "leakage_std" not in estimate[3]["ekf"] and estimate[10]["observable"] == {"leakage": True}
    assert by_topic["/eha/axis_a/diagnosis"][1] == {
        "time": 2.0, "statistic": 1.0, "threshold": 12.0,
        "probabilities": {"healthy": 0.25}, "features": {"bias": 2.0, "ripple": 3.0},
    }  # fmt: skip
    onset, detected = by_topic["/eha/axis_a/events"]
    assert onset["timestamp"] == {"sec": 7, "nsec": 0} and onset["level"] == 3
    assert detected["level"] == 4 and "internal_leakage or pump_wear detected" in detected["message"]
    assert "9.8e-12 m³/(s·Pa)" in detected["message"]


def test_given_events_are_shown_instead(tmp_path: Path) -> None:
    events = [Event(1.5, "operator stopped the pump")]
    write_annotated(tmp_path / "a.mcap", strokes(3000), {}, ANSWER, axis="a", events=events)
    with (tmp_path / "a.mcap").open("rb") as stream:
        said = [json.loads(m.data) for _, _, m in make_reader(stream).iter_messages(topics=["/eha/a/events"])]
    assert [(s["message"], s["level"], s["name"]) for s in said] == [("operator stopped the pump", 2, "a")]


@given(
    st.lists(st.floats(), min_size=1, max_size=20),
    st.text(max_size=10),
)
def test_json_rows_are_what_the_standard_library_reads(values: list[float], name: str) -> None:
    column = np.array(values)
    assert [json.loads(r) for r in json_rows({name: column})] == [
        {name: v} if np.isfinite(v) else {} for v in values
    ]
    rows = json_rows(
        {name: column, "nested": {name: column[::-1], "flag": column > 0}, "n": np.arange(column.size)}
    )
    assert len(rows) == column.size
    for k, row in enumerate(rows):
        expected = {"nested": {"flag": bool(column[k] > 0)}, "n": k}
        if np.isfinite(column[k]):
            expected[name] = column[k]
        if np.isfinite(column[::-1][k]):
            expected["nested"][name] = column[::-1][k]
        if name not in ("nested", "n", "flag"):
            assert json.loads(row) == expected
