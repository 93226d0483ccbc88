"""What each fault does to the conditions of the plant.

One function per fault and one table; those of sensors are in `fdd.plant.sensors.faults`. A new fault is a
catalogue entry and a line here. Severity 0 leaves every number as it was, bit for bit. Figures are those of
`fdd.plant.faults.scales`; leakages go in at the oil's reference temperature, as all conditions do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fdd.plant import conditions as c
from fdd.plant.details import Details
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec

Array = NDArray[np.float64]

_MEGAPASCAL = 1e6
_WEAR_SPEED = 100.0  # rad/s, at which the scale of pump wear is given

Effect = Callable[[Array, Array, FaultSpec, FaultScales, Details], None]


def _internal_leakage(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    turbulent = by.internal_leakage_orifice_share
    rows[:, c.CROSS_LEAKAGE] += severity * by.internal_leakage * (1.0 - turbulent)
    rows[:, c.CROSS_ORIFICE] += severity * by.internal_leakage * turbulent * _MEGAPASCAL


def _external_leakage(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    rows[:, c.OUTSIDE_1 if spec.side == 1 else c.OUTSIDE_2] += severity * by.external_leakage


def _pump_wear(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    rows[:, c.SPEED_LEAKAGE] += severity * by.pump_wear_leakage / _WEAR_SPEED
    rows[:, c.DISPLACEMENT] *= 1.0 - severity * by.pump_wear_displacement_loss
    rows[:, c.RIPPLE] += severity * by.pump_wear_ripple


def _case_drain_seal_failure(
    rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details
) -> None:
    rows[:, c.CASE_LEAKAGE] += severity * by.case_leakage


def _shaft_seal_wear(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    rows[:, c.SHAFT_LEAKAGE] += severity * by.shaft_leakage_flow / by.shaft_leakage_pressure


def _seal_wear(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, details: Details) -> None:
    kind, _, direction = str(spec.variant).partition("_")
    loose = kind == "loose"
    change = (by.loose_friction if loose else by.tight_friction) - 1.0
    if direction != "reverse":
        rows[:, c.FRICTION_FORWARD] *= 1.0 + severity * change
    if direction != "forward":
        rows[:, c.FRICTION_REVERSE] *= 1.0 + severity * change
    rows[:, c.VISCOUS] *= 1.0 + severity * (0.5 * change if direction else change)
    if loose:
        rows[:, c.SEAL_LEAKAGE] += severity * details.loose_seal_leakage
        rows[:, c.OUTSIDE_1] += severity * by.loose_rod_leakage
        rows[:, c.OUTSIDE_2] += severity * by.loose_rod_leakage


def _aeration(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    rows[:, c.AIR] += severity * by.free_air


def _check_valve_stuck_open(
    rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details
) -> None:
    rows[:, c.OPEN_1 if spec.side == 1 else c.OPEN_2] += severity * by.check_valve_flow


def _check_valve_clogged(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    rows[:, c.REFEED_1 if spec.side == 1 else c.REFEED_2] *= 1.0 - severity * by.check_valve_clogging


def _relief_valve_stuck_open(
    rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details
) -> None:
    rows[:, c.RELIEF_OPEN] += severity * by.relief_valve_flow


def _oil_degradation(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    # The plant itself takes viscosity into leakages and viscous friction.
    target = by.thin_viscosity if spec.variant == "thin" else by.thick_viscosity
    rows[:, c.VISCOSITY] *= 1.0 + severity * (target - 1.0)


def _motor_degradation(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    rows[:, c.TORQUE] *= 1.0 - severity * by.torque_loss
    rows[:, c.RESISTANCE] *= 1.0 + severity * by.resistance_gain
    rows[:, c.CURRENT_LIMIT] *= 1.0 - severity * by.current_limit_loss


def _coupling_wear(rows: Array, severity: Array, spec: FaultSpec, by: FaultScales, _: Details) -> None:
    rows[:, c.PLAY] += severity * by.coupling_play
    rows[:, c.ECCENTRICITY] += severity * by.coupling_eccentricity


PLANT_FAULTS: dict[str, Effect] = {
    "internal_leakage": _internal_leakage,
    "external_leakage": _external_leakage,
    "pump_wear": _pump_wear,
    "case_drain_seal_failure": _case_drain_seal_failure,
    "shaft_seal_wear": _shaft_seal_wear,
    "seal_wear": _seal_wear,
    "aeration": _aeration,
    "check_valve_stuck_open": _check_valve_stuck_open,
    "check_valve_clogged": _check_valve_clogged,
    "relief_valve_stuck_open": _relief_valve_stuck_open,
    "oil_degradation": _oil_degradation,
    "motor_degradation": _motor_degradation,
    "coupling_wear": _coupling_wear,
}
"""Fault to what it does, in the order in which a scenario's faults take effect."""


def inject(
    rows: Array,
    time: Array,
    specs: Sequence[FaultSpec],
    scales: FaultScales,
    details: Details,
    *,
    axis: int = 1,
) -> None:
    """Put an axis's plant faults into its conditions, in place.

    Parameters
    ----------
    rows : (n, COLUMNS) conditions; any stretch of a run.
    time : (n,) s, of each row.
    specs : the scenario's faults; those of sensors and of the other axis are passed over.
    scales : figures of severity 1.
    details : of the plant.
    axis : 1 or 2, whose rows these are.
    """
    mine = [spec for spec in specs if spec.axis == axis]
    for name, effect in PLANT_FAULTS.items():
        for spec in mine:
            if spec.fault == name:
                effect(rows, spec.over(time), spec, scales, details)
