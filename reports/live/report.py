"""``python -m reports load``: axes that one core watches; ``outage``: nothing is lost; ``soak``: weeks."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import paho.mqtt.client as paho
import typer

from fdd.campaign.scenarios import fitting_duty
from fdd.cli.console import progress, remark
from fdd.diagnosis.baseline import add_baseline
from fdd.errors import InputError
from fdd.faults import fault
from fdd.identification.identify import identify_unit
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.config import Serve
from fdd.service.fleet import Fleet
from fdd.service.queues import Bus, Inbox
from fdd.service.store import Store
from fdd.unit import Unit
from reports.live import capacity
from reports.service import AXIS, MOSQUITTO, resident, until
from reports.writing import FOLDER, OutOption, load_now, made_by, render, require_folder, write_report

HARDER_AXES = 40
"""Of the cases in which each axis costs more."""
BEFORE_S = 10.0
"""s of data that are sent before the service is killed."""
LONGEST_S = 3600.0


def load(
    out: OutOption = FOLDER,
    axes: Annotated[
        str, typer.Option(help="Numbers of axes that are tried, rising.", metavar="N,N,...")
    ] = "20,40,50,60,80,100",
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
        stages=stages, seconds=seconds, why=why, best=_most(stages),
        settle=capacity.SETTLE_S, lag=capacity.LAG_S, cases=cases or {}, over=over,
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


UNIT, FAULT = "axis_a", "internal_leakage"
DAY_S, START_S, BLOCK_ROWS = 86400.0, 1.7e9, 100
KEPT = 2
"""Of the rows that the plant records at 200 Hz every second one is sent: 100 Hz."""
DUTIES = ("flight", "flight", "steps", "sines")
GAIN = 16_875.0
"""(rad/s)/m of the position loop."""


@dataclass
class Life:
    """What became of an axis.

    `hours`: in motion. `days`: how it stood at the end of each: number, severity, leakage and its std (SI),
    memory and store (B), µs of processor time a sample. `alarms`: day, fault and severity told, of each that
    was raised. `restarts`: clean ones, and kills.
    """

    wears: bool
    hours: float = 0.0
    samples: int = 0
    days: list[dict[str, float]] = field(default_factory=list)
    alarms: list[tuple[float, str, float | None]] = field(default_factory=list)
    restarts: list[int] = field(default_factory=lambda: [0, 0])


@dataclass(frozen=True)
class Plan:
    """Days, flights on each, minutes of a flight; the leak's severity at the end, and the day it begins."""

    days: int = 30
    flights: int = 8
    minutes: float = 5.0
    severity: float = 0.5
    onset: float = 10.0

    def at(self, day: float) -> float:
        """Severity of the leak."""
        return max(self.severity * (day - self.onset) / (self.days - self.onset), 0.0)


def recorded(rng: np.random.Generator, celsius: float, seconds: float, severity: float = 0.0) -> Samples:
    """One flight of the actuator at 100 Hz, warming up."""
    unit = Unit.load(UNIT)
    duty, control = fitting_duty(str(rng.choice(DUTIES)), unit, rng, {}, speed=False, gain=GAIN)
    faults: list[Any] = [{"fault": FAULT, "severity": severity, "onset": 0.0}] if severity > 0.0 else []
    scenario = Scenario.model_validate({
        "duration": seconds, "duty": duty, "control": control, "oil_temperature": celsius,
        "warming": rng.uniform(0.0, 0.02), "faults": faults, "seed": int(rng.integers(1 << 40)),
        "recording": {"rate": 200},
    })  # fmt: skip
    run = simulate(unit, scenario).samples
    return Samples(run.time[::KEPT], {name: run[name][::KEPT] for name in run.channels if name != "command"})


def lived(plan: Plan, seed: int, folder: Path, advance: Callable[[float], None]) -> Life:
    """Let an axis live; each night the service is restarted, every other time by a kill."""
    rng, life = np.random.default_rng(seed), Life(plan.severity > 0.0)
    healthy = [recorded(rng, celsius, 120.0) for celsius in (25.0, 35.0, 45.0, 38.0)]
    profile, path = folder / "unit.yaml", folder / "fdd.db"
    add_baseline(identify_unit(healthy, Unit.load(UNIT)).unit, healthy).save(profile)
    config = Serve.from_yaml(
        f"schema: fdd.serve/1\nunits: {{{AXIS}: {profile}}}\nsources: [{{type: udp, port: 0}}]"
    )
    now, cpu, sequence = START_S, 0.0, 0

    def opened() -> tuple[Store, Fleet, Inbox]:
        store = Store(f"sqlite:///{path}")
        fleet = Fleet(config, store, Bus(), clock=lambda: now)
        fleet.resume()
        return store, fleet, fleet.inbox

    store, fleet, inbox = opened()
    for number in range(plan.days * plan.flights):
        day = (number + 0.5) / plan.flights
        # The oil is as warm as the day, give or take 2 K.
        celsius = 35.0 + 8.0 * np.sin(2.0 * np.pi * (day - 0.375)) + rng.normal(scale=2.0)
        run = recorded(rng, celsius, 60.0 * plan.minutes, plan.at(day))
        samples = Samples(run.time + START_S + DAY_S * day, run.columns)
        began = time.process_time()
        for start in range(0, len(samples), BLOCK_ROWS):
            part = samples.rows(start, start + BLOCK_ROWS)
            now = float(part.time[-1])
            inbox.put(Block(AXIS, part, sequence, now))
            sequence += 1
            while fleet.step(0.0):
                pass
        cpu += time.process_time() - began
        life.samples += len(samples)
        life.hours += samples.duration / 3600.0
        advance(life.samples)
        if (number + 1) % plan.flights:
            continue
        killed = int(day) % 2 == 1
        if not killed:
            fleet.keep()
        leakage = fleet.axes()[0].estimates["leakage"]
        store.close()
        life.restarts[killed] += 1
        life.days.append({
            "number": int(day) + 1, "severity": plan.at(day), "leakage": leakage.value or 0.0,
            "std": leakage.std or 0.0, "resident": resident(), "store": path.stat().st_size,
            "cpu_us": 1e6 * cpu / life.samples,
        })  # fmt: skip
        store, fleet, inbox = opened()
    for record in reversed(store.audit()):
        if record["action"] == "RAISED":
            alarm = store.alarm(record["alarm_id"]) or {}
            life.alarms.append(((record["wall"] - START_S) / DAY_S, alarm["fault"], alarm.get("severity")))
    store.close()
    return life


def soak(
    out: OutOption = FOLDER,
    days: Annotated[int, typer.Option(min=3, max=365, help="Of each life.")] = 30,
    flights: Annotated[int, typer.Option(min=1, max=24, help="A day.")] = 6,
    minutes: Annotated[float, typer.Option(min=1.0, max=50.0, help="Of each flight.")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Fixes everything random.")] = 1,
) -> None:
    """Let an axis live for weeks at 100 Hz through the fleet and its store, with restarts (40 min)."""
    require_folder(out)
    plan = Plan(days=days, flights=flights, minutes=minutes, onset=days / 3.0)
    lives = []
    for number, each in enumerate((plan, replace(plan, severity=0.0))):
        with (
            progress(f"life {number + 1} of 2", 6000.0 * minutes * days * flights) as advance,
            tempfile.TemporaryDirectory(prefix="fdd-soak-") as folder,
        ):
            life = lived(each, seed + number, Path(folder), advance)
        print(f"{life.hours:.0f} hours in motion: {len(life.alarms)} alarms")
        leaks = [a for a in life.alarms if life.wears and a[0] >= plan.onset]
        half = life.days[len(life.days) // 2 :]
        growth = np.polyfit([d["number"] for d in half], [d["resident"] / 1e6 for d in half], 1)[0]
        found = next((day for day, name, _ in leaks if name == FAULT), None)
        lives.append((life, growth, len(life.alarms) - len(leaks), found))
    text = render(
        Path(__file__).with_name("soak.md.j2"), made_by=made_by("soak"), load_now=load_now(), plan=plan,
        lives=lives, title=lambda name: fault(name).title,
    )  # fmt: skip
    write_report(out / "soak.md", text)
