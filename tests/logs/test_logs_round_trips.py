"""What is written is read back, bit for bit, and other libraries read it too."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from made_up_logs import assert_same, strokes

from fdd.logs import read_log
from fdd.logs.mcap_runs import RunBlock, write_blocks
from fdd.logs.mcap_writing import write_run
from fdd.logs.tabular_writing import write_csv, write_parquet
from fdd.samples import Samples

finite = st.floats(-1e300, 1e300)
with_gaps = st.one_of(finite, st.just(float("nan")))


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
        columns[name] = column(finite, 1.0)
    return Samples(np.cumsum(steps), columns)


@given(any_samples())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_any_samples_survive_every_format(samples: Samples) -> None:
    with TemporaryDirectory() as folder:
        for kind, write in (("csv", write_csv), ("parquet", write_parquet), ("mcap", None)):
            path = Path(folder) / f"run.{kind}"
            if write is None:
                write_run(path, samples, axis="axis_a")
            else:
                write(path, samples)
            log = read_log(path, shortest=0.0)
            assert_same(log, samples)
            assert set(log.samples.channels) == set(samples.channels)
            expected = np.isnan(np.array(list(samples.columns.values()))).any(axis=0).sum()
            assert log.quality.nan_samples == expected


def test_the_suffix_does_not_matter(tmp_path: Path) -> None:
    samples = strokes()
    for write in (write_csv, write_parquet, lambda p, s: write_run(p, s, axis="a")):
        path = tmp_path / "log.dat"
        write(path, samples)
        assert_same(read_log(path), samples)


def test_pandas_reads_what_we_write(tmp_path: Path) -> None:
    samples = strokes()
    samples = samples.with_columns(
        {"pressure_1": np.where(np.arange(6000) % 7, samples["pressure_1"], np.nan)}
    )
    write_csv(tmp_path / "a.csv", samples)
    write_parquet(tmp_path / "a.parquet", samples)
    for frame in (
        pd.read_csv(tmp_path / "a.csv", engine="pyarrow"),
        pd.read_parquet(tmp_path / "a.parquet"),
    ):
        for name in samples.channels:
            np.testing.assert_array_equal(frame[name].to_numpy(), samples[name])


def test_we_read_what_pandas_writes(tmp_path: Path) -> None:
    samples = strokes()
    frame = pd.DataFrame({"time": samples.time, **samples.columns})
    frame.to_csv(tmp_path / "a.csv", index=False)
    frame.to_csv(tmp_path / "b.csv", index=False, sep=";", decimal=",", encoding="utf-8-sig")
    frame.to_csv(tmp_path / "c.csv", index=False, sep="\t", encoding="utf-16")
    frame.to_parquet(tmp_path / "a.parquet", index=False)
    for name in ("a.csv", "b.csv", "c.csv", "a.parquet"):
        assert_same(read_log(tmp_path / name), samples)


def test_an_mcap_log_comes_with_its_axis_time_and_metadata(tmp_path: Path) -> None:
    samples = strokes(3000)
    gap = samples["position"].copy()
    gap[7] = np.nan
    samples = samples.with_columns({"position": gap})
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


def test_an_mcap_log_of_two_axes_is_read_by_axis(tmp_path: Path) -> None:
    path, axes = tmp_path / "dual.mcap", {"a": strokes(3000, seed=1), "b": strokes(3000, seed=2)}
    blocks = [RunBlock(samples, None, axis) for axis, samples in axes.items()]
    write_blocks(path, blocks, axes=["a", "b"], units={"a": "of a", "b": "of b"})
    for axis, samples in axes.items():
        log = read_log(path, axis=axis)
        assert_same(log, samples)
        assert log.metadata["unit"]["yaml"] == f"of {axis}"


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"old")
    with pytest.raises(Exception, match="not JSON serializable"):
        write_run(path, strokes(10), axis="a", labels={"x": object()})
    with pytest.raises(ValueError):
        write_run(path, strokes(10), axis="a", truth={"time": np.zeros(3), "leakage": np.ones(4)})
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
