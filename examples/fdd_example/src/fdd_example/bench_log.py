"""Bench logs: lines of text that name rate and signals, then a row of numbers for each sample.

BENCH 1
rate 1000
signal position mm
signal pump_speed rpm
data
0.012 310.5
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.formats import Format, LogFile, Signal, require_size

MAGIC = b"BENCH 1"
LONGEST_HEAD = 1000
"""Lines in which `data` must come."""


@dataclass
class BenchLog(LogFile):
    """A bench log; `above` lines stand above its `rows`, `period` seconds apart."""

    period: float = 1e-3
    above: int = 0
    rows: int = 0

    def read(self, names: Iterable[str]) -> dict[str, NDArray[np.float64]]:
        """Columns of the signals."""
        wanted = list(names)
        columns = [list(self.signals).index(name) for name in wanted]
        table = np.loadtxt(self.path, skiprows=self.above, usecols=columns, ndmin=2)
        return dict(zip(wanted, table.T, strict=True))

    def stamps(self, clock: str) -> NDArray[np.float64]:
        """Times of the rows, s."""
        return np.arange(self.rows) * self.period

    def place(self, row: int) -> str:
        """Where a user finds a row."""
        return f"line {self.above + 1 + row}"


def open_bench(path: Path) -> BenchLog:
    """Read the head, and count the rows."""
    log = BenchLog(path)
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            word, *rest = line.split() or [""]
            if word == "rate" and rest:
                log.period = 1.0 / float(rest[0])
            elif word == "signal" and rest:
                log.signals[rest[0]] = Signal(rest[0], unit=rest[1] if len(rest) > 1 else None)
            elif word == "data":
                log.above = number
                break
            elif number > LONGEST_HEAD:
                break
        if not log.above:
            raise InputError("no line 'data'", where=path, mend="record it again")
        log.rows = sum(1 for line in file if line.strip())
    require_size(log.rows, len(log.signals), path)  # before anything is held
    return log


FORMAT = Format("bench log", (".bench",), lambda head: head.startswith(MAGIC), open_bench)
