"""Servomotor: velocity loop, current loop, winding and shaft (eqs 3.20 to 3.29), compiled.

The velocity loop is the PI controller with feed-forward whose closed loop has the poles and the zero of
eq. 6.11; behind it the drive's current loop is a lag of its own, for which the PI's gains make room (a third
pole far to the left). Voltage and current are limited, the winding has resistance and inductance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.plant.compiled import njit
from fdd.plant.conditions import BRAKING, CURRENT_LIMIT, DRAG, PHASE, RESISTANCE, TORQUE
from fdd.plant.parameters import Constants
from fdd.plant.state import ANGLE, CURRENT, DRIVE, SPEED

Array = NDArray[np.float64]


@njit(error_model="numpy", inline="always")
def drive_rates(
    y: Array, command: float, hydraulic_torque: float, now: Array, par: Constants, dy: Array
) -> tuple[float, float]:
    """Motor torque and the friction's (N·m); fills the rates of angle, speed, integrator and current.

    A gear pump's torque loss is a constant, a share of its load and a viscous part (McCandlish and Dorey,
    doi:10.1243/PIME_PROC_1984_198_062_02).
    """
    speed, integrator, current = y[SPEED], y[DRIVE], y[CURRENT]
    # Dead band of the command's input (Table 6.1).
    if command > par.command_dead_band:
        command -= par.command_dead_band
    elif command < -par.command_dead_band:
        command += par.command_dead_band
    else:
        command = 0.0
    # Accelerations that the loop asks for; it knows the healthy motor's constants and viscous friction.
    wanted = integrator - par.loop_gain * speed + par.loop_feed * command
    demand = (par.inertia * wanted + par.rotary_viscous * speed) / par.torque_constant
    limit = par.current_limit * now[CURRENT_LIMIT]
    allowed = min(max(demand, -limit), limit)
    # Current loop: its integral part, quicker than all else here, has made up for resistance and back EMF
    # whatever they have become, or a degraded motor would take more than the limit. Within its voltage.
    share = now[TORQUE]
    opposing = par.winding_resistance * now[RESISTANCE] * current + par.back_emf * share * speed
    voltage = opposing + par.winding_inductance * par.current_rate * (allowed - current)
    voltage = min(max(voltage, -par.voltage_limit), par.voltage_limit)
    dy[CURRENT] = (voltage - opposing) / par.winding_inductance
    if now[PHASE] != 0.0:
        # Two phases of three: the torque swings with twice the electrical angle.
        share *= 1.0 - 0.5 * now[PHASE] * (1.0 + math.cos(2.0 * par.pole_pairs * y[ANGLE]))
    # Magnets and slots pull without current; shorted turns brake.
    torque = par.torque_constant * share * current - now[BRAKING] * speed
    if par.cogging_torque != 0.0:
        torque -= par.cogging_torque * math.sin(2.0 * par.pole_pairs * y[ANGLE])
    # Dry friction of shaft and gears, which the load presses together, and the oil that they shear.
    dry = par.rotary_coulomb + par.pump_friction * abs(hydraulic_torque)
    turning = (par.rotary_viscous + par.pump_drag * now[DRAG]) * speed
    turning += dry * speed / math.sqrt(1.0 + speed * speed)
    dy[ANGLE] = speed
    dy[SPEED] = (torque - hydraulic_torque - turning) / par.inertia
    # What the limit takes away does not wind the integrator up.
    dy[DRIVE] = (
        par.loop_integral * (command - speed)
        + par.loop_gain * par.torque_constant * (allowed - demand) / par.inertia
    )
    if now[CURRENT_LIMIT] <= 0.0:
        # Without power the drive's outputs are off: no current, and the loop is held at rest.
        dy[CURRENT] = -par.current_rate * current
        dy[DRIVE] = -par.loop_gain * integrator
    return torque, turning
