"""The rig's circuits around an axis: valves, charging, external accumulators (thesis 4.6, Table 4.12).

Openings are programmes over time, so that an experiment can move a valve while the axis runs.
Which settings contradict each other is said in `fdd.plant.scenario`.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fdd.errors import InputError
from fdd.plant import SHUT, Array, ShareProgramme, Validated
from fdd.plant import conditions as c
from fdd.unit import Unit

RATED_PRESSURE = 10.34e6
"""Pa, gauge: rated pressure of the system (4.6.3)."""

WHERE = "scenario valves"
"""Where messages say that contradictory valves stand."""

ValveFlow = Annotated[float, Field(gt=0.0, le=1e-3)]


class ExternalAccumulators(Validated):
    """The variable bulk modulus circuit (assembly 3): one accumulator on each chamber.

    Gas and added volume soften the chambers; the circuit's relief valve opens at 9.65 MPa.

    Attributes
    ----------
    gas_charge : Pa, gauge, of the nitrogen without oil; "no more than 9.30 MPa" (4.6.3).
    gas_volume : m³ of each, Table 4.15's Hawe AC13.
    valve_flow : m³/s at 1 MPa through each flow control valve as it is set (FC08-20F). Assumption:
        2e-5 lets the accumulator follow slow pressure changes and hides it from fast ones.
    """

    gas_charge: Annotated[float, Field(ge=1e4, le=9.30e6)] = 4.0e5
    gas_volume: Annotated[float, Field(ge=1e-7, le=1e-3)] = 13e-6
    valve_flow: Annotated[float, Field(ge=0.0, le=1e-3)] = 2e-5


class Circuit(Validated):
    """Valves and auxiliary circuits of one axis, as they are set and moved in a run.

    Attributes
    ----------
    blocked : the ball valve between pump and cylinder is shut (assembly 7); manual, so for a whole run.
    bypass : opening of the by-pass across the cylinder (figure 4.2's decoupling valve). The rig's sits
        in the pump block (4.5); the plant has it beside the throttle, which differs only where `blocked`.
    bypass_flow : m³/s at 1 MPa when fully open; 137 kPa at 1.39e-4 m³/s (4.4, SV08-24), quadratic.
    throttle : opening of the throttling valve across the cylinder, behind its ball valve (assembly 8).
    throttle_flow : m³/s at 1 MPa when fully open. Assumption: the pump's 1.75e-4 m³/s at
        0.34 MPa, about what friction alone takes.
    external_leakage : opening of the external leakage valve (assembly 2).
    external_leakage_side : chamber that it is connected to.
    external_leakage_coefficient : m³/(s·Pa) when fully open, taken as laminar. Assumption: at 0.5 MPa
        the accumulator's 13 cm³ leave within a second, "real-time discharging" (4.6.4).
    charging : share of the charging pump's speed (assembly 4).
    charging_displacement : m³/rad of that pump, Table 4.16.
    charging_speed : rad/s of its motor at 1; the drive's own 3000 rpm.
    charging_pressure : Pa, gauge, set value of the charging circuit's relief valve. The gauge charge
        of the thesis goes up to 689 kPa; the rig's relief valve to 9.65 MPa.
    accumulators : the bulk-modulus circuit, where it is connected.

    Examples
    --------
    >>> import numpy as np
    >>> Circuit(throttle="0:1/5:0.2").throttle.over(np.array([0.0, 5.0]))
    array([1. , 0.2])
    """

    blocked: bool = False
    bypass: ShareProgramme = SHUT
    bypass_flow: ValveFlow = 3.76e-4
    throttle: ShareProgramme = SHUT
    throttle_flow: ValveFlow = 3e-4
    external_leakage: ShareProgramme = SHUT
    external_leakage_side: Annotated[int, Field(ge=1, le=2)] = 1
    external_leakage_coefficient: Annotated[float, Field(gt=0.0, le=1e-9)] = 3e-11
    charging: ShareProgramme = SHUT
    charging_displacement: Annotated[float, Field(gt=0.0, le=1e-5)] = 2.83e-7
    charging_speed: Annotated[float, Field(gt=0.0, le=2000.0)] = 314.16
    charging_pressure: Annotated[float, Field(ge=0.0, le=9.65e6)] = 6.89e5
    accumulators: ExternalAccumulators | None = None

    @property
    def passes(self) -> bool:
        """Whether oil can ever go from one side of the cylinder to the other over this axis's valves."""
        return self.bypass.most > 0.0 or self.throttle.most > 0.0


class Connect(Validated):
    """The connect valves between both axes (assembly 6).

    Attributes
    ----------
    line_1, line_2 : opening of the valve between both axes' lines 1, and 2.
    flow : m³/s at 1 MPa through each when fully open. Assumption: a pump's 1.75e-4 m³/s at 0.12 MPa.
    """

    line_1: ShareProgramme = SHUT
    line_2: ShareProgramme = SHUT
    flow: ValveFlow = 5e-4

    @property
    def open(self) -> bool:
        """Whether either valve ever opens."""
        return self.line_1.most > 0.0 or self.line_2.most > 0.0

    @property
    def joined(self) -> bool:
        """Whether both valves open: only then can one axis's pump move the other's oil to and fro."""
        return self.line_1.most > 0.0 and self.line_2.most > 0.0


def apply(circuit: Circuit, rows: Array, time: Array) -> None:
    """Write an axis's valves into its conditions (n, COLUMNS) at `time` (n,) s, in place."""
    across = circuit.bypass.over(time) * circuit.bypass_flow
    rows[:, c.BYPASS] += across + circuit.throttle.over(time) * circuit.throttle_flow
    outside = c.OUTSIDE_1 if circuit.external_leakage_side == 1 else c.OUTSIDE_2
    rows[:, outside] += circuit.external_leakage.over(time) * circuit.external_leakage_coefficient
    full = circuit.charging_displacement * circuit.charging_speed
    rows[:, c.CHARGE] += circuit.charging.over(time) * full


def apply_connect(connect: Connect, rows: Array, time: Array) -> None:
    """Write the connect valves into the first axis's conditions, in place; as `apply`."""
    rows[:, c.CONNECT_1] += connect.line_1.over(time) * connect.flow
    rows[:, c.CONNECT_2] += connect.line_2.over(time) * connect.flow


def check_charging(circuit: Circuit, unit: Unit, charge_factor: float = 1.0) -> None:
    """Refuse charging without flow, or beyond the rated pressure without the circuit that protects."""
    if circuit.charging.most == 0.0:
        return
    charge = unit.accumulator.charge_pressure * charge_factor
    told = f"charging to {circuit.charging_pressure / 1e6:g} MPa"
    if circuit.charging_pressure <= charge:
        problem = f"{told} adds nothing to a charge of {charge / 1e6:g} MPa"
        raise InputError(problem, where=WHERE, mend="raise charging_pressure or lower charge_factor")
    together = circuit.charging_pressure + unit.accumulator.relief_pressure
    if together > RATED_PRESSURE and circuit.accumulators is None:
        raise InputError(
            f"{told} below relief valves of {unit.accumulator.relief_pressure / 1e6:g} MPa exceeds the rated "
            f"{RATED_PRESSURE / 1e6:g} MPa",
            where=WHERE,
            mend="lower charging_pressure or connect the accumulators, whose relief valve protects",
        )
