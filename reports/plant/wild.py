"""Whether the plant stays within physics: scenarios drawn of everything that the rig allows, each checked."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fdd.campaign.drawing import draw_unit
from fdd.campaign.recipe import Recipe
from fdd.campaign.scenarios import fitting_duty
from fdd.errors import InputError
from fdd.faults import CATALOGUE, PROFILES
from fdd.plant import PERIOD
from fdd.plant import state as s
from fdd.plant.duty import DUTIES, Duty, Levels
from fdd.plant.faults import PLANT_FAULTS
from fdd.plant.integrator import STEPS
from fdd.plant.prepare import Prepared, prepare
from fdd.plant.rig import LOADS
from fdd.plant.scenario import Control, Scenario
from fdd.plant.simulate import RawBlock, raw_blocks
from fdd.unit import Unit
from reports.plant.energies import energies, fine_run


class Wild(NamedTuple):
    """A scenario that may be run, and how often the rig's rules refused one before."""

    unit: Unit
    partner: Unit | None
    scenario: Scenario
    refused: int

    def prepared(self) -> Prepared:
        """Ready to run."""
        return prepare(self.unit, self.scenario, partner=self.partner)


def draw_wild(seed: int, duration: float = 4.0) -> Wild:
    """Draw scenario `seed` of `duration` s: unit, details, duty, load, faults, valves, second axis."""
    rng = np.random.default_rng([2026, seed])
    recipe = Recipe(schema="fdd.recipe/1", healthy_share=1.0, area_mismatch=0.05)
    first, second = (draw_unit(recipe, rng, index) for index in (seed, seed + 1))
    if rng.random() < 0.25:
        # The thesis's 13 cm³, which run empty and full.
        small = Unit.load("axis_a_13cm3").accumulator
        first, second = (
            replace(rig, unit=rig.unit.model_copy(update={"accumulator": small})) for rig in (first, second)
        )
    for refused in range(100):
        dual = rng.random() < 0.4
        with suppress(InputError):
            scenario = _scenario(first.unit, first.details.model_dump(), rng, duration, dual)
            wild = Wild(first.unit, second.unit if dual else None, scenario, refused)
            wild.prepared().conditions(0, 1)
            return wild
    raise RuntimeError(f"no scenario of seed {seed} was allowed")


def _scenario(
    unit: Unit, details: dict[str, Any], rng: np.random.Generator, duration: float, dual: bool
) -> Scenario:
    name = str(rng.choice(list(DUTIES)))
    control: Control
    duty: Duty
    if name == "levels":
        control = Control(mode=rng.choice(["position", "speed"]))
        most = 0.1 if control.mode == "position" else 250.0
        times = np.cumsum(rng.uniform(0.1, 1.0, 5))
        points = [[float(t), float(rng.uniform(-most, most))] for t in times]
        duty = Levels(points=points, linear=bool(rng.random() < 0.5))
    else:
        gain = float(np.exp(rng.uniform(np.log(2e3), np.log(2.5e4))))
        duty, control = fitting_duty(name, unit, rng, {}, speed=bool(rng.random() < 0.4), gain=gain)
        duty = duty.model_copy(update={"lead_in": 0.2})
    if rng.random() < 0.2 and control.mode == "position":
        control = control.model_copy(update={"rate_gain": float(rng.uniform(0.0, 500.0))})
    second: dict[str, Any] = {}
    if dual:
        drive = str(rng.choice(["same", "still", "own"]))
        own = {"name": "prbs", "speed": float(rng.uniform(20, 200)), "bit": 0.2} if drive == "own" else None
        power, circuit = _power(rng), _circuit(rng, may_block=True)
        second["partner"] = {"drive": drive, "duty": own, "power": power, "circuit": circuit}
        second["accumulator"] = str(rng.choice(["shared", "each"]))
        second["connect"] = {line: _opening(rng, 0.4) for line in ("line_1", "line_2")}
    kind = LOADS[str(rng.choice(list(LOADS)))]
    return Scenario(
        unit=unit.name, duration=duration, duty=duty, control=control, details=details,
        load=kind(**{name: float(rng.uniform(*bounds)) for name, bounds in kind.usual.items()}),
        oil_temperature=float(rng.uniform(-20.0, 110.0)), warming=float(rng.uniform(-0.5, 0.5)),
        charge_factor=float(rng.uniform(0.3, 2.5)), ambient=float(rng.uniform(2e4, 1.1e5)),
        faults=_faults(rng, duration, dual), power=_power(rng),
        circuit=_circuit(rng, may_block=dual and rng.random() < 0.3), seed=int(rng.integers(0, 2**62)),
        **second,
    )  # fmt: skip


def _faults(rng: np.random.Generator, duration: float, dual: bool) -> list[dict[str, Any]]:
    """None, one, some or all of the plant's faults, on any axis."""
    names = list(PLANT_FAULTS)
    size = int(rng.choice([0, 1, 1, 1, 2, 3, 5, len(names)]))
    return [
        {
            "fault": entry.id,
            "severity": 1.0 if rng.random() < 0.3 else float(rng.uniform(0.0, 1.0)),
            "onset": float(rng.uniform(0.0, 0.7) * duration) if rng.random() < 0.7 else 0.0,
            "profile": str(rng.choice(PROFILES)),
            "seed": int(rng.integers(0, 1000)),
            "ramp": float(rng.uniform(0.05, 3.0)),
            "period": float(rng.uniform(0.1, 2.0)),
            "side": int(rng.choice(entry.sides)) if entry.sides else None,
            "variant": str(rng.choice(entry.variants)) if entry.variants else None,
            "law": str(rng.choice(list(entry.laws))) if entry.laws else None,
            "axis": int(rng.integers(1, 3)) if dual else 1,
        }
        for entry in (CATALOGUE[str(name)] for name in rng.permutation(names)[:size])
    ]


def _opening(rng: np.random.Generator, share: float) -> Any:
    """Shut, open or moving while the axis runs."""
    if rng.random() > share:
        return 0.0
    if rng.random() < 0.5:
        return float(rng.uniform(0.0, 1.0))
    at = float(rng.uniform(0.3, 3.0))
    return [[0.0, 0.0], [at, 0.0], [at + float(rng.choice([1e-3, 0.5])), float(rng.uniform(0.05, 1.0))]]


def _power(rng: np.random.Generator) -> Any:
    """Mostly on; now and then off, or going off."""
    return [1.0, 1.0, 1.0, 0.0, [[0.0, 1.0], [1.5, 1.0], [1.501, 0.0]], 0.3][int(rng.integers(0, 6))]


def _circuit(rng: np.random.Generator, *, may_block: bool) -> dict[str, Any]:
    accumulators = {"gas_charge": float(rng.uniform(5e4, 9e5)), "valve_flow": float(rng.uniform(1e-6, 1e-4))}
    return {
        "blocked": bool(may_block and rng.random() < 0.5),
        "bypass": _opening(rng, 0.2),
        "throttle": _opening(rng, 0.3),
        "external_leakage": _opening(rng, 0.15),
        "external_leakage_side": int(rng.integers(1, 3)),
        "charging": _opening(rng, 0.15),
        "charging_pressure": float(rng.uniform(5e5, 3e6)),
        "accumulators": accumulators if rng.random() < 0.15 else None,
    }


ENERGY, GIVE = 1e-5, 1e-3
"""Most energy that may be made or lost, over all that went through; m that stops may give way."""


@dataclass(frozen=True)
class Outcome:
    """What one wild run came to: sentences for everything outside physics, lowest absolute pressure (Pa), m
    that the piston went past its stroke, most that oil and energy departed from what came and went, over all
    of it, steps of the integrator for each millisecond, and draws that the rig's rules refused."""

    seed: int
    failures: list[str] = field(default_factory=list)
    lowest_pressure: float = np.nan
    beyond_stop: float = np.nan
    oil: float = np.nan
    energy: float = np.nan
    steps: float = np.nan
    refused: int = 0


def try_wild(seed: int, duration: float = 4.0) -> Outcome:
    """Run one wild scenario and check it."""
    wild = draw_wild(seed, duration)
    ready = wild.prepared()
    try:
        raw = next(iter(raw_blocks(ready, block=wild.scenario.rows)))
    except InputError as error:
        return Outcome(seed, [str(error)], refused=wild.refused)
    return _checked(seed, wild, ready, raw)


def _checked(seed: int, wild: Wild, ready: Prepared, raw: RawBlock) -> Outcome:
    failures = []
    if not (np.isfinite(raw.states).all() and np.isfinite(raw.found).all()):
        return Outcome(seed, ["NaN"], refused=wild.refused)
    par = ready.parameters[0]
    axes = range(len(ready.units))
    own = [raw.states[:, s.SHARED + axis * s.AXIS_STATES :] for axis in axes]
    lowest = float(min(x[:, [s.P1, s.P2, s.LINE_1, s.LINE_2]].min() for x in own) + par.ambient)
    if lowest <= 0.0:
        failures.append(f"absolute pressure {lowest:.0f} Pa")
    beyond = float(np.abs(raw.states[:, s.X]).max() - par.half_stroke)
    if beyond > GIVE:
        failures.append(f"{beyond * 1e3:.2f} mm beyond the stop")
    mass = sum(raw.found[:, axis * s.FINDINGS + s.OIL_MASS] for axis in axes)
    drift = float(np.abs(mass / np.asarray(mass)[0] - 1.0).max())
    if drift > 1e-6:
        failures.append(f"oil changed by {drift:.1e}")
    gap = energy_gap(wild)
    if gap > ENERGY:
        failures.append(f"energy changed by {gap:.1e}")
    # The fastest motor's command, or the oil of pistons and the other pump, explain its speed.
    fastest = [float(np.abs(x[:, s.SPEED]).max()) for x in own]
    worst = int(np.argmax(fastest))
    of = ready.parameters[worst]
    flow = of.area_1 * float(np.abs(raw.states[:, s.V]).max())
    if len(ready.units) > 1:
        flow += ready.parameters[1 - worst].displacement * fastest[1 - worst]
    speed, most = fastest[worst], 1.3 * max(of.max_speed, flow / of.displacement)
    if speed > most:
        failures.append(f"motor at {speed:.0f} rad/s, explained {most:.0f} rad/s")
    steps = float(ready.memory[STEPS]) / raw.states.shape[0]
    return Outcome(seed, failures, lowest, beyond, drift, gap, steps, wild.refused)


def energy_gap(wild: Wild, duration: float = 0.4) -> float:
    """Energy made or lost in the run's first part, over all that went through (`reports.plant.energies`)."""
    unit, partner = (
        each and each.model_copy(update={"drive": each.drive.model_copy(update={"delay": PERIOD})})
        for each in (wild.unit, wild.partner)
    )
    assert unit is not None
    faults = [spec for spec in wild.scenario.faults if spec.onset < duration]
    scenario = wild.scenario.model_copy(update={"duration": duration, "faults": faults})
    share = np.inf
    for nodes in (12, 40, 100):
        # Corners of friction and valves within a millisecond are what the fewer nodes miss.
        run = fine_run(unit, scenario, partner=partner, nodes=nodes)
        gap, through = energies(run).gap(run)
        # A run in which hardly anything moves is judged by a joule.
        share = gap / max(through, 1.0)
        if share <= ENERGY:
            break
    return share
