"""`fdd serve --engine ray` on two raylets, one of which is killed: nothing lost, nothing told twice."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from brokers import Broker, Client, needs_mosquitto
from senders import until
from stores import postgres_url
from watched import blocks_of, fleet_of, leaking, send

from fdd.samples import Samples
from fdd.service.blocks import encode_arrow
from fdd.service.config import Serve
from fdd.service.service import Service
from fdd.service.store import Store

ray = pytest.importorskip("ray", reason="no ray here: install fdd[ray]")
pytestmark = [needs_mosquitto, pytest.mark.slow]

AXES = [f"A{k}" for k in range(4)]
SHARDS = 3
HEALTH = {"health_check_period_ms": 500, "health_check_failure_threshold": 3, "health_check_timeout_ms": 500,
          "health_check_initial_delay_ms": 0}  # fmt: skip
"""Ray finds a lost node within 2 s instead of some 18 s."""


@pytest.fixture
def two_raylets() -> Iterator[Any]:
    from ray.cluster_utils import Cluster

    root = Path(__file__).parents[2]
    os.environ["PYTHONPATH"] = os.pathsep.join((str(root), os.environ.get("PYTHONPATH", "")))
    small = {"num_cpus": 1, "object_store_memory": 80 << 20}
    cluster = Cluster(initialize_head=True, head_node_args={**small, "_system_config": HEALTH})
    cluster.add_node(**small)
    cluster.wait_for_nodes()
    os.environ["RAY_ADDRESS"] = cluster.address
    yield cluster
    del os.environ["RAY_ADDRESS"]
    ray.shutdown()
    cluster.shutdown()


def told(store: Store) -> dict[str, Any]:
    """What people are told, whatever the order among axes, which is not ours to set."""
    names = ("axis", "time", "fault", "onset", "confidence", "severity")
    return {
        "findings": sorted(tuple(f[k] for k in names) for f in store.findings()),
        "audit": sorted((a["axis"], a["action"], a["time"]) for a in store.audit()),
        "alarms": sorted((a["axis"], a["key"], a["state"], a["count"]) for a in store.alarms()),
    }


def undisturbed(path: Path, log: Samples) -> dict[str, Any]:
    """The same blocks in one process without Ray, a broker or a shard."""
    fleet, inbox, _ = fleet_of(store := Store(f"sqlite:///{path}"))
    for axis in AXES:
        send(fleet, inbox, blocks_of(log, axis))
    fleet.keep()
    return told(store)


def test_a_lost_node_loses_nothing_and_tells_nothing_twice(two_raylets: Any, tmp_path: Path) -> None:
    log = leaking(30.0, onset=10.0)
    wanted = undisturbed(tmp_path / "alone.db", log)
    assert {f[0] for f in wanted["findings"]} == set(AXES), "else this shows nothing"
    broker, url = Broker(tmp_path), postgres_url()
    config = Serve.from_yaml(
        f"schema: fdd.serve/1\nstore: {url}\nfallback: axis_a\nshards: {SHARDS}\nlisten: {{port: 0}}\n"
        f"sources: [{{type: mqtt, host: 127.0.0.1, port: {broker.port}, topics: ['rigs/{{axis}}'],"
        " client_id: fdd}]\noutputs: {jsonl: told.jsonl}\n", folder=tmp_path,
    )  # fmt: skip
    stop, service = threading.Event(), Service(config, "ray")
    running = threading.Thread(target=service.run, args=(stop,))
    running.start()
    try:
        until(lambda: service.health()["problems"] == [], 60.0)
        play(service, two_raylets, broker, log)
        raised = lambda: (tmp_path / "told.jsonl").read_text().count('"RAISED"')  # noqa: E731
        until(lambda: raised() >= len(wanted["alarms"]))  # what the outbox has is told a moment later
    finally:
        stop.set()
        running.join(60.0)
        broker.kill()
    assert not running.is_alive()
    store = Store(url)
    assert told(store) == wanted
    assert raised() == len(wanted["alarms"]), "an output hears of each once"
    store.close()


def play(service: Service, cluster: Any, broker: Broker, log: Samples) -> None:
    """Publish all blocks; half-way one raylet is killed, whose shards come back."""
    sender = Client(broker)
    rows = [blocks_of(log, axis) for axis in AXES]
    for k, blocks in enumerate(zip(*rows, strict=True)):
        for block in blocks:
            sender.publish(f"rigs/{block.axis}", encode_arrow(block))
        time.sleep(0.01)
        if k == len(rows[0]) // 2:
            (second,) = cluster.worker_nodes
            where = {shard_node(service, n) for n in range(SHARDS)}
            assert second.node_id in where and len(where) == 2, "both have some of the shards"
            cluster.remove_node(second, allow_graceful=False)
    until(lambda: service.health()["problems"] != [], 20.0)
    until(lambda: service.health()["problems"] == [] and len(service.fleet.axes()) == len(AXES), 60.0)
    # The last samples of each wait for more, until the axis is silent.
    until(lambda: [a.samples for a in service.fleet.axes()] == [len(log)] * len(AXES), 60.0)
    for status in service.fleet.axes():
        left_out = {k: status.quality[k] for k in ("late", "missing_blocks", "reordered")}
        assert not any(left_out.values()), (status.name, left_out)
    sender.close()


def shard_node(service: Service, number: int) -> str:
    """Where an actor is, as Ray has it."""
    actor = service.fleet._actors[number]  # type: ignore[union-attr]
    node = lambda shard: ray.get_runtime_context().get_node_id()  # noqa: E731
    return str(ray.get(actor.__ray_call__.remote(node)))
