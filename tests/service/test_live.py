"""What `fdd serve` finds in a log that comes by MQTT, late, overtaken, with holes, `fdd diagnose` finds."""

import json
import math
import os
import runpy
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner
from watched import leaking

from fdd.cli.app import app
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.logs.tabular_writing import write_table
from fdd.samples import Samples
from fdd.service.axis import AxisWatch
from fdd.service.blocks import Block, Decoder
from fdd.service.config import Serve
from fdd.service.store import Store
from fdd.unit import Unit
from tests.service.senders import serving, until
from tests.service.servers import Broker, Client, needs_mosquitto

pytestmark = needs_mosquitto
EXAMPLES = Path(__file__).parents[2] / "examples"
RIGS = Path(os.environ.get("FDD_TEST_RIGS", "/nowhere"))
"""Logs of the rigs 0 to 5, which are not in the repository."""
BAD_LINE = ("--speed", "20", "--jitter", "0.05", "--loss", "0.01", "--shuffle", "3", "--seed", "1")
SAME = ("faults", "verdict", "probabilities", "estimates", "sensors", "not_visible", "samples", "duration_s")


def ran(*arguments: object) -> str:
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def blocks_by_axis(heard: Client) -> dict[str, list[Block]]:
    """What came, in its order, once nothing has come for a second."""
    count = -1
    while count < len(heard.came):
        count = len(heard.came)
        time.sleep(1.0)
    heard.close()
    found: dict[str, list[Block]] = {}
    for message in heard.came:
        block = Decoder().decode(message.payload)
        found.setdefault(block.axis, []).append(block)
    return found


def unlike(place: str, one: Any, other: Any) -> list[str]:
    """Where two answers differ, numbers by more than 1e-9 of them."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return [line for key in one for line in unlike(f"{place}.{key}", one[key], other[key])]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return [line for k, pair in pairs for line in unlike(f"{place}.{k}", *pair)]
    if isinstance(one, float) and isinstance(other, float) and math.isclose(one, other, rel_tol=1e-9):
        return []
    return [] if one == other else [f"{place}: {one!r} live, {other!r} offline"]


def wrong(folder: Path, logs: list[Path], unit: str, *more: object, patience: float = 60.0) -> list[str]:
    """Where the service and `fdd diagnose` differ on logs that were published over a bad line."""
    broker = Broker(folder)
    config = Serve.from_yaml(
        f"schema: fdd.serve/1\nfallback: {unit}\nlisten: {{port: 0}}\nsources:\n"
        f"- {{type: mqtt, host: 127.0.0.1, port: {broker.port}, topics: ['fdd/{{axis}}/blocks']}}\n",
        folder=folder,
    )  # fmt: skip
    with ExitStack() as running:
        running.callback(broker.kill)
        service = running.enter_context(serving(config))
        heard = Client(broker, listens="fdd/#")
        until(lambda: service.health()["status"] == "ok")
        ran("publish", *logs, "--mqtt", f"mqtt://127.0.0.1:{broker.port}", *BAD_LINE, *more)
        came = blocks_by_axis(heard)
        rows = {axis: sum(len(block.samples) for block in blocks) for axis, blocks in came.items()}
        until(lambda: {s.name: s.samples + s.quality["late"] for s in service.fleet.axes()} == rows, patience)
        quality = {status.name: status.quality for status in service.fleet.axes()}
    out, store = [], Store(config.store_url)
    for axis, blocks in came.items():
        numbers = np.array([block.sequence for block in blocks])
        assert (numbers < np.maximum.accumulate(numbers)).any() and len(numbers) <= numbers.max()
        watch, checkpoint = AxisWatch(axis, Unit.load(unit), Model.load()), store.checkpoint(axis)
        assert checkpoint is not None
        watch.go_on(checkpoint)
        answer = watch.pipeline.finish().model_dump(mode="json", by_alias=True)
        found = [f["body"] for f in store.findings() if f["axis"] == axis][::-1]

        samples = Samples.concatenate([b.samples for b in sorted(blocks, key=lambda b: b.sequence or 0)])
        pipeline = Pipeline(Unit.load(unit), Model.load(), axis=axis)
        offline = [f.model_dump(mode="json") for b in samples.blocks(10_000) for f in pipeline.push(b)]
        write_table(folder / f"{axis}.parquet", samples)
        told = json.loads(ran("diagnose", folder / f"{axis}.parquet", "--unit", unit, "--json", "-"))
        mine = {"dropped_samples": "dropped", "time_jumps": "gaps", "late": "late"}
        out += [
            *unlike(f"{axis}.findings", found, offline),
            *unlike(f"{axis}.answer", answer, pipeline.finish().model_dump(mode="json", by_alias=True)),
            *unlike(f"{axis}.command", {k: answer[k] for k in SAME}, {k: told[k] for k in SAME}),
            *unlike(f"{axis}.quality", {k: quality[axis][n] for k, n in mine.items()},
                    {k: told["quality"].get(k, 0) for k in mine}),
        ]  # fmt: skip
    assert any(f["fault"] for f in store.findings())
    store.close()
    return out


@pytest.mark.slow
def test_a_simulated_axis_on_a_bad_line(tmp_path):
    write_table(tmp_path / "leaks.parquet", leaking(35.0, 18.0))
    assert wrong(tmp_path, [tmp_path / "leaks.parquet"], "axis_a") == []


@pytest.mark.skipif(not RIGS.is_dir(), reason="FDD_TEST_RIGS names no folder of the rigs' logs")
@pytest.mark.parametrize("rig", [f"rig{k}" for k in range(6)])
def test_rigs_on_a_bad_line(rig, tmp_path):
    profile, channel_map = tmp_path / f"{rig}.yaml", EXAMPLES / f"{rig}.map.yaml"
    runpy.run_path(str(EXAMPLES / "rig_answers.py"))["identified"](RIGS / rig).save(profile)
    logs = sorted((RIGS / rig).glob("run*"))
    assert wrong(tmp_path, logs, str(profile), "--map", channel_map, patience=900.0) == []
