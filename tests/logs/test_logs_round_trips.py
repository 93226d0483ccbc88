"""What is written is read back, bit for bit, by other libraries too, and however it was cut into blocks."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from made_up_logs import ROWS, A, B, assert_same, parts, refused, strokes

from fdd.logs import read_log
from fdd.logs.mcap_writing import RunBlock, write_blocks, write_run
from fdd.logs.tabular_writing import write_csv, write_parquet, write_table_blocks
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


WRITERS = {"csv": write_csv, "parquet": write_parquet, "mcap": partial(write_run, axis="axis_a")}


@given(any_samples())
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_any_samples_survive_every_format(samples: Samples) -> None:
    with TemporaryDirectory() as folder:
        for kind, write in WRITERS.items():
            path = Path(folder) / f"run.{kind}"
            write(path, samples)
            log = read_log(path, shortest=0.0)
            assert_same(log, samples)
            assert set(log.samples.channels) == set(samples.channels)
            expected = np.isnan(np.array(list(samples.columns.values()))).any(axis=0).sum()
            assert log.quality.nan_samples == expected


def test_pandas_reads_what_we_write(tmp_path: Path) -> None:
    samples = strokes()
    gaps = np.where(np.arange(6000) % 7, samples["pressure_1"], np.nan)
    samples = samples.with_columns({"pressure_1": gaps})
    write_csv(tmp_path / "a.csv", samples)
    write_parquet(tmp_path / "a.parquet", samples)
    for frame in (pd.read_csv(tmp_path / "a.csv", engine="pyarrow"), pd.read_parquet(tmp_path / "a.parquet")):
        for name in samples.channels:
            np.testing.assert_array_equal(frame[name].to_numpy(), samples[name])


def test_an_mcap_log_comes_with_its_axis_time_and_metadata(tmp_path: Path) -> None:
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
def test_tables_in_any_blocks_are_the_same(edges: list[int]) -> None:
    gaps = A.with_columns({"load_force": np.where(np.arange(ROWS) < 500, np.nan, 1.5)})
    with TemporaryDirectory() as folder:
        for kind in ("csv", "parquet"):
            path = Path(folder) / f"cut.{kind}"
            assert write_table_blocks(path, parts(gaps, edges, None), axes=["a"]) == [path]
            assert_same(read_log(path, shortest=0.0), gaps)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_dual_run_in_tables_is_a_file_for_each_axis(tmp_path: Path, kind: str) -> None:
    blocks = [*parts(A, [500], "a"), *parts(B, [200], "b")]
    files = write_table_blocks(tmp_path / f"run.{kind}", blocks, axes=["a", "b"])
    assert [f.name for f in files] == [f"run.a.{kind}", f"run.b.{kind}"]
    assert_same(read_log(files[0], shortest=0.0), A)
    assert_same(read_log(files[1], shortest=0.0), B)


def failing(blocks: list[RunBlock]) -> Iterator[RunBlock]:
    yield from blocks
    raise RuntimeError("the plant stopped")


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap"])
@pytest.mark.parametrize("axes", [["a"], ["a", "b"]])
def test_a_run_that_breaks_off_leaves_no_file(tmp_path: Path, axes: list[str], kind: str) -> None:
    write = write_blocks if kind == "mcap" else write_table_blocks
    with pytest.raises(RuntimeError):
        write(tmp_path / f"a.{kind}", failing(parts(A, [500], "a")), axes=axes)
    assert list(tmp_path.iterdir()) == []


def test_blocks_that_do_not_fit_are_refused_in_one_line(tmp_path: Path) -> None:
    other = RunBlock(Samples(B.time + 2.0, {"position": B["position"]}))
    for blocks, said in (([RunBlock(A), other], "same columns"), ([RunBlock(A, None, "c")], "'c'")):
        assert said in refused(partial(write_table_blocks, tmp_path / "a.csv", blocks, axes=["a"]))
    assert list(tmp_path.iterdir()) == []
