"""The plant's right-hand side: one axis, or two on one rod.

Each axis has its own hydraulics, drive and seal friction; piston position and velocity are shared, since the
cylinders are joined at the shaft (section 4.5), and connect valves may join the lines (section 4.6.6).
`fdd.plant.state` says where everything stands.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.plant.compiled import njit
from fdd.plant.conditions import CONNECT_1, CONNECT_2, FORCE, STORE_SPECIFIC, WARMING
from fdd.plant.drive import drive_rates
from fdd.plant.friction import friction_rates
from fdd.plant.hydraulics import gas_rate, hydraulic_rates
from fdd.plant.laws import oil_at, orifice, store_pressure
from fdd.plant.parameters import Constants
from fdd.plant.state import (
    ACCUMULATOR,
    AXIS_STATES,
    DROP,
    FINDINGS,
    FRICTION_FORCE,
    GAS,
    LINE_1,
    LINE_2,
    LOAD_FORCE,
    LOSSES,
    MOTOR_TORQUE,
    P1,
    P2,
    SHARED,
    SPEED,
    STATES,
    STOP_FORCE,
    STORE,
    TEMPERATURE,
    V,
    X,
)

Array = NDArray[np.float64]


@njit(error_model="numpy", inline="always")
def axis_rates(
    y: Array, x: float, v: float, command: float, pa: float, linked_1: float, linked_2: float, now: Array,
    par: Constants, dy: Array, found: Array,
) -> float:  # fmt: skip
    """Force of one axis on the rod (N); fills its rates and findings."""
    resisting, heat, rise_1, rise_2, rise_a, rise_b = hydraulic_rates(
        y, x, v, pa, linked_1, linked_2, now, par, dy, found
    )
    torque, turning = drive_rates(y, command, resisting, now, par, dy)
    friction = friction_rates(y, x, v, now, par, dy)
    heat += abs(friction * v) + abs(turning * y[SPEED])
    cooling = par.cooling * (y[TEMPERATURE] - par.surroundings)
    warming = now[WARMING] + (heat - cooling) / par.heat_capacity
    dy[TEMPERATURE] = warming
    # Oil swells in every volume.
    dy[P1] += rise_1 * warming
    dy[P2] += rise_2 * warming
    dy[LINE_1] += rise_a * warming
    dy[LINE_2] += rise_b * warming
    found[FRICTION_FORCE] = friction
    found[MOTOR_TORQUE] = torque
    found[LOSSES] = heat
    return par.area_1 * y[P1] - par.area_2 * y[P2] - friction


@njit(error_model="numpy", inline="always")
def accumulator_pressure(y: Array, now: Array, par: Constants) -> float:
    """Gauge pressure (Pa) of an axis's accumulator."""
    return store_pressure(y[STORE] * now[STORE_SPECIFIC], y[GAS], par)


@njit(error_model="numpy", inline="always")
def load_spring(x: float, par: Constants) -> float:
    """Force of the load's spring (N): through a hinge's play, and of a press only where it touches."""
    reach = x - par.spring_centre
    if par.spring_play > 0.0:
        reach = max(reach - par.spring_play, 0.0) + min(reach + par.spring_play, 0.0)
    if par.one_sided > 0.0:
        reach = max(reach, 0.0)
    return par.spring * reach


@njit(error_model="numpy", inline="always")
def end_stop(x: float, v: float, par: Constants) -> float:
    """Force of stops and cushions, positive against extension (N).

    A cushion throttles the oil that the piston pushes out of the cylinder's end and lets it back freely.
    """
    force = 0.0
    if x * v > 0.0:
        depth = (abs(x) - par.half_stroke) / par.cushion_length + 1.0
        if depth > 0.0:
            force = par.cushion_damping * min(depth, 1.0) * v * abs(v)
    if x > par.half_stroke:
        force += max(par.stop_stiffness * (x - par.half_stroke) * (1.0 + par.stop_damping * v), 0.0)
    elif x < -par.half_stroke:
        force += min(par.stop_stiffness * (x + par.half_stroke) * (1.0 - par.stop_damping * v), 0.0)
    return force


# Its arrays are borrowed: without counting references to them (_nrt) it takes a quarter less time.
@njit(error_model="numpy", _nrt=False)
def right_hand_side(
    y: Array,
    command_1: float,
    command_2: float,
    now: Array,
    first: Constants,
    second: Constants,
    dy: Array,
    found: Array,
) -> None:
    """Time derivative of the state.

    Parameters
    ----------
    y : (STATES,) for one axis, (STATES + AXIS_STATES,) for two.
    command_1, command_2 : rad/s, speeds demanded of the drives (after their delay).
    now : (axes, COLUMNS) conditions of this millisecond, at the present viscosity.
    first, second : constants of each axis; load, stops and mass are the first's.
    dy : as y, is filled with the derivative.
    found : (axes·FINDINGS,) is filled with forces, flows, pressures.
    """
    x, v = y[X], y[V]
    row = now[0]
    linked_1, linked_2 = 0.0, 0.0
    o = SHARED + AXIS_STATES
    dual = y.size > STATES
    if dual and (row[CONNECT_1] != 0.0 or row[CONNECT_2] != 0.0):
        # From the second axis's lines into the first's, at the mean of their densities.
        a, b = y[SHARED + LINE_1], y[SHARED + LINE_2]
        a_2, b_2 = y[o + LINE_1], y[o + LINE_2]
        warm = y[SHARED + TEMPERATURE] - first.reference_temperature
        _, log_a, _, _ = oil_at(0.5 * (a + a_2), 0.0, warm, 1.0, first)
        _, log_b, _, _ = oil_at(0.5 * (b + b_2), 0.0, warm, 1.0, first)
        linked_1 = math.exp(log_a) * orifice(a_2 - a, row[CONNECT_1], first.orifice_transition)
        linked_2 = math.exp(log_b) * orifice(b_2 - b, row[CONNECT_2], first.orifice_transition)
    own, rates = y[SHARED:o], dy[SHARED:o]
    pa = accumulator_pressure(own, row, first)
    force = axis_rates(own, x, v, command_1, pa, linked_1, linked_2, row, first, rates, found[:FINDINGS])
    if dual:
        own_2, rates_2 = y[o:], dy[o:]
        if second.shares <= 0.0:
            pa = accumulator_pressure(own_2, now[1], second)
        force += axis_rates(
            own_2, x, v, command_2, pa, -linked_1, -linked_2, now[1], second, rates_2, found[FINDINGS:]
        )
        if second.shares > 0.0:
            # One accumulator serves both inner circuits (section 4.3).
            rates[STORE] += rates_2[STORE]
            rates_2[STORE] = 0.0
        gas_rate(own_2, pa, now[1], second, rates_2)
    gas_rate(own, found[ACCUMULATOR], row, first, rates)

    drop = y[DROP]
    load = row[FORCE] + load_spring(x, first) + first.partner_area * drop
    dy[DROP] = 0.0
    if first.partner_area > 0.0:
        width = first.orifice_transition
        through = drop / math.sqrt(first.throttle * math.sqrt(drop * drop + width * width))
        dy[DROP] = (first.partner_area * v - through) / first.partner_compliance
    stop = end_stop(x, v, first)
    dy[X] = v
    dy[V] = (force - load - stop) / first.mass
    found[LOAD_FORCE] = load
    found[STOP_FORCE] = stop
    if dual:
        found[FINDINGS + LOAD_FORCE] = load
        found[FINDINGS + STOP_FORCE] = stop
