"""How the experiments drive the prototype: the one place here that writes scenarios.

The thesis commands the pump in volt: ±10 V are ±3000 rpm. Every run starts at rest and is logged whole, at
1 kHz, through the sensors of Appendix A.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.plant.circuit import Circuit, Connect
from fdd.plant.details import Details
from fdd.plant.duty import Replay
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.scenario import Control, Partner, Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.unit import Unit

Array = NDArray[np.float64]

PERIOD = 1e-3
"""Sampling interval of the thesis (s), section 6.1."""
VOLT = 31.416
"""Commanded pump speed per volt (rad/s): 3000 rpm at 10 V."""
THOUSAND_RPM = 104.7
"""Pump speed of section 5.2 (rad/s)."""


def run_speed(
    unit: Unit,
    command: Array,
    *,
    start: float = 0.0,
    partner: tuple[Unit, Partner] | None = None,
    connect: Connect | None = None,
    details: Details | None = None,
    charge_factor: float = 1.0,
    faults: list[FaultSpec] | None = None,
    seed: int = 0,
) -> Simulation:
    """Drive the pump with a commanded speed, without feedback of position.

    Parameters
    ----------
    unit : the axis.
    command : (n,) rad/s, one value a millisecond.
    start : m from mid-stroke.
    partner : the other axis and what it does; None leaves the cylinder alone.
    connect : valves between both axes, shut unless given.
    details, charge_factor, faults : of the scenario.
    seed : draws the trial: friction, noise.

    Returns
    -------
    The log and the truth, n rows.

    Raises
    ------
    InputError : `start` is outside the stroke.
    """
    scenario = Scenario(
        unit=unit.name,
        duration=command.size * PERIOD,
        duty=Replay(values=tuple(command.tolist()), offset=start),
        control=Control(mode="speed"),
        partner=partner[1] if partner else None,
        connect=connect or Connect(),
        details=details or Details(),
        charge_factor=charge_factor,
        faults=faults or [],
        recording=Recording.perfect(),
        seed=seed,
    )
    return simulate(unit, scenario, partner=partner[0] if partner else None)


def run_position(
    unit: Unit,
    setpoint: Array,
    gain: float,
    *,
    start: float = 0.0,
    partner: tuple[Unit, Partner] | None = None,
    details: Details | None = None,
    seed: int = 0,
) -> Simulation:
    """Close the position loop of section 7.2 around the pump.

    Parameters
    ----------
    unit : the axis.
    setpoint : (n,) m from mid-stroke.
    gain : (rad/s)/m.
    start, partner, details, seed : as in `run_speed`.

    Returns
    -------
    The log and the truth, n rows.

    Raises
    ------
    InputError : `start` is outside the stroke, or the gain out of range.
    """
    scenario = Scenario(
        unit=unit.name,
        duration=setpoint.size * PERIOD,
        duty=Replay(values=tuple(setpoint.tolist()), offset=start),
        control=Control(mode="position", gain=gain),
        partner=partner[1] if partner else None,
        details=details or Details(),
        recording=Recording.perfect(),
        seed=seed,
    )
    return simulate(unit, scenario, partner=partner[0] if partner else None)


def throttled_partner(unit: Unit, partner: Unit, pressure: float) -> Partner:
    """The other axis on the same rod, its pump shut off, pushing its oil through its throttle (figure 5.2).

    Parameters
    ----------
    unit, partner : the driving axis and the other.
    pressure : Pa over the throttle while the driving pump turns at 100 rad/s without leakage.

    The throttle closes from fully open within two seconds: against a closed one the piston's start would
    overshoot and open the relief valve, which shuts again only below the pressures of section 5.2.
    """
    flow = 100.0 * unit.pump.displacement * partner.cylinder.area_1 / unit.cylinder.area_1
    opening = flow / (Circuit().throttle_flow * math.sqrt(1e-6 * pressure))
    return Partner(
        unit=partner.name,
        drive="still",
        circuit=Circuit.model_validate({"blocked": True, "throttle": f"0:1/2:{opening:.6g}"}),
    )


def riding_partner(partner: Unit, *, throttle: bool = True) -> tuple[Unit, Partner]:
    """The other axis carried along on the rod, its pump held, its oil free to go round.

    Parameters
    ----------
    partner : the other axis.
    throttle : whether its throttling valve is open beside its by-pass.
    """
    circuit = Circuit.model_validate({"bypass": 1, "throttle": int(throttle)})
    return partner, Partner(unit=partner.name, drive="still", circuit=circuit)


def both_pumps(unit: Unit, partner: Unit) -> Unit:
    """One cylinder driven by both axes' pumps in parallel, as for the friction tests of section 5.3.

    Flows add, and so do the torques and inertias on what counts here as one shaft. The dual rig with open
    connect valves would carry the other cylinder, and its seals, along: see `evidence.thesis.dual_operation`.

    Parameters
    ----------
    unit : the axis whose cylinder moves.
    partner : the axis whose pump helps.
    """
    together = unit.model_copy(deep=True)
    together.pump.displacement += partner.pump.displacement
    together.pump.cross_port_leakage += partner.pump.cross_port_leakage
    together.pump.case_leakage += partner.pump.case_leakage
    together.drive.inertia += partner.drive.inertia
    together.drive.viscous_friction += partner.drive.viscous_friction
    together.drive.current_limit += partner.drive.current_limit
    return together
