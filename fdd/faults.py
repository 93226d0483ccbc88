"""The fault catalogue: one table, from which everything else takes ids, families and meanings."""

from __future__ import annotations

from dataclasses import dataclass

from fdd.errors import InputError

FAMILIES = (
    "healthy", "leakage", "seal_wear", "aeration", "check_valve", "relief_valve",
    "friction", "motor", "sensor", "unknown",
)  # fmt: skip
"""Keys of an answer's probabilities, in the contract's order."""


@dataclass(frozen=True)
class Fault:
    """One entry of the catalogue.

    Attributes
    ----------
    id, family : the contract's words.
    title : for people.
    thesis : where the thesis names or injects it.
    plant : what it does to the plant.
    severity : what severity 1.0 means, in physical units, on an actuator of the thesis's size; campaigns
        scale it for machines of other sizes (`fdd.campaign.sizes.Scale.fault_scales`).
    source : where that scale comes from, or that it is an assumption.
    variants, sides : choices that the injection takes; the first is the default.
    simulated : whether `fdd.plant` injects it.
    """

    id: str
    family: str
    title: str
    thesis: str
    plant: str
    severity: str
    source: str
    variants: tuple[str, ...] = ()
    sides: tuple[int, ...] = ()
    simulated: bool = False


_ASSUMED = "assumption: scale chosen so that 1.0 is gross and 0.2 is near the limit of what sensors show"

CATALOGUE: dict[str, Fault] = {
    f.id: f
    for f in (
        Fault(
            "internal_leakage", "leakage", "internal leakage", "4.6.8",
            "more flow across the ports, laminar plus orifice",
            "cross-port leakage +12e-12 m³/(s·Pa) at 1 MPa, a tenth of it through an orifice",
            "2 to 3 times the healthy L_T of section 5.2, 0.7 L/min at 1 MPa; assumption: the orifice's part",
            simulated=True,
        ),
        Fault(
            "external_leakage", "leakage", "external leakage", "Table 4.1, 4.6.2",
            "flow from one chamber to the outside; the accumulator drains",
            "6e-12 m³/(s·Pa) from one chamber to the outside", _ASSUMED, sides=(1, 2), simulated=True,
        ),
        Fault(
            "pump_wear", "leakage", "pump gear wear", "Table 4.1",
            "volumetric loss that grows with pressure and speed, more flow ripple",
            "cross-port leakage +12e-12 m³/(s·Pa) at 100 rad/s, displacement -2 %, flow ripple +5 %",
            _ASSUMED, simulated=True,
        ),
        Fault(
            "case_drain_seal_failure", "leakage", "case drain seal failure", "Table 4.1",
            "case drain flow into the accumulator, its pressure rises",
            "case leakage of each port +24e-12 m³/(s·Pa)", _ASSUMED, simulated=True,
        ),
        Fault(
            "shaft_seal_wear", "leakage", "pump shaft seal wear", "Table 4.1",
            "slow loss from the case drain to the outside",
            "1 cm³/min from the case drain to the outside, at 487 kPa in the case",
            "assumption: a steady drip, which empties the 13 cm³ accumulator within minutes", simulated=True,
        ),
        Fault(
            "seal_wear", "seal_wear", "actuator seal wear", "Table 4.1",
            "the friction curve is scaled per direction; some rod leakage",
            "loose: friction falls to 35 %, each rod leaks 1e-14 m³/(s·Pa); tight: friction rises to 200 %; "
            "loose_forward: loose, friction of extension only; loose_reverse: of retraction only; "
            "tight_forward: tight, extension only; tight_reverse: retraction only",
            "assumption: a seal that lost its preload, or a swollen one, on both lips or one",
            variants=("loose", "tight", "loose_forward", "loose_reverse", "tight_forward", "tight_reverse"),
            simulated=True,
        ),
        Fault(
            "aeration", "aeration", "air in the oil", "4.6.3, 5.4",
            "entrained air: the effective bulk modulus falls, most at low pressure",
            "2.5 % more free air (volume at atmospheric pressure over volume of oil)",
            "eqs 5.20 and 5.21: halves to thirds the bulk modulus at charge pressure", simulated=True,
        ),
        Fault(
            "check_valve_stuck_open", "check_valve", "check valve stuck open", "Table 4.1",
            "one chamber stays connected to the inner circuit and cannot build pressure",
            "passes 1e-4 m³/s at 1 MPa backwards (orifice)",
            "about the area of the refeeding valve's seat held fully open", sides=(1, 2), simulated=True,
        ),
        Fault(
            "check_valve_clogged", "check_valve", "check valve clogged", "Table 4.1",
            "no refeeding: the low side cavitates",
            "refeeding flow gain of that side's check valve falls to 0", _ASSUMED,
            sides=(1, 2), simulated=True,
        ),
        Fault(
            "relief_valve_stuck_open", "relief_valve", "relief valve stuck open", "Table 4.1",
            "flow over the relief valve far below its setting",
            "passes 1e-4 m³/s at 1 MPa from the chamber of higher pressure to the other (orifice)", _ASSUMED,
            simulated=True,
        ),
        Fault(
            "oil_degradation", "friction", "oil degradation", "Table 4.1",
            "viscous friction and leakage change with viscosity",
            "thin: viscosity falls to 50 %; thick: it rises to 200 %", _ASSUMED,
            variants=("thin", "thick"), simulated=True,
        ),
        Fault(
            "motor_degradation", "motor", "motor degradation", "Table 4.1",
            "torque constant down, winding resistance up, current limit down",
            "torque constant -30 %, winding resistance +50 %, current limit -20 %", _ASSUMED, simulated=True,
        ),
        Fault(
            "coupling_wear", "motor", "coupling wear", "Table 4.1",
            "torsional play, vibration at shaft frequency",
            "2 degrees of play, pump speed swings by 2 % once a turn", _ASSUMED, simulated=True,
        ),
        Fault(
            "pressure_sensor_bias", "sensor", "pressure sensor bias", "Appendix A",
            "a constant added to the pressure measured", "250 kPa on the differential pressure",
            "3.6 % of the transducer's range", simulated=True,
        ),
        Fault(
            "pressure_sensor_drift", "sensor", "pressure sensor drift", "Appendix A",
            "a ramp added to the pressure measured", "5 kPa/s on the differential pressure",
            "250 kPa within 50 s", simulated=True,
        ),
        Fault(
            "position_sensor_slip", "sensor", "position sensor slip", "Appendix A",
            "the encoder's head slips in its clamp: its zero walks, in the log and for the controller",
            "about once a second by 0.5 to 1.5 mm to either side, within 5 mm", _ASSUMED, simulated=True,
        ),
        Fault(
            "sensor_dropout", "sensor", "sensor dropout", "Appendix A",
            "a loose contact: a channel is missing, held, or reads a broken current loop, in bursts",
            "the channel is lost all the time; 0.3: for 30 % of it, in bursts of about 0.1 s; "
            "missing: no value of the differential pressure; held: its last value again; "
            "broken_loop: what 0 mA reads; position_missing: no value of the position; "
            "position_held: its last value again", _ASSUMED,
            variants=("missing", "held", "broken_loop", "position_missing", "position_held"), simulated=True,
        ),
        Fault(
            "unknown", "unknown", "unknown fault", "",
            "something is wrong that is none of the above", "has no scale", "",
        ),
    )
}  # fmt: skip

PROFILES = ("step", "ramp", "intermittent")
"""How a fault comes: at once, growing over a time, or on and off."""


def fault(name: str) -> Fault:
    """Look a fault up.

    Raises
    ------
    InputError : unknown id; the line lists the known ones.
    """
    found = CATALOGUE.get(name)
    if found is None:
        raise InputError(f"unknown fault {name!r}", mend=f"the catalogue has: {', '.join(CATALOGUE)}")
    return found


def faults_of(family: str) -> tuple[str, ...]:
    """Ids of a family's faults, in the catalogue's order."""
    return tuple(f.id for f in CATALOGUE.values() if f.family == family)
