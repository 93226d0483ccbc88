"""Settings that all tests share."""

import os
import runpy
from pathlib import Path

import pytest
from hypothesis import settings

# As the command line does, before NumPy is loaded: workers that share the cores would wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from fdd.diagnosis.model import AlarmTail, Calibration, Model
from fdd.logs import ChannelMap

ROOT = Path(__file__).resolve().parents[1]
# Assertions of the checks of faults are to be explained as those of tests are.
pytest.register_assert_rewrite("fault_case", "fault_checks", "drive_and_seal_checks")
# The same examples on every run, and no deadlines: the first call of a compiled function takes seconds.
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=40)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def tiny_model() -> Model:
    """A model of round numbers for tests of what stands around the evidence; no word on accuracy."""
    return Model(
        data="made up for tests",
        tail=AlarmTail(height=3.0, rate_per_hour=4.0, scale=1.0, hours=1.0),
        calibration=Calibration(midpoint=3.0, slope=1.0),
    )


def recordings(below: str) -> Path:
    """A folder of FDD_SHARED, or of ../shared beside the repository; skips where it is absent."""
    folder = Path(os.environ.get("FDD_SHARED", ROOT.parent / "shared")) / below
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set FDD_SHARED to the folder that holds {below}")
    return folder


@pytest.fixture(scope="session")
def rig_logs() -> Path:
    return recordings("rig_logs")


@pytest.fixture(scope="session")
def bench() -> Path:
    return recordings("real/eha_bench")


@pytest.fixture(scope="session")
def bench_map(bench: Path) -> ChannelMap:
    """The real bench's map as `fdd map` proposes it."""
    found: ChannelMap = runpy.run_path(str(ROOT / "examples" / "bench_runs.py"))["bench_map"](bench)
    return found
