"""Which settings of the rig's valves contradict each other, from section 4.6 of the thesis.

=====================================  ==========  ========================================================
setting                                answer      why
=====================================  ==========  ========================================================
connect valve open, no partner         refused     there is nothing to connect to (4.6.6)
load throttle with a partner           refused     it stands for a partner: it would be there twice
both axes blocked                      refused     no pump reaches a cylinder (4.6.7)
blocked without a partner              refused     nothing can move the cylinder
blocked, throttle and by-pass shut,    refused     hydraulic lock: its cylinder must follow the other's and
and the other cylinder is driven                   has no way out for its oil (4.6.7). The connect valves do
                                                   not help: they lie on the pumps' side, or two pumps could
                                                   not "drive one actuator" with one ball valve shut
position loop on a blocked first       refused     its encoder does not see what its pump does, unless the
axis that moves nothing                            partner takes the same command or both lines connect
charging on both axes                  refused     there is one charging pump (4.6.4)
charging above 9.65 MPa                refused     rating, field of `Circuit`
gas charge above 9.30 MPa              refused     "no more than 9.30 MPa" (4.6.3), field of the circuit
charging and relief setting together   refused     12.74 MPa of 3.44 and 9.30 exceed the rated 10.34 MPa
above 10.34 MPa, no accumulators                   (4.6.3); the bulk-modulus circuit's relief valve protects
charging at or below the charge        refused     no oil would flow
charging with external leakage open    allowed     how static pressure is varied in real time (4.6.4)
throttle or by-pass on a driving axis  allowed     how 4.6.8 injects internal leakage; where it passes the
                                                   pump's whole flow the axis stands and its loop
                                                   saturates, which harms nothing
one connect valve of two               allowed     relieves one line (4.6.6); to drive the other's cylinder
                                                   a pump needs both
blocked first axis in speed control    allowed     its pump works against its relief valve; the partner's
                                                   cylinder stands or is driven by its own pump
partner still, its valves shut         allowed     its motor holds: the axes fight up to the relief valves
valves shut for part of the run        allowed     a cylinder stopped for a while, relief valves take it
=====================================  ==========  ========================================================
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from fdd.errors import InputError
from fdd.plant.circuit import RATED_PRESSURE, Circuit
from fdd.plant.duty import Standstill
from fdd.unit import Unit

if TYPE_CHECKING:
    from fdd.plant.scenario import Scenario

_WHERE = "scenario valves"


def _connect_needs_a_partner(scenario: Scenario) -> None:
    if scenario.partner is None and scenario.connect.open:
        raise InputError(
            "a connect valve is open but there is no partner",
            where=_WHERE,
            mend="shut connect or give a partner",
        )


def _one_partner_only(scenario: Scenario) -> None:
    if scenario.partner is not None and scenario.load.name == "throttle":
        raise InputError(
            "load throttle stands for a throttled partner, and there is a partner",
            where="scenario load",
            mend="open the partner's own throttle instead, with another load",
        )


def _one_axis_reaches_its_cylinder(scenario: Scenario) -> None:
    if not scenario.circuit.blocked:
        return
    if scenario.partner is None:
        raise InputError(
            "the axis is blocked and no partner moves its cylinder",
            where=_WHERE,
            mend="open its ball valve (blocked: false) or give a partner",
        )
    if scenario.partner.circuit.blocked:
        raise InputError(
            "both axes are blocked: no pump reaches a cylinder",
            where=_WHERE,
            mend="open one of the ball valves",
        )


def _no_hydraulic_lock(scenario: Scenario) -> None:
    partner = scenario.partner
    if partner is None:
        return
    asked = not isinstance(scenario.duty, Standstill)
    first = asked and scenario.power.most > 0.0
    second = partner.power.most > 0.0 and (
        asked if partner.drive == "same" else not isinstance(partner.duty, Standstill | None)
    )
    together = first or second
    for name, circuit, driven in (
        ("first axis", scenario.circuit, together if scenario.connect.joined else second),
        ("partner", partner.circuit, together if scenario.connect.joined else first),
    ):
        if circuit.blocked and driven and not circuit.passes:
            raise InputError(
                f"hydraulic lock: the {name} is blocked, its throttle and by-pass are shut, and its cylinder "
                "is driven by the other's",
                where=_WHERE,
                mend="open its throttle or by-pass",
            )


def _the_loop_sees_its_pump(scenario: Scenario) -> None:
    partner = scenario.partner
    if partner is None or not scenario.circuit.blocked or scenario.control.mode != "position":
        return
    if partner.drive != "same" and not scenario.connect.joined:
        raise InputError(
            "the first axis is blocked: its position loop would not see what its pump does",
            where=_WHERE,
            mend="use speed control, partner drive same, or open both connect valves",
        )


def _one_charging_pump(scenario: Scenario) -> None:
    partner = scenario.partner
    if partner is not None and min(scenario.circuit.charging.most, partner.circuit.charging.most) > 0.0:
        raise InputError(
            "both axes are being charged, and the rig has one charging pump",
            where=_WHERE,
            mend="charge one of them; they share the accumulator",
        )


CONTRADICTIONS: tuple[Callable[[Scenario], None], ...] = (
    _connect_needs_a_partner,
    _one_partner_only,
    _one_axis_reaches_its_cylinder,
    _no_hydraulic_lock,
    _the_loop_sees_its_pump,
    _one_charging_pump,
)
"""What a scenario is checked for, in this order."""


def check_valves(scenario: Scenario) -> None:
    """Refuse what the module's table refuses of a scenario.

    Raises
    ------
    InputError : the first contradiction, and what is allowed.
    """
    for contradiction in CONTRADICTIONS:
        contradiction(scenario)


def check_charging(circuit: Circuit, unit: Unit, charge_factor: float = 1.0) -> None:
    """Refuse charging that the unit's own pressures rule out.

    Parameters
    ----------
    circuit : of the axis.
    unit : its charge pressure and relief setting.
    charge_factor : accumulator charge over the unit's.

    Raises
    ------
    InputError : beyond the system's rated pressure without the circuit that protects it, or no flow.
    """
    if circuit.charging.most == 0.0:
        return
    charge = unit.accumulator.charge_pressure * charge_factor
    if circuit.charging_pressure <= charge:
        raise InputError(
            f"charging to {circuit.charging_pressure / 1e6:g} MPa adds nothing to a charge of "
            f"{charge / 1e6:g} MPa",
            where=_WHERE,
            mend="raise charging_pressure or lower charge_factor",
        )
    together = circuit.charging_pressure + unit.accumulator.relief_pressure
    if together > RATED_PRESSURE and circuit.accumulators is None:
        raise InputError(
            f"charging to {circuit.charging_pressure / 1e6:g} MPa below relief valves of "
            f"{unit.accumulator.relief_pressure / 1e6:g} MPa exceeds the rated {RATED_PRESSURE / 1e6:g} MPa",
            where=_WHERE,
            mend="lower charging_pressure or connect the accumulators, whose relief valve protects",
        )
