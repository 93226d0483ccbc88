"""What is written as MCAP, as the libraries of MCAP and Protobuf read it."""

import json
import tracemalloc
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_logs import ROWS, A, B, messages, of_topic, parts, refused, strokes
from mcap.reader import make_reader

from fdd.logs.mcap_writing import RunBlock, mcap_file, write_annotated, write_blocks, write_run
from fdd.samples import CHANNELS, Samples

cuts = st.lists(st.integers(0, ROWS), max_size=8)
any_double = st.floats(allow_infinity=False)  # subnormal, huge, -0.0 and NaN too


def bits(values: object) -> list[int]:
    """Doubles as their bits, so that NaN and the sign of zero count."""
    return np.array(values, dtype=np.float64).view(np.uint64).tolist()


@given(
    st.lists(any_double, min_size=1, max_size=30), st.lists(any_double, min_size=1, max_size=3),
    st.sampled_from([1, 2, 14, 15, 16, 17, 130]), st.integers(0, 2**62),  # tags of one and of two bytes
)  # fmt: skip
@settings(max_examples=20, deadline=None)
def test_every_value_comes_back_to_the_bit(values, others, fields, start_ns):
    n = len(values)
    columns = {f"c{k}": np.roll(np.resize([*values, *others], n), k) for k in range(fields)}
    columns |= {"g.x": np.array(values), "g.h.y": np.array(values)[::-1], "g.h.up": np.array(values) > 0.0}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        with mcap_file(path, start_ns=start_ns) as out:
            out.add_columns({"/eha/a/truth": {"time": np.arange(n) * 0.25, **columns}})
        found = messages(path)
    assert [stamp for stamp, _, _ in found] == [start_ns + 250_000_000 * k for k in range(n)]
    read = [fields for _, _, fields in found]
    assert list(read[0]) == ["time", *(f"c{k}" for k in range(fields)), "g"], "every field is there, NaN too"
    for k in range(fields):
        assert bits([m[f"c{k}"] for m in read]) == bits(columns[f"c{k}"])
    assert bits([m["g"]["x"] for m in read]) == bits(values)
    assert bits([m["g"]["h"]["y"] for m in read]) == bits(values[::-1])
    assert [m["g"]["h"]["up"] for m in read] == [v > 0.0 for v in values]


def test_infinities_are_nan_and_empty_blocks_and_runs_are_nothing(tmp_path):
    with mcap_file(tmp_path / "a.mcap") as out:
        out.add_columns({"/t": {"time": [0, 1, 2], "std": [np.inf, 1.5, -np.inf], "count": [3, 4, 5]}})
    read = of_topic(tmp_path / "a.mcap", "/t")
    assert bits([m["std"] for m in read]) == bits([np.nan, 1.5, np.nan])
    assert [m["count"] for m in read] == [3.0, 4.0, 5.0]
    path, none = tmp_path / "a.mcap", A.rows(0, 0)
    write_blocks(path, [RunBlock(none, {"leakage": []}, "a"), *parts(A, [0, 600, 600], "a", 0)], axes=["a"])
    assert bits([m["time"] for _, _, m in messages(path)]) == bits(A.time)
    for blocks in ([], [RunBlock(none, None, "a")]):
        write_blocks(path, blocks, axes=["a"])
        assert messages(path) == []


def mixed(seed: int, *queues: list[RunBlock]):
    """The blocks of several axes in a random order, each axis's in its own."""
    choice = np.random.default_rng(seed)
    left = [list(q) for q in queues]
    while any(left):
        queue = left[choice.integers(len(left))]
        if queue:
            yield queue.pop(0)


@given(first=cuts, second=cuts, order=st.integers(0, 2**32))
@settings(max_examples=12, deadline=None)
def test_two_axes_in_any_blocks_and_any_order(first, second, order):
    with TemporaryDirectory() as folder:
        path = Path(folder) / "dual.mcap"
        write_blocks(path, mixed(order, parts(A, first, "a"), parts(B, second, "b")), axes=["a", "b"])
        found = messages(path)
    stamps = [stamp for stamp, _, _ in found]
    assert stamps == sorted(stamps)
    for axis, samples in (("a", A), ("b", B)):
        measured = [fields for _, topic, fields in found if topic == f"/eha/{axis}/measurement"]
        assert bits([m["time"] for m in measured]) == bits(samples.time)
        for channel in samples.channels:
            assert bits([m[channel] for m in measured]) == bits(samples[channel])
        true = [fields for _, topic, fields in found if topic == f"/eha/{axis}/truth"]
        assert [t["leakage"] for t in true] == [1e-12 * k for k in range(0, len(samples), 10)]


def test_the_schema_says_what_the_messages_hold(tmp_path):
    truth = {"leakage": np.ones(ROWS), "stuck": np.ones(ROWS, bool)}
    write_run(tmp_path / "a.mcap", A, axis="a", truth=truth)
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
        (file,) = FileDescriptorSet.FromString(schema.data).file
        (message,) = file.message_type
        assert schema.name == f"{file.package}.{message.name}"
        kinds = {f.name: (f.type, f.label) for f in message.field}
        if channel.topic == "/eha/a/measurement":
            assert schema.name == "fdd.Measurement" and set(kinds) == {"time", *A.channels}
            assert channel.metadata["pressure_1"] == f"Pa: {CHANNELS['pressure_1'].meaning}"
        else:
            assert schema.name == "fdd.Truth" and list(kinds) == ["time", "leakage", "stuck"]
            assert kinds["leakage"] == (1, 1) and kinds["stuck"] == (8, 1), "optional double, optional bool"


@pytest.mark.slow
def test_memory_does_not_grow_with_the_run(tmp_path):
    block, peaks = strokes(5000), list[int]()
    for count in (4, 20):
        blocks = (RunBlock(Samples(block.time + 5.0 * k, block.columns), None, "a") for k in range(count))
        tracemalloc.start()
        write_blocks(tmp_path / "a.mcap", blocks, axes=["a"])
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]


def test_blocks_that_do_not_fit_are_refused_in_one_line(tmp_path):
    first, second = parts(A, [600], "a", 0)
    other = RunBlock(Samples(second.samples.time, {"position": second.samples["position"]}), None, "a")
    number = RunBlock(second.samples, {"stuck": np.ones(600)}, "a")

    def write(blocks: list[RunBlock], axes: tuple[str, ...] = ("a",)) -> str:
        return refused(lambda: write_blocks(tmp_path / "a.mcap", blocks, axes=axes))

    assert "same columns" in write([first, other])
    assert "same columns" in write([RunBlock(first.samples, {"stuck": np.ones(600, bool)}, "a"), number])
    for n in (1, 3, ROWS + 1):
        assert f"{n} values for 1200" in write([RunBlock(A, {"leakage": np.ones(n)}, "a")])
    assert "cannot name a field" in write([RunBlock(A, {"leak age": np.ones(ROWS)}, "a")])
    assert "start_ns" in write([RunBlock(A, {"time": A.time - 1.0, "leakage": A.time}, "a")])
    assert "topic" in write([], ("a/b",))
    assert list(tmp_path.iterdir()) == []


FAULT = {
    "fault": "internal_leakage", "ambiguity": ["internal_leakage", "pump_wear"], "confidence": 0.97,
    "onset_s": 2.0, "detected_s": 2.9, "evidence": ["leakage rose to 9.8e-12 m³/(s·Pa)"],
}  # fmt: skip
ANSWER = json.dumps({"verdict": "faulty", "faults": [FAULT]})
GAP = pytest.approx(np.nan, nan_ok=True)
"""What stands where there is no value."""


def test_everything_of_a_diagnosis_is_there(tmp_path):
    samples = strokes(5000)
    row = np.arange(250)
    trajectories = {
        "time": samples.time[::20],
        "estimates": {"ekf": {"leakage": np.full(250, 6e-12)}, "svsf": {"leakage": np.full(250, 7e-12)}},
        "stds": {"ekf": {"leakage": np.where(row == 3, np.nan, 1e-13)}, "svsf": {}},
        "observable": {"leakage": row > 9},
        "held": {"leakage": np.where(row > 9, 6e-12, np.nan)},
        "held_std": {"leakage": np.where(row > 9, 2e-13, np.nan)},
        "information_std": {"leakage": np.where(row > 0, 3e-13, np.inf)},
        "nis": {"ekf": np.ones(250)},
        "window_time": np.arange(1.0, 5.0),
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
        by_topic.setdefault(topic.removeprefix("/eha/axis_a/"), []).append(fields)
    with path.open("rb") as stream:
        metadata = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert by_topic.keys() == {"measurement", "estimate", "diagnosis", "events"}
    assert [m["position"] for m in by_topic["measurement"]] == samples["position"].tolist()
    assert messages(path)[0][0] == 5 * 10**9
    assert metadata == {"unit": {"yaml": "u: 1"}, "diagnosis": {"json": ANSWER}}
    estimate = by_topic["estimate"]
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
    assert by_topic["diagnosis"][1] == {
        "time": 2.0, "statistic": 1.0, "threshold": 12.0,
        "probabilities": {"healthy": 0.25}, "features": {"bias": 2.0, "ripple": 3.0},
    }  # fmt: skip
    onset, detected = by_topic["events"]
    assert onset["timestamp"] == {"sec": 7, "nsec": 0} and onset["level"] == 3
    assert detected["level"] == 4 and "internal_leakage or pump_wear detected" in detected["message"]
    assert "9.8e-12 m³/(s·Pa)" in detected["message"]
    write_annotated(tmp_path / "a.mcap", strokes(3000), {}, "{}", axis="a")
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {c.topic for c in summary.channels.values()} == {"/eha/a/measurement"}
    assert "topic" in refused(lambda: write_annotated(tmp_path / "a", strokes(9), {}, "{}", axis="a/b"))
