"""The cases of the benchmark, and what really happened in a run of one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.eha import layout
from estimators.eha import model as eha
from fdd.residuals.tracking import estimates
from fdd.unit import Unit

Array = NDArray[np.float64]

DURATION = 20.0
"""s of a run."""
WINDOW = 8.0
"""s: what least squares fits, and the last part of the run, over which errors are counted."""

MOTIONS: dict[str, dict[str, Any]] = {
    "steps": {"name": "steps", "amplitude": 0.05, "hold": 1.0},
    "sines": {"name": "sines", "amplitude": 0.04, "low_hz": 0.2, "high_hz": 2.0},
    "prbs": {"name": "prbs", "amplitude": 0.01, "bit": 0.25},
    "flight": {"name": "flight", "amplitude": 0.06, "hold": 2.5, "corrections": 0.05},
    "sawtooth": {"name": "sawtooth", "amplitude": 0.06, "period": 4.0},
    "strokes": {"name": "strokes", "amplitude": 0.05, "rate": 0.06, "dwell": 0.4},
    "standstill": {"name": "standstill"},
}
"""Duty of each name as `fdd.plant.duty` takes it; what is random in it follows the run's seed."""

LOADS: dict[str, dict[str, Any]] = {
    "none": {"name": "none"},
    "constant": {"name": "constant", "level": 1200.0},
    "spring": {"name": "spring", "rate": 1.5e4},
    "throttle": {"name": "throttle", "pressure": 0.3e6},
    "gust": {"name": "gust", "deviation": 300.0, "bandwidth_hz": 1.0, "rate": 8e3},
}
"""Load of each name as `fdd.plant.load` takes it."""

ALL = ("position", "pump_angle", "pump_speed", "pressure_1", "pressure_2", "pressure_difference",
       "pressure_accumulator", "oil_temperature")  # fmt: skip
MINIMUM = ("position", "pump_speed", "pressure_difference")
"""The smallest set that a diagnosis takes."""


@dataclass(frozen=True)
class Case:
    """One case.

    `duty`: of `MOTIONS`. `load`: of `LOADS`. `minimum`: whether the estimators have the `MINIMUM` of sensors
    instead of `ALL`.
    """

    duty: str
    load: str
    minimum: bool = False

    @property
    def name(self) -> str:
        """As the report shows it."""
        return f"{self.duty}, {self.load}, {'minimum' if self.minimum else 'all'}"

    @property
    def channels(self) -> tuple[str, ...]:
        """What the estimators are given."""
        return MINIMUM if self.minimum else ALL


CASES = (
    Case("steps", "none"),
    Case("steps", "constant"),
    Case("steps", "constant", minimum=True),
    Case("sines", "spring"),
    Case("sines", "spring", minimum=True),
    Case("prbs", "none"),
    Case("prbs", "spring", minimum=True),
    Case("flight", "gust"),
    Case("flight", "gust", minimum=True),
    Case("sawtooth", "throttle"),
    Case("strokes", "constant"),
    Case("standstill", "constant"),
    Case("standstill", "none", minimum=True),
)


QUANTITIES = ("leakage", "bulk_modulus", "coulomb_friction", "viscous_friction")
"""What is tracked and reported, in this order everywhere."""
TRACKED = (eha.LEAK, eha.AIR, eha.FRIC, eha.VISC)
"""The state behind each."""


@dataclass(frozen=True)
class Trajectory:
    """What really happened in a run.

    `states`: (n, STATES) in the units of `estimators.eha.model`, one row per sample. `accumulator`: (n,) MPa.
    `viscosity`: (n,) over the reference's.
    """

    states: Array
    accumulator: Array
    viscosity: Array


def quantities(
    states: Array, variances: Array, viscosity: Array, unit: Unit, model: eha.Parameters
) -> tuple[Array, Array]:
    """The tracked quantities and their standard deviations in SI, as `fdd.residuals.tracking.estimates`.

    `states`, `variances`: (n, STATES). `viscosity`: (n,). `unit`, `model`: the profile that the estimators
    have, and its parameter array.

    Gives `values`, `stds`: (4, n) each, in the order of `QUANTITIES`.
    """
    records = np.zeros(states.shape[0], layout.RECORD)
    records["state"], records["variance"], records["viscosity"] = states, variances, viscosity
    values, stds = estimates(records, unit, model)
    return np.array([values[q] for q in QUANTITIES]), np.array([stds[q] for q in QUANTITIES])
