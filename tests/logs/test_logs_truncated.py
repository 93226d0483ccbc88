"""Cut off and damaged MCAP files: what is whole is read, and nothing but InputError comes out."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_logs import refused_log, strokes
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Header
from mcap.writer import CompressionType, Writer

from fdd.errors import InputError
from fdd.logs import Log, mcap_writing, read_log
from fdd.logs.mcap_writing import write_run

SAMPLES = strokes(2500)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A run in many small chunks, with metadata."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap_writing, "CHUNK_BYTES", 40_000)
        write_run(path, SAMPLES, axis="a", unit_yaml="x: 1", scenario_json="{}")
    return path.read_bytes()


def read_bytes(content: bytes) -> Log | InputError:
    """What `read_log` makes of a file with this content."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(content)
        try:
            return read_log(path, shortest=0.0)
        except InputError as error:
            assert "\n" not in str(error) and str(error).startswith(str(path))
            return error


def assert_prefix(log: Log) -> None:
    n = len(log.samples)
    np.testing.assert_array_equal(log.samples.time, SAMPLES.time[:n])
    for name in SAMPLES.channels:
        np.testing.assert_array_equal(log.samples[name], SAMPLES[name][:n])


@given(share=st.floats(0.0, 1.0, exclude_max=True))
@settings(max_examples=50, deadline=None)
def test_a_file_cut_anywhere_gives_a_prefix_and_a_note(whole: bytes, share: float) -> None:
    read = read_bytes(whole[: int(share * len(whole))])
    if isinstance(read, Log):
        assert_prefix(read)
        assert "truncated: read up to t=" in read.quality.notes[0]
        assert read.metadata["unit"] == {"yaml": "x: 1"}
    else:
        assert share < 0.2
        assert "cut off" in str(read) or "not an MCAP" in str(read) or "is empty" in str(read)


@given(share=st.floats(0.0, 1.0, exclude_max=True), value=st.integers(0, 255))
@settings(max_examples=50, deadline=None)
def test_a_flipped_byte_never_changes_a_value(whole: bytes, share: float, value: int) -> None:
    at = int(share * len(whole))
    read = read_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
    if isinstance(read, Log):
        rows = np.searchsorted(SAMPLES.time, read.samples.time)
        np.testing.assert_array_equal(SAMPLES.time[rows], read.samples.time)
        np.testing.assert_array_equal(SAMPLES["position"][rows], read.samples["position"])
        if len(read.samples) < len(SAMPLES):
            assert read.quality.notes


@pytest.mark.parametrize("how", [*({"compression": c} for c in CompressionType), {"use_chunking": False}])
def test_unfinished_files_of_every_compression(tmp_path: Path, how: dict[str, Any]) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=40_000, **how)
        writer.start()
        channel = writer.register_channel("/eha/a/measurement", "json", 0)
        columns = {"time": SAMPLES.time, **SAMPLES.columns}
        for values in zip(*(v.tolist() for v in columns.values()), strict=True):
            row, stamp = json.dumps(dict(zip(columns, values, strict=True))), int(values[0] * 1e9)
            writer.add_message(channel, stamp, row.encode(), stamp)
        # Never finished: the recorder was switched off.
    log = read_log(path, shortest=0.5)
    assert_prefix(log)
    assert len(log.samples) > 0.8 * len(SAMPLES)
    assert "truncated" in log.quality.notes[0]


def test_a_damaged_chunk_is_left_out_and_told(whole: bytes) -> None:
    middle = len(whole) // 3
    read = read_bytes(whole[:middle] + bytes(64) + whole[middle + 64 :])
    assert isinstance(read, Log)
    assert "damaged chunks" in " ".join(read.quality.notes)
    assert 0.5 * len(SAMPLES) < len(read.samples) < len(SAMPLES)
    assert read.quality.time_jumps == 1


def test_a_bomb_is_bounded(tmp_path: Path) -> None:
    bomb = zstandard.compress(bytes(200_000_000))
    records = RecordBuilder()
    Header(profile="", library="").write(records)
    for size in (2**40, 1000):
        Chunk("zstd", bomb, 0, 0, 0, size).write(records)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + records.end())
    assert "are read" in refused_log(path)
