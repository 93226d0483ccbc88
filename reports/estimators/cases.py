"""The cases of the benchmark, what really happened in a run, and what the estimators take for noise.

The noise is written from the documentation of `estimators.eha.layout.Noise`, not by calling the tracker: the
worlds that are drawn, the bound and filterpy's filter have the same statement to start from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.tracker import EhaTracker
from fdd.residuals.tracking import estimates
from fdd.unit import Unit
from reports.estimators.compiled import njit

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

DURATION = 20.0
"""s of a run."""
WINDOW = 8.0
"""s at the end of a run over which errors are counted."""

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
"""Load of each name as `fdd.plant.rig` takes it."""

ALL = ("position", "pump_angle", "pump_speed", "pressure_1", "pressure_2", "pressure_difference",
       "pressure_accumulator", "oil_temperature")  # fmt: skip
MINIMUM = ("position", "pump_speed", "pressure_difference")
"""The smallest set that a diagnosis takes."""


@dataclass(frozen=True)
class Case:
    """A duty of `MOTIONS` under a load of `LOADS`, with the `MINIMUM` of sensors or `ALL`."""

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


class Trajectory(NamedTuple):
    """What really happened in a run: states (n, STATES) in units of `estimators.eha.model`, pressure of the
    accumulator (n,) in MPa, and viscosity (n,) over the reference's."""

    states: Array
    accumulator: Array
    viscosity: Array


def quantities(
    states: Array, variances: Array, viscosity: Array, unit: Unit, model: eha.Parameters
) -> tuple[Array, Array]:
    """Of states and variances, (n, STATES), `QUANTITIES` and their standard deviations in SI, (4, n) each, as
    `fdd.residuals.tracking.estimates` gives them."""
    records = np.zeros(states.shape[0], layout.RECORD)
    records["state"], records["variance"], records["viscosity"] = states, variances, viscosity
    values, stds = estimates(records, unit, model)
    return np.array([values[q] for q in QUANTITIES]), np.array([stds[q] for q in QUANTITIES])


FORCE_PERIOD = 20
"""ms over which a force balance is averaged."""
SETTLING = 80
"""ms of sliding one way until the friction curve holds."""
LOW_SIDE, LOW_SIDE_TIME = 0.2, 1e4
"""MPa and ms: how near the low side stays to the accumulator, and for how long that is one and the same fact,
where only the pressures' difference is measured."""
MOTION_SPREAD = (1.0, 0.1, 1.0, 0.3, 0.3, 0.3)
"""Standard deviations of the motion states at the start, model units: wide, encoders and pressures set
them."""


class Sizes(NamedTuple):
    """Standard deviations of the noise of motion and measurement for one millisecond, model units.

    `small` and `large` are a chamber's unmodelled volume, shut and where it may be fed or relieved:
    within `margin` above the accumulator's pressure, or from the pressure difference `relief` on.
    """

    force: float
    acceleration: float
    small: float
    large: float
    margin: float
    relief: float
    position: float
    angle: float
    pressure: float
    difference: float
    force_mean: float


class Assumed(NamedTuple):
    """What the filter assumes before any data, (STATES,) in model units: first estimate, standard deviations,
    those of each state's noise over one second, and rate (1/s) at which it is drawn back to its start.

    A walk never gets less certain than the initial spread: that of an Ornstein-Uhlenbeck process with the
    rate q²/2σ₀².
    """

    start: Array
    spread: Array
    walk: Array
    pull: Array
    sizes: Sizes


def assumed(tracker: EhaTracker) -> Assumed:
    """What a tracker that has seen no data assumes."""
    noise, model, per_step = tracker.noise, tracker.model, float(np.sqrt(1e-3))
    spread = np.sqrt(np.diag(tracker.P))
    spread[: eha.P2 + 1] = MOTION_SPREAD
    walk = np.zeros(eha.STATES)
    for state, per_second in (
        (eha.LEAK, noise.leakage), (eha.VALVE1, noise.valve), (eha.VALVE2, noise.valve),
        (eha.AIR, noise.air * 1e3), (eha.SPLIT, noise.air_split * 1e3), (eha.GAIN, noise.gain),
        (eha.FRIC, noise.friction), (eha.VISC, noise.viscous_friction), (eha.SKEW, noise.viscous_skew),
        (eha.ZERO, noise.zero * 1e-6), (eha.LOAD, noise.load), (eha.STIF, noise.stiffness * 1e-3),
        (eha.THROT, noise.throttle), (eha.INERT, noise.inertia),
    ):  # fmt: skip
        walk[state] = per_second if spread[state] > 0.0 else 0.0
    pull = np.divide(0.5 * walk**2, spread**2, out=np.zeros_like(walk), where=spread > 0.0)
    pull[eha.LOAD] = 0.0  # a load goes where it likes
    sizes = Sizes(
        force=noise.force / float(model.moving_mass) * per_step,  # m/s is mm/ms
        acceleration=noise.acceleration * 1e-3 * per_step,
        small=noise.flow * 1e9 * per_step,
        large=noise.flow_refeeding * 1e9 * per_step,
        margin=noise.refeed_margin * 1e-6,
        relief=noise.relief_pressure * 1e-6,
        position=noise.position * 1e3,
        angle=noise.angle,
        pressure=noise.pressure * 1e-6,
        difference=noise.pressure_difference * 1e-6,
        force_mean=noise.force_mean,
    )
    return Assumed(tracker.x.copy(), spread, walk, pull, sizes)


@njit(error_model="numpy")
def chamber_noise(p1: float, p2: float, p_acc: float, known: bool, sizes: Sizes) -> tuple[float, float]:
    """Standard deviation of each chamber's unmodelled volume (mm³) over one millisecond.

    Large where the accumulator may feed the chamber or the relief valve may open. Without a sensor of the
    accumulator's pressure (`known`), the low side always counts as fed.
    """
    fed1 = p1 < p_acc + sizes.margin if known else p1 <= p2
    fed2 = p2 < p_acc + sizes.margin if known else p2 < p1
    relieved = abs(p1 - p2) > sizes.relief
    small, large = sizes.small, sizes.large
    return large if relieved or fed1 else small, large if relieved or fed2 else small
