"""Runs written block by block: the same bytes however they are cut, several axes, all or nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_logs import assert_same, refused, strokes
from mcap.reader import NonSeekingReader, make_reader
from pyarrow import parquet

from fdd.logs import mcap_merging, read_log, tabular_writing
from fdd.logs.mcap_runs import RunBlock, run_file, write_blocks, write_run
from fdd.logs.tabular_writing import table_file, write_csv, write_parquet, write_table_blocks
from fdd.samples import Samples

ROWS = 1200
A, B = strokes(ROWS, seed=1), strokes(ROWS, seed=2)
# The axes are sampled together, but B loses rows of its own.
B = Samples(B.time[np.arange(ROWS) % 7 > 0], {c: v[np.arange(ROWS) % 7 > 0] for c, v in B.columns.items()})
cuts = st.lists(st.integers(0, ROWS), max_size=8)


def parts(samples: Samples, edges: list[int], axis: str | None, thin: int = 1) -> list[RunBlock]:
    """Blocks between the edges, with every `thin`-th row's truth; 0 for none."""
    bounds = [0, *sorted(min(e, len(samples)) for e in edges), len(samples)]
    blocks = []
    for start, stop in pairwise(bounds):
        truth = None
        if thin:
            rows = np.arange(start, stop)[np.arange(start, stop) % thin == 0]
            truth = {"time": samples.time[rows], "leakage": 1e-12 * rows, "stuck": rows % 2 == 0}
        blocks.append(RunBlock(samples.rows(start, stop), truth, axis))
    return blocks


def mixed(seed: int, *queues: list[RunBlock]) -> Iterator[RunBlock]:
    """The blocks of several axes in a random order, each axis's in its own."""
    choice = np.random.default_rng(seed)
    left = [list(q) for q in queues]
    while any(left):
        queue = left[choice.integers(len(left))]
        if queue:
            yield queue.pop(0)


@given(edges=cuts, thin=st.sampled_from([0, 1, 10]))
@settings(max_examples=40, deadline=None)
def test_one_axis_in_any_blocks_is_the_run_as_a_whole(edges: list[int], thin: int) -> None:
    with TemporaryDirectory() as folder:
        whole, cut = Path(folder) / "whole.mcap", Path(folder) / "cut.mcap"
        one = parts(A, [], "a", thin)[0]
        write_run(whole, A, axis="a", truth=one.truth, unit_yaml="u", scenario_json="{}", labels={"x": 1})
        write_blocks(
            cut, parts(A, edges, "a", thin),
            axes=["a"], units={"a": "u"}, scenario_json="{}", labels={"x": 1},
        )  # fmt: skip
        assert cut.read_bytes() == whole.read_bytes()


@given(first=cuts, second=cuts, order=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_two_axes_in_any_blocks_and_any_order_make_one_file(
    first: list[int], second: list[int], order: int
) -> None:
    with TemporaryDirectory() as folder:
        whole, cut = Path(folder) / "whole.mcap", Path(folder) / "cut.mcap"
        write_blocks(whole, [*parts(B, [], "b", 10), *parts(A, [], "a", 10)], axes=["a", "b"])
        blocks = mixed(order, parts(A, first, "a", 10), parts(B, second, "b", 10))
        write_blocks(cut, blocks, axes=["a", "b"])
        assert cut.read_bytes() == whole.read_bytes()


def test_a_dual_run_holds_both_axes_in_the_order_of_time(tmp_path: Path) -> None:
    path = tmp_path / "dual.mcap"
    every = [
        b for pair in zip(parts(A, [300, 700], "a"), parts(B, [250, 800], "b"), strict=True) for b in pair
    ]
    write_blocks(path, every, axes=["a", "b"], units={"a": "of a", "b": "of b"}, start_ns=10**18)
    with path.open("rb") as stream:
        messages = list(NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False))
    stamps = [m.log_time for _, _, m in messages]
    assert stamps == sorted(stamps)
    topics = [c.topic for _, c, _ in messages]
    assert {t: topics.count(t) for t in set(topics)} == {
        "/eha/a/measurement": len(A), "/eha/a/truth": len(A),
        "/eha/b/measurement": len(B), "/eha/b/truth": len(B),
    }  # fmt: skip
    true = [json.loads(m.data) for _, c, m in messages if c.topic == "/eha/b/truth"]
    assert [t["leakage"] for t in true] == [1e-12 * k for k in range(len(B))]
    for axis, samples in (("a", A), ("b", B)):
        log = read_log(path, axis=axis, shortest=0.0)
        assert_same(log, samples)
        assert log.metadata["unit"]["yaml"] == f"of {axis}" and log.start_ns == 10**18


def test_what_is_held_back_is_only_what_a_slower_axis_may_come_before(tmp_path: Path) -> None:
    path = tmp_path / "dual.mcap"
    with run_file(path, axes=["a", "b"]) as out:
        for a, b in zip(parts(A, [300, 600, 900], "a"), parts(A, [300, 600, 900], "b"), strict=True):
            out.add(a)
            out.add(b)
            held = [q for q in out._merged._queues for _ in q.waiting]
            # The last row of each topic: one more of its time could come of a topic before it.
            assert len(held) == 4 and all(s.size == 1 for q in held for s, _ in q.waiting)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == 4 * len(A)


@given(edges=cuts)
@settings(max_examples=25, deadline=None)
def test_tables_in_any_blocks_are_the_same_files(edges: list[int]) -> None:
    gaps = A.with_columns({"load_force": np.where(np.arange(ROWS) < 500, np.nan, 1.5)})
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(tabular_writing, "GROUP_ROWS", 350)
        for kind, write in (("csv", write_csv), ("parquet", write_parquet)):
            whole, cut = Path(folder) / f"whole.{kind}", Path(folder) / f"cut.{kind}"
            write(whole, gaps)
            assert write_table_blocks(cut, parts(gaps, edges, None, 0), axes=["a"]) == [cut]
            assert cut.read_bytes() == whole.read_bytes()
            assert_same(read_log(cut, shortest=0.0), gaps)
        groups = parquet.ParquetFile(Path(folder) / "cut.parquet").metadata
        assert [groups.row_group(k).num_rows for k in range(groups.num_row_groups)] == [350, 350, 350, 150]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_dual_run_in_tables_is_a_file_for_each_axis(tmp_path: Path, kind: str) -> None:
    blocks = [*parts(A, [500], "a", 0), *parts(B, [200], "b", 0)]
    files = write_table_blocks(tmp_path / f"run.{kind}", blocks, axes=["a", "b"])
    assert [f.name for f in files] == [f"run.a.{kind}", f"run.b.{kind}"]
    assert_same(read_log(files[0], shortest=0.0), A)
    assert_same(read_log(files[1], shortest=0.0), B)


def failing(blocks: list[RunBlock]) -> Iterator[RunBlock]:
    yield from blocks
    raise RuntimeError("the plant stopped")


def test_a_run_that_breaks_off_leaves_no_file(tmp_path: Path) -> None:
    for name in ("a.mcap", "a.csv", "a.parquet"):
        write = write_blocks if name.endswith("mcap") else write_table_blocks
        for axes in (["a"], ["a", "b"]):
            with pytest.raises(RuntimeError):
                write(tmp_path / name, failing(parts(A, [500], "a", 0)), axes=axes)
    assert list(tmp_path.iterdir()) == []


def test_blocks_that_do_not_fit_are_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    first, second = parts(A, [600], "a", 0)
    other = RunBlock(Samples(second.samples.time, {"position": second.samples["position"]}), None, "a")
    true = parts(A, [600], "a")[1]
    short = RunBlock(A, {"leakage": np.ones(3)}, "a")

    def write(blocks: list[RunBlock], axes: tuple[str, ...] = ("a",)) -> str:
        return refused(lambda: write_blocks(path, blocks, axes=axes))

    assert "order of time" in write([second, first])
    assert "same columns" in write([first, other])
    assert "with every block or with none" in write([first, true])
    assert "'b'" in write([RunBlock(A, None, "b")])
    assert "None" in write([RunBlock(A)], ("a", "b"))
    assert "3 values for 1200" in write([short])
    assert "name each axis once" in write([], ("a", "a"))
    assert "topic" in write([], ("a/b",))
    with table_file(tmp_path / "a.csv") as out:
        out.add(A.time, A.columns)
        assert "same columns" in refused(lambda: out.add(A.time, {"position": A["position"]}))
    tables = [RunBlock(A, None, "c")]
    assert "'c'" in refused(lambda: write_table_blocks(tmp_path / "b.csv", tables, axes=["a"]))
    assert [f.name for f in tmp_path.iterdir()] == ["a.csv"]


def test_an_axis_that_stays_behind_is_refused_before_memory_runs_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_merging, "MOST_HELD", 500)
    blocks = [*parts(B, [10], "b", 0)[:1], *parts(A, [200, 400, 600, 800], "a", 0)]
    line = refused(lambda: write_blocks(tmp_path / "a.mcap", blocks, axes=["a", "b"]))
    assert "/eha/b/measurement" in line and "in turn" in line
    never = parts(A, [200, 400, 600, 800], "a", 0)
    assert "no block of b" in refused(lambda: write_blocks(tmp_path / "a.mcap", never, axes=["a", "b"]))
