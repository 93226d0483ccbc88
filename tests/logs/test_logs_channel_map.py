"""Channel maps: both forms, conversions, and what a wrong map is told."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_up_logs import frame, refused, strokes

from fdd.logs import ChannelMap, read_log

LONG = """
schema: fdd.map/1
name: some rig
axis: left
csv: {delimiter: ";", decimal: ",", skip_rows: 2}
channels:
  time: {column: n, unit: ms}
  position: {column: cyl_pos, unit: mm}
"""


def test_long_and_short_form() -> None:
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
def test_a_wrong_map_is_told_where_and_what(text: str, said: list[str], tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(text)
    line = refused(lambda: ChannelMap.load(path))
    assert line.startswith(f"{path}: ")
    for part in said:
        assert part in line, line


def test_every_conversion_of_a_table(tmp_path: Path) -> None:
    """A foreign CSV in other units, checked against figures worked out by hand."""
    n = 3000
    row = np.arange(n)
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


def test_time_of_day_in_a_table_counts_from_the_start(tmp_path: Path) -> None:
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


def test_a_delay_is_taken_out(tmp_path: Path) -> None:
    samples = strokes(3000)
    late = np.interp(samples.time - 0.005, samples.time, samples["position"])
    columns = {**samples.columns, "position": late}
    pd.DataFrame({"time": samples.time, **columns}).to_parquet(tmp_path / "a.parquet")
    entries = {c: f"{{column: {c}}}" for c in ("time", *samples.channels)}
    entries["position"] = "{column: position, delay: 0.005}"
    channel_map = ChannelMap.from_yaml("".join(f"{c}: {entry}\n" for c, entry in entries.items()))
    read = read_log(tmp_path / "a.parquet", channel_map).samples
    np.testing.assert_allclose(read["position"][:-5], samples["position"][:-5], atol=1e-9)
