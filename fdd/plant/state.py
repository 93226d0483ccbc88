"""Where each quantity stands in the plant's state and among what the equations find on their way."""

from __future__ import annotations

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
"""Of each axis: forces (N), flows (m³/s; refeeding, drain, outside and connecting ones at the density that
oil is counted at), pressures of accumulator and case (Pa, gauge) and across the pump's ports (Pa), torque of
the motor on its shaft (N·m), power turned into heat in the oil (W), all the oil inside and lost (m³ at gauge
zero and the reference temperature), oil in the accumulator (m³ as it is; negative where it is empty)."""
