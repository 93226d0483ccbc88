"""What each fault does: to the conditions of the plant, or to a measurement.

One function per fault and one table for each kind; a new fault is a catalogue entry and a
line here. Severity 0 leaves every number as it was, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fdd.plant.conditions import (
    AIR,
    CASE_LEAKAGE,
    CROSS_LEAKAGE,
    FRICTION,
    OPEN_1,
    OPEN_2,
    REFEED_1,
    REFEED_2,
    RELIEF_OPEN,
    TORQUE,
    VISCOUS,
)
from fdd.plant.details import Details
from fdd.plant.faults.spec import FaultSpec

Array = NDArray[np.float64]

INTERNAL_LEAKAGE = 12e-12
"""Cross-port leakage added at severity 1 and reference viscosity, m³/(s·Pa)."""
FREE_AIR = 0.025
"""Fraction of free air added at severity 1."""
LOOSE, TIGHT = -0.65, 1.0
"""Change of the friction's scale at severity 1."""
STUCK_VALVE_FLOW = 1e-4
"""m³/s at 1 MPa through a check valve stuck open, at severity 1."""
RELIEF_VALVE_FLOW = 1e-4
"""m³/s at 1 MPa through a relief valve stuck open, at severity 1."""
THIN, THICK = -0.5, 1.0
"""Change of the oil's viscosity at severity 1, over what it has at the present temperature."""
TORQUE_LOSS = 0.3
"""Share of the torque constant lost at severity 1."""


def _internal_leakage(rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details) -> None:
    # Laminar like the healthy leakage, so thin oil leaks more through it.
    rows[:, CROSS_LEAKAGE] += severity * INTERNAL_LEAKAGE / ratio


def _seal_wear(rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details) -> None:
    loose = spec.variant == "loose"
    scale = 1.0 + severity * (LOOSE if loose else TIGHT)
    rows[:, FRICTION] *= scale
    rows[:, VISCOUS] *= scale
    if loose:
        rows[:, CROSS_LEAKAGE] += severity * details.loose_seal_leakage / ratio


def _aeration(rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details) -> None:
    rows[:, AIR] += severity * FREE_AIR


def _check_valve_stuck_open(
    rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details
) -> None:
    rows[:, OPEN_1 if spec.side == 1 else OPEN_2] += severity * STUCK_VALVE_FLOW


def _check_valve_clogged(
    rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details
) -> None:
    rows[:, REFEED_1 if spec.side == 1 else REFEED_2] *= 1.0 - severity


def _relief_valve_stuck_open(
    rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details
) -> None:
    rows[:, RELIEF_OPEN] += severity * RELIEF_VALVE_FLOW


def _oil_degradation(rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details) -> None:
    change = 1.0 + severity * (THIN if spec.variant == "thin" else THICK)
    rows[:, CROSS_LEAKAGE] /= change
    rows[:, CASE_LEAKAGE] /= change
    rows[:, VISCOUS] *= change
    ratio *= change


def _motor_degradation(rows: Array, severity: Array, spec: FaultSpec, ratio: Array, details: Details) -> None:
    rows[:, TORQUE] *= 1.0 - TORQUE_LOSS * severity


PLANT_FAULTS: dict[str, Callable[[Array, Array, FaultSpec, Array, Details], None]] = {
    # First: whatever leaks further, leaks the degraded oil.
    "oil_degradation": _oil_degradation,
    "internal_leakage": _internal_leakage,
    "seal_wear": _seal_wear,
    "aeration": _aeration,
    "check_valve_stuck_open": _check_valve_stuck_open,
    "check_valve_clogged": _check_valve_clogged,
    "relief_valve_stuck_open": _relief_valve_stuck_open,
    "motor_degradation": _motor_degradation,
}
"""Fault to what it does, in the order in which a scenario's faults take effect."""


def inject(rows: Array, time: Array, specs: list[FaultSpec], ratio: Array, details: Details) -> None:
    """Put the plant's faults into its conditions, in place.

    Parameters
    ----------
    rows : (n, COLUMNS) conditions.
    time : (n,) s, of each row.
    specs : faults; those of sensors are left to `fdd.plant.sensors`.
    ratio : (n,) viscosity over the reference's.
    details : of the plant.
    """
    ratio = ratio.copy()
    for fault, effect in PLANT_FAULTS.items():
        for spec in specs:
            if spec.fault == fault:
                effect(rows, spec.over(time), spec, ratio, details)
