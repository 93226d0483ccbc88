"""What a base profile asks of a data sheet: names, units, and the range that any such actuator keeps to.

The ranges go from the smallest flight-control actuator to a press: 1 kN to 2 MN, 0.5 to 70 MPa. They are
wide on purpose. A number outside is nearly always one in another unit of measure.
"""

from __future__ import annotations

from dataclasses import dataclass

from fdd.measures import measure


@dataclass(frozen=True)
class Question:
    """One number of a data sheet.

    Attributes
    ----------
    key : its name in a file of answers.
    words : what is asked.
    unit : SI unit, which a plain number is in.
    low, high : SI, the range outside which it is refused.
    spread : relative standard deviation of what such sheets say; None where nobody knows.
    assumed : what is assumed where the sheet does not say; None where an answer is needed.
    also : a second unit of measure that it may be given in (a leakage as flow at the rated pressure).
    path : where the number stands in the profile, if it goes there as it is.
    """

    key: str
    words: str
    unit: str
    low: float
    high: float
    spread: float | None = None
    assumed: str | None = None
    also: str | None = None
    path: str | None = None

    @property
    def dimensions(self) -> tuple[str, ...]:
        """What the answer may measure."""
        return tuple(measure(u).dimension for u in (self.unit, self.also) if u is not None)


AREA, GAIN, VOLUME, LEAKAGE = 0.006, 0.02, 0.10, 0.40
"""Usual relative errors of data sheets: bores are machined to some tenths of a per cent, gear pumps'
displacement is the theoretical one, volumes leave lines out, leakage is a bound or a typical value."""
MODULUS, BREAKAWAY, MASS = 0.20, 0.30, 0.05
"""The oil's own modulus leaves walls, hoses and air out; a seal's friction is a typical value."""

QUESTIONS: dict[str, Question] = {
    q.key: q
    for q in (
        # Cylinder; position 0 is mid-stroke, positive extends.
        Question(
            "piston_area_1",
            "Piston area of the side that extends",
            "m^2",
            1e-5,
            0.3,
            AREA,
            path="cylinder.area_1",
        ),
        Question(
            "piston_area_2",
            "Piston area of the side that retracts",
            "m^2",
            1e-5,
            0.3,
            AREA,
            path="cylinder.area_2",
        ),
        Question("stroke", "Stroke, end to end", "m", 0.005, 5.0, path="cylinder.stroke"),
        Question(
            "moving_mass",
            "Mass moved: piston, rod and what hangs on it",
            "kg",
            0.1,
            1e5,
            MASS,
            path="cylinder.moving_mass",
        ),
        Question(
            "chamber_volume_1",
            "Oil of side 1 with its lines at mid-stroke",
            "m^3",
            1e-7,
            1.0,
            VOLUME,
            "half the stroke times the area, and a third more for lines",
            path="cylinder.volume_1",
        ),
        Question(
            "chamber_volume_2",
            "Oil of side 2 with its lines at mid-stroke",
            "m^3",
            1e-7,
            1.0,
            VOLUME,
            "half the stroke times the area, and a third more for lines",
            path="cylinder.volume_2",
        ),
        Question(
            "breakaway_pressure", "Pressure difference that breaks the piston away", "Pa", 1e3, 5e6, BREAKAWAY
        ),
        # Pump and circuit.
        Question(
            "pump_displacement", "Pump displacement", "m^3/rad", 1e-9, 2e-4, GAIN, path="pump.displacement"
        ),
        Question("max_speed", "Largest pump speed", "rad/s", 5.0, 2500.0, path="drive.max_speed"),
        Question("rated_pressure", "Rated pressure", "Pa", 5e5, 7e7),
        Question(
            "relief_pressure",
            "Setting of the relief valves",
            "Pa",
            5e5,
            8e7,
            assumed="a tenth above the rated pressure",
            path="accumulator.relief_pressure",
        ),
        Question(
            "rated_flow",
            "Rated flow at the largest speed",
            "m^3/s",
            1e-6,
            0.1,
            assumed="displacement times largest speed",
        ),
        Question(
            "leakage",
            "Leakage of pump and cylinder, or its flow at the rated pressure",
            "m^3/(s*Pa)",
            1e-15,
            1e-9,
            LEAKAGE,
            "5 % of the rated flow at the rated pressure",
            also="m^3/s",
        ),
        Question(
            "charge_pressure",
            "Charge of accumulator or reservoir (gauge)",
            "Pa",
            0.0,
            5e6,
            VOLUME,
            path="accumulator.charge_pressure",
        ),
        Question(
            "gas_volume",
            "Gas volume of the accumulator",
            "m^3",
            1e-6,
            0.1,
            VOLUME,
            path="accumulator.gas_volume",
        ),
        Question(
            "oil_volume",
            "Oil that the accumulator holds at that charge",
            "m^3",
            0.0,
            0.1,
            VOLUME,
            assumed="half the gas, a third of the shell",
            path="accumulator.oil_volume",
        ),
        Question(
            "cracking_pressure",
            "Cracking pressure of the refeeding check valves",
            "Pa",
            0.0,
            1e6,
            assumed="30 kPa, a light spring",
            path="accumulator.refeed_cracking_pressure",
        ),
        Question(
            "refeed_flow_gain",
            "Flow of a refeeding valve per pressure beyond cracking",
            "m^3/(s*Pa)",
            1e-13,
            1e-4,
            assumed="the rated flow at twice the cracking pressure",
            path="accumulator.refeed_flow_gain",
        ),
        Question(
            "relief_flow_gain",
            "Flow of a relief valve per pressure above its setting",
            "m^3/(s*Pa)",
            1e-13,
            1e-4,
            assumed="the rated flow a tenth above the setting",
            path="accumulator.relief_flow_gain",
        ),
        # Oil.
        Question(
            "bulk_modulus",
            "Bulk modulus of the oil",
            "Pa",
            5e7,
            5e9,
            MODULUS,
            "1.4 GPa, mineral oil",
            path="oil.bulk_modulus",
        ),
        Question(
            "density",
            "Density of the oil",
            "kg/m^3",
            600.0,
            1500.0,
            assumed="860 kg/m^3, mineral oil",
            path="oil.density",
        ),
        Question(
            "viscosity_40", "Viscosity of the oil at 40 °C", "m^2/s", 2e-6, 1e-3, path="oil.viscosity_40"
        ),
        Question(
            "viscosity_100",
            "Viscosity of the oil at 100 °C",
            "m^2/s",
            5e-7,
            2e-4,
            assumed="viscosity index 100",
            path="oil.viscosity_100",
        ),
        # Motor.
        Question(
            "torque_constant",
            "Motor torque constant",
            "N*m/A",
            1e-3,
            100.0,
            0.05,
            path="drive.torque_constant",
        ),
        Question(
            "winding_resistance",
            "Motor winding resistance",
            "ohm",
            1e-4,
            100.0,
            path="drive.winding_resistance",
        ),
        Question("current_limit", "Motor current limit", "A", 0.1, 5000.0, path="drive.current_limit"),
        Question("inertia", "Inertia of rotor and pump", "kg*m^2", 1e-7, 10.0, path="drive.inertia"),
        # Sensors.
        Question(
            "position_noise",
            "Noise of the position sensor, standard deviation",
            "m",
            1e-9,
            1e-3,
            assumed="10 µm",
        ),
        Question(
            "pressure_full_scale",
            "Full scale of the pressure sensors",
            "Pa",
            5e5,
            2e8,
            assumed="1.5 times the rated pressure",
        ),
    )
}
"""In the order in which they are asked."""
