"""The whole path on logs that we did not make: identify, diagnose, answer. Skipped where they are absent.

What is right and wrong on them stands in README.md; here only that nothing breaks, and that healthy
machines are not called faulty with confidence.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import FAMILIES
from fdd.identify import identify_unit
from fdd.logs import ChannelMap, read_log
from fdd.unit import Unit

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared"
BENCH = SHARED / "real" / "eha_bench" / "session_18oct"


@pytest.mark.skipif(not (SHARED / "rig_logs").is_dir(), reason="the rigs' logs are not here")
@pytest.mark.parametrize(("rig", "base"), [("rig1", "axis_b"), ("rig4", "axis_a")])
def test_every_log_of_a_rig_gets_an_answer(rig: str, base: str) -> None:
    labels = json.loads((SHARED / "rig_logs" / "labels.json").read_text())
    channel_map = ChannelMap.load(ROOT / "examples" / f"{rig}.map.yaml")
    logs = {n: label for n, label in labels.items() if n.startswith(f"{rig}/")}
    healthy = [
        read_log(SHARED / "rig_logs" / n, channel_map).samples
        for n, label in logs.items()
        if label["baseline"]
    ]
    unit = add_baseline(identify_unit(healthy, Unit.load(base), rig).unit, healthy)
    for name, label in logs.items():
        pipeline = Pipeline(unit, log=name, keep_trajectories=False)
        for block in read_log(SHARED / "rig_logs" / name, channel_map).samples.blocks(20_000):
            pipeline.push(block)
        found = pipeline.finish()
        assert set(found.probabilities) == set(FAMILIES)
        assert all(e.value is not None and e.std is not None and e.std > 0 for e in found.estimates.values())
        if not label["faults"]:
            assert not [f for f in found.faults if f.confidence > 0.9], name


@pytest.mark.skipif(not BENCH.is_dir(), reason="the bench's logs are not here")
def test_healthy_runs_of_a_real_bench_are_no_confident_faults() -> None:
    channel_map = ChannelMap.load(ROOT / "examples" / "bench.map.yaml")

    def run(name: str) -> Path:
        return BENCH / f"exp_data_{name}.csv"

    known = [read_log(run(n), channel_map).samples for n in ("1_1", "1_4", "3_1", "3_4", "5_1", "5_4")]
    base = Unit.load(ROOT / "examples" / "bench.base.yaml")
    unit = add_baseline(identify_unit(known, base, "bench").unit, known)
    for name in ("1_2", "2_3", "3_2", "4_1", "4_4", "5_3"):
        pipeline = Pipeline(unit, log=name)
        pipeline.push(read_log(run(name), channel_map).samples)
        found = pipeline.finish()
        assert not [f for f in found.faults if f.confidence > 0.8], name
        assert found.estimates["leakage"].value is not None
