"""Machines of other sizes: a whole profile from rated pressure, displacement and ratio of areas.

What a designer would choose in proportion is drawn in proportion, around the shares that data sheets of
electro-hydrostatic actuators, servomotors and gear or piston pumps give; where no source is named it is an
assumption. `Scale` then says by how much loads, duties, faults and the plant's details differ from those of
the thesis's axis A, whose numbers the rest of the house is written in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from fdd.campaign.population import Range, Rng, log_uniform, uniform
from fdd.data_sheet.plausibility import accumulator_volumes
from fdd.faults import CATALOGUE
from fdd.plant import Validated
from fdd.plant.details import Details
from fdd.plant.faults import FaultScales
from fdd.plant.oil import air_compliance
from fdd.sections import CurrentLoop, Sensor
from fdd.unit import Section, Unit

AXIS = "axis_a"
RELIEF = 1.1
"""Relief setting over rated pressure."""
STEEL = 8000.0
"""kg/m³: piston and rod weigh about what their swept volume of steel does."""
SENSED = 1.5
"""Range of the pressure transducers over the relief setting."""
GROSS_LEAKAGE = 0.05
"""Of the rated flow, at half the rated pressure: internal leakage of severity 1."""
STUCK_FLOW = 0.7
"""Of the rated flow, at half the rated pressure: through a valve that is stuck fully open."""
OIL_TEMPERATURES: Range = (10.0, 70.0)
"""°C, coldest and hottest oil that an accumulator is sized for where nothing else is known."""
MARGIN = (1.2, 2.0)
"""Gas and oil at rest over what the rule asks for: designers' reserve, and what units differ by."""
_MEGAPASCAL = 1e6
_GRADES = ((15e-6, 3.3e-6), (32e-6, 5.4e-6), (46e-6, 6.8e-6))
"""m²/s at 40 and 100 °C of ISO VG 15, 32 and 46."""
_DETAILS, _FAULTS = Details().model_dump(), FaultScales().model_dump()
S = TypeVar("S", bound=Section)


class Size(Validated):
    """What a drawn machine is sized by.

    Attributes
    ----------
    rated_pressure : Pa, drawn log-uniformly; the relief valves open a tenth above it.
    displacement : m³/rad, drawn log-uniformly.
    area_ratio : second area over the first. Below 1 the refeeding valves must be piloted.
    """

    rated_pressure: Range = (2e6, 30e6)
    displacement: Range = (0.2e-6, 7e-6)
    area_ratio: Range = (1.0, 1.0)


def sized_unit(size: Size, rng: Rng, oil_temperatures: Range = OIL_TEMPERATURES) -> Unit:
    """A data sheet of a machine of that size: a profile whose parts fit each other.

    `oil_temperatures` are the coldest and hottest (°C) that its accumulator has to outlast.
    """
    axis = Unit.load(AXIS)
    rated, displacement = log_uniform(rng, size.rated_pressure), log_uniform(rng, size.displacement)
    ratio, fastest = uniform(rng, size.area_ratio), log_uniform(rng, (220.0, 420.0))
    flow, torque = displacement * fastest, displacement * rated
    velocity = log_uniform(rng, (0.06, 0.25))
    area_1 = flow / velocity
    area_2 = ratio * area_1
    stroke = float(np.clip(velocity * uniform(rng, (1.5, 4.0)), 0.08, 0.8))
    swept = 0.5 * area_1 * stroke
    dead = swept * log_uniform(rng, (0.5, 6.0))
    mass = STEEL * area_1 * stroke * log_uniform(rng, (0.7, 2.0))
    cylinder = _changed(
        axis.cylinder, area_1=area_1, area_2=area_2, stroke=stroke, moving_mass=mass,
        volume_1=swept + dead, volume_2=ratio * swept + dead,
    )  # fmt: skip
    leakage, drained = log_uniform(rng, (0.01, 0.05)) * flow / rated, uniform(rng, (0.1, 0.3))
    across, case = (1.0 - drained) * leakage, 2.0 * drained * leakage
    pump = _changed(axis.pump, displacement=displacement, cross_port_leakage=across, case_leakage=case)
    charge = min(uniform(rng, (0.35e6, 1.0e6)), 0.2 * rated)
    # What the oil, its walls and hoses give without air; then the air at charge pressure.
    stiff, air = log_uniform(rng, (4e8, 1.4e9)), log_uniform(rng, (5e-4, 5e-3))
    modulus = 1.0 / (1.0 / stiff + air * float(air_compliance(charge, axis.oil.polytropic_index)))
    thick, thin = _GRADES[int(rng.integers(len(_GRADES)))]
    oil = _changed(
        axis.oil, bulk_modulus=modulus, air_fraction=air, reference_pressure=charge, viscosity_40=thick,
        viscosity_100=thin,
    )  # fmt: skip
    margin = log_uniform(rng, MARGIN)
    accumulator = _changed(
        axis.accumulator, charge_pressure=charge, refeed_cracking_pressure=log_uniform(rng, (5e3, 50e3)),
        refeed_flow_gain=flow / log_uniform(rng, (1e4, 4e4)), relief_pressure=RELIEF * rated,
        relief_flow_gain=flow / (0.1 * RELIEF * rated),
    )  # fmt: skip
    break_away = log_uniform(rng, (0.005, 0.02)) * rated * 0.5 * (area_1 + area_2)
    shape, drag = uniform(rng, (0.35, 0.8)), uniform(rng, (0.0, 0.8))
    falling, exponent = log_uniform(rng, (0.03, 0.2)) * velocity, uniform(rng, (0.6, 2.0))
    branches = {}
    for name in ("forward", "reverse"):
        static = break_away * uniform(rng, (0.85, 1.15))
        branches[name] = _changed(
            getattr(axis.friction, name), static=static, coulomb=shape * static, stribeck_velocity=falling,
            stribeck_exponent=exponent, viscous=drag * shape * static / velocity,
        )  # fmt: skip
    # Of a servomotor of that torque; the winding's voltages are the axis's.
    stall, base = 1.6 * torque, axis.drive
    motor, turns = stall / 8.0, base.max_speed / fastest
    quick = uniform(rng, (0.5, 1.1))
    drive = _changed(
        base, max_speed=fastest,
        **{name: quick * getattr(base, name) for name in ("pole_1", "pole_2", "zero")},
        **{name: turns * getattr(base, name) for name in ("torque_constant", "back_emf_constant")},
        winding_resistance=base.winding_resistance * turns * turns / motor,
        winding_inductance=base.winding_inductance * turns * turns / motor,
        inertia=base.inertia * motor * uniform(rng, (0.7, 1.4)),
        viscous_friction=base.viscous_friction * motor,
        current_limit=2.0 * stall / (turns * base.torque_constant),
    )  # fmt: skip
    described = f"{rated / 1e6:.3g} MPa, {displacement * 1e6:.3g} cm³/rad, areas 1 : {ratio:.2f}."
    unit = axis.model_copy(update={
        "name": "sized", "axis": "axis", "description": described, "cylinder": cylinder, "pump": pump,
        "oil": oil, "accumulator": accumulator, "friction": axis.friction.model_copy(update=branches),
        "drive": drive, "sensors": _sensors(axis, SENSED * RELIEF * rated, drive.current_limit),
    })  # fmt: skip
    return with_accumulator(unit, oil_temperatures, margin)


def with_accumulator(unit: Unit, oil_temperatures: Range, margin: float = MARGIN[0]) -> Unit:
    """The unit with gas and oil of `fdd.data_sheet.plausibility.accumulator_volumes`, `margin` times;
    `oil_temperatures` in °C, coldest and hottest."""
    cylinder, store, oil = unit.cylinder, unit.accumulator, unit.oil
    coldest, hottest = (t - oil.reference_temperature for t in oil_temperatures)
    volumes = cylinder.volume_1, cylinder.volume_2
    shifted = (cylinder.area_1 - cylinder.area_2) * 0.5 * cylinder.stroke
    gas, held = accumulator_volumes(
        sum(volumes), max(volumes), store.relief_pressure, oil.bulk_modulus, shifted, max(-coldest, 0.0),
        max(hottest, 0.0),
    )  # fmt: skip
    changed = _changed(store, gas_volume=margin * gas, oil_volume=margin * held)
    return unit.model_copy(update={"accumulator": changed})


class Scale:
    """How much larger a machine that was drawn as a whole is than axis A, as factors.

    Without a `unit` all are 1: of the machines that recipes' ranges are made for.
    """

    def __init__(self, unit: Unit | None = None) -> None:
        self.unit = unit

        def over(size: Callable[[Unit], float]) -> float:
            return 1.0 if unit is None else size(unit) / size(Unit.load(AXIS))

        self.pressure = over(lambda u: u.accumulator.relief_pressure)
        self.turning = over(lambda u: u.drive.max_speed)
        self.flow = over(lambda u: u.pump.displacement * u.drive.max_speed)
        self.area = over(lambda u: min(u.cylinder.area_1, u.cylinder.area_2))
        self.stroke = over(lambda u: u.cylinder.stroke)
        # Of the force that it breaks away at, of the oil on the piston, of the drive's limit.
        self.friction = over(lambda u: 0.5 * (u.friction.forward.static + u.friction.reverse.static))
        self.stiffness = over(_stiffness)
        self.current = over(lambda u: u.drive.current_limit)
        self.charge = over(lambda u: u.accumulator.charge_pressure)
        self.cracking = over(lambda u: u.accumulator.refeed_cracking_pressure)
        self.force = self.pressure * self.area
        self.velocity = self.flow / self.area  # of the piston at the drive's largest speed
        self.torque = self.pressure * self.flow / self.turning  # of the pump at the relief setting
        self.leakage = self.flow / self.pressure
        self.position_gain = self.turning / self.velocity  # of a loop that is as quick

    def load_ranges(self, name: str, ranges: Mapping[str, Range]) -> dict[str, Range]:
        """Ranges of a load's parameters for this machine."""
        per_stroke = self.force / self.stroke
        spring = {"rate": per_stroke, "slack": self.stroke}
        factors = {
            "constant": {"level": self.force}, "spring": spring, "press": spring,
            "hinge": {**spring, "gap": self.stroke},
            # As slow on the oil's spring, and not more than the pump's pressure can brake.
            "inertia": {"added": min(self.stiffness, self.force / self.velocity)},
            "gust": {"deviation": self.force, "level": self.force, "rate": per_stroke},
            "changing": {"deviation": self.force, "level": self.force},
            "throttle": {"pressure": self.pressure},
        }  # fmt: skip
        return _scaled_by(ranges, factors.get(name, {}))

    def duty_ranges(self, ranges: Mapping[str, Range]) -> dict[str, Range]:
        """Ranges of a duty's parameters for this machine."""
        return _scaled_by(ranges, {"amplitude": self.stroke, "speed": self.turning, "rate": self.velocity})

    def details(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """All details of the plant for this machine, from those that were drawn for axis A.

        What is a time, a share, or a property of oil and seals stays, and so do the pump's drag over μ·D·ω
        and the gas's time, whose range is that of accumulators of 0.1 to 5 l.
        """
        torque = self.torque
        bulk = (self.pressure * self.flow) ** 0.75  # what is larger is heavier, but less so than stronger
        factors = {
            "bristle_stiffness": self.friction, "bristle_fade": self.velocity,
            "seal_damping": self.friction / self.velocity, "smooth_width": self.velocity,
            "pump_coulomb_torque": torque, "line_loss": self.pressure / self.flow**2,
            "coupling_stiffness": torque, "coupling_damping": torque, "relief_width": self.pressure,
            "stop_stiffness": self.force, "cushion_damping": self.force / self.velocity**2,
            "cushion_length": self.stroke, "heat_capacity": bulk, "cooling": bulk,
            "loose_seal_leakage": self.leakage,
            "check_hysteresis": self.cracking,  # of the same spring
            "gallery_volume": self.flow / self.turning,  # of the pump's case
        }  # fmt: skip
        whole = {**_DETAILS, **drawn}
        return {n: v * factors[n] if n in factors else v for n, v in whole.items()}

    def fault_scales(self, drawn: Mapping[str, float]) -> dict[str, float]:
        """Figures of severity 1 for this machine, around those that were drawn.

        Internal leakage passes `GROSS_LEAKAGE` of the rated flow at half the rated pressure, a stuck valve
        `STUCK_FLOW`; air brings the bulk modulus at charge pressure to 35 %, as 2.5 % does on axis A. The
        other leakages keep their proportion to the internal one, the cracking pressure of a clogged valve
        that to the charge, a brake on the shaft that to the torque at the drive's largest speed.
        """
        unit, axis = self.unit, _FAULTS
        if unit is None:
            return dict(drawn)
        rated = unit.accumulator.relief_pressure / RELIEF
        flow, half = unit.pump.displacement * unit.drive.max_speed, 0.5 * rated
        turbulent = drawn.get("internal_leakage_orifice_share", axis["internal_leakage_orifice_share"])
        laminar = (1.0 - turbulent) * half + turbulent * math.sqrt(_MEGAPASCAL * half)
        times = GROSS_LEAKAGE * flow / laminar / axis["internal_leakage"]
        stuck = STUCK_FLOW * flow * math.sqrt(_MEGAPASCAL / half)
        soft = float(air_compliance(unit.oil.reference_pressure, unit.oil.polytropic_index))
        factors = {
            "leakage": times, "speed_leakage": times / self.turning,
            "orifice": stuck / axis["check_valve_flow"], "flow": self.flow, "pressure": self.pressure,
            "charge": self.charge, "torque": self.torque / self.turning,  # a brake's, over speed
        }  # fmt: skip
        figures = [figure for entry in CATALOGUE.values() for figure in entry.figures if figure.grows]
        return {
            **drawn,
            **{f.name: factors[f.grows] * drawn.get(f.name, f.value) for f in figures},
            "shaft_leakage_pressure": unit.accumulator.charge_pressure + 5e3,
            "free_air": min((1.0 / 0.35 - 1.0) / (unit.oil.bulk_modulus * soft), 0.2),
        }

    def zero_errors(self, errors: Mapping[str, float]) -> dict[str, float]:
        """Zero errors of axis A's sensors, for this machine's ranges."""
        factors = {
            **dict.fromkeys(("pressure_difference", "pressure_1", "pressure_2"), self.pressure),
            "motor_current": self.current,
            "position": min(self.stroke, 1.0),
        }
        return {channel: error * factors.get(channel, 1.0) for channel, error in errors.items()}


def _stiffness(unit: Unit) -> float:
    """N/m of the oil on the piston."""
    cylinder = unit.cylinder
    springs = cylinder.area_1**2 / cylinder.volume_1 + cylinder.area_2**2 / cylinder.volume_2
    return unit.oil.bulk_modulus * springs


NEUTRAL = Scale()


def _sensors(axis: Unit, full: float, current: float) -> dict[str, Sensor]:
    """Axis A's chain with transducers of that range (Pa) and a drive of that current limit (A)."""
    sensors = dict(axis.sensors)
    old = sensors["pressure_difference"]
    assert old.loop is not None
    wider = full / old.loop.high
    loop = CurrentLoop(low=0.0, high=full, resistance=old.loop.resistance, reversible=True)
    tones = [(hz, wider * amplitude) for hz, amplitude in old.tones]
    noise, width = wider * old.noise, old.bandwidth_hz
    sensors["pressure_difference"] = Sensor(noise=noise, bandwidth_hz=width, tones=tones, loop=loop)
    for channel in ("pressure_1", "pressure_2"):
        old = sensors[channel]
        noise, step = wider * old.noise, wider * old.resolution
        sensors[channel] = Sensor(noise=noise, resolution=step, low=old.low, high=full)
    old, larger = sensors["motor_current"], current / axis.drive.current_limit
    sensors["motor_current"] = Sensor(noise=larger * old.noise, resolution=larger * old.resolution)
    return sensors


def _changed(section: S, **values: float) -> S:
    return section.model_copy(update={**values, "provenance": {}})


def _scaled_by(ranges: Mapping[str, Range], factors: Mapping[str, float]) -> dict[str, Range]:
    times = {name: factors.get(name, 1.0) for name in ranges}
    return {name: (low * times[name], high * times[name]) for name, (low, high) in ranges.items()}
