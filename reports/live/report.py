"""``python -m reports load``: how many axes one core watches in real time; ``outage``: nothing is lost."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import paho.mqtt.client as paho
import typer

from fdd.cli.console import progress, remark
from fdd.errors import InputError
from reports.live import capacity
from reports.service import MOSQUITTO, until
from reports.writing import FOLDER, OutOption, load_now, made_by, render, require_folder, write_report

GOAL_AXES, GOAL_BYTES = 100, 20e6
"""Axes on a core, and memory of each, that were asked for."""
HARDER_AXES = 40
"""Of the cases in which each axis costs more."""
BEFORE_S = 10.0
"""s of data that are sent before the service is killed."""
LONGEST_S = 3600.0


def load(
    out: OutOption = FOLDER,
    axes: Annotated[
        str, typer.Option(help="Numbers of axes that are tried, rising.", metavar="N,N,...")
    ] = "20,40,60,80,90,100,120,140",
    seconds: Annotated[float, typer.Option(min=20.0, max=3600.0, help="With each number of axes.")] = 60.0,
    repeats: Annotated[int, typer.Option(min=1, max=100, help="Runs of the fleet that are timed.")] = 3,
    aged: Annotated[
        float, typer.Option(min=0.0, max=36_000.0, help="s of data by which memory is told.")
    ] = 660.0,
    quick: Annotated[bool, typer.Option("--quick", help="A few minutes instead of twenty: rough.")] = False,
) -> None:
    """Measure fdd serve on one core: axes in real time, lag, processor time, memory (20 min)."""
    require_folder(out)
    numbers = sorted({int(n) for n in axes.split(",")}) if axes.replace(",", "").isdecimal() else []
    if not numbers or not 0 < numbers[0] <= numbers[-1] <= 1000:
        raise InputError(f"--axes {axes!r} are no numbers from 1 to 1000", mend="write e.g. 20,40,60")
    watched, span, missing = 10, 60.0, capacity.why_not()
    if quick:
        watched, span, seconds, repeats, aged = 4, 20.0, min(seconds, 25.0), 1, 0.0
    with progress("simulating logs"):
        recorded = capacity.logs(max(aged, 60.0, 0.0 if missing else seconds * len(numbers)))
    with progress("measuring the fleet's thread"):
        cost = capacity.inside(recorded, watched, span, repeats, aged)
    stages, cases, over = [], {}, None
    if missing is None:
        stages = capacity.ramp(recorded, numbers, seconds, remark)
        cases = capacity.harder(recorded, min(HARDER_AXES, numbers[-1]), seconds, remark)
        over = capacity.overload(recorded, 2 * max(_most(stages), 1), 2.0 * seconds)
    write_report(out / "live.md", report_text(cost, stages, seconds, missing, cases, over))
    print(f"{cost.whole:.1f} µs a sample, of which {cost.alone:.1f} are the pipeline's")
    print(f"{_most(stages)} axes in real time on one core" if stages else f"not in real time: {missing}")


def _most(stages: Sequence[capacity.Stage]) -> int:
    return max((s.axes for s in stages if s.in_time), default=0)


def report_text(
    cost: capacity.Inside, stages: Sequence[capacity.Stage], seconds: float, why: str | None = None,
    cases: Mapping[str, capacity.Stage] | None = None, over: capacity.Overload | None = None,
) -> str:  # fmt: skip
    """The whole report; `why` says what hindered the measurement in real time."""
    return render(
        Path(__file__).with_name("live.md.j2"), made_by=made_by("load"), load_now=load_now(), cost=cost,
        stages=stages, seconds=seconds, why=why, best=_most(stages), goal_axes=GOAL_AXES,
        goal_bytes=GOAL_BYTES, settle=capacity.SETTLE_S, lag=capacity.LAG_S, cases=cases or {}, over=over,
        aged=math.isfinite(cost.axis_bytes),
    )  # fmt: skip


def outage(
    axes: Annotated[int, typer.Option(min=1, max=200, help="That send.")] = 24,
    seconds: Annotated[float, typer.Option(min=30.0, max=3600.0, help="s of data sent meanwhile.")] = 600.0,
) -> None:
    """Kill the service, let axes send to the broker, start it again: what is lost or told twice (10 min)."""
    if MOSQUITTO is None:
        raise InputError("no mosquitto here", mend="install it (Debian: mosquitto)")
    with progress("simulating logs"):
        payloads = [capacity.messages(log) for log in capacity.logs(BEFORE_S + seconds)]
    first, last = round(BEFORE_S / capacity.BLOCK_S), round((BEFORE_S + seconds) / capacity.BLOCK_S)
    client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
    client.max_queued_messages_set(0)

    def send(begin: int, end: int) -> None:
        for number in range(begin, end):
            for k in range(axes):
                sent = client.publish(f"rig/A{k}/blocks", payloads[k % len(payloads)][number], qos=1)
            if number % 50 == 49 or number == end - 1:
                sent.wait_for_publish(300.0)

    with capacity.served_by_broker() as (served, port):
        until(lambda: not served.problems(), 30.0)
        client.connect("127.0.0.1", port)
        client.loop_start()
        send(0, first)
        served.kill()
        send(first, last)
        client.loop_stop()
        begun = time.monotonic()
        served.spawn()
        until(lambda: served.get("/api/health"), 120.0)
        answered, wanted, slowest, worked = time.monotonic() - begun, axes * last * capacity.ROWS, 0.0, 0
        while worked < wanted and time.monotonic() - begun < LONGEST_S:
            time.sleep(1.0)
            asked = time.monotonic()
            served.problems()
            slowest = max(slowest, time.monotonic() - asked)
            worked = sum(axis["samples"] for axis in served.axes())
        took, megabytes = time.monotonic() - begun, served.resident / 1e6
        served.end()
        findings, audit = served.told()
    print(f"{worked:,} of {wanted:,} samples are worked {took:.0f} s after the start, {megabytes:.0f} MB")
    print(f"health answers {answered:.1f} s after the start, and then within {slowest:.2f} s")
    leaking = sum(k % len(payloads) == capacity.LEAKING for k in range(axes))
    print(f"{len(findings)} findings, {audit.count('RAISED')} alarms raised, of {leaking} axes that leak")
