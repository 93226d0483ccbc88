"""What severity 1 of each fault is in figures: numbers that a user may override."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from fdd.plant.validated import Validated

Leakage = Annotated[float, Field(ge=0.0, le=1e-9)]
OrificeFlow = Annotated[float, Field(ge=0.0, le=1e-1)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class FaultScales(Validated):
    """Effects of the faults at severity 1; between 0 and 1 they go in proportion.

    Leakages are those at the oil's reference temperature, orifice flows those at 1 MPa. The catalogue
    (`fdd.faults`) quotes the defaults. Where a source is not named the number is an assumption.

    Attributes
    ----------
    internal_leakage : m³/(s·Pa) across the ports at 1 MPa, orifice included; two to three times
        the healthy L_T of section 5.2.
    internal_leakage_orifice_share : part of that flow at 1 MPa which is turbulent; the rig injects
        this leakage by a throttling valve (4.6.8), a worn clearance gives a laminar one, and the thesis's own
        leakage is straight over pressure (figure 5.4).
    external_leakage : m³/(s·Pa) from one chamber to the outside.
    pump_wear_leakage : m³/(s·Pa) across the ports at 100 rad/s; in proportion to speed.
    pump_wear_displacement_loss : share of the displacement.
    pump_wear_ripple : amplitude of the flow ripple added, over the mean flow; Table 4.1: more noise.
    case_leakage : m³/(s·Pa), each port to the case drain.
    shaft_leakage_flow : m³/s to the outside at `shaft_leakage_pressure`; 1 cm³/min.
    shaft_leakage_pressure : Pa, the case's at rest: mid charge pressure of the thesis, 4.82e5 Pa, and
        5 kPa of the case drain's check valve.
    loose_friction, tight_friction : friction over the healthy one. A seal that lost its preload keeps
        some friction; a swollen one doubles it. Worn in one direction, the viscous part, which the
        plant has in common, takes half of the change.
    loose_rod_leakage : m³/(s·Pa) from each chamber past its rod to the outside, where the seals are
        loose (Table 4.1: "potential external leakage").
    free_air : volume of free air added over that of oil; eqs 5.20 and 5.21 turn it into bulk modulus.
    check_valve_flow : m³/s at 1 MPa backwards through a check valve stuck open; about its seat's area.
    check_valve_clogging : share of its flow gain that a clogged check valve loses.
    relief_valve_flow : m³/s at 1 MPa through a relief valve stuck open.
    thin_viscosity, thick_viscosity : of the oil over that of sound oil.
    torque_loss : share of the torque constant.
    resistance_gain : rise of the winding resistance, relative.
    current_limit_loss : share of the current limit, which a drive lowers for a winding that runs hot.
    coupling_play : rad between motor and pump; 2 degrees.
    coupling_eccentricity : pump speed's swing once a turn, over the speed.
    pressure_bias, pressure_drift : Pa and Pa/s on the pressure measured; 3.6 % of the transducer's range, at
        once or within 50 s.

    Examples
    --------
    >>> FaultScales(free_air=0.04).internal_leakage
    1.2e-11
    """

    usual: ClassVar[dict[str, tuple[float, float]]] = {
        "internal_leakage_orifice_share": (0.0, 0.25),
        "pump_wear_displacement_loss": (0.0, 0.04),
        "pump_wear_ripple": (0.01, 0.1),
        "loose_rod_leakage": (0.0, 3e-14),
        "resistance_gain": (0.2, 0.8),
        "current_limit_loss": (0.0, 0.4),
        "coupling_eccentricity": (0.005, 0.04),
    }
    """Ranges that a campaign draws from: of what comes along with a fault. What the catalogue gives as
    severity 1 is not drawn, or a severity would not mean the same in two logs of a data set."""

    internal_leakage: Leakage = 12e-12
    internal_leakage_orifice_share: Share = 0.1
    external_leakage: Leakage = 6e-12
    pump_wear_leakage: Leakage = 12e-12
    pump_wear_displacement_loss: Annotated[float, Field(ge=0.0, le=0.5)] = 0.02
    pump_wear_ripple: Annotated[float, Field(ge=0.0, le=0.5)] = 0.05
    case_leakage: Leakage = 24e-12
    shaft_leakage_flow: Annotated[float, Field(ge=0.0, le=1e-4)] = 1e-6 / 60.0
    shaft_leakage_pressure: Annotated[float, Field(ge=1e3, le=1e7)] = 4.87e5
    loose_friction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.35
    tight_friction: Annotated[float, Field(ge=1.0, le=10.0)] = 2.0
    loose_rod_leakage: Leakage = 1e-14
    free_air: Annotated[float, Field(ge=0.0, le=0.2)] = 0.025
    check_valve_flow: OrificeFlow = 1e-4
    check_valve_clogging: Share = 1.0
    relief_valve_flow: OrificeFlow = 1e-4
    thin_viscosity: Annotated[float, Field(ge=0.05, le=1.0)] = 0.5
    thick_viscosity: Annotated[float, Field(ge=1.0, le=20.0)] = 2.0
    torque_loss: Annotated[float, Field(ge=0.0, le=0.95)] = 0.3
    resistance_gain: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    current_limit_loss: Share = 0.2
    coupling_play: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0349
    coupling_eccentricity: Annotated[float, Field(ge=0.0, le=0.5)] = 0.02
    pressure_bias: Annotated[float, Field(ge=0.0, le=1e8)] = 250e3
    pressure_drift: Annotated[float, Field(ge=0.0, le=1e7)] = 5e3
