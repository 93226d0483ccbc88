"""Where each quantity stands in the plant's state and among what the equations find on their way; and the
truth, which is read from there: what really was in the plant, row by row beside the samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fdd.plant import Array, Constants
from fdd.plant import conditions as c
from fdd.plant.oil import KELVIN, bulk_modulus, viscosity_ratio
from fdd.unit import Unit

# Shared by all axes on the rod.
X, V, DROP = range(3)
SHARED = 3
"""Piston position (m) and velocity (m/s); pressure drop (Pa) over the throttle of a lumped partner."""

# Of each axis, from its offset on.
(
    P1, P2, LINE_1, LINE_2, STORE, LOST, EXTERNAL_1, EXTERNAL_2, Z, MEMORY, ANGLE, SPEED, DRIVE, CURRENT, GAP,
    TEMPERATURE, VALVE_1, VALVE_2, FREE_1, FREE_2, GAS, RELIEF,
) = range(22)  # fmt: skip
AXIS_STATES = 22
STATES = SHARED + AXIS_STATES
"""States of a single axis; a dual one has `AXIS_STATES` more.

p1, p2 (Pa, gauge) at the cylinder; the same at the pump, which differ where the axis is blocked; oil in the
accumulator, oil lost to the outside, and oil in the external accumulators (m³ at gauge zero and the
reference temperature); mean bristle deflection (m); velocity as the seal remembers it (m/s); motor angle
(rad) and speed (rad/s); integrator of the velocity loop (rad/s²); motor current (A); motor angle ahead of the
pump's (rad); oil temperature (°C); lift of each refeeding valve's poppet (0 to 1); free air of each chamber
(volume at atmospheric pressure over that of oil); absolute temperature of the accumulator's gas over that at
rest; lift of the relief valves, as the excess of pressure (Pa) at which one would rest there, signed by
direction."""

(
    FRICTION_FORCE, LOAD_FORCE, STOP_FORCE, PUMP_FLOW, CROSS_FLOW, BYPASS_FLOW, REFEED_FLOW_1, REFEED_FLOW_2,
    DRAIN_FLOW, RELIEF_FLOW, STUCK_RELIEF_FLOW, OUTSIDE_FLOW, CONNECT_FLOW_1, CONNECT_FLOW_2, ACCUMULATOR,
    CASE_PRESSURE, PORT_DIFFERENCE, MOTOR_TORQUE, LOSSES, OIL_MASS, STORED_OIL,
) = range(21)  # fmt: skip
FINDINGS = 21
"""Of each axis, with the units and meanings of `TRUTH`; its atmospheric density is that at gauge zero and the
reference temperature, by which oil is counted."""

TRUTH: dict[str, tuple[str, str]] = {
    "leakage": ("m^3/(s*Pa)", "L_T = C_ep/2 + ξ at present viscosity, speed, pressure and faults (eq. 3.50)"),
    "bulk_modulus": ("Pa", "effective bulk modulus of the present oil at the unit's reference pressure"),
    "bulk_modulus_1": ("Pa", "effective bulk modulus at the pressure in chamber 1"),
    "bulk_modulus_2": ("Pa", "effective bulk modulus at the pressure in chamber 2"),
    "coulomb_friction": ("N", "Coulomb friction, mean of both directions, this run's spread included"),
    "viscous_friction": ("N*s/m", "viscous friction, mean of both directions"),
    "position": ("m", "piston position"),
    "velocity": ("m/s", "piston velocity"),
    "pressure_1": ("Pa", "chamber 1 pressure, gauge"),
    "pressure_2": ("Pa", "chamber 2 pressure, gauge"),
    "pressure_difference": ("Pa", "chamber pressure difference P1 - P2"),
    "pressure_accumulator": ("Pa", "accumulator pressure, gauge"),
    "pressure_case": ("Pa", "case drain pressure, gauge"),
    "port_difference": ("Pa", "pressure difference at the pump's ports, line losses included"),
    "pump_angle": ("rad", "angle of the motor and its encoder; a worn coupling lets the pump's differ"),
    "pump_speed": ("rad/s", "speed of the motor and its encoder"),
    "motor_current": ("A", "motor current"),
    "motor_torque": ("N*m", "torque of the motor on its shaft"),
    "oil_temperature": ("°C", "oil temperature"),
    "friction_force": ("N", "friction on the piston, positive against extension"),
    "load_force": ("N", "external load on the rod, positive against extension"),
    "stop_force": ("N", "force of the end stops, positive against extension"),
    "pump_flow": ("m^3/s", "flow that the pump displaces, towards chamber 1"),
    "cross_flow": ("m^3/s", "leakage across the ports, from chamber 1 to 2"),
    "bypass_flow": ("m^3/s", "flow over by-pass, throttle and piston seal, from chamber 1 to 2"),
    "refeed_flow_1": ("m^3/s", "flow from the accumulator into chamber 1, at atmospheric density"),
    "refeed_flow_2": ("m^3/s", "flow from the accumulator into chamber 2, at atmospheric density"),
    "drain_flow": ("m^3/s", "case leakage of both chambers into the accumulator, at atmospheric density"),
    "relief_flow": ("m^3/s", "flow over the relief valves, from chamber 1 to 2"),
    "stuck_relief_flow": ("m^3/s", "flow over a relief valve stuck open, from chamber 1 to 2"),
    "outside_flow": ("m^3/s", "flow to the outside, at atmospheric density"),
    "connect_flow_1": ("m^3/s", "flow from the other axis's line 1, at atmospheric density"),
    "connect_flow_2": ("m^3/s", "flow from the other axis's line 2, at atmospheric density"),
    "power_lost": ("W", "power that turns into heat in oil, seals and pump"),
    "oil_lost": ("m^3", "oil gone to the outside less what was charged, at atmospheric density"),
    "oil_mass": ("m^3", "all oil inside and lost, as its volume at atmospheric pressure and 40 °C"),
    "oil_stored": ("m^3", "oil in the accumulator; negative is what the inner circuit lacks"),
    "gas_temperature": ("°C", "temperature of the accumulator's gas"),
}
"""Name to SI unit and meaning."""

_FOUND: dict[str, int] = {name: globals()[name.upper()] for name in TRUTH if name.upper() in globals()} | {
    "pressure_accumulator": ACCUMULATOR, "pressure_case": CASE_PRESSURE, "power_lost": LOSSES,
    "oil_stored": STORED_OIL,
}  # fmt: skip
"""Columns that the equations find on their way."""


@dataclass(frozen=True)
class Truth:
    """Columns aligned with the samples' rows.

    Attributes
    ----------
    time : (n,) s, the samples' own stamps.
    columns : name of `TRUTH` to (n,) values.
    severity : id of each fault of the scenario to (n,) severity, 0 to 1.
    """

    time: Array
    columns: dict[str, Array]
    severity: dict[str, Array] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __len__(self) -> int:
        return int(self.time.size)

    def as_columns(self) -> dict[str, Array]:
        """Everything in one table: the columns, then ``severity_<fault>`` for each fault."""
        return {**self.columns, **{f"severity_{k}": v for k, v in self.severity.items()}}


def truth_columns(
    unit: Unit, par: Constants, rows: Array, states: Array, found: Array, axis: int
) -> dict[str, Array]:
    """Truth of one axis (0 or 1), each column (n,), as `TRUTH` describes them.

    From the axis's conditions (n, COLUMNS), the plant's states (n, states) and findings (n, axes·FINDINGS).
    """
    own, f = states[:, SHARED + axis * AXIS_STATES :], found[:, axis * FINDINGS :]
    air_1, air_2 = own[:, FREE_1], own[:, FREE_2]
    p1, p2, speed = own[:, P1], own[:, P2], own[:, SPEED]
    ratio = viscosity_ratio(unit.oil, own[:, TEMPERATURE]) * rows[:, c.VISCOSITY]
    cross = rows[:, c.CROSS_LEAKAGE] + rows[:, c.SPEED_LEAKAGE] * np.abs(speed) + rows[:, c.SEAL_LEAKAGE]
    drop = f[:, PORT_DIFFERENCE]
    case = 0.25 * (rows[:, c.CASE_LEAKAGE_1] + rows[:, c.CASE_LEAKAGE_2])
    cross = cross + rows[:, c.CROSS_OPENING] * np.abs(drop)
    leakage = (cross + case) / ratio
    if rows[:, c.CROSS_ORIFICE].any():
        # Of the turbulent part its flow over the present pressure, laminar up to a width.
        width = par.orifice_transition * ratio**2
        leakage = leakage + rows[:, c.CROSS_ORIFICE] * 1e-3 / np.sqrt(np.sqrt(drop * drop + width * width))
    film = 1.0 + par.film_share * (np.sqrt(ratio) - 1.0)
    coulomb_forward = par.coulomb_forward * rows[:, c.FRICTION_FORWARD] * rows[:, c.COULOMB_FORWARD]
    coulomb_reverse = par.coulomb_reverse * rows[:, c.FRICTION_REVERSE] * rows[:, c.COULOMB_REVERSE]
    computed = {
        "leakage": leakage,
        "bulk_modulus": bulk_modulus(
            unit.oil, np.full_like(p1, unit.oil.reference_pressure), 0.5 * (air_1 + air_2)
        ),
        "bulk_modulus_1": bulk_modulus(unit.oil, p1, air_1, par.ambient),
        "bulk_modulus_2": bulk_modulus(unit.oil, p2, air_2, par.ambient),
        "coulomb_friction": 0.5 * (coulomb_forward + coulomb_reverse) * film,
        "viscous_friction": 0.5 * (par.viscous_forward + par.viscous_reverse) * rows[:, c.VISCOUS] * ratio,
        "position": states[:, X],
        "velocity": states[:, V],
        "pressure_1": p1,
        "pressure_2": p2,
        "pressure_difference": p1 - p2,
        "pump_angle": own[:, ANGLE],
        "pump_speed": speed,
        "motor_current": own[:, CURRENT],
        "oil_temperature": own[:, TEMPERATURE],
        "oil_lost": own[:, LOST],
        "gas_temperature": own[:, GAS] * (par.surroundings + KELVIN) - KELVIN,
    }
    return {name: f[:, _FOUND[name]] if name in _FOUND else computed[name] for name in TRUTH}
