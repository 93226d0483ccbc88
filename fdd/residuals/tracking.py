"""Both estimators on one axis, set up from its profile and the channels it has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators import eha_layout as layout
from estimators import eha_model as eha
from estimators.eha_noise import Noise
from estimators.eha_tracker import EhaTracker
from fdd.residuals.viscosity import viscosity_ratio
from fdd.samples import Samples
from fdd.unit import FrictionBranch, Unit

Array = NDArray[np.float64]
METHODS = ("ekf", "svsf")

# A quantity is called observable while its standard deviation is below the first share of its
# value, and until it exceeds the second (hysteresis against flicker).
OBSERVABLE = {
    "leakage": (0.05, 0.07),
    "bulk_modulus": (0.05, 0.07),
    "coulomb_friction": (0.10, 0.15),
    "viscous_friction": (0.20, 0.30),
}

THERMAL_GAIN = 5e-4
"""Relative change of displacement over area within 30 K: metals grow by 1 to 2.5e-5 per kelvin."""


def model_parameters(unit: Unit) -> Array:
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
    """Measurement noise from the profile's sensors; process noise as its defaults argue.

    What the profile's `estimation` gives (``fdd identify`` writes it) goes before both.
    """
    noise = Noise()
    position = unit.sensor("position")
    noise.position = max(noise.position, float(np.hypot(position.noise, position.resolution / np.sqrt(12.0))))
    angle = unit.sensor("pump_angle")
    noise.angle = max(noise.angle, float(np.hypot(angle.noise, angle.resolution / np.sqrt(12.0))))
    chambers = [unit.sensor(c).noise for c in ("pressure_1", "pressure_2") if c in unit.sensors]
    noise.pressure = max(chambers) if chambers and max(chambers) > 0 else noise.pressure
    difference = unit.sensor("pressure_difference")
    noise.pressure_difference = difference.noise or noise.pressure_difference
    noise.initial_gain = gain_spread(unit)
    noise.relief_pressure = 0.9 * unit.accumulator.relief_pressure
    if unit.estimation is not None:
        for name, value in unit.estimation.known.items():
            setattr(noise, name, value)
    return noise


def gain_spread(unit: Unit) -> float:
    """Standard deviation of the pump's gain: the profile's own, or a shipped profile's for another unit."""
    known = unit.pump.provenance.get("displacement")
    if known is None or known.std is None:
        return Noise().initial_gain
    return float(np.hypot(known.std / unit.pump.displacement, THERMAL_GAIN))


def healthy_viscous(unit: Unit) -> float:
    """Mean viscous friction of both directions, N·s/m."""
    return 0.5 * (unit.friction.forward.viscous + unit.friction.reverse.viscous)


def healthy_coulomb(unit: Unit) -> float:
    """Mean Coulomb friction of both directions, N."""
    return 0.5 * (unit.friction.forward.coulomb + unit.friction.reverse.coulomb)


@dataclass(frozen=True)
class Channels:
    """Which channels a log has, decided on its first second."""

    names: tuple[str, ...]

    @property
    def chambers(self) -> bool:
        """Both chamber pressures."""
        return "pressure_1" in self.names and "pressure_2" in self.names

    @classmethod
    def of(cls, samples: Samples) -> Channels:
        """Channels with at least one finite value in `samples`."""
        return cls(tuple(n for n in samples.channels if np.isfinite(samples[n]).any()))


class Tracking:
    """EKF and SVSF side by side on the same samples.

    Parameters
    ----------
    unit : profile. channels : what the log has. period : s, nominal.
    decimation : samples per record of the trajectories.
    """

    def __init__(self, unit: Unit, channels: Channels, period: float, decimation: int = 10) -> None:
        self.unit = unit
        self.channels = channels
        self.period = period
        self.model = model_parameters(unit)
        noise = noise_of(unit)
        self.trackers = {
            method: EhaTracker(
                self.model,
                noise,
                method,  # type: ignore[arg-type]
                period=period,
                pressures=channels.chambers,
                angle="pump_angle" in channels.names,
                difference="pressure_difference" in channels.names,
                viscous_friction=healthy_viscous(unit),
                viscous_skew=0.5 * (unit.friction.forward.viscous - unit.friction.reverse.viscous),
                air_fraction=unit.oil.air_fraction,
                decimation=decimation,
            )
            for method in METHODS
        }

    def block(self, samples: Samples) -> Array:
        """The samples as the trackers' columns, sensor zeros and gains taken out."""
        out = np.full((len(samples), layout.COLUMNS), np.nan)
        out[:, layout.TIME] = samples.time
        for column, name in (
            (layout.POSITION, "position"),
            (layout.ANGLE, "pump_angle"),
            (layout.SPEED, "pump_speed"),
            (layout.PRESSURE_1, "pressure_1"),
            (layout.PRESSURE_2, "pressure_2"),
            (layout.DIFFERENCE, "pressure_difference"),
            (layout.ACCUMULATOR, "pressure_accumulator"),
        ):
            if name in self.channels.names:
                sensor = self.unit.sensor(name)
                out[:, column] = (samples.get(name) - sensor.zero) / sensor.gain
        if "oil_temperature" in self.channels.names:
            out[:, layout.VISCOSITY] = viscosity_ratio(self.unit.oil, samples.get("oil_temperature"))
        return out

    def push(self, block: Array) -> dict[str, Array]:
        """Run both filters over a block from `block`; records of each."""
        return {method: t.push(block) for method, t in self.trackers.items()}

    def state(self) -> dict[str, Any]:
        """State of both filters, nested dicts of arrays."""
        return {method: t.state() for method, t in self.trackers.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Take back what `state` gave."""
        for method, t in self.trackers.items():
            t.restore(state[method])


def estimates(records: Array, unit: Unit, model: Array) -> tuple[dict[str, Array], dict[str, Array]]:
    """Tracked quantities and their standard deviations, SI, from a filter's records.

    Leakage is L_T across the ports at the oil's temperature of the moment. Bulk modulus is that
    at the unit's reference pressure; friction the mean of both directions.
    """
    x = records[:, layout.R_STATE : layout.R_STATE + eha.STATES]
    var = records[:, layout.R_VARIANCE : layout.R_VARIANCE + eha.STATES]
    scale = unit.pump.total_leakage / records[:, layout.R_VISCOSITY]
    pressure = unit.oil.reference_pressure * 1e-6
    air_unit = 1e-3 * eha.air_curve(pressure, model[eha.Q_POLYTROPIC])
    stiff = model[eha.Q_STIFFNESS_INV]
    c = np.maximum(stiff + air_unit * x[:, eha.AIR], eha.COMPLIANCE_FLOOR * stiff)
    coulomb = healthy_coulomb(unit)
    values = {
        "leakage": scale * x[:, eha.LEAK],
        "bulk_modulus": 1e6 / c,
        "coulomb_friction": coulomb * x[:, eha.FRIC],
        "viscous_friction": x[:, eha.VISC],
    }
    stds = {
        "leakage": scale * np.sqrt(var[:, eha.LEAK]),
        "bulk_modulus": 1e6 / c**2 * air_unit * np.sqrt(var[:, eha.AIR]),
        "coulomb_friction": coulomb * np.sqrt(var[:, eha.FRIC]),
        "viscous_friction": np.sqrt(var[:, eha.VISC]),
    }
    return values, stds


def observability(values: dict[str, Array], stds: dict[str, Array]) -> dict[str, NDArray[np.bool_]]:
    """Where each quantity is observable: relative std with hysteresis (see `OBSERVABLE`)."""
    flags = {}
    for name, (low, high) in OBSERVABLE.items():
        share = stds[name] / np.maximum(np.abs(values[name]), 1e-300)
        state = np.where(share < low, 1.0, np.where(share > high, 0.0, np.nan))
        # Between the two limits the last decision stands.
        index = np.maximum.accumulate(np.where(np.isnan(state), -1, np.arange(state.size)))
        flags[name] = np.where(index >= 0, state[np.maximum(index, 0)] == 1.0, False)
    return flags
