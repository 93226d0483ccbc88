"""What each fault does: to the conditions of the plant, or to a measurement.

One function per fault and one table for each kind; a new fault is a catalogue entry and a
line here. Severity 0 leaves every number as it was, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fdd.plant.conditions import AIR, CROSS_LEAKAGE, FRICTION, OPEN_1, OPEN_2, VISCOUS
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
SENSOR_BIAS = 250e3
"""Pa on the differential pressure at severity 1."""
SENSOR_DRIFT = 5e3
"""Pa/s on the differential pressure at severity 1."""


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


PLANT_FAULTS: dict[str, Callable[[Array, Array, FaultSpec, Array, Details], None]] = {
    "internal_leakage": _internal_leakage,
    "seal_wear": _seal_wear,
    "aeration": _aeration,
    "check_valve_stuck_open": _check_valve_stuck_open,
}


def _bias(measured: Array, severity: Array, time: Array) -> Array:
    return measured + severity * SENSOR_BIAS


def _drift(measured: Array, severity: Array, time: Array) -> Array:
    # What has drifted stays: the rate follows the severity, the offset is its integral.
    gained = np.concatenate([[0.0], np.cumsum(severity[:-1] * np.diff(time))])
    return measured + SENSOR_DRIFT * gained


SENSOR_FAULTS: dict[str, tuple[str, Callable[[Array, Array, Array], Array]]] = {
    "pressure_sensor_bias": ("pressure_difference", _bias),
    "pressure_sensor_drift": ("pressure_difference", _drift),
}
"""Fault to the channel whose measurement it falsifies, and how."""


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
    for spec in specs:
        effect = PLANT_FAULTS.get(spec.fault)
        if effect is not None:
            effect(rows, spec.over(time), spec, ratio, details)
