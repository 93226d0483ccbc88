"""Channel maps: both forms, what a wrong map is told; conversions of units, counts, valves and speeds."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_logs import frame, refused, strokes

from fdd.logs import ChannelMap, read_log
from fdd.logs.channel_map import accumulate_speed, directed, unwrap_counts
from fdd.logs.quality import sample_numbers

LONG = """
schema: fdd.map/1
name: some rig
axis: left
csv: {delimiter: ";", decimal: ",", skip_rows: 2}
channels:
  time: {column: n, unit: ms}
  position: {column: cyl_pos, unit: mm}
"""


def test_long_and_short_form():
    long = ChannelMap.from_yaml(LONG)
    assert (long.name, long.axis, long.csv.delimiter, long.csv.skip_rows) == ("some rig", "left", ";", 2)
    short = ChannelMap.from_yaml(
        "time: {column: n, unit: ms}\nposition: {column: cyl_pos, unit: mm}\naxis: left"
    )
    assert short.channels == long.channels and short.axis == "left"
    topics = ChannelMap.from_yaml("position: {topic: /daq, field: cyl.pos, unit: mm}")
    assert topics.reads_mcap and not long.reads_mcap


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("positon: {column: x}\ntime: {column: t}", ["unknown channel 'positon'", "did you mean 'position'"]),
        ("position: {column: x, unit: bar}", ["channel position: unit 'bar' measures pressure, not length"]),
        ("position: {column: x, unit: blurp}", ["channel position: ", "unknown unit 'blurp'", "mm"]),
        ("position: {column: x, units: mm}", ["position.units"]),
        ("position: {unit: mm}", ["one of column, topic or from"]),
        ("position: {column: x, topic: /a, field: b}", ["one of column, topic or from"]),
        ("position: {topic: /a}", ["give the field", "/a"]),
        ("position: {topic: /a, field: x}\ntime: {column: t}", ["mixed"]),
        ("position: {topic: /a, field: x, wrap: 4096}", ["wrap is for an angle"]),
        ("position: {topic: /a, field: x, scale: 0}", ["scale is 0"]),
        ("position: {topic: /a, field: x, scale: .nan}", ["position.scale"]),
        ("position: {topic: /a, field: x, sign: 2}", ["position.sign"]),
        ("position: {topic: /a, field: x, period: 1}", ["period goes with"]),
        ("pump_angle: {from: pump_speed}\nposition: {topic: /a, field: x}", ["the map does not give"]),
        ("pump_angle: {from: pump_speed, unit: rpm}", ["unit does not go with from"]),
        ("position: {from: pump_speed}\npump_speed: {topic: /a, field: x}", ["makes pump_angle of"]),
        ("channels: {position: {column: x}}\ntime: {column: t}", ["'time' stands beside channels:"]),
        ("channels: [position]", ["channels: not a mapping"]),
        ("channels: {}", ["no channel is mapped"]),
        ("position: x", ["position"]),
        ("just a sentence", ["not a channel map", "position: {column: cyl_pos"]),
        ("schema: fdd.map/9\nposition: {topic: /a, field: x}", ["schema"]),
    ],
)  # fmt: skip
def test_a_wrong_map_is_told_where_and_what(text, said, tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(text)
    line = refused(lambda: ChannelMap.load(path))
    assert line.startswith(f"{path}: ")
    assert [part for part in said if part not in line] == [], line


def test_every_conversion_of_a_table(tmp_path):
    """A foreign CSV in other units, checked against figures worked out by hand."""
    row = np.arange(3000)
    foreign = pd.DataFrame(
        {
            "index": row,
            "volt": np.where(row < 1000, 10.0, -10.0),
            "counts": (row * 40) % 4096,
            "valve": np.where(row < 1000, 1000, np.where(row < 2000, 0, -1000)),
            "rpm": 600.0,
            "x": 2.0 + row,
            "raw_p": 100.0 + row % 2,
            "kelvin": 313.15,
        }
    )
    foreign.to_csv(tmp_path / "a.csv", index=False, sep=";")
    channel_map = ChannelMap.from_yaml(
        """
        time: {column: index, unit: s, scale: 0.001, offset: 3}
        command: {column: volt, scale: 31.416, unit: rad/s}
        pump_angle: {column: counts, wrap: 4096, unit: rev, scale: 2.44140625e-4, sign: -1, sign_of: valve}
        pump_speed: {column: rpm, unit: rpm, sign_of: valve}
        position: {column: x, unit: mm, sign: -1}
        pressure_1: {column: raw_p, scale: 0.0625, offset: -0.625, unit: bar}
        pressure_2: {column: raw_p, unit: psi}
        oil_temperature: {column: kelvin, unit: K}
        """
    )
    samples = read_log(tmp_path / "a.csv", channel_map).samples
    np.testing.assert_allclose(samples.time, 3.0 + row / 1000)
    assert samples["command"][0] == pytest.approx(314.16) and samples["command"][-1] == pytest.approx(-314.16)
    step = -40 / 4096 * 2 * math.pi
    direction = np.where(row < 1000, 1, np.where(row < 2000, 0, -1))
    np.testing.assert_allclose(np.diff(samples["pump_angle"]), step * direction[1:], atol=1e-9)
    np.testing.assert_allclose(samples["pump_speed"], 20 * math.pi * direction)
    np.testing.assert_allclose(samples["position"], -(2.0 + row) / 1000)
    np.testing.assert_allclose(samples["pressure_1"][:2], [562_500.0, 568_750.0])
    assert samples["pressure_2"][0] == pytest.approx(689_475.7, abs=0.1)
    np.testing.assert_allclose(samples["pressure_difference"], samples["pressure_1"] - samples["pressure_2"])
    np.testing.assert_allclose(samples["oil_temperature"], 40.0)


def test_time_of_day_in_a_table_counts_from_the_start(tmp_path):
    whole = frame(3000)
    dated = whole.assign(time=pd.Timestamp("2024-10-18 12:00:00") + pd.to_timedelta(whole["time"], unit="s"))
    dated.to_parquet(tmp_path / "a.parquet", index=False)
    dated.to_csv(tmp_path / "a.csv", index=False, date_format="%Y-%m-%dT%H:%M:%S.%fZ")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    lines[100] = "noon" + lines[100][lines[100].index(",") :]
    (tmp_path / "b.csv").write_text("\n".join(lines))
    assert "line 101, column 'time': 'noon'" in refused(lambda: read_log(tmp_path / "b.csv"))
    whole.assign(time=whole["time"] + 1.7e9).to_csv(tmp_path / "c.csv", index=False)
    for name in ("a.parquet", "a.csv", "c.csv"):
        log = read_log(tmp_path / name)
        np.testing.assert_allclose(log.samples.time, whole["time"], atol=3e-7)
    assert "the clock starts at 1700000000.000 s" in " ".join(log.quality.notes)


def test_a_delay_is_taken_out(tmp_path):
    samples = strokes(3000)
    late = np.interp(samples.time - 0.005, samples.time, samples["position"])
    columns = {**samples.columns, "position": late}
    pd.DataFrame({"time": samples.time, **columns}).to_parquet(tmp_path / "a.parquet")
    entries = {c: f"{{column: {c}}}" for c in ("time", *samples.channels)}
    entries["position"] = "{column: position, delay: 0.005}"
    (tmp_path / "map.yaml").write_text("".join(f"{c}: {entry}\n" for c, entry in entries.items()))
    read = read_log(tmp_path / "a.parquet", tmp_path / "map.yaml").samples
    np.testing.assert_allclose(read["position"][:-5], samples["position"][:-5], atol=1e-9)


@given(st.lists(st.integers(-2047, 2047), min_size=1, max_size=50), st.sets(st.integers(0, 49)))
def test_unwrapping_gives_counts_back(steps, missing):
    """An encoder of 4096 counts, rows missing between small steps."""
    small = [s // 8 for s in steps] if missing else steps
    true = 100.0 + np.cumsum([0, *small])
    raw = np.mod(true, 4096.0)
    for row in missing:
        # Two missing rows in a row stay below half a turn: 3 * 255 counts.
        if 0 < row < raw.size - 1 and not np.isnan(raw[row - 1]) and not np.isnan(raw[row + 1]):
            raw[row] = np.nan
    out = unwrap_counts(raw, 4096.0)
    there = np.isfinite(raw)
    np.testing.assert_array_equal(out[there] - out[0], true[there] - true[0])
    assert np.isnan(out[~there]).all()


def test_count_differences_add_up_with_missing_rows_bridged_but_not_over_a_long_gap():
    """Speed as count difference per nominal millisecond, rows missing, stamps late, constant speed."""
    rng = np.random.default_rng(3)
    count = 9.587e-5
    counts = np.cumsum(np.full(20_000, 7))
    speed = np.diff(counts, prepend=counts[0] - 7) * count / 1e-3
    time = np.arange(20_000) * 1e-3
    late = rng.choice(np.arange(10, 19_990, 7), 20, replace=False)
    time[late] += rng.uniform(1e-4, 9e-4, 20)
    dropped = rng.choice(np.arange(1, 19_999), 40, replace=False)
    dropped = np.setdiff1d(dropped, np.concatenate([late - 1, late, late + 1]))
    keep = np.setdiff1d(np.arange(20_000), dropped)
    angle = accumulate_speed(time[keep], speed[keep], 1e-3)
    np.testing.assert_allclose(angle, (counts[keep] - counts[0]) * count, atol=1e-9)
    time, speed = np.arange(1000) * 1e-3, np.linspace(0.0, 50.0, 1000)
    whole = accumulate_speed(time, speed, 1e-3)
    keep = np.setdiff1d(np.arange(1000), np.r_[300:308, 500])
    gone = accumulate_speed(time[keep], speed[keep], 1e-3)
    np.testing.assert_allclose(gone, whole[keep], atol=1e-12)
    missing = speed.copy()
    missing[np.r_[300:308, 500]] = np.nan
    bridged = accumulate_speed(time, missing, 1e-3)
    np.testing.assert_allclose(bridged[keep], whole[keep], atol=1e-12)
    assert np.isnan(bridged[305])
    time = np.array([0.0, 0.001, 5.0, 5.001])
    angle = accumulate_speed(time, np.full(4, 100.0), 1e-3)
    np.testing.assert_allclose(angle, [0.0, 0.1, 0.2, 0.3])
    assert np.isnan(accumulate_speed(time, np.full(4, np.nan), 1e-3)).all()


steps_and_valves = st.tuples(st.integers(-5, 5), st.sampled_from([-1000.0, 0.0, 1000.0]))


@given(st.lists(steps_and_valves, min_size=1, max_size=40))
def test_a_valve_gives_each_step_its_sign(rows):
    steps, valve = (np.array(c, dtype=float) for c in zip(*rows, strict=True))
    raw = np.cumsum(steps)
    expected, at = [raw[0]], raw[0]
    for k in range(1, raw.size):
        at += steps[k] * (valve[k] > 0) - steps[k] * (valve[k] < 0)
        expected.append(at)
    np.testing.assert_array_equal(directed(raw, valve, accumulate=True), expected)
    np.testing.assert_array_equal(directed(raw, valve, accumulate=False), raw * np.sign(valve))


def test_an_unknown_valve_keeps_its_last_direction_and_before_the_first_tells_none():
    valve = np.array([np.nan, 1.0, np.nan, -1.0, np.nan])
    np.testing.assert_array_equal(directed(np.full(5, 2.0), valve, accumulate=False), [np.nan, 2, 2, -2, -2])


@given(
    st.lists(st.integers(1, 4), min_size=2, max_size=60),
    st.lists(st.floats(-0.5, 0.5), min_size=60, max_size=60),
    st.floats(-1e-4, 1e-4),
)
def test_late_stamps_neither_lose_nor_make_rows(gaps, late, drift):
    """Rows on a grid with gaps, every third late or early by up to half a period; a clock that drifts."""
    wanted = np.concatenate(([0], np.cumsum(gaps)))
    lateness = np.array([0.0 if k % 3 else late[k % 60] for k in range(wanted.size)])
    lateness[0] = 0.0
    numbers = sample_numbers((1.0 + drift) * wanted + 0.95 * lateness, 1.0)
    on_time = lateness == 0.0
    np.testing.assert_array_equal(np.diff(numbers[on_time]), np.diff(wanted[on_time]))
