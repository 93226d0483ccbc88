"""Recordings of the real bench, read once."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from fdd.logs import ChannelMap, read_log
from fdd.samples import Samples

MAP = Path(__file__).parents[2] / "examples" / "bench.map.yaml"


@cache
def bench_run(path: Path) -> Samples:
    """One recording in SI."""
    return read_log(path, ChannelMap.load(MAP)).samples
