"""The annotated MCAP: estimates, windows, events and the answer beside the measurement."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from made_up_logs import messages, refused, strokes
from mcap.reader import make_reader

from fdd.logs.mcap_writing import write_annotated

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


GAP = pytest.approx(np.nan, nan_ok=True)
"""What stands where there is no value."""


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
    by_topic: dict[str, list[dict]] = {}
    for _, topic, fields in messages(path):
        by_topic.setdefault(topic, []).append(fields)
    with path.open("rb") as stream:
        metadata = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    measured = by_topic["/eha/axis_a/measurement"]
    assert [m["position"] for m in measured] == samples["position"].tolist() and len(by_topic) == 4
    assert messages(path)[0][0] == 5 * 10**9
    assert metadata == {"unit": {"yaml": "u: 1"}, "diagnosis": {"json": ANSWER}}
    estimate = by_topic["/eha/axis_a/estimate"]
    assert estimate[0] == {
        "time": 0.0,
        "ekf": {"leakage": 6e-12, "leakage_std": 1e-13, "nis": 1.0},
        "svsf": {"leakage": 7e-12},
        "observable": {"leakage": False},
        "held": {"leakage": GAP},
        "held_std": {"leakage": GAP},
        "information_std": {"leakage": GAP},
    }
    assert estimate[10]["held"] == {"leakage": 6e-12} and estimate[10]["held_std"] == {"leakage": 2e-13}
    assert estimate[1]["information_std"] == {"leakage": 3e-13}
    assert estimate[3]["ekf"]["leakage_std"] == GAP and estimate[10]["observable"] == {"leakage": True}
    assert by_topic["/eha/axis_a/diagnosis"][1] == {
        "time": 2.0, "statistic": 1.0, "threshold": 12.0,
        "probabilities": {"healthy": 0.25}, "features": {"bias": 2.0, "ripple": 3.0},
    }  # fmt: skip
    onset, detected = by_topic["/eha/axis_a/events"]
    assert onset["timestamp"] == {"sec": 7, "nsec": 0} and onset["level"] == 3
    assert detected["level"] == 4 and "internal_leakage or pump_wear detected" in detected["message"]
    assert "9.8e-12 m³/(s·Pa)" in detected["message"]


def test_without_trajectories_or_faults_there_is_the_measurement(tmp_path: Path) -> None:
    write_annotated(tmp_path / "a.mcap", strokes(3000), {}, "{}", axis="a")
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {c.topic for c in summary.channels.values()} == {"/eha/a/measurement"}
    assert "topic" in refused(lambda: write_annotated(tmp_path / "a", strokes(9), {}, "{}", axis="a/b"))
