"""Where each quantity stands in the plant's state and among what the equations find on their way."""

from __future__ import annotations

# Shared by all axes on the rod.
X, V, DROP = range(3)
SHARED = 3
"""Piston position (m) and velocity (m/s); pressure drop (Pa) over the throttle of a lumped partner."""

# Of each axis, from its offset on.
(
    P1,
    P2,
    LINE_1,
    LINE_2,
    STORE,
    LOST,
    EXTERNAL_1,
    EXTERNAL_2,
    Z,
    MEMORY,
    ANGLE,
    SPEED,
    DRIVE,
    CURRENT,
    GAP,
    TEMPERATURE,
    VALVE_1,
    VALVE_2,
    FREE_1,
    FREE_2,
) = range(20)
AXIS_STATES = 20
STATES = SHARED + AXIS_STATES
"""States of a single axis; a dual one has `AXIS_STATES` more.

p1, p2 (Pa, gauge) at the cylinder; the same at the pump, which differ where the axis is blocked; oil taken
by the accumulator since the start, and oil lost to the outside (m³ at atmospheric density); oil in the
external accumulators (m³); mean bristle deflection (m); velocity as the seal remembers it (m/s); motor angle
(rad) and speed (rad/s); integrator of the velocity loop (rad/s²); motor current (A); motor angle ahead of the
pump's (rad); oil temperature (°C); opening of each refeeding valve (0 to 1), where its poppet takes time;
share of each chamber's air that is free, where air dissolves."""

(
    FRICTION_FORCE,
    LOAD_FORCE,
    STOP_FORCE,
    PUMP_FLOW,
    CROSS_FLOW,
    BYPASS_FLOW,
    REFEED_FLOW_1,
    REFEED_FLOW_2,
    DRAIN_FLOW,
    RELIEF_FLOW,
    STUCK_RELIEF_FLOW,
    OUTSIDE_FLOW,
    CONNECT_FLOW_1,
    CONNECT_FLOW_2,
    ACCUMULATOR,
    CASE_PRESSURE,
    PORT_DIFFERENCE,
    MOTOR_TORQUE,
    LOSSES,
    OIL_MASS,
) = range(20)
FINDINGS = 20
"""Of each axis: forces (N), flows (m³/s; refeeding, drain, outside and connecting ones at atmospheric
density), pressures of accumulator and case (Pa, gauge) and across the pump's ports (Pa), torque of the motor
on its shaft (N·m), power turned into heat (W), all the oil inside and lost (m³ at atmospheric density)."""
