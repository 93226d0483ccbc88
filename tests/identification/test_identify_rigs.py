"""Logs of rigs and a bench that others built; skipped where they are not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd.identification.identify import identify_unit
from fdd.logs import ChannelMap, read_log
from fdd.unit import Unit

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
RIGS = ROOT.parent / "shared" / "rig_logs"
BENCH = ROOT.parent / "shared" / "real" / "eha_bench" / "session_18oct"


@pytest.mark.skipif(not RIGS.is_dir(), reason="the rigs' logs are not here")
@pytest.mark.parametrize(
    ("rig", "suffix", "axis"), [("rig1", "parquet", "axis_b"), ("rig4", "mcap", "axis_a")]
)
def test_rig(rig: str, suffix: str, axis: str) -> None:
    log = read_log(RIGS / rig / f"baseline.{suffix}", ROOT / "examples" / f"{rig}.map.yaml").samples
    found = identify_unit([log], Unit.load(axis)).unit
    truth = pd.read_parquet(RIGS / "trajectories.parquet")
    truth = truth[truth.log == f"{rig}/baseline.{suffix}"]
    loaded = truth[truth.leakage_excited]
    assert found.pump.total_leakage == pytest.approx(loaded.leakage.median(), rel=0.07)
    # The rig's volumes are its own: bulk modulus is right but for their ratio, which is within 20 %.
    assert found.oil.bulk_modulus == pytest.approx(truth.bulk_modulus_1.median(), rel=0.25)
    assert 5.0e-7 < found.pump.displacement < 6.0e-7


@pytest.mark.skipif(not RIGS.is_dir(), reason="the rigs' logs are not here")
@pytest.mark.parametrize("rig", ["rig6", "rig7"])
def test_another_makers_rig_from_its_data_sheet(rig: str) -> None:
    """Ordinary work under a load that nobody measures, Δp or p1 and p2 alone; the sheet leaves 40 %."""
    base = Unit.load(ROOT / "examples" / f"{rig}.base.yaml")
    logs = [read_log(path).samples for path in sorted((RIGS / rig).glob("baseline*.parquet"))]
    result = identify_unit(logs, base)
    truth = pd.read_parquet(RIGS / "trajectories.parquet")
    truth = truth[truth.log.str.startswith(f"{rig}/baseline") & truth.leakage_excited]
    assert result.unit.pump.total_leakage == pytest.approx(truth.leakage.mean(), rel=0.15)
    assert any("could not be told apart" in note for note in result.notes)
    assert any("through gusts" in note for note in result.notes)


@pytest.mark.skipif(not BENCH.is_dir(), reason="the bench's logs are not here")
def test_bench(bench_map: ChannelMap) -> None:
    base = Unit.load("axis_a")
    base.cylinder.area_1, base.cylinder.area_2, base.cylinder.stroke = 1963.5e-6, 1649.3e-6, 0.075
    base.pump.displacement = 2.5e-7
    logs = [read_log(path, bench_map).samples for path in sorted(BENCH.glob("exp_data_[13]_*.csv"))]
    result = identify_unit(logs, base)
    found = result.unit
    # Measured in steady strokes: 0.125 mm/rad out, 1.45 to 1.49 times that back, slip included.
    assert found.pump.displacement / found.cylinder.area_1 == pytest.approx(0.126e-3, rel=0.03)
    assert 1.0 / 1.56 < found.cylinder.area_2 / found.cylinder.area_1 < 1.0 / 1.40
    assert found.sensors["position"].resolution == pytest.approx(25e-6, rel=1e-6)
    assert 1e5 < found.sensors["pressure_2"].noise < 3e5
    assert np.isfinite(found.oil.bulk_modulus) and found.oil.bulk_modulus > 1e8
