"""What reading a long log takes in memory, beside its columns: one or two more of them, and no second log."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from made_up_logs import strokes

from fdd.logs.mcap_writing import write_run
from fdd.logs.tabular_writing import write_parquet
from fdd.samples import Samples

ROWS = 1_200_000
"""Twenty minutes at 1 kHz: ten of them hardly show beside the buffers of a batch."""
CHANNELS = (
    "pump_angle", "pump_speed", "position", "pressure_difference", "pressure_1", "pressure_2",
    "pressure_accumulator", "motor_current", "oil_temperature",
)  # fmt: skip
MOST = 1.8
"""Times the columns; reading them beside a table of them, or with parts that are joined later, takes two."""
READ = """
import sys
from pathlib import Path
from fdd.logs import read_log
from fdd.logs.formats import open_log
from fdd.logs.inspection import inspect

def status(key):
    return int(Path("/proc/self/status").read_text().split(key + ":")[1].split()[0]) * 1024

act = {"read": read_log, "inspect": lambda path: inspect(open_log(path))}[sys.argv[1]]
act(sys.argv[2])  # loads what is loaded once
before = status("VmRSS")
kept = act(sys.argv[3])
print(status("VmHWM") - before)
"""


def ten_minutes(rows: int) -> Samples:
    """All channels with noise of their own, some values missing, the temperature measured seldom."""
    rng = np.random.default_rng(1)
    log = strokes(rows, seed=1)
    columns = {n: log.columns.get(n, np.zeros(rows)) + 1e-3 * rng.normal(size=rows) for n in CHANNELS}
    columns["oil_temperature"] = np.repeat(40.0 + rng.normal(size=rows // 100), 100)
    columns["pressure_1"][rng.integers(0, rows, 50)] = np.nan
    return Samples(log.time, columns)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak is read from /proc")
@pytest.mark.parametrize(
    ("name", "write"),
    [("run.parquet", write_parquet), ("run.mcap", lambda path, log: write_run(path, log, axis="a"))],
)
def test_a_long_log_takes_little_more_memory_than_its_columns(
    tmp_path: Path, name: str, write: Callable[[Path, Samples], None]
) -> None:
    log = ten_minutes(ROWS)
    short, long = tmp_path / f"short_{name}", tmp_path / name
    write(short, log.rows(0, 5000))
    write(long, log)
    columns = (len(CHANNELS) + 1) * ROWS * 8
    for what in ("read", "inspect"):
        peak = subprocess.check_output([sys.executable, "-c", READ, what, short, long], text=True)
        assert columns < int(peak) < MOST * columns, what
