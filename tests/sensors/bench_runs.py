"""Recordings of the real bench, read once."""

from __future__ import annotations

from pathlib import Path

from fdd.logs import ChannelMap, read_log
from fdd.samples import Samples

_READ: dict[Path, Samples] = {}


def bench_run(path: Path, bench_map: ChannelMap) -> Samples:
    """One recording in SI."""
    if path not in _READ:
        _READ[path] = read_log(path, bench_map).samples
    return _READ[path]
