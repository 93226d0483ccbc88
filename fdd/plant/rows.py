"""The conditions of an axis over a run, or any stretch of it: duty, load, power, valves and faults."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fdd.plant import conditions as c
from fdd.plant.circuit import apply, apply_connect, check_charging
from fdd.plant.faults.injection import STATE_BORNE, inject
from fdd.plant.scenario import Scenario
from fdd.plant.sensors import generator
from fdd.unit import Unit

Array = NDArray[np.float64]

FRICTION_TIME = 20.0
"""s, over which wandering friction forgets what it was: assumption, films and seals settle in tens of s."""
_KNOT = 0.1  # s, between which that friction is linear


class AxisConditions(NamedTuple):
    """Conditions of an axis, (n, COLUMNS), and what is added at full load and at full heat, if anything."""

    rows: Array
    by_load: Array | None
    by_heat: Array | None


def axis_conditions(
    unit: Unit, scenario: Scenario, time: Array, setpoint: Array, force: Array, *, axis: int = 1
) -> AxisConditions:
    """Everything that changes with time about one axis, at `time` (n,) s.

    Each row depends on its own time alone, so a run may be cut anywhere. `setpoint` (n,) is the controller's
    (see `fdd.plant.conditions`), `force` (n,) N on the rod goes with the first axis.

    Raises
    ------
    InputError : charging that the unit's pressures rule out.
    """
    rows = c.healthy_conditions(unit, setpoint, force)
    rows[:, c.WARMING] = scenario.warming
    if scenario.friction_wander > 0.0:
        both = [c.FRICTION_FORWARD, c.FRICTION_REVERSE]
        rows[:, both] *= _wandering_friction(scenario, time, axis)[:, None]
    partner = scenario.partner
    circuit, power = scenario.circuit, scenario.power
    if axis == 2 and partner is not None:
        circuit, power = partner.circuit, partner.power
    rows[:, c.CURRENT_LIMIT] *= power.over(time)
    check_charging(circuit, unit, scenario.charge_factor)
    apply(circuit, rows, time)
    if axis == 1:
        apply_connect(scenario.connect, rows, time)
    put = partial(inject, time=time, specs=scenario.faults, scales=scenario.fault_scales,
                  details=scenario.details, axis=axis)  # fmt: skip
    put(rows)
    added: dict[str, Array | None] = dict.fromkeys(STATE_BORNE)
    for profile in {spec.profile for spec in scenario.faults if spec.axis == axis} & set(STATE_BORNE):
        whole = rows.copy()
        put(whole, profile=profile)
        added[profile] = whole - rows
    return AxisConditions(rows, added["load"], added["heat"])


def _wandering_friction(scenario: Scenario, time: Array, axis: int) -> Array:
    """Friction of an axis over its mean, (n,) at (n,) s, the same for both directions.

    An Ornstein-Uhlenbeck process (1930, doi 10.1103/PhysRev.36.823), none beyond three standard deviations.

    All of the run is drawn each time, so that a stretch of it is the same bits however the run is cut.
    """
    rng = generator(scenario.seed, "friction wander" + ("" if axis == 1 else f" {axis}"))
    white = rng.standard_normal(math.ceil(scenario.duration / _KNOT) + 2)
    kept = math.exp(-_KNOT / FRICTION_TIME)
    white[1:] *= math.sqrt(1.0 - kept * kept)
    knots = np.clip(lfilter([1.0], [1.0, -kept], white), -3.0, 3.0)
    place = np.clip(time / _KNOT, 0.0, knots.size - 1.001)
    before = place.astype(int)
    share = place - before
    wander = (1.0 - share) * knots[before] + share * knots[before + 1]
    return np.asarray(1.0 + scenario.friction_wander * wander)


def partner_setpoint(scenario: Scenario, n: int, rng: np.random.Generator) -> Array:
    """The partner's own speed command, (n,) rad/s for n ms; zeros where it has none."""
    duty = scenario.partner.duty if scenario.partner is not None else None
    return np.zeros(n) if duty is None else duty.setpoint(n, False, rng)
