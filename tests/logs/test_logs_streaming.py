"""Tables written block by block: the same bytes however they are cut, several axes, all or nothing."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_logs import assert_same, refused, strokes
from pyarrow import parquet

from fdd.logs import read_log, tabular_writing
from fdd.logs.mcap_runs import RunBlock
from fdd.logs.tabular_writing import table_file, write_csv, write_parquet, write_table_blocks
from fdd.samples import Samples

ROWS = 1200
A, B = strokes(ROWS, seed=1), strokes(ROWS, seed=2)
# The axes are sampled together, but B loses rows of its own.
B = Samples(B.time[np.arange(ROWS) % 7 > 0], {c: v[np.arange(ROWS) % 7 > 0] for c, v in B.columns.items()})
cuts = st.lists(st.integers(0, ROWS), max_size=8)


def parts(samples: Samples, edges: list[int], axis: str | None) -> list[RunBlock]:
    """Blocks between the edges."""
    bounds = [0, *sorted(min(e, len(samples)) for e in edges), len(samples)]
    return [RunBlock(samples.rows(start, stop), None, axis) for start, stop in pairwise(bounds)]


@given(edges=cuts)
@settings(max_examples=25, deadline=None)
def test_tables_in_any_blocks_are_the_same_files(edges: list[int]) -> None:
    gaps = A.with_columns({"load_force": np.where(np.arange(ROWS) < 500, np.nan, 1.5)})
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(tabular_writing, "GROUP_ROWS", 350)
        for kind, write in (("csv", write_csv), ("parquet", write_parquet)):
            whole, cut = Path(folder) / f"whole.{kind}", Path(folder) / f"cut.{kind}"
            write(whole, gaps)
            assert write_table_blocks(cut, parts(gaps, edges, None), axes=["a"]) == [cut]
            assert cut.read_bytes() == whole.read_bytes()
            assert_same(read_log(cut, shortest=0.0), gaps)
        groups = parquet.ParquetFile(Path(folder) / "cut.parquet").metadata
        assert [groups.row_group(k).num_rows for k in range(groups.num_row_groups)] == [350, 350, 350, 150]


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


def test_a_run_that_breaks_off_leaves_no_file(tmp_path: Path) -> None:
    for name in ("a.csv", "a.parquet"):
        for axes in (["a"], ["a", "b"]):
            with pytest.raises(RuntimeError):
                write_table_blocks(tmp_path / name, failing(parts(A, [500], "a")), axes=axes)
    assert list(tmp_path.iterdir()) == []


def test_blocks_that_do_not_fit_are_refused_in_one_line(tmp_path: Path) -> None:
    with table_file(tmp_path / "a.csv") as out:
        out.add(A.time, A.columns)
        assert "same columns" in refused(lambda: out.add(A.time, {"position": A["position"]}))
    tables = [RunBlock(A, None, "c")]
    assert "'c'" in refused(lambda: write_table_blocks(tmp_path / "b.csv", tables, axes=["a"]))
    assert [f.name for f in tmp_path.iterdir()] == ["a.csv"]
