"""Unusable logs: each is refused with one line that names the place, the problem and the mend."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_up_logs import assert_same, frame, mcap_of, refused_log, strokes

from fdd.logs import ChannelMap, read_log
from fdd.logs.mcap_writing import RunBlock, write_blocks, write_run
from fdd.logs.tabular_writing import write_csv

Frame = pd.DataFrame


def scaled(columns: list[str], factor: float) -> Callable[[Frame], Frame]:
    return lambda f: f.assign(**{c: f[c] * factor for c in columns})


def back_one_second(f: Frame) -> Frame:
    return f.assign(time=np.where(np.arange(len(f)) >= 3000, f["time"] - 1.0, f["time"]))


PRESSURES = ["pressure_difference", "pressure_1", "pressure_2"]
UNUSABLE: dict[str, tuple[Callable[[Frame], Frame], list[str]]] = {
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
def test_unusable_content(case: str, tmp_path: Path) -> None:
    change, said = UNUSABLE[case]
    change(frame()).to_parquet(tmp_path / "log.parquet", index=False)
    line = refused_log(tmp_path / "log.parquet")
    for part in said:
        assert part in line, line


@pytest.mark.parametrize(
    ("columns", "factor", "said", "words"),
    [
        (PRESSURES, 1e-5, "kPa", ["look like bar", " kPa)", "give unit: bar"]),
        (PRESSURES, 1e-8, "bar", ["no pressures of a cylinder", " bar)", "correct its scale or unit"]),
        (PRESSURES, 1.0, "bar", ["e+05 bar", "give unit: Pa"]),
        (["position"], 1e3, "cm", [" cm, looks like mm", "give unit: mm"]),
    ],
)
def test_a_hint_tells_the_numbers_that_were_written(
    columns: list[str], factor: float, said: str, words: list[str], tmp_path: Path
) -> None:
    content = scaled(columns, factor)(frame())
    content["position"] += 2.0 * factor if columns == ["position"] else 0.0
    content.to_csv(tmp_path / "log.csv", index=False)
    units = {c: f"{{column: {c}{f', unit: {said}' if c in columns else ''}}}" for c in content}
    (tmp_path / "map.yaml").write_text("".join(f"{c}: {entry}\n" for c, entry in units.items()))
    line = refused_log(tmp_path / "log.csv", map=tmp_path / "map.yaml")
    for part in words:
        assert part in line, line


def test_the_place_of_a_backwards_clock(tmp_path: Path) -> None:
    back_one_second(frame()).to_csv(tmp_path / "a.csv", index=False)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[3001].startswith("2.0,")  # the 3002nd line
    assert "at line 3002" in refused_log(tmp_path / "a.csv")


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
def test_what_is_no_log_at_all(case: str, tmp_path: Path) -> None:
    name, content, said = NO_LOGS[case]
    (tmp_path / name).write_bytes(content)
    line = refused_log(tmp_path / name, shortest=0.0)
    for part in said:
        assert part in line, line


def test_no_file_and_a_folder(tmp_path: Path) -> None:
    assert "no such file" in refused_log(tmp_path / "none.csv")
    assert "is a folder" in refused_log(tmp_path)


def test_a_last_line_cut_in_the_middle_is_forgiven(tmp_path: Path) -> None:
    text = frame().to_csv(index=False)
    (tmp_path / "a.csv").write_text(text[: text.rindex(",") - 30])
    log = read_log(tmp_path / "a.csv")
    assert len(log.samples) == 5999
    assert "incomplete" in log.quality.notes[0] and "line 6001" in log.quality.notes[0]


GOOD = [b'{"cyl": {"pos": 1.5}}'] * 9
MAP = ChannelMap.from_yaml("position: {topic: /daq, field: cyl.pos, unit: mm}")


def test_mcap_messages_that_are_not_what_the_map_says(tmp_path: Path) -> None:
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


def test_several_axes_must_be_chosen_from(tmp_path: Path) -> None:
    path, axes = tmp_path / "a.mcap", {"left": strokes(3000, seed=1), "right": strokes(3000, seed=2)}
    blocks = [RunBlock(samples, None, axis) for axis, samples in axes.items()]
    write_blocks(path, blocks, axes=list(axes), units={axis: f"of {axis}" for axis in axes})
    assert "2 axes: left, right; choose one with --axis" in refused_log(path)
    assert "the file has: left, right" in refused_log(path, None, "middle")
    for axis, samples in axes.items():
        log = read_log(path, axis=axis)
        assert_same(log, samples)
        assert (log.axis, log.metadata["unit"]["yaml"]) == (axis, f"of {axis}")


def test_map_and_file_of_different_kinds(tmp_path: Path) -> None:
    columns = ChannelMap.from_yaml("time: {column: t}\nposition: {column: x}")
    write_run(tmp_path / "a.mcap", strokes(3000), axis="a")
    assert "map names columns" in refused_log(tmp_path / "a.mcap", columns)
    write_csv(tmp_path / "a.csv", strokes(3000))
    assert "map names topics" in refused_log(tmp_path / "a.csv", MAP)
    other = ChannelMap.from_yaml("time: {column: Time}\nposition: {column: pos}")
    line = refused_log(tmp_path / "a.csv", other)
    assert "no column 'Time' (did you mean 'time'?)" in line and "the file has: time, command" in line
