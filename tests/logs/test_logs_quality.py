"""What is missing or odd is counted and told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_up_logs import refused, strokes
from mcap.writer import Writer

from fdd.logs import ChannelMap, DataQuality, Log, read_log
from fdd.logs.stamps import ordered_time


def read_frame(folder: Path, frame: pd.DataFrame) -> Log:
    frame.to_parquet(folder / "a.parquet", index=False)
    return read_log(folder / "a.parquet")


def frame(n: int = 8000) -> pd.DataFrame:
    samples = strokes(n)
    return pd.DataFrame({"time": samples.time, **samples.columns})


def noted(quality: DataQuality, *parts: str) -> None:
    assert any(all(p in note for p in parts) for note in quality.notes), quality.notes


def test_a_clean_log_has_nothing_to_note(tmp_path: Path) -> None:
    quality = read_frame(tmp_path, frame()).quality
    assert quality == DataQuality(period=0.001)


def test_missing_rows_gaps_and_nan_are_counted(tmp_path: Path) -> None:
    odd = frame()
    odd.loc[100:119, "pressure_1"] = np.nan
    odd.loc[110:129, "position"] = np.nan
    odd = odd.drop(index=[7, 8, 500, *range(2000, 2050)])
    quality = read_frame(tmp_path, odd).quality
    assert quality.dropped_samples == 53
    assert quality.nan_samples == 30
    assert quality.time_jumps == 1
    noted(quality, "53 rows are missing")
    noted(quality, "time jumps 1 times", "0.051 s", "t=1.999 s")
    noted(quality, "pressure_1: 20 values")
    noted(quality, "position: 20 values")


def test_an_hour_without_data_is_a_jump_not_a_million_rows(tmp_path: Path) -> None:
    odd = frame()
    odd.loc[4000:, "time"] += 3600.0
    quality = read_frame(tmp_path, odd).quality
    assert (quality.dropped_samples, quality.time_jumps) == (0, 1)


def test_late_stamps_are_noted_and_are_no_missing_rows(tmp_path: Path) -> None:
    odd = frame()
    odd.loc[[100, 2000, 3000], "time"] += 0.0007
    quality = read_frame(tmp_path, odd).quality
    assert quality.dropped_samples == 0
    noted(quality, "6 steps of time are uneven")


def test_a_stamp_later_than_the_next_goes_between_its_neighbours(tmp_path: Path) -> None:
    odd = frame()
    odd.loc[100, "time"] += 0.0013
    log = read_frame(tmp_path, odd)
    np.testing.assert_allclose(log.samples.time, np.arange(8000) * 1e-3, atol=1e-12)
    noted(log.quality, "1 late time stamps")


def test_repeated_rows_and_rows_without_time_are_left_out(tmp_path: Path) -> None:
    odd = pd.concat([frame()[:10], frame()[9:]])
    log = read_frame(tmp_path, odd)
    assert len(log.samples) == 8000
    noted(log.quality, "1 rows repeat")
    lost = frame()
    lost.loc[5, "time"] = np.nan
    log = read_frame(tmp_path, lost)
    assert len(log.samples) == 7999
    noted(log.quality, "1 rows without a time stamp")


def test_infinite_and_empty_channels(tmp_path: Path) -> None:
    odd = frame().assign(motor_current=np.nan)
    odd.loc[3, "position"] = np.inf
    log = read_frame(tmp_path, odd)
    assert np.isnan(log.samples["position"][3]) and "motor_current" not in log.samples
    noted(log.quality, "position: 1 infinite")
    noted(log.quality, "motor_current: no value at all")


def test_standstill_and_stuck_sensors(tmp_path: Path) -> None:
    still = frame().assign(position=0.1, pump_angle=0.0, pump_speed=0.0)
    noted(read_frame(tmp_path, still).quality, "standstill")
    stuck = frame()
    stuck.loc[1000:7000, "pressure_2"] = 4.2e5
    quality = read_frame(tmp_path, stuck).quality
    noted(quality, "pressure_2", "exactly 420000 Pa for 6.0 s", "t=1.0 s")
    assert not any("standstill" in n for n in quality.notes)


def test_impossible_angle_steps_and_a_speed_in_rpm(tmp_path: Path) -> None:
    odd = frame()
    odd.loc[5000:, "pump_angle"] += 3.0
    noted(read_frame(tmp_path, odd).quality, "1 steps of impossible speed", "300")
    rpm = frame()
    rpm["pump_speed"] *= 30.0 / np.pi
    noted(read_frame(tmp_path, rpm).quality, "pump_speed is 9.55 times")


@pytest.mark.parametrize("hole", [20.0, 1e6])
def test_a_hole_in_the_log_makes_no_speed_wrong(tmp_path: Path, hole: float) -> None:
    odd = frame()
    fastest = int(odd["pump_speed"].abs().to_numpy().argmax())
    odd.loc[fastest:, "time"] += hole
    notes = read_frame(tmp_path, odd).quality.notes
    assert any("time jumps 1 times" in n if hole < 1e4 else "stands still" in n for n in notes)
    assert not any("pump_speed" in n for n in notes), notes
    odd["pump_speed"] *= 30.0 / np.pi
    noted(read_frame(tmp_path, odd).quality, "pump_speed is 9.55 times")


def test_speeds_are_compared_where_the_pump_is_sampled_seldom(tmp_path: Path) -> None:
    seldom = frame()
    seldom.loc[np.arange(8000) % 20 != 0, ["pump_angle", "pump_speed"]] = np.nan
    assert not any("times the rate" in n for n in read_frame(tmp_path, seldom).quality.notes)
    seldom["pump_speed"] *= 2.0
    noted(read_frame(tmp_path, seldom).quality, "pump_speed is 2 times")


def test_what_is_absent_is_derived_from_what_is_there(tmp_path: Path) -> None:
    bare = frame()[["time", "position", "pump_speed", "pressure_1", "pressure_2"]]
    samples = read_frame(tmp_path, bare).samples
    truth = strokes(8000)
    np.testing.assert_allclose(samples["pressure_difference"], truth["pressure_difference"], atol=1e-9)
    np.testing.assert_allclose(samples["pump_angle"], truth["pump_angle"] - truth["pump_angle"][0], atol=1e-9)


def test_a_drained_accumulator_is_a_fault_and_no_wrong_unit(tmp_path: Path) -> None:
    drained = frame().assign(pressure_accumulator=50.0 + np.arange(8000) % 3)
    assert "pressure_accumulator" in read_frame(tmp_path, drained).samples


def test_backwards_time_names_the_row() -> None:
    time = np.concatenate([np.arange(10.0), np.arange(5.0)])
    assert "at row 10: 0.000000 s after 9.000000 s" in refused(lambda: ordered_time(time))


def test_a_slower_topic_has_values_when_they_come(tmp_path: Path) -> None:
    """Test: oil at 2 Hz from 0.4 s to 5 s. Expected: these ten values and none between."""
    samples = strokes(12_000)
    start = 1_700_000_000 * 10**9
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        daq = writer.register_channel("/rig/daq", "json", 0)
        oil = writer.register_channel("/rig/oil", "json", 0)
        for second in np.arange(0.4, 5.0, 0.5):
            # Written first: the order of the file is not the order of time.
            writer.add_message(
                oil, start + round(second * 1e9), json.dumps({"K": 313.15 + second}).encode(), 0
            )
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


def through(tmp_path: Path, columns: dict[str, np.ndarray], time: np.ndarray) -> Log:
    pd.DataFrame({"time": time, **columns}).to_parquet(tmp_path / "a.parquet", index=False)
    return read_log(tmp_path / "a.parquet")


def test_channels_that_take_turns_meet(tmp_path: Path) -> None:
    """Test: pressures every fifth row, the position every fifth row too, never in the same.

    Expected: rows at their rate with all of them, some between their measurements.
    """
    samples = strokes(8000)
    columns = {n: v.copy() for n, v in samples.columns.items() if n != "pressure_difference"}
    row = np.arange(8000)
    for name in ("pressure_1", "pressure_2"):
        columns[name][row % 5 != 0] = np.nan
    columns["position"][row % 5 != 2] = np.nan
    log = through(tmp_path, columns, samples.time)
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
    """Test: a log at 500 Hz that was exported at 1 kHz. Expected: the 500 Hz log."""
    samples = strokes(8000)
    fresh, time = samples.time[::2], samples.time
    columns = {}
    for name, values in samples.columns.items():
        held = values[(np.arange(8000) // 2) * 2]
        columns[name] = held if how == "held" else np.interp(time, fresh, values[::2])
    log = through(tmp_path, columns, time)
    assert log.quality.period == pytest.approx(0.002) and len(log.samples) == pytest.approx(4000, abs=2)
    shared = np.isin(np.round(fresh, 6), np.round(log.samples.time, 6))
    assert shared.sum() > 3990
    read = np.isin(np.round(log.samples.time, 6), np.round(fresh, 6))
    for name in ("position", "pressure_1"):
        np.testing.assert_allclose(log.samples[name][read], samples[name][::2][shared], rtol=1e-9, atol=1e-12)


def test_rows_that_hold_a_speed_alone_are_left_out(tmp_path: Path) -> None:
    """Test: 500 Hz on rows of 1 kHz, the speed but for its rounding held. Expected: the 500 Hz log."""
    samples, rng = strokes(8000), np.random.default_rng(3)
    columns = {n: np.interp(samples.time, samples.time[::2], v[::2]) for n, v in samples.columns.items()}
    columns["pump_speed"] = samples["pump_speed"] * (1.0 + 1e-14 * rng.normal(size=8000))
    log = through(tmp_path, columns, samples.time)
    assert log.quality.period == pytest.approx(0.002)
    assert np.isfinite(log.samples["position"]).mean() > 0.99
    np.testing.assert_allclose(np.interp(log.samples.time, samples.time, columns["pump_speed"]),
                               log.samples["pump_speed"], rtol=1e-9, atol=1e-9)  # fmt: skip


def test_packets_of_rows_with_one_stamp_are_spread(tmp_path: Path) -> None:
    odd = frame()
    odd["time"] = np.floor(np.arange(8000) / 10) * 0.01
    log = read_frame(tmp_path, odd)
    np.testing.assert_allclose(log.samples.time, np.arange(8000) * 1e-3, atol=1e-9)
    noted(log.quality, "packets of 10 rows")
