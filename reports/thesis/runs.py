"""How the experiments drive the prototype, and how its axes are changed for them.

The thesis commands the pump in volt: ±10 V are ±3000 rpm. Every run starts at rest and is logged whole, at
1 kHz, through the sensors of Appendix A.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.plant.circuit import Circuit
from fdd.plant.details import Details
from fdd.plant.duty import Replay
from fdd.plant.scenario import Control, Partner, Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.unit import Unit

Array = NDArray[np.float64]
Figures = dict[str, Any]
"""What an experiment measured, by the names that its block of the template has; ``picture`` is its panels."""
Beside = tuple[Unit, Partner]
"""The other axis on the same rod, and what it does."""

PERIOD = 1e-3
"""Sampling interval of the thesis (s), section 6.1."""
VOLT = 31.416
"""Commanded pump speed per volt (rad/s): 3000 rpm at 10 V."""
THOUSAND_RPM = 104.7
"""Pump speed of section 5.2 (rad/s)."""


def run_speed(
    unit: Unit, command: Array, *, start: float = 0.0, partner: Beside | None = None, seed: int = 0,
    details: Details | None = None, control: Control | None = None, **scenario: Any,
) -> Simulation:  # fmt: skip
    """Drive the pump with a commanded speed, without feedback of position.

    `command`: (n,) rad/s, one value a millisecond. `start`: m from mid-stroke. `partner`: None leaves the
    cylinder alone. `seed`: draws the trial: friction, noise. `scenario`: what else of it.

    Raises `InputError`: `start` is outside the stroke.
    """
    whole = Scenario(
        unit=unit.name, duration=command.size * PERIOD, control=control or Control(mode="speed"),
        duty=Replay(values=tuple(command.tolist()), offset=start), partner=partner[1] if partner else None,
        details=details or Details(), recording=Recording.perfect(), seed=seed, **scenario,
    )  # fmt: skip
    return simulate(unit, whole, partner=partner[0] if partner else None)


def run_position(unit: Unit, setpoint: Array, gain: float, **more: Any) -> Simulation:
    """Close the position loop of section 7.2, `gain` in (rad/s)/m, around the pump; set-point (n,) in m."""
    return run_speed(unit, setpoint, control=Control(mode="position", gain=gain), **more)


def throttled_partner(unit: Unit, partner: Unit, pressure: float) -> Beside:
    """The other axis, its pump shut off, pushing its oil through its throttle (figure 5.2).

    The throttle closes from fully open within two seconds: against a closed one the piston's start would
    overshoot and open the relief valve, which shuts again only below the pressures of section 5.2.
    `pressure`: Pa over it while the driving pump turns at 100 rad/s without leakage.
    """
    flow = 100.0 * unit.pump.displacement * partner.cylinder.area_1 / unit.cylinder.area_1
    opening = flow / (Circuit().throttle_flow * math.sqrt(1e-6 * pressure))
    circuit = Circuit.model_validate({"blocked": True, "throttle": f"0:1/2:{opening:.6g}"})
    return partner, Partner(unit=partner.name, drive="still", circuit=circuit)


def riding_partner(partner: Unit, *, throttle: bool = True) -> Beside:
    """The other axis carried along, its pump held, its oil free to go round by its by-pass (and throttle)."""
    circuit = Circuit.model_validate({"bypass": 1, "throttle": int(throttle)})
    return partner, Partner(unit=partner.name, drive="still", circuit=circuit)


def both_pumps(unit: Unit, partner: Unit) -> Unit:
    """One cylinder driven by both axes' pumps in parallel, as for the friction tests of section 5.3.

    Flows add, and so do the torques and inertias on what counts here as one shaft. The dual rig with open
    connect valves would carry the other cylinder, and its seals, along.
    """
    together = unit.model_copy(deep=True)
    for part, names in (
        ("pump", ("displacement", "cross_port_leakage", "case_leakage")),
        ("drive", ("inertia", "viscous_friction", "current_limit")),
    ):
        mine, other = getattr(together, part), getattr(partner, part)
        for name in names:
            setattr(mine, name, getattr(mine, name) + getattr(other, name))
    return together


def changed(unit: Unit, part: str, **values: float) -> Unit:
    """The same axis with other values in one part of its profile: ``changed(unit, "drive", delay=0.01)``."""
    out = unit.model_copy(deep=True)
    for name, value in values.items():
        setattr(getattr(out, part), name, value)
    return out


def with_friction(unit: Unit, share: float = 1.0, *, rises: bool = True) -> Unit:
    """The same axis with a share of its dry friction, which `rises` towards rest or is Coulomb's alone."""
    out = unit.model_copy(deep=True)
    for branch in (out.friction.forward, out.friction.reverse):
        branch.coulomb *= share
        branch.static = share * branch.static if rises else branch.coulomb
    return out


def with_leakage(unit: Unit, pump: Unit, share: float = 1.0) -> Unit:
    """The same axis with a share of the leakage of a pump, its own or another one."""
    cross, case = pump.pump.cross_port_leakage, pump.pump.case_leakage
    return changed(unit, "pump", cross_port_leakage=share * cross, case_leakage=share * case)


def with_torque(unit: Unit, torque: float) -> Unit:
    """The same axis with another largest torque of its drive (N·m)."""
    return changed(unit, "drive", current_limit=torque / unit.drive.torque_constant)


def hydraulic_gain(unit: Unit) -> float:
    """Dp/A (m/rad)."""
    return unit.pump.displacement / unit.cylinder.area_1


def holding_leakage(unit: Unit) -> float:
    """ξ + C_ep (m³/(s·Pa)): what the pump makes up under pressure while the low side is refed (mode 2)."""
    return unit.pump.cross_port_leakage + unit.pump.case_leakage


def chirp(seconds: float, low_hz: float, high_hz: float) -> Array:
    """A sine of amplitude 1 whose frequency rises evenly from `low_hz` to `high_hz`, (n,)."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    return np.asarray(np.sin(2.0 * np.pi * (low_hz + 0.5 * (high_hz - low_hz) * time / seconds) * time))


def binary_noise(seconds: float, switching_hz: float, seed: int) -> Array:
    """Pseudo-random ±1 that may change `switching_hz` times a second, (n,)."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    which = np.floor(time * switching_hz + 1e-9).astype(np.int64)
    bits = np.random.default_rng(seed).integers(0, 2, int(which[-1]) + 1) * 2.0 - 1.0
    return np.asarray(bits[which], dtype=np.float64)


def identification_volts(seconds: float, seed: int, high_hz: float = 150.0) -> Array:
    """Section 6.2's signal: a chirp of ±1.5 V from 0.1 to 150 Hz with binary noise of ±0.25 V at 450 Hz."""
    return 1.5 * chirp(seconds, 0.1, high_hz) + 0.25 * binary_noise(seconds, 450.0, seed)
