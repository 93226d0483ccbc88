"""Speed of writing a run, MCAP beside Parquet: ``pytest tests/benchmarks --benchmark-enable -k logs``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fdd.logs.mcap_runs import RunBlock, write_blocks
from fdd.logs.tabular_writing import table_file
from fdd.performance.cases import Cases
from fdd.plant.simulate import stream

SECONDS = 60.0
CASE = next(case for case in Cases().speed if case.name == "sines")


@pytest.fixture(scope="module")
def run() -> list[RunBlock]:
    """A simulated run in the plant's blocks, with the truth at the rate of the measurement."""
    parts = [p[0] for p in stream(CASE.unit, CASE.scenario(SECONDS, whole=False))]
    return [RunBlock(p.samples, {"time": p.truth.time, **p.truth.as_columns()}) for p in parts]


@pytest.mark.parametrize("truth", [False, True], ids=["measurement", "measurement and truth"])
@pytest.mark.parametrize("kind", ["mcap", "parquet"])
def test_writing(benchmark: Any, run: list[RunBlock], tmp_path: Path, kind: str, truth: bool) -> None:
    """Parquet has the truth in a table of its own."""
    benchmark.group = "writing, with truth" if truth else "writing"
    benchmark.extra_info["simulated_s"] = SECONDS
    out = tmp_path / f"run.{kind}"

    def write_mcap() -> None:
        write_blocks(out, run if truth else [RunBlock(b.samples) for b in run], axes=["a"])

    def write_parquet() -> None:
        with table_file(out) as table:
            for block in run:
                table.add(block.samples.time, block.samples.columns)
        if truth:
            with table_file(tmp_path / "truth.parquet") as table:
                for block in run:
                    columns = dict(block.truth or {})
                    table.add(columns.pop("time"), columns)

    benchmark(write_mcap if kind == "mcap" else write_parquet)
    assert out.stat().st_size > 100_000
