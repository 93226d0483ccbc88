"""Both estimators on one axis, set up from its profile and the channels it has."""

from __future__ import annotations

import math

import numpy as np

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.layout import Noise
from estimators.eha.tracker import EhaTracker
from estimators.eha.walk import drifts
from estimators.observability import Observability, Observed
from fdd.residuals.compiled import Array, Flags
from fdd.residuals.oil import viscosity_ratio
from fdd.restorable import Restorable
from fdd.samples import Samples
from fdd.tolerances import RELIEF_SHUT
from fdd.unit import FrictionBranch, Unit

METHODS = ("ekf", "svsf")

OBSERVABLE = {
    "leakage": (0.05, 0.07), "bulk_modulus": (0.05, 0.07),
    "coulomb_friction": (0.10, 0.15), "viscous_friction": (0.20, 0.30),
}  # fmt: skip
"""A quantity is called observable while its standard deviation is below the first share of its value, and
until it exceeds the second (hysteresis against flicker)."""
QUANTITIES = {
    "leakage": eha.LEAK, "bulk_modulus": eha.AIR, "coulomb_friction": eha.FRIC, "viscous_friction": eha.VISC,
}  # fmt: skip
"""Tracked quantities and the states of the model that they follow from."""
INFORMATION_S = 5.0
"""s that information is counted over: a stroke or two."""
COLUMNS = {
    layout.POSITION: "position", layout.ANGLE: "pump_angle", layout.SPEED: "pump_speed",
    layout.PRESSURE_1: "pressure_1", layout.PRESSURE_2: "pressure_2",
    layout.DIFFERENCE: "pressure_difference", layout.ACCUMULATOR: "pressure_accumulator",
}  # fmt: skip
"""The filters' columns and the channels that they are, but for their sensors' zeros and gains."""
RATED_FORCE, RATED_SPEED, STROKE = 5.23e3, 0.115, 0.30
"""N, m/s, m: of the thesis's axes (sections 4.4 and 4.5), by which `Noise` argues its defaults of loads."""
LOAD_NOISE = {
    "force": (1, 0, 0), "force_mean": (1, 0, 0), "load": (1, 0, 0), "inertia": (1, 0, 0),
    "stiffness": (1, 0, -1), "throttle": (1, -2, 0), "viscous_friction": (1, -1, 0),
    "viscous_skew": (1, -1, 0),
}  # fmt: skip
"""Noise of force and load, and the powers of rated force, rated speed and stroke that it goes by."""
COMPLIANCE_ERROR = 0.1
"""Relative standard deviation of the oil's compliance, of a unit that was identified but for it: an
assumption. What a profile without identified numbers says is taken as it is."""
VELOCITY_ERROR = 0.01
"""Of the rated speed, that a mean velocity may err by where the flow is linearised."""
THERMAL_GAIN = 5e-4
"""Relative change of displacement over area within 30 K: metals grow by 1 to 2.5e-5 per kelvin."""


def model_parameters(unit: Unit) -> eha.Parameters:
    """The unit's numbers as the reduced model takes them."""

    def branch(b: FrictionBranch) -> tuple[float, float, float, float]:
        return b.coulomb, max(b.static, b.coulomb), b.stribeck_velocity, b.stribeck_exponent

    return eha.parameters(
        area_1=unit.cylinder.area_1, area_2=unit.cylinder.area_2,
        volume_1=unit.cylinder.volume_1, volume_2=unit.cylinder.volume_2,
        moving_mass=unit.cylinder.moving_mass, displacement=unit.pump.displacement,
        cross_port_leakage=unit.pump.cross_port_leakage, case_leakage=unit.pump.case_leakage,
        bulk_modulus=unit.oil.bulk_modulus, air_fraction=unit.oil.air_fraction,
        polytropic_index=unit.oil.polytropic_index, reference_pressure=unit.oil.reference_pressure,
        friction_forward=branch(unit.friction.forward), friction_reverse=branch(unit.friction.reverse),
        accumulator_pressure=unit.accumulator.charge_pressure,
        position_compliance=unit.cylinder.position_compliance,
    )  # fmt: skip


def noise_of(unit: Unit) -> Noise:
    """Measurement noise from the profile's sensors; process noise as its defaults argue, of forces and loads
    by this machine's rated ones.

    What the profile's `estimation` gives goes before both.
    """
    noise, cylinder = Noise(), unit.cylinder
    area = 0.5 * (cylinder.area_1 + cylinder.area_2)
    speed = unit.pump.displacement * unit.drive.max_speed / area
    force = area * unit.accumulator.relief_pressure
    over = force / RATED_FORCE, speed / RATED_SPEED, cylinder.stroke / STROKE
    for name, powers in LOAD_NOISE.items():
        for field in (name, f"initial_{name}"):
            if hasattr(noise, field):
                setattr(noise, field, getattr(noise, field) * float(np.prod(np.power(over, powers))))
    position, angle = (
        math.hypot(sensor.noise, sensor.resolution / math.sqrt(12.0))
        for sensor in map(unit.sensor, ("position", "pump_angle"))
    )
    noise.position, noise.angle = max(noise.position, position), max(noise.angle, angle)
    # Over so long the difference of two positions tells the velocity well enough.
    noise.smoothing = math.sqrt(2.0) * noise.position / (VELOCITY_ERROR * speed)
    chambers = [unit.sensor(c).noise for c in ("pressure_1", "pressure_2") if c in unit.sensors]
    noise.pressure = max(chambers, default=0.0) or noise.pressure
    noise.pressure_difference = unit.sensor("pressure_difference").noise or noise.pressure_difference
    noise.initial_gain = gain_spread(unit)
    modulus_std = unit.oil.std_of("bulk_modulus")
    if modulus_std is not None:
        noise.compression = modulus_std / unit.oil.bulk_modulus
    elif unit.pump.std_of("displacement") is not None:
        noise.compression = COMPLIANCE_ERROR
    noise.relief_pressure = RELIEF_SHUT * unit.accumulator.relief_pressure
    if unit.estimation is not None:
        for name, value in unit.estimation.known.items():
            setattr(noise, name, value)
    return noise


def gain_spread(unit: Unit) -> float:
    """Standard deviation of the pump's gain: the profile's own, or a shipped profile's for another unit."""
    std = unit.pump.std_of("displacement")
    return Noise().initial_gain if std is None else math.hypot(std / unit.pump.displacement, THERMAL_GAIN)


def healthy_viscous(unit: Unit) -> float:
    """Mean viscous friction of both directions, N·s/m."""
    return 0.5 * (unit.friction.forward.viscous + unit.friction.reverse.viscous)


def healthy_coulomb(unit: Unit) -> float:
    """Mean Coulomb friction of both directions, N."""
    return 0.5 * (unit.friction.forward.coulomb + unit.friction.reverse.coulomb)


def channels_of(samples: Samples) -> tuple[str, ...]:
    """Channels with at least one finite value."""
    return tuple(n for n in samples.channels if np.isfinite(samples[n]).any())


class Tracking(Restorable):
    """EKF and SVSF side by side on the same samples, of a nominal period in s."""

    STATE = ("trackers",)

    def __init__(self, unit: Unit, channels: tuple[str, ...], period: float) -> None:
        self.unit = unit
        self.channels = channels
        self.period = period
        self.model = model_parameters(unit)
        noise = noise_of(unit)
        self.trackers = {
            method: EhaTracker(
                self.model, noise, method,  # type: ignore[arg-type]
                period=period, pressures={"pressure_1", "pressure_2"} <= set(channels),
                angle="pump_angle" in channels, difference="pressure_difference" in channels,
                viscous_friction=healthy_viscous(unit),
                viscous_skew=0.5 * (unit.friction.forward.viscous - unit.friction.reverse.viscous),
                air_fraction=unit.oil.air_fraction,
            )
            for method in METHODS
        }  # fmt: skip

    def block(self, samples: Samples) -> Array:
        """The samples as the trackers' columns, sensor zeros and gains taken out."""
        out = np.full((len(samples), layout.COLUMNS), np.nan)
        out[:, layout.TIME] = samples.time
        for column, name in COLUMNS.items():
            if name in self.channels:
                sensor = self.unit.sensor(name)
                out[:, column] = (samples.get(name) - sensor.zero) / sensor.gain
        if "oil_temperature" in self.channels:
            out[:, layout.VISCOSITY] = viscosity_ratio(self.unit.oil, samples.get("oil_temperature"))
        return out

    def push(self, block: Array) -> dict[str, layout.Records]:
        """Run both filters over a block from `block`; records of each."""
        return {method: t.push(block) for method, t in self.trackers.items()}


def estimates(
    records: layout.Records, unit: Unit, model: eha.Parameters
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Tracked quantities and their standard deviations, SI, from a filter's records.

    Leakage is L_T across the ports at the oil's temperature of the moment. Bulk modulus is that
    at the unit's reference pressure; friction the mean of both directions.
    """
    values, scale = _quantities(records, unit, model)
    std = np.sqrt(records["variance"].clip(0.0))
    return values, {name: scale[name] * std[:, state] for name, state in QUANTITIES.items()}


def _quantities(
    records: layout.Records, unit: Unit, model: eha.Parameters
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Tracked quantities, and magnitudes of their derivatives by their states, (n,) SI."""
    x, stiff = records["state"], model.stiff_compliance
    one, leakage = np.ones(len(x)), unit.pump.total_leakage / records["viscosity"]
    coulomb = healthy_coulomb(unit) * one
    # 1/β at the reference pressure, 1/MPa, and what a permille of free air adds to it.
    air_unit = 1e-3 * eha.air_curve(unit.oil.reference_pressure * 1e-6, model.polytropic_index)
    compliance = np.maximum(stiff + air_unit * x[:, eha.AIR], eha.COMPLIANCE_FLOOR * stiff)
    values = {
        "leakage": leakage * x[:, eha.LEAK], "bulk_modulus": 1e6 / compliance,
        "coulomb_friction": coulomb * x[:, eha.FRIC], "viscous_friction": x[:, eha.VISC],
    }  # fmt: skip
    scale = {
        "leakage": leakage, "bulk_modulus": 1e6 / compliance**2 * air_unit,
        "coulomb_friction": coulomb, "viscous_friction": one,
    }  # fmt: skip
    return values, scale


def new_watch() -> Observability:
    """Follows what is observable, before the first record."""
    return Observability(OBSERVABLE, window=INFORMATION_S)


def watched(
    watch: Observability, records: layout.Records, unit: Unit, model: eha.Parameters, noise: Noise
) -> dict[str, Observed]:
    """Observability of each tracked quantity by a filter's next records.

    `watch`, of `new_watch`, goes on from the records before; they are of one filter, as model and noise.
    """
    _, scale = _quantities(records, unit, model)
    walks = drifts(records, noise, {state: scale[name] for name, state in QUANTITIES.items()})
    drift = {name: walks[state] for name, state in QUANTITIES.items()}
    return watch.push(records["time"], *estimates(records, unit, model), drift)


def observability(values: dict[str, Array], stds: dict[str, Array]) -> dict[str, Flags]:
    """Where each quantity is observable: relative std with hysteresis (see `OBSERVABLE`)."""
    watch = new_watch()
    order = np.arange(values["leakage"].size, dtype=np.float64)
    return {name: seen.valid for name, seen in watch.push(order, values, stds).items()}
