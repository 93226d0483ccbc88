"""``python -m reports outage``: the service is killed, axes go on sending to the broker, it starts again."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Annotated

import paho.mqtt.client as paho
import typer

from fdd.cli.console import progress
from fdd.errors import InputError
from reports.live.inside import BLOCK_S, ROWS, logs, messages, profile_text
from reports.service import MOSQUITTO, Broker, Process, until

BEFORE_S = 10.0
"""s of data that are sent before the service is killed."""
LONGEST_S = 3600.0


def outage(
    axes: Annotated[int, typer.Option(min=1, max=200, help="That send.")] = 24,
    seconds: Annotated[float, typer.Option(min=30.0, max=3600.0, help="s of data sent meanwhile.")] = 600.0,
) -> None:
    """Kill the service, let axes send to the broker, start it again: what is lost or told twice (10 min)."""
    if MOSQUITTO is None:
        raise InputError("no mosquitto here", mend="install it (Debian: mosquitto)")
    with progress("simulating logs"):
        payloads = [messages(log) for log in logs(BEFORE_S + seconds)]
    first, last = round(BEFORE_S / BLOCK_S), round((BEFORE_S + seconds) / BLOCK_S)
    client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
    client.max_queued_messages_set(0)

    def send(begin: int, end: int) -> None:
        for number in range(begin, end):
            for k in range(axes):
                sent = client.publish(f"rig/A{k}/blocks", payloads[k % len(payloads)][number], qos=1)
            if number % 50 == 49 or number == end - 1:
                sent.wait_for_publish(300.0)

    with tempfile.TemporaryDirectory(prefix="fdd-outage-") as name:
        broker = Broker(Path(name))
        (Path(name) / "unit.yaml").write_text(profile_text(), "utf-8")
        source = {"type": "mqtt", "host": "127.0.0.1", "port": broker.port, "topics": ["rig/{axis}/blocks"]}
        served = Process(Path(name), [source], fallback=str(Path(name) / "unit.yaml"))
        try:
            served.start()
            until(lambda: not served.problems(), 30.0)
            client.connect("127.0.0.1", broker.port)
            client.loop_start()
            send(0, first)
            served.kill()
            send(first, last)
            begun = time.monotonic()
            served.spawn()
            until(lambda: served.get("/api/health"), 120.0)
            answered, wanted, slowest, worked = time.monotonic() - begun, axes * last * ROWS, 0.0, 0
            while worked < wanted and time.monotonic() - begun < LONGEST_S:
                time.sleep(1.0)
                asked = time.monotonic()
                served.problems()
                slowest = max(slowest, time.monotonic() - asked)
                worked = sum(axis["samples"] for axis in served.axes())
            took, megabytes = time.monotonic() - begun, served.resident / 1e6
            served.end()
            findings, audit = served.told()
        finally:
            client.loop_stop()
            served.kill()
            broker.stop()
    print(f"{worked:,} of {wanted:,} samples are worked {took:.0f} s after the start, {megabytes:.0f} MB")
    print(f"health answers {answered:.1f} s after the start, and then within {slowest:.2f} s")
    leaking = sum(k % len(payloads) == 1 for k in range(axes))
    print(f"{len(findings)} findings, {audit.count('RAISED')} alarms raised, of {leaking} axes that leak")
