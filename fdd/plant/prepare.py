"""A scenario made ready to run: constants, state at rest, controller, and the conditions of an axis over any
stretch of it (duty, load, power, valves and faults), as the compiled loop takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.signal import butter, cont2discrete, lfilter

from fdd.errors import InputError
from fdd.plant import PERIOD, Array, Constants
from fdd.plant import conditions as c
from fdd.plant import integrator as loop
from fdd.plant import state as s
from fdd.plant.details import plant_parameters, record
from fdd.plant.duty import ConstantSpeed
from fdd.plant.equations import load_spring
from fdd.plant.faults import STATE_BORNE, inject
from fdd.plant.integrator import new_memory, take_row
from fdd.plant.oil import settled_air, walther_line
from fdd.plant.rig import apply, apply_connect, check_charging
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.faults import position_offset
from fdd.plant.sensors.recording import generator
from fdd.plant.steps import tolerances
from fdd.unit import Unit

FRICTION_TIME = 20.0
"""s, over which wandering friction forgets what it was: assumption, films and seals settle in tens of s."""
_KNOT = 0.1  # s, between which that friction is linear


@dataclass
class Prepared:
    """A scenario ready to run: what the compiled loop takes, and what it changes on its way.

    Attributes
    ----------
    units : of each axis.
    state : of the plant at rest.
    memory, past : of the controllers, see `fdd.plant.integrator.new_memory`.
    parameters : of each axis.
    controller : of the rig.
    viscosity : (axes, 3), Walther's line and the reference viscosity (cSt).
    allowed, longest : error of each state over a step, and the longest step (s).
    setpoints, force : (axes, rows) what the controllers are asked for, and (rows,) N on the rod.
    """

    units: list[Unit]
    scenario: Scenario
    state: Array
    memory: Array
    past: Array
    parameters: list[Constants]
    controller: Constants
    viscosity: Array
    allowed: Array
    longest: float
    setpoints: Array
    force: Array

    def row(self, y: Array, t: int, conditions: tuple[Array, Array, Array]) -> Array:
        """What acts in millisecond t of these conditions at that state, (axes, COLUMNS), as in the loop."""
        now = np.empty(conditions[0].shape[1:])
        for axis, par in enumerate(self.parameters):
            take_row(y, axis, t, *conditions, self.viscosity, self.memory, par, now)
        return now

    def conditions(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """Conditions of some milliseconds, (stop - start, axes, COLUMNS), and what faults that come with load
        and with heat add to them at their full; (0, axes, COLUMNS) where there are none."""
        time, force = np.arange(start, stop, dtype=np.float64) * PERIOD, self.force[start:stop]
        parts = [
            axis_conditions(unit, self.scenario, time, self.setpoints[i, start:stop], force, axis=i + 1)
            for i, unit in enumerate(self.units)
        ]
        first = [spec for spec in self.scenario.faults if spec.axis == 1]
        parts[0][0][:, c.ENCODER_OFFSET] = position_offset(first, start, stop - start, self.scenario.seed)
        # Of a single axis without a copy.
        rows, by_load, by_heat = (
            each[0][:, np.newaxis] if len(each) == 1 else np.stack(each, axis=1)
            for each in zip(*parts, strict=True)
        )
        return rows, by_load, by_heat


def axis_conditions(
    unit: Unit, scenario: Scenario, time: Array, setpoint: Array, force: Array, *, axis: int = 1
) -> tuple[Array, Array, Array]:
    """Everything that changes with time about one axis, at `time` (n,) s: its conditions, (n, COLUMNS), and
    what is added at full load and at full heat, or no rows.

    Each row depends on its own time alone, so a run may be cut anywhere. `setpoint` (n,) is the controller's
    (see `fdd.plant.conditions`), `force` (n,) N on the rod goes with the first axis.
    """
    rows = c.healthy_conditions(unit, setpoint, force)
    rows[:, c.WARMING] = scenario.warming
    if scenario.friction_wander > 0.0:
        both = [c.FRICTION_FORWARD, c.FRICTION_REVERSE]
        rows[:, both] *= _wandering_friction(scenario, time, axis)[:, None]
    own = scenario.partner if axis == 2 and scenario.partner is not None else scenario
    rows[:, c.CURRENT_LIMIT] *= own.power.over(time)
    check_charging(own.circuit, unit, scenario.charge_factor)
    apply(own.circuit, rows, time)
    if axis == 1:
        apply_connect(scenario.connect, rows, time)
    put = partial(inject, time=time, specs=scenario.faults, scales=scenario.fault_scales,
                  details=scenario.details, axis=axis)  # fmt: skip
    put(rows)
    added = dict.fromkeys(STATE_BORNE, rows[:0])
    for profile in {spec.profile for spec in scenario.faults} & set(STATE_BORNE):
        whole = rows.copy()
        put(whole, profile=profile)
        added[profile] = whole - rows
    return rows, added["load"], added["heat"]


def _wandering_friction(scenario: Scenario, time: Array, axis: int) -> Array:
    """Friction of an axis over its mean, (n,) at (n,) s, the same for both directions.

    An Ornstein-Uhlenbeck process (1930, doi 10.1103/PhysRev.36.823), none beyond three standard deviations.
    All of the run is drawn each time, so that a stretch of it is the same bits however the run is cut.
    """
    rng = generator(scenario.seed, f"friction wander{stream_of(axis - 1)}")
    white = rng.standard_normal(math.ceil(scenario.duration / _KNOT) + 2)
    kept = math.exp(-_KNOT / FRICTION_TIME)
    white[1:] *= math.sqrt(1.0 - kept * kept)
    knots = np.clip(lfilter([1.0], [1.0, -kept], white), -3.0, 3.0)
    place = np.clip(time / _KNOT, 0.0, knots.size - 1.001)
    before = place.astype(int)
    share = place - before
    wander = (1.0 - share) * knots[before] + share * knots[before + 1]
    return np.asarray(1.0 + scenario.friction_wander * wander)


def stream_of(axis: int) -> str:
    """What tells an axis's random streams from the other's: nothing for the first."""
    return "" if axis == 0 else f" {axis + 1}"


def prepare(unit: Unit, scenario: Scenario, *, partner: Unit | None = None, refine: float = 1.0) -> Prepared:
    """Turn units and scenario into the compiled loop's arguments; as `fdd.plant.simulate.simulate`."""
    if not 0.25 <= refine <= 64.0:
        raise InputError(f"refine {refine} is out of range", mend="use 0.25 to 64")
    _fits(unit, scenario)
    units, circuits = [unit], [scenario.circuit]
    if scenario.partner is not None:
        units.append(partner or Unit.load(scenario.partner.unit))
        circuits.append(scenario.partner.circuit)
    elif partner is not None:
        raise InputError("a second unit is given, but the scenario has no partner", mend="give it one")
    n, seed = scenario.rows, scenario.seed
    position = scenario.control.mode == "position"
    setpoints = np.zeros((len(units), n))
    setpoints[0] = scenario.duty.setpoint(n, position, generator(seed, "duty"))
    if scenario.partner is not None and scenario.partner.duty is not None:
        setpoints[1] = scenario.partner.duty.setpoint(n, False, generator(seed, "duty 2"))
    force = scenario.load.force(n, generator(seed, "load"))
    mass = sum(u.cylinder.moving_mass for u in units)
    parameters = [
        plant_parameters(
            each, scenario.details, scenario.load, circuit=circuits[i], charge_factor=scenario.charge_factor,
            ambient=scenario.ambient, friction_draw=_friction_draw(each, seed, i),
            surroundings=scenario.oil_temperature, joined_mass=mass - each.cylinder.moving_mass,
            shares=i > 0 and scenario.accumulator == "shared",
        )
        for i, each in enumerate(units)
    ]  # fmt: skip
    controller = _controller(units, scenario)
    none, viscosity = np.zeros(0), np.array([walther_line(each.oil) for each in units])
    ready = Prepared(
        units, scenario, none, none, none, parameters, controller, viscosity, tolerances(len(units), refine),
        PERIOD / refine, setpoints, force,
    )  # fmt: skip
    rows, *_ = ready.conditions(0, 1)
    air = rows[0][:, [c.AIR_1, c.AIR_2, c.VAPOUR]]
    ready.state = _at_rest(units, scenario, parameters, float(force[0]), air[:, :2] + rows[0][:, [c.INGRESS]])
    seen = controller.encoder_gain * ready.state[s.X] + controller.encoder_zero
    ready.memory, ready.past = new_memory(controller, seen, air)
    return ready


def _friction_draw(unit: Unit, seed: int, axis: int) -> tuple[float, float]:
    """This run's friction over the unit's, forward and reverse: Table 5.1's spread from trial to trial."""
    rng = generator(seed, f"friction{stream_of(axis)}")
    spread = np.clip(rng.standard_normal(2), -3.0, 3.0) * unit.friction.trial_spread
    draw = np.maximum(1.0 + spread, 0.1)
    return float(draw[0]), float(draw[1])


def _fits(unit: Unit, scenario: Scenario) -> None:
    """Whether the duty stays within the stroke."""
    duty, half = scenario.duty, 0.5 * unit.cylinder.stroke
    moves = duty.amplitude if scenario.control.mode == "position" or isinstance(duty, ConstantSpeed) else 0.0
    if abs(duty.offset) + moves > 0.95 * half:
        raise InputError(
            f"amplitude {moves:g} m around offset {duty.offset:g} m leaves the stroke of ±{half:g} m",
            where="scenario duty",
            mend=f"keep |offset| + amplitude within {0.95 * half:.3f} m",
        )


def _controller(units: list[Unit], scenario: Scenario) -> Constants:
    """Constants of the controller, SI; it sees the position encoder, not the position."""
    duty, control, unit, last = scenario.duty, scenario.control, units[0], units[-1].drive
    encoder, position = unit.sensor("position"), control.mode == "position"
    shuttle = isinstance(duty, ConstantSpeed)
    follows = {"same": loop.SAME, "still": loop.STILL, "own": loop.OWN}
    b1, b2, a1, a2 = chatter_filter(control.filter_cutoff, PERIOD)
    return record({
        "mode": loop.POSITION if position else loop.SHUTTLE if shuttle else loop.SPEED_COMMAND,
        "gain": control.gain,
        "max_speed": unit.drive.max_speed,
        # Position beyond which a speed command outwards is cut to zero (the rig's interlock).
        "limit": 0.45 * unit.cylinder.stroke,
        "low": duty.offset - duty.amplitude, "high": duty.offset + duty.amplitude,
        # Rest at each end of a shuttle, in milliseconds.
        "dwell": round(duty.dwell * 1000.0) if isinstance(duty, ConstantSpeed) else 0,
        "encoder_gain": encoder.gain, "encoder_zero": encoder.zero, "encoder_resolution": encoder.resolution,
        # Feedback of the filtered, differentiated encoder ((rad/s)/(m/s)).
        "rate_gain": control.rate_gain if position else 0.0,
        "b1": b1, "b2": b2, "a1": a1, "a2": a2,
        "follows": follows[scenario.partner.drive] if scenario.partner else loop.STILL,
        # Delays of the drives (s).
        "delay_1": unit.drive.delay, "delay_2": last.delay, "max_speed_2": last.max_speed,
    })  # fmt: skip


def chatter_filter(cutoff: float, period: float) -> tuple[float, float, float, float]:
    """b1, b2, a1 and a2 of the filter that takes the chatter out of a differentiated encoder (thesis 7.1.1).

    ``y[k] = b1·u[k-1] + b2·u[k-2] - a1·y[k-1] - a2·y[k-2]``, eqs 7.3 and 7.5: a second-order Butterworth
    low-pass of `cutoff` (rad/s), discretised at `period` (s) with a zero-order hold. The thesis says Tustin's
    rule (eq. 7.4), but that would give a term without delay; its printed coefficients, 4.39e-2, -1.514 and
    0.61, are the hold's. Its 5.28e-2 is a misprint of 5.18e-2: only with that a constant passes unchanged.
    """
    top, bottom, _ = cont2discrete(butter(2, cutoff, analog=True), period, method="zoh")
    return top[0, 1], top[0, 2], bottom[1], bottom[2]


def _at_rest(
    units: list[Unit], scenario: Scenario, parameters: list[Constants], force: float, air: Array
) -> Array:
    """The state at which nothing moves: chambers at charge pressure, the first axis's loaded one above it;
    `air` (axes, 2) is that of the chambers, by volume."""
    y = np.zeros(s.SHARED + s.AXIS_STATES * len(units))
    y[s.X] = scenario.duty.offset
    for i, (unit, par) in enumerate(zip(units, parameters, strict=True)):
        o = s.SHARED + i * s.AXIS_STATES
        charge = unit.accumulator.charge_pressure * scenario.charge_factor
        # The rod carries the load and, with unequal areas, the charge pressure's own push.
        push = -charge * (par.area_1 - par.area_2)
        if i == 0:
            push += force + load_spring(y[s.X], par)
        y[o + s.P1] = y[o + s.LINE_1] = charge + max(push, 0.0) / par.area_1
        y[o + s.P2] = y[o + s.LINE_2] = charge + max(-push, 0.0) / par.area_2
        for k, held in enumerate((s.P1, s.P2)):
            y[o + s.FREE_1 + k] = settled_air(y[o + held], air[i, k] * par.air_scale, par)
        warm = scenario.oil_temperature - par.reference_temperature
        y[o + s.GAS] = 1.0
        if not par.shares:
            held_oil = par.shell_volume - par.gas_volume
            y[o + s.STORE] = held_oil * par.store_density * math.exp(-par.expansion * warm)
        if par.blocked:
            y[o + s.LINE_1] = y[o + s.LINE_2] = charge
        if par.external_flow > 0.0:
            for held, pressure in ((s.EXTERNAL_1, y[o + s.P1]), (s.EXTERNAL_2, y[o + s.P2])):
                left = par.external_pressure / max(pressure + par.ambient, 1.0)
                y[o + held] = par.external_volume * max(1.0 - left, 0.0)
        y[o + s.TEMPERATURE] = scenario.oil_temperature
    return y
