"""What `fdd serve` finds in logs that come over MQTT, late, overtaken and with holes, `fdd diagnose` finds.

``FDD_TEST_RIGS=FOLDER pytest -s tests/service/test_live_rigs.py`` does it for the logs of the rigs 0 to 5,
which are not in the repository, and prints a table.
"""

from __future__ import annotations

import json
import math
import os
import runpy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner
from watched import leaking

from fdd.cli.app import app
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.logs.tabular_writing import write_parquet
from fdd.samples import Samples
from fdd.unit import Unit
from tests.service.brokers import Broker, needs_mosquitto
from tests.service.live import Live, watched

pytestmark = needs_mosquitto
ROOT = Path(__file__).resolve().parents[2]
RIGS = Path(os.environ.get("FDD_TEST_RIGS", "/nowhere"))
BAD_LINE = ("--jitter", "0.05", "--loss", "0.01", "--shuffle", "3", "--seed", "1")


def published(
    tmp_path: Path, profile: str, logs: list[Path], *more: str, patience: float = 60.0
) -> dict[str, Live]:
    broker = Broker(tmp_path)

    def publish() -> None:
        url = f"mqtt://127.0.0.1:{broker.port}"
        done = CliRunner().invoke(app, ["publish", *map(str, logs), "--mqtt", url, *BAD_LINE, *more])
        assert done.exit_code == 0, done.output

    try:
        return watched(tmp_path, broker.port, profile, publish, patience)
    finally:
        broker.kill()


@dataclass(frozen=True)
class Offline:
    """What the samples that came give when they are there at once: by the pipeline, and by the command."""

    findings: list[dict[str, Any]]
    answer: dict[str, Any]
    told: dict[str, Any]


def offline(axis: str, samples: Samples, profile: str, folder: Path) -> Offline:
    pipeline = Pipeline(Unit.load(profile), Model.load(), axis=axis)
    findings = [f.model_dump(mode="json") for b in samples.blocks(10_000) for f in pipeline.push(b)]
    log = folder / f"{axis}.parquet"
    write_parquet(log, samples)
    done = CliRunner().invoke(app, ["diagnose", str(log), "--unit", profile, "--json", "-"])
    assert done.exit_code == 0, done.output
    return Offline(
        findings, pipeline.finish().model_dump(mode="json", by_alias=True), json.loads(done.stdout)
    )


def differences(live: Live, other: Offline) -> list[str]:
    answer, counts = live.answer.model_dump(mode="json", by_alias=True), live.status.quality
    same = (
        "faults",
        "verdict",
        "probabilities",
        "estimates",
        "sensors",
        "not_visible",
        "samples",
        "duration_s",
    )
    quality = {"dropped_samples": counts["dropped"], "time_jumps": counts["gaps"], "late": counts["late"]}
    told = {"late": 0} | {k: n for k, n in other.told["quality"].items() if k in quality}
    return [
        *unlike("findings", live.findings, other.findings),
        *unlike("answer", answer, other.answer),
        *unlike("command", {k: answer[k] for k in same}, {k: other.told[k] for k in same}),
        *unlike("quality", quality, told),
    ]


def unlike(place: str, one: Any, other: Any) -> list[str]:
    """Where two answers differ, numbers by more than 1e-9 of them."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return [line for key in one for line in unlike(f"{place}.{key}", one[key], other[key])]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return [line for k, pair in pairs for line in unlike(f"{place}.{k}", *pair)]
    if isinstance(one, float) and isinstance(other, float):
        return [] if math.isclose(one, other, rel_tol=1e-9) else [f"{place}: {one!r} live, {other!r} offline"]
    return [] if one == other else [f"{place}: {one!r} live, {other!r} offline"]


def overtaken(live: Live) -> int:
    numbers = np.array([b.sequence for b in live.came])
    return int((numbers < np.maximum.accumulate(numbers)).sum())


def test_a_simulated_axis_on_a_bad_line(tmp_path: Path) -> None:
    log = tmp_path / "leaks.parquet"
    write_parquet(log, leaking(35.0, 18.0))
    live = published(tmp_path, "axis_a", [log], "--speed", "20")["leaks"]
    assert 300 < len(live.came) < 350 and overtaken(live) > 0, "else this shows nothing"
    assert [f["fault"] for f in live.findings] == ["internal_leakage"]
    assert not differences(live, offline("leaks", live.samples, "axis_a", tmp_path))


@pytest.mark.skipif(
    not RIGS.is_dir(),
    reason="FDD_TEST_RIGS names no folder of the rigs' logs, which are not in the repository",
)
@pytest.mark.parametrize("rig", [f"rig{k}" for k in range(6)])
def test_rigs_on_a_bad_line(rig: str, tmp_path: Path) -> None:
    profile, channel_map = tmp_path / f"{rig}.yaml", ROOT / "examples" / f"{rig}.map.yaml"
    runpy.run_path(str(ROOT / "examples" / "rig_answers.py"))["identified"](RIGS / rig).save(profile)
    logs = sorted((RIGS / rig).glob("run*"))
    found = published(
        tmp_path, str(profile), logs, "--speed", "20", "--map", str(channel_map), patience=900.0
    )
    wrong = []
    print("\n| log | blocks | lost | overtaken | offline | live | differences |")
    for log in logs:
        live = found[log.stem]
        whole = 1 + max(b.sequence or 0 for b in live.came)
        other = offline(log.stem, live.samples, str(profile), tmp_path)
        unequal = differences(live, other)
        wrong += [f"{log.stem}: {line}" for line in unequal]
        print(
            f"| {rig}/{log.stem} | {whole} | {whole - len(live.came)} | {overtaken(live)} "
            f"| {named(other.findings, other.told['verdict'])} | {named(live.findings, live.answer.verdict)} "
            f"| {len(unequal)} |",
            flush=True,
        )
    assert not wrong, "\n".join(wrong)


def named(findings: list[dict[str, Any]], verdict: str) -> str:
    return ", ".join([verdict, *(f"{f['fault']} at {f['onset_s']:.1f} s" for f in findings)])
