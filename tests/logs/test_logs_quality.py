"""What is missing or odd is counted and told."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_up_logs import frame, strokes
from mcap.writer import Writer

from fdd.logs import ChannelMap, DataQuality, Log, read_log
from fdd.samples import Samples


def read_frame(folder: Path, frame: pd.DataFrame) -> Log:
    frame.to_parquet(folder / "a.parquet", index=False)
    return read_log(folder / "a.parquet")


def read_columns(folder: Path, samples: Samples, columns: dict[str, np.ndarray]) -> Log:
    return read_frame(folder, pd.DataFrame({"time": samples.time, **columns}))


def test_a_clean_log_has_nothing_to_note(tmp_path: Path) -> None:
    quality = read_frame(tmp_path, frame(8000)).quality
    assert quality == DataQuality(period=0.001)


Change = Callable[[pd.DataFrame], pd.DataFrame]


def put(*cells: tuple[object, str, object]) -> Change:
    """Rows, column and value of each."""

    def change(whole: pd.DataFrame) -> pd.DataFrame:
        for rows, column, value in cells:
            whole.loc[rows, column] = value
        return whole

    return change


def later(rows: object, seconds: float) -> Change:
    return lambda whole: put((rows, "time", whole.loc[rows, "time"] + seconds))(whole)


GAPS = put((slice(100, 119), "pressure_1", np.nan), (slice(110, 129), "position", np.nan))
ODD: dict[str, tuple[Change, tuple[int, int, int, int], list[list[str]]]] = {
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
def test_what_is_odd_is_counted_and_told(what: str, tmp_path: Path) -> None:
    change, counted, notes = ODD[what]
    log = read_frame(tmp_path, change(frame(8000)))
    q = log.quality
    assert (len(log.samples), q.dropped_samples, q.nan_samples, q.time_jumps) == counted
    for parts in notes:
        assert any(all(p in note for p in parts) for note in q.notes), q.notes
    if what in ("packets", "a stamp later than the next"):
        np.testing.assert_allclose(log.samples.time, np.arange(8000) * 1e-3, atol=1e-9)


def test_what_is_absent_is_derived_from_what_is_there(tmp_path: Path) -> None:
    bare = frame(8000)[["time", "position", "pump_speed", "pressure_1", "pressure_2"]]
    samples = read_frame(tmp_path, bare).samples
    truth = strokes(8000)
    np.testing.assert_allclose(samples["pressure_difference"], truth["pressure_difference"], atol=1e-9)
    np.testing.assert_allclose(samples["pump_angle"], truth["pump_angle"] - truth["pump_angle"][0], atol=1e-9)


def test_a_drained_accumulator_is_a_fault_and_no_wrong_unit(tmp_path: Path) -> None:
    drained = frame(8000).assign(pressure_accumulator=50.0 + np.arange(8000) % 3)
    assert "pressure_accumulator" in read_frame(tmp_path, drained).samples


def test_a_slower_topic_has_values_when_they_come(tmp_path: Path) -> None:
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


def test_channels_that_take_turns_meet(tmp_path: Path) -> None:
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
def test_rows_that_were_made_up_are_taken_out(how: str, tmp_path: Path) -> None:
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


def test_rows_that_hold_a_speed_alone_are_left_out(tmp_path: Path) -> None:
    """500 Hz on rows of 1 kHz, the speed but for its rounding held, are read as the 500 Hz log."""
    samples, rng = strokes(8000), np.random.default_rng(3)
    columns = {n: np.interp(samples.time, samples.time[::2], v[::2]) for n, v in samples.columns.items()}
    columns["pump_speed"] = samples["pump_speed"] * (1.0 + 1e-14 * rng.normal(size=8000))
    read = read_columns(tmp_path, samples, columns)
    assert read.quality.period == pytest.approx(0.002)
    assert np.isfinite(read.samples["position"]).mean() > 0.99
    speed = np.interp(read.samples.time, samples.time, columns["pump_speed"])
    np.testing.assert_allclose(speed, read.samples["pump_speed"], rtol=1e-9, atol=1e-9)
