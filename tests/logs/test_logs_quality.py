"""Unusable logs are refused in one line with place, problem and mend; what is odd is counted and told."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_up_logs import assert_same, frame, mcap_of, refused_log, strokes
from mcap.writer import Writer

from fdd.logs import ChannelMap, DataQuality, Log, read_log
from fdd.logs.mcap_writing import RunBlock, write_blocks, write_run
from fdd.logs.tabular_writing import write_table
from fdd.samples import Samples


def scaled(columns: list[str], factor: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda f: f.assign(**{c: f[c] * factor for c in columns})


def back_one_second(f: pd.DataFrame) -> pd.DataFrame:
    return f.assign(time=np.where(np.arange(len(f)) >= 3000, f["time"] - 1.0, f["time"]))


PRESSURES = ["pressure_difference", "pressure_1", "pressure_2"]
UNUSABLE = {
    "clock reset": (back_one_second, ["time runs backwards", "2.000000 s after 2.999000 s", "sort the log"]),
    "one second": (lambda f: f[:1000], ["a log of 1 s (1000 rows)", "at least 5 s"]),
    "one row": (lambda f: f[:1], ["too short"]),
    "no position": (lambda f: f.drop(columns="position"), ["missing channels: position"]),
    "no pump": (lambda f: f.drop(columns=["pump_angle", "pump_speed"]), ["pump_angle (or pump_speed)"]),
    "one chamber": (
        lambda f: f.drop(columns=["pressure_difference", "pressure_2"]), ["pressure_1 and pressure_2"],
    ),
    "all NaN": (lambda f: f.assign(position=np.nan), ["position", "without a single value"]),
    "no rows": (lambda f: f[:0], ["no rows"]),
    "text": (lambda f: f.assign(position="a"), ["'position' holds text"]),
    "bar": (scaled(PRESSURES, 1e-5), ["pressures look like bar", "unit: bar"]),
    "only Δp in bar": (
        lambda f: scaled(PRESSURES, 1e-5)(f).drop(columns=["pressure_1", "pressure_2"]), ["look like bar"],
    ),
    "pressures too large": (scaled(PRESSURES, 1e5), ["more than any hydraulic circuit"]),
    "mm": (lambda f: f.assign(position=f["position"] * 1e3 + 50), ["position", "looks like mm"]),
    "kelvin": (lambda f: f.assign(oil_temperature=313.0), ["looks like kelvin"]),
    "no time": (lambda f: f.drop(columns="time"), ["no column 'time'", "--map"]),
    "foreign columns": (
        lambda f: f.rename(columns=lambda c: f"x_{c}"), ["no usable channels", "x_position", "--map"],
    ),
    "no stamp at all": (lambda f: f.assign(time=np.nan), ["time: no value"]),
}  # fmt: skip


@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_content(case, tmp_path):
    change, said = UNUSABLE[case]
    change(frame()).to_parquet(tmp_path / "log.parquet", index=False)
    line = refused_log(tmp_path / "log.parquet")
    assert [part for part in said if part not in line] == [], line


@pytest.mark.parametrize(
    ("columns", "factor", "said", "words"),
    [
        (PRESSURES, 1e-5, "kPa", ["look like bar", " kPa)", "give unit: bar"]),
        (PRESSURES, 1e-8, "bar", ["no pressures of a cylinder", " bar)", "correct its scale or unit"]),
        (PRESSURES, 1.0, "bar", ["e+05 bar", "give unit: Pa"]),
        (["position"], 1e3, "cm", [" cm, looks like mm", "give unit: mm"]),
    ],
)
def test_a_hint_tells_the_numbers_that_were_written(columns, factor, said, words, tmp_path):
    content = scaled(columns, factor)(frame())
    content["position"] += 2.0 * factor if columns == ["position"] else 0.0
    content.to_csv(tmp_path / "log.csv", index=False)
    units = {c: f"{{column: {c}{f', unit: {said}' if c in columns else ''}}}" for c in content}
    (tmp_path / "map.yaml").write_text("".join(f"{c}: {entry}\n" for c, entry in units.items()))
    line = refused_log(tmp_path / "log.csv", map=tmp_path / "map.yaml")
    assert [part for part in words if part not in line] == [], line


def test_the_place_of_a_backwards_clock_is_told_and_a_last_line_cut_in_the_middle_forgiven(tmp_path):
    back_one_second(frame()).to_csv(tmp_path / "a.csv", index=False)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[3001].startswith("2.0,")  # the 3002nd line
    assert "at line 3002" in refused_log(tmp_path / "a.csv")
    text = frame().to_csv(index=False)
    (tmp_path / "a.csv").write_text(text[: text.rindex(",") - 30])
    log = read_log(tmp_path / "a.csv")
    assert len(log.samples) == 5999
    assert "incomplete" in log.quality.notes[0] and "line 6001" in log.quality.notes[0]
    assert "no such file" in refused_log(tmp_path / "none.csv")
    assert "is a folder" in refused_log(tmp_path)


HEADER = b"time,position,pump_angle,pressure_difference\n"
NO_LOGS: dict[str, tuple[str, bytes, list[str]]] = {
    "empty": ("a.csv", b"", ["the file is empty"]),
    "blank": ("a.csv", b"\n\n\n", ["no header row"]),
    "header only": ("a.csv", HEADER, ["no rows"]),
    "no header": ("a.csv", b"0.0,1.0,2.0\n0.001,1.0,2.0\n", ["line 1", "no header row"]),
    "text": ("a.csv", HEADER + b"0,1,1,1\n0.001,abc,1,1\n", ["line 3", "'position'", "'abc'"]),
    "short row": ("a.csv", HEADER + b"0,1,1,1\n1,2\n2,1,1,1\n", ["line 3", "2 cells", "4"]),
    "twice": ("a.csv", HEADER.replace(b"pump_angle", b"position") + b"0,1,1,1\n", ["'position'", "twice"]),
    "prose": ("a.csv", b"Dear all, please find the log.\nRegards\n", ["no rows of numbers below a header"]),
    "damaged gzip": ("a.csv", b"\x1f\x8b\x08rest", ["damaged gzip file"]),
    "bytes": ("a.csv", bytes(range(256)) * 20, ["of no known format"]),
    "no MCAP": ("a.mcap", b"\x89MCAP1\r\nnonsense", ["not an MCAP file"]),
    "empty MCAP": ("a.mcap", b"", ["the file is empty"]),
    "MCAP's head": ("a.mcap", b"\x89MCAP0\r\n", ["cut off before its first message"]),
    "damaged Parquet": ("a.parquet", b"PAR1 and then nothing", ["not readable as Parquet"]),
    "no Parquet": ("a.parquet", b"time,position\n", ["not a Parquet file"]),
}


@pytest.mark.parametrize("case", NO_LOGS)
def test_what_is_no_log_at_all(case, tmp_path):
    name, content, said = NO_LOGS[case]
    (tmp_path / name).write_bytes(content)
    line = refused_log(tmp_path / name, shortest=0.0)
    assert [part for part in said if part not in line] == [], line


GOOD = [b'{"cyl": {"pos": 1.5}}'] * 9
MAP = ChannelMap.from_yaml("position: {topic: /daq, field: cyl.pos, unit: mm}")


def test_mcap_messages_that_are_not_what_the_map_says(tmp_path):
    path = mcap_of(tmp_path / "a.mcap", GOOD)
    assert "--map" in refused_log(path)
    line = refused_log(path, ChannelMap.from_yaml("position: {topic: /dap, field: cyl.pos}"))
    assert "no topic /dap (did you mean '/daq'?)" in line and "the file has: /daq" in line
    line = refused_log(path, ChannelMap.from_yaml("position: {topic: /daq, field: cyl.poss}"))
    assert "no field 'cyl.poss' (did you mean 'cyl.pos'?)" in line
    assert "no message on topic /daq" in refused_log(mcap_of(path, [], use_chunking=False), MAP)
    assert "protobuf" in refused_log(mcap_of(path, GOOD, encoding="protobuf"), MAP)
    for odd in (b"{half", b"1,2", b"[1, 2]"):
        assert f"not a JSON object: {odd!r}" in refused_log(mcap_of(path, [*GOOD, odd]), MAP)
    assert "'x' is not a number" in refused_log(mcap_of(path, [*GOOD, b'{"cyl": {"pos": "x"}}']), MAP)
    assert "not a number" in refused_log(mcap_of(path, [b'{"cyl": {"pos": [1, 2]}}'] * 3), MAP)
    assert "not a JSON object" in refused_log(mcap_of(path, [b"[" * 100_000]), MAP)


def test_axes_must_be_chosen_and_maps_be_of_the_files_kind(tmp_path):
    path, axes = tmp_path / "a.mcap", {"left": strokes(3000, seed=1), "right": strokes(3000, seed=2)}
    blocks = [RunBlock(samples, None, axis) for axis, samples in axes.items()]
    write_blocks(path, blocks, axes=list(axes), units={axis: f"of {axis}" for axis in axes})
    assert "2 axes: left, right; choose one with --axis" in refused_log(path)
    assert "the file has: left, right" in refused_log(path, None, "middle")
    for axis, samples in axes.items():
        log = read_log(path, axis=axis)
        assert_same(log, samples)
        assert (log.axis, log.metadata["unit"]["yaml"]) == (axis, f"of {axis}")
    columns = ChannelMap.from_yaml("time: {column: t}\nposition: {column: x}")
    write_run(tmp_path / "a.mcap", strokes(3000), axis="a")
    assert "map names columns" in refused_log(tmp_path / "a.mcap", columns)
    write_table(tmp_path / "a.csv", strokes(3000))
    assert "map names topics" in refused_log(tmp_path / "a.csv", MAP)
    other = ChannelMap.from_yaml("time: {column: Time}\nposition: {column: pos}")
    line = refused_log(tmp_path / "a.csv", other)
    assert "no column 'Time' (did you mean 'time'?)" in line and "the file has: time, command" in line


def read_frame(folder: Path, frame: pd.DataFrame) -> Log:
    frame.to_parquet(folder / "a.parquet", index=False)
    return read_log(folder / "a.parquet")


def read_columns(folder: Path, samples: Samples, columns: dict[str, np.ndarray]) -> Log:
    return read_frame(folder, pd.DataFrame({"time": samples.time, **columns}))


def put(*cells: tuple[object, str, object]) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(whole: pd.DataFrame) -> pd.DataFrame:
        for rows, column, value in cells:
            whole.loc[rows, column] = value
        return whole

    return change


def later(rows: object, seconds: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda whole: put((rows, "time", whole.loc[rows, "time"] + seconds))(whole)


GAPS = put((slice(100, 119), "pressure_1", np.nan), (slice(110, 129), "position", np.nan))
ODD = {
    "nothing": (lambda whole: whole, (8000, 0, 0, 0), []),
    "rows and values that are missing": (
        lambda whole: GAPS(whole).drop(index=[7, 8, 500, *range(2000, 2050)]), (7947, 53, 30, 1),
        [["53 rows are missing"], ["time jumps 1 times", "0.051 s", "t=1.999 s"], ["pressure_1: 20 values"],
         ["position: 20 values"]],
    ),
    "an hour without data is a jump": (later(slice(4000, None), 3600.0), (8000, 0, 0, 1), [["time jumps 1"]]),
    "five hours without data are cut": (
        later(slice(3000, None), 5 * 3600.0), (5000, 0, 0, 0), [["stands still for more", "3000 rows"]],
    ),
    "late stamps are no missing rows": (
        later([100, 2000, 3000], 0.0007), (8000, 0, 0, 0), [["6 steps of time are uneven"]],
    ),
    "a stamp later than the next": (later(100, 0.0013), (8000, 0, 0, 0), [["1 late time stamps"]]),
    "a row that comes twice": (
        lambda whole: pd.concat([whole[:10], whole[9:]]), (8000, 0, 0, 0), [["1 rows repeat"]],
    ),
    "no stamp": (put((5, "time", np.nan)), (7999, 1, 0, 0), [["1 rows without a time stamp"]]),
    "infinite and empty": (
        lambda whole: put((3, "position", np.inf))(whole.assign(motor_current=np.nan)), (8000, 0, 1, 0),
        [["position: 1 infinite"], ["motor_current: no value at all"]],
    ),
    "packets": (
        lambda whole: whole.assign(time=np.floor(np.arange(8000) / 10) * 0.01), (8000, 0, 0, 0),
        [["packets of 10 rows"]],
    ),
}  # fmt: skip
"""What is changed; rows, dropped, NaN and jumps that are counted; parts of notes."""


@pytest.mark.parametrize("what", ODD)
def test_what_is_odd_is_counted_and_told(what, tmp_path):
    change, counted, notes = ODD[what]
    log = read_frame(tmp_path, change(frame(8000)))
    q = log.quality
    assert (len(log.samples), q.dropped_samples, q.nan_samples, q.time_jumps) == counted
    assert notes or q == DataQuality(period=0.001)
    for parts in notes:
        assert any(all(p in note for p in parts) for note in q.notes), q.notes
    if what in ("packets", "a stamp later than the next"):
        np.testing.assert_allclose(log.samples.time, np.arange(8000) * 1e-3, atol=1e-9)


def test_what_is_absent_is_derived_and_a_drained_accumulator_is_no_wrong_unit(tmp_path):
    bare = frame(8000)[["time", "position", "pump_speed", "pressure_1", "pressure_2"]]
    samples = read_frame(tmp_path, bare).samples
    truth = strokes(8000)
    np.testing.assert_allclose(samples["pressure_difference"], truth["pressure_difference"], atol=1e-9)
    np.testing.assert_allclose(samples["pump_angle"], truth["pump_angle"] - truth["pump_angle"][0], atol=1e-9)
    drained = frame(8000).assign(pressure_accumulator=50.0 + np.arange(8000) % 3)
    assert "pressure_accumulator" in read_frame(tmp_path, drained).samples


def test_a_slower_topic_has_values_when_they_come(tmp_path):
    """Oil at 2 Hz from 0.4 s to 5 s: these ten values and none between."""
    samples = strokes(12_000)
    start = 1_700_000_000 * 10**9
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        daq = writer.register_channel("/rig/daq", "json", 0)
        oil = writer.register_channel("/rig/oil", "json", 0)
        for second in np.arange(0.4, 5.0, 0.5):
            # Written first: the order of the file is not the order of time.
            message = {"K": 313.15 + second}
            writer.add_message(oil, start + round(second * 1e9), json.dumps(message).encode(), 0)
        for k in range(12_000):
            message = {"x": samples["position"][k], "w": samples["pump_speed"][k], "p": {"d": 1e3 + k % 9}}
            writer.add_message(daq, start + k * 10**6, json.dumps(message).encode(), 0)
        writer.finish()
    channel_map = ChannelMap.from_yaml(
        "position: {topic: /rig/daq, field: x}\npump_speed: {topic: /rig/daq, field: w}\n"
        "pressure_difference: {topic: /rig/daq, field: p.d, unit: kPa}\n"
        "oil_temperature: {topic: /rig/oil, field: K, unit: K}\n"
    )
    log = read_log(tmp_path / "a.mcap", channel_map)
    oil_read = log.samples["oil_temperature"]
    np.testing.assert_allclose(log.samples.time, samples.time, atol=1e-12)
    came = np.flatnonzero(np.isfinite(oil_read))
    np.testing.assert_array_equal(came, 400 + 500 * np.arange(10))
    np.testing.assert_allclose(oil_read[came], 40.4 + 0.5 * np.arange(10))
    assert log.quality.nan_samples == 0
    assert log.start_ns == start


def test_channels_that_take_turns_meet(tmp_path):
    """Pressures every fifth row, the position every fifth row too, never in the same: rows at their rate."""
    samples = strokes(8000)
    columns = {n: v.copy() for n, v in samples.columns.items() if n != "pressure_difference"}
    row = np.arange(8000)
    for name in ("pressure_1", "pressure_2"):
        columns[name][row % 5 != 0] = np.nan
    columns["position"][row % 5 != 2] = np.nan
    log = read_columns(tmp_path, samples, columns)
    at = np.flatnonzero(np.isin(np.round(samples.time, 6), np.round(log.samples.time, 6)))
    np.testing.assert_array_equal(at, row[row % 5 == at[0] % 5])
    inner = slice(10, -10)
    np.testing.assert_allclose(log.samples["position"][inner], samples["position"][at][inner], atol=2e-6)
    assert np.isfinite(log.samples["pressure_difference"][inner]).all()
    bound = np.abs(np.diff(samples["pump_angle"])).max()
    turned = log.samples["pump_angle"] - log.samples["pump_angle"][0]
    np.testing.assert_allclose(turned, samples["pump_angle"][at] - samples["pump_angle"][at[0]], atol=bound)


@pytest.mark.parametrize("how", ["held", "interpolated"])
def test_rows_that_were_made_up_are_taken_out(how, tmp_path):
    """A log at 500 Hz that was exported at 1 kHz is read as the 500 Hz log."""
    samples = strokes(8000)
    fresh = samples.time[::2]
    columns = {}
    for name, values in samples.columns.items():
        held = np.repeat(values[::2], 2)
        columns[name] = held if how == "held" else np.interp(samples.time, fresh, values[::2])
    log = read_columns(tmp_path, samples, columns)
    assert log.quality.period == pytest.approx(0.002) and len(log.samples) == pytest.approx(4000, abs=2)
    shared = np.isin(np.round(fresh, 6), np.round(log.samples.time, 6))
    assert shared.sum() > 3990
    read = np.isin(np.round(log.samples.time, 6), np.round(fresh, 6))
    for name in ("position", "pressure_1"):
        np.testing.assert_allclose(log.samples[name][read], samples[name][::2][shared], rtol=1e-9, atol=1e-12)


def test_rows_that_hold_a_speed_alone_are_left_out(tmp_path):
    """500 Hz on rows of 1 kHz, the speed but for its rounding held, are read as the 500 Hz log."""
    samples, rng = strokes(8000), np.random.default_rng(3)
    columns = {n: np.interp(samples.time, samples.time[::2], v[::2]) for n, v in samples.columns.items()}
    columns["pump_speed"] = samples["pump_speed"] * (1.0 + 1e-14 * rng.normal(size=8000))
    read = read_columns(tmp_path, samples, columns)
    assert read.quality.period == pytest.approx(0.002)
    assert np.isfinite(read.samples["position"]).mean() > 0.99
    speed = np.interp(read.samples.time, samples.time, columns["pump_speed"])
    np.testing.assert_allclose(speed, read.samples["pump_speed"], rtol=1e-9, atol=1e-9)
