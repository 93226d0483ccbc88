"""Where the recordings of the real bench are."""

from __future__ import annotations

from pathlib import Path

import pytest

from fdd.unit import Unit

ROOT = Path(__file__).parents[2]
SHARED = next((p for p in (q / "shared" for q in ROOT.parents) if (p / "real" / "eha_bench").is_dir()), None)


@pytest.fixture(scope="session")
def bench_folder() -> Path:
    """The recordings; tests that use them skip where they are absent."""
    if SHARED is None:
        pytest.skip("the recordings of the real bench (shared/real/eha_bench) are not here")
    return SHARED / "real" / "eha_bench"


@pytest.fixture(scope="session")
def bench_unit() -> Unit:
    """Its base profile."""
    return Unit.load(ROOT / "examples" / "bench.base.yaml")
