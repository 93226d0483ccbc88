"""``python -m reports soak``: lives of an axis in compressed time, through fleet and store, with restarts."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from fdd.campaign.motion import fitting_duty
from fdd.cli.console import progress
from fdd.diagnosis.baseline import add_baseline
from fdd.faults import fault
from fdd.identification import identify_unit
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.bus import Bus
from fdd.service.config import Serve
from fdd.service.fleet import Fleet
from fdd.service.inbox import Inbox
from fdd.service.store import Store
from fdd.unit import Unit
from reports.service import AXIS, resident
from reports.writing import FOLDER, OutOption, load_now, made_by, render, require_folder, write_report

UNIT, FAULT = "axis_a", "internal_leakage"
DAY_S, START_S, BLOCK_ROWS = 86400.0, 1.7e9, 100
KEPT = 2
"""Of the rows that the plant records at 200 Hz every second one is sent: 100 Hz."""
DUTIES = ("flight", "flight", "steps", "sines")
GAIN = 16_875.0
"""(rad/s)/m of the position loop."""


@dataclass(frozen=True)
class Day:
    """How it stood at a day's end: seconds of processor time a thousand samples took, and bytes."""

    number: int
    severity: float
    leakage: float
    std: float
    resident: int
    store: int
    cpu_us: float


@dataclass
class Life:
    """What became of an axis.

    `hours`: in motion. `alarms`: day, fault and severity told, of each that was raised. `restarts`: clean
    ones, and kills.
    """

    wears: bool
    hours: float = 0.0
    samples: int = 0
    days: list[Day] = field(default_factory=list)
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
            inbox.put(Block(AXIS, part, sequence, "soak", now))
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
        found, size, us = (leakage.value or 0.0, leakage.std or 0.0), path.stat().st_size, cpu / life.samples
        life.days.append(Day(int(day) + 1, plan.at(day), *found, resident(), size, 1e6 * us))
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
        growth = np.polyfit([d.number for d in half], [d.resident / 1e6 for d in half], 1)[0]
        found = next((day for day, name, _ in leaks if name == FAULT), None)
        lives.append((life, growth, len(life.alarms) - len(leaks), found))
    text = render(
        Path(__file__).with_name("soak.md.j2"), made_by=made_by("soak"), load_now=load_now(), plan=plan,
        lives=lives, title=lambda name: fault(name).title,
    )  # fmt: skip
    write_report(out / "soak.md", text)
