"""What is written is read back, bit for bit, in whatever blocks; of cut and damaged files what is whole."""

import json
import subprocess
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from made_up_logs import ROWS, A, B, assert_same, parts, refused, refused_log, strokes
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Header
from mcap.writer import CompressionType, Writer

from fdd.errors import InputError
from fdd.logs import Log, mcap_writing, read_log
from fdd.logs.mcap_writing import RunBlock, write_blocks, write_run
from fdd.logs.tabular_writing import write_table, write_tables
from fdd.samples import Samples


@st.composite
def any_samples(draw: st.DrawFn) -> Samples:
    """Plausible magnitudes where the reader judges them, any float elsewhere."""
    n = draw(st.integers(2, 40))

    def column(elements: st.SearchStrategy[float], first: float) -> np.ndarray:
        values = draw(hnp.arrays(np.float64, n, elements=st.one_of(elements, st.just(float("nan")))))
        values[0] = first  # a channel without any value would be taken as absent
        return values

    steps = draw(hnp.arrays(np.float64, n, elements=st.floats(1e-4, 2e-3)))
    columns = {
        "position": column(st.floats(-0.5, 0.5), 0.1),
        "pump_angle": column(st.floats(-1e6, 1e6), 0.0),
        "pressure_difference": column(st.floats(-3e7, 3e7), 1e6),
    }
    for name in draw(st.sets(st.sampled_from(["load_force", "motor_current", "position_setpoint"]))):
        columns[name] = column(st.floats(-1e300, 1e300), 1.0)
    return Samples(np.cumsum(steps), columns)


WRITERS = {"csv": write_table, "parquet": write_table, "mcap": partial(write_run, axis="axis_a")}


@given(any_samples())
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_any_samples_survive_every_format(samples):
    with TemporaryDirectory() as folder:
        for kind, write in WRITERS.items():
            path = Path(folder) / f"run.{kind}"
            write(path, samples)
            log = read_log(path, shortest=0.0)
            assert_same(log, samples)
            assert set(log.samples.channels) == set(samples.channels)
            expected = np.isnan(np.array(list(samples.columns.values()))).any(axis=0).sum()
            assert log.quality.nan_samples == expected


def test_pandas_reads_what_we_write(tmp_path):
    samples = strokes()
    gaps = np.where(np.arange(6000) % 7, samples["pressure_1"], np.nan)
    samples = samples.with_columns({"pressure_1": gaps})
    write_table(tmp_path / "a.csv", samples)
    write_table(tmp_path / "a.parquet", samples)
    for frame in (pd.read_csv(tmp_path / "a.csv", engine="pyarrow"), pd.read_parquet(tmp_path / "a.parquet")):
        for name in samples.channels:
            np.testing.assert_array_equal(frame[name].to_numpy(), samples[name])


def test_an_mcap_log_comes_with_its_axis_time_and_metadata(tmp_path):
    samples = strokes(3000)
    samples = samples.with_columns({"position": np.where(np.arange(3000) == 7, np.nan, samples["position"])})
    truth = {"time": samples.time[::10], "leakage": np.full(300, 6e-12)}
    write_run(
        tmp_path / "a.mcap", samples, axis="axis_b", truth=truth,
        unit_yaml="schema: fdd.unit/1\n", scenario_json='{"seed": 7}', labels={"faults": []}, start_ns=10**18,
    )  # fmt: skip
    log = read_log(tmp_path / "a.mcap")
    assert (log.axis, log.start_ns, log.name) == ("axis_b", 10**18, "a.mcap")
    assert log.metadata["unit"]["yaml"] == "schema: fdd.unit/1\n"
    assert log.metadata["scenario"]["json"] == '{"seed": 7}'
    assert log.metadata["labels"]["json"] == '{"faults": []}'
    assert_same(log, samples)
    assert log.quality.nan_samples == 1


cuts = st.lists(st.integers(0, ROWS), max_size=8)


@given(edges=cuts)
@settings(max_examples=12, deadline=None)
def test_tables_in_any_blocks_are_the_same(edges):
    gaps = A.with_columns({"load_force": np.where(np.arange(ROWS) < 500, np.nan, 1.5)})
    with TemporaryDirectory() as folder:
        for kind in ("csv", "parquet"):
            path = Path(folder) / f"cut.{kind}"
            assert write_tables(path, parts(gaps, edges, "a"), axes=["a"]) == [path]
            assert_same(read_log(path, shortest=0.0), gaps)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_dual_run_in_tables_is_a_file_for_each_axis(tmp_path, kind):
    blocks = [*parts(A, [500], "a"), *parts(B, [200], "b")]
    files = write_tables(tmp_path / f"run.{kind}", blocks, axes=["a", "b"])
    assert [f.name for f in files] == [f"run.a.{kind}", f"run.b.{kind}"]
    assert_same(read_log(files[0], shortest=0.0), A)
    assert_same(read_log(files[1], shortest=0.0), B)


def failing(blocks: list[RunBlock]):
    yield from blocks
    raise RuntimeError("the plant stopped")


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap"])
@pytest.mark.parametrize("axes", [["a"], ["a", "b"]])
def test_a_run_that_breaks_off_leaves_no_file(tmp_path, axes, kind):
    write = write_blocks if kind == "mcap" else write_tables
    with pytest.raises(RuntimeError):
        write(tmp_path / f"a.{kind}", failing(parts(A, [500], "a")), axes=axes)
    assert list(tmp_path.iterdir()) == []


def test_blocks_that_do_not_fit_are_refused_in_one_line(tmp_path):
    other = RunBlock(Samples(B.time + 2.0, {"position": B["position"]}), None, "a")
    blocks = [RunBlock(A, None, "a"), other]
    assert "same columns" in refused(partial(write_tables, tmp_path / "a.csv", blocks, axes=["a"]))
    assert list(tmp_path.iterdir()) == []


SAMPLES = strokes(2500)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
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
def test_a_file_cut_anywhere_gives_a_prefix_and_a_note(whole, share):
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
def test_a_flipped_byte_never_changes_a_value(whole, share, value):
    at = int(share * len(whole))
    read = read_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
    if isinstance(read, Log):
        rows = np.searchsorted(SAMPLES.time, read.samples.time)
        np.testing.assert_array_equal(SAMPLES.time[rows], read.samples.time)
        np.testing.assert_array_equal(SAMPLES["position"][rows], read.samples["position"])
        if len(read.samples) < len(SAMPLES):
            assert read.quality.notes


@pytest.mark.parametrize("how", [*({"compression": c} for c in CompressionType), {"use_chunking": False}])
def test_unfinished_files_of_every_compression(tmp_path, how):
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


def test_a_damaged_chunk_is_left_out_and_told_and_a_bomb_bounded(whole, tmp_path):
    middle = len(whole) // 3
    read = read_bytes(whole[:middle] + bytes(64) + whole[middle + 64 :])
    assert isinstance(read, Log)
    assert "damaged chunks" in " ".join(read.quality.notes)
    assert 0.5 * len(SAMPLES) < len(read.samples) < len(SAMPLES)
    assert read.quality.time_jumps == 1
    bomb = zstandard.compress(bytes(200_000_000))
    records = RecordBuilder()
    Header(profile="", library="").write(records)
    for size in (2**40, 1000):
        Chunk("zstd", bomb, 0, 0, 0, size).write(records)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + records.end())
    assert "are read" in refused_log(path)


LONG = 1_200_000
"""Twenty minutes at 1 kHz: ten of them hardly show beside the buffers of a batch."""
MOST = 1.8
"""Times the columns; reading them beside a table of them, or with parts that are joined later, takes two."""
READ = """
import sys
from pathlib import Path
from fdd.logs import read_log
from fdd.logs.formats import open_log
from fdd.logs.rates import inspect

def status(key):
    return int(Path("/proc/self/status").read_text().split(key + ":")[1].split()[0]) * 1024

act = {"read": read_log, "inspect": lambda path: inspect(open_log(path))}[sys.argv[1]]
act(sys.argv[2])  # loads what is loaded once
before = status("VmRSS")
kept = act(sys.argv[3])
print(status("VmHWM") - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak is read from /proc")
@pytest.mark.parametrize(
    ("name", "write"),
    [("run.parquet", write_table), ("run.mcap", lambda path, log: write_run(path, log, axis="a"))],
)
def test_a_long_log_takes_little_more_memory_than_its_columns(tmp_path, name, write):
    """All channels with noise of their own, some values missing, the temperature measured seldom."""
    rng, log = np.random.default_rng(1), strokes(LONG, seed=1)
    names = (*log.columns, "pump_speed", "motor_current")
    columns = {n: log.columns.get(n, 0.0) + 1e-3 * rng.normal(size=LONG) for n in names}
    columns["oil_temperature"] = np.repeat(40.0 + rng.normal(size=LONG // 100), 100)
    columns["pressure_1"][rng.integers(0, LONG, 50)] = np.nan
    log = Samples(log.time, columns)
    short, long = tmp_path / f"short_{name}", tmp_path / name
    write(short, log.rows(0, 5000))
    write(long, log)
    size = (len(columns) + 1) * LONG * 8
    for what in ("read", "inspect"):
        peak = subprocess.check_output([sys.executable, "-c", READ, what, short, long], text=True)
        assert size < int(peak) < MOST * size, what
