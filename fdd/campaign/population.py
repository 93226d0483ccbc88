"""How numbers are drawn: from ranges and weights of a recipe, and by the distributions of ``population:
stated``, which say how actuators of one type differ, and one actuator's runs.

Each quantity has a distribution, its width and where that comes from; what no source gives is an assumption
with its reason. Beyond three standard deviations nothing is drawn.

Between the runs of one actuator differ oil temperature (normal about the middle of the recipe's range, a
quarter of its width: most runs are made warm) and charge (likewise, and `CHARGE`; then by the oil's
expansion and the gas law); friction (thesis Table 5.1, 8.8 %: the plant draws it by the unit's
`trial_spread`); sensors' zeros (`WARM_ZERO`); loads, duties and warming, uniform within the recipe's
ranges, as what a user does with an actuator has no distribution. Within a run friction drifts (`WANDER`, an
Ornstein-Uhlenbeck process over 20 s), a gust has its own noise, and the plant's heat balance warms the oil.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from fdd.errors import InputError
from fdd.plant.oil import ATMOSPHERE, KELVIN, air_compliance, stiff_bulk_modulus
from fdd.unit import Oil, Unit


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] <= pair[1]:
        raise InputError(f"range [{pair[0]:g}, {pair[1]:g}] runs backwards", mend="write [low, high]")
    return pair


def within(least: float, most: float) -> AfterValidator:
    """Marks a range that may not leave these bounds."""

    def inside(pair: tuple[float, float]) -> tuple[float, float]:
        if pair[0] < least or pair[1] > most:
            problem = f"[{pair[0]:g}, {pair[1]:g}] leaves {least:g} to {most:g}"
            raise InputError(problem, mend="correct that range")
        return pair

    return AfterValidator(inside)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Range = Annotated[tuple[Finite, Finite], AfterValidator(_ordered)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Weight = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Rng = np.random.Generator


def uniform(rng: Rng, bounds: Range) -> float:
    """One value of a range."""
    return float(rng.uniform(*bounds))


def log_uniform(rng: Rng, bounds: Range) -> float:
    """One value of a positive range, each factor as likely."""
    return float(np.exp(rng.uniform(np.log(bounds[0]), np.log(bounds[1]))))


def spread(rng: Rng, bounds: Range) -> float:
    """Log-uniform where a positive range spans a factor of four or more, else uniform."""
    return log_uniform(rng, bounds) if 0.0 < 4.0 * bounds[0] <= bounds[1] else uniform(rng, bounds)


def drawn(rng: Rng, ranges: Mapping[str, Range]) -> dict[str, Any]:
    """One value for each, see `spread`."""
    return {name: spread(rng, bounds) for name, bounds in ranges.items()}


def chosen(rng: Rng, weights: Mapping[str, float]) -> str:
    """One of the names, by weight."""
    names, values = list(weights), np.array(list(weights.values()))
    return names[int(rng.choice(len(names), p=values / values.sum()))]


def apportioned(shares: Mapping[str, float], number: int) -> NDArray[np.str_]:
    """`number` names in their shares (sum 1): whole parts first, then the largest remainders."""
    names, wanted = list(shares), np.array(list(shares.values())) * number
    counts = np.floor(wanted + 1e-9).astype(int)
    left = number - int(counts.sum())
    for k in np.argsort(-(wanted - counts), kind="stable")[:left]:
        counts[k] += 1
    return np.repeat(names, counts)


@dataclass(frozen=True)
class Spread:
    """How a quantity is distributed about its base's value, as a factor; `width` is the standard deviation,
    of the factor's logarithm if it is lognormal, or half the width of a uniform one."""

    distribution: Literal["normal", "lognormal", "uniform"]
    width: float
    source: str

    def factor(self, rng: Rng) -> float:
        """One draw."""
        if self.distribution == "uniform":
            return 1.0 + self.width * float(rng.uniform(-1.0, 1.0))
        departure = self.width * float(np.clip(rng.standard_normal(), -3.0, 3.0))
        return float(np.exp(departure)) if self.distribution == "lognormal" else 1.0 + departure

    def alike(self, width: float) -> Spread:
        """What takes its place in a population whose numbers all differ alike: uniform within ± `width`."""
        return Spread("uniform", width, "the recipe")


_HOSES = "assumption: hoses and fittings are cut and screwed on site; a tenth of a metre in one"
_GAP = (
    "thesis 5.2: L_T of axes A and B differ by a factor of 1.5 (a standard deviation of 0.3 in the "
    "logarithm); leakage goes with the gap cubed, so 12 % of the gap are 40 %"
)
_SPRING = "assumption: wire and seat of small valves; cracking pressures are catalogued to about a fifth"
_LOOP = "assumption: loops are tuned on each machine"
_GRADE = "ISO 3448: a grade holds its mid-point viscosity at 40 °C within 10 %"

BETWEEN_UNITS: dict[str, dict[str, Spread]] = {
    "cylinder": {
        "area_1": Spread("normal", 0.006, "assumption: rounded data sheets; ISO 286 H8 and f7 give 0.2 %"),
        "stroke": Spread("normal", 0.003, "assumption: a millimetre of 300"),
        "moving_mass": Spread("normal", 0.05, "assumption: rod end and clevis are the user's"),
        "volume_1": Spread("normal", 0.1, _HOSES),
        "volume_2": Spread("normal", 0.1, _HOSES),
    },
    "pump": {
        "displacement": Spread("normal", 0.02, "thesis: Table 4.21 and its text differ by 1.3 %"),
        "cross_port_leakage": Spread("lognormal", 0.4, _GAP),
        "case_leakage": Spread("lognormal", 0.4, _GAP),
    },
    "oil": {
        # Of oil and walls without air; the effective one follows by `with_its_air`.
        "bulk_modulus": Spread("normal", 0.08, "assumption: walls and hoses; oils of one kind differ by 5 %"),
        "air_fraction": Spread("lognormal", 0.5, "assumption: how well a circuit was bled, within 2.7 times"),
        "viscosity_40": Spread("uniform", 0.1, _GRADE),
        "viscosity_100": Spread("uniform", 0.06, "ISO 3448 with a viscosity index of 95 to 105"),
    },
    "accumulator": {
        "charge_pressure": Spread("normal", 0.05, "assumption: charged by a gauge of class 2.5"),
        "gas_volume": Spread("normal", 0.1, "assumption: shells to 5 %, and how much oil was filled in"),
        "refeed_cracking_pressure": Spread("normal", 0.2, _SPRING),
        "refeed_flow_gain": Spread("normal", 0.15, _SPRING),
        "case_cracking_pressure": Spread("normal", 0.2, _SPRING),
        "relief_pressure": Spread("normal", 0.03, "assumption: set on a bench by a gauge of class 1.6"),
        "relief_flow_gain": Spread("normal", 0.15, _SPRING),
    },
    "drive": {
        "delay": Spread("uniform", 0.15, "assumption: a cycle more or less of the drive's own"),
        "pole_1": Spread("normal", 0.08, _LOOP),
        "pole_2": Spread("normal", 0.08, _LOOP),
        "zero": Spread("normal", 0.08, _LOOP),
        "torque_constant": Spread("uniform", 0.07, "assumption: servomotors' catalogues allow 5 to 10 %"),
        "winding_resistance": Spread("uniform", 0.07, "assumption: as torque_constant"),
        "inertia": Spread("normal", 0.03, "assumption: couplings; thesis 4.10 adds up to 7 % less than 4.21"),
        "viscous_friction": Spread("lognormal", 0.2, "assumption: bearings and their seals"),
        "current_limit": Spread("normal", 0.02, "assumption: a drive's current measurement"),
    },
}
"""Section of the profile to field: what an actuator has over its data sheet. What is left out is a definition
(reference pressure and temperature), a rating (maximum speed, ranges) or hardly varies (polytropic index,
density)."""
OIL_VOLUME = {"oil_volume": Spread("normal", 0.1, "as gas_volume")}
"""Of an accumulator whose profile states it."""
AREA_RATIO = Spread("normal", 0.003, "assumption: both chambers have the bore in common, the rod is ground")
_SEALS = "assumption: seals' squeeze and roughness from one cylinder to the next, 15 to 20 %"
FRICTION_LEVEL = Spread("lognormal", 0.17, _SEALS)
"""Of Coulomb and static friction, both directions."""
FRICTION: dict[str, Spread] = {
    "coulomb": Spread("lognormal", 0.2, "thesis Table 5.2: four branches differ by 36 %, fit included"),
    "static": Spread("lognormal", 0.06, "thesis Table 5.1: means of four branches differ by 5.5 %"),
    "stribeck_velocity": Spread("lognormal", 0.3, "thesis Table 5.2: 7 to 26 mm/s in four branches"),
    "stribeck_exponent": Spread("normal", 0.1, "thesis Table 5.2: 0.59 to 0.84 in four branches"),
    "viscous": Spread("normal", 0.15, "thesis Table 5.2: 109 to 138 N·s/m in three branches"),
}
"""Of each direction by itself, beside `FRICTION_LEVEL`."""
CHARGE = Spread("normal", 0.03, "assumption: a reading by gauge, and what leaked since")
_SHIFT = "assumption: transducers typically shift by 0.2 % of their range per 10 K; bodies differ by 1.5 K"
WARM_ZERO = Spread("normal", 0.25, _SHIFT)
"""Of the recipe's largest zero error: how a sensor's zero after warm-up differs from run to run."""
WANDER: Range = (0.01, 0.04)
"""Relative standard deviation of a run's friction about its mean, drawn for each run: assumption, a fraction
of what Table 5.1 shows from trial to trial, as films build up and break within a run."""


def central(rng: Rng, bounds: Range) -> float:
    """One value of a range: normal about its middle, a quarter of its width, none outside."""
    middle, width = 0.5 * (bounds[0] + bounds[1]), bounds[1] - bounds[0]
    return float(np.clip(middle + 0.25 * width * rng.standard_normal(), *bounds))


def with_its_air(oil: Oil, sheet: Oil) -> Oil:
    """The drawn oil with the bulk modulus that follows from its own air, on its data sheet's stiffness."""
    stiff = stiff_bulk_modulus(sheet) * oil.bulk_modulus / sheet.bulk_modulus
    air = oil.air_fraction * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    return oil.model_copy(update={"bulk_modulus": 1.0 / (1.0 / stiff + air)})


def charge_factor(unit: Unit, at_reference: float, temperature: float) -> float:
    """Charge (gauge) of the circuit over the unit's, once oil and gas are at another temperature (°C).

    The oil that expands goes into the accumulator, whose gas follows the ideal gas law; leaks are none.
    `at_reference` is the same at the oil's reference temperature.
    """
    store, oil = unit.accumulator, unit.oil
    warmer = temperature - oil.reference_temperature
    swollen = oil.thermal_expansion * (unit.cylinder.volume_1 + unit.cylinder.volume_2) * warmer
    left = max(store.gas_volume - swollen, 0.4 * store.gas_volume)
    absolute = at_reference * store.charge_pressure + ATMOSPHERE
    hot = (temperature + KELVIN) / (oil.reference_temperature + KELVIN)
    gauge = absolute * hot * store.gas_volume / left - ATMOSPHERE
    return float(np.clip(gauge / store.charge_pressure, 0.3, 2.5))


def warm_zeros(unit: Unit, zero_errors: Mapping[str, float], rng: Rng) -> Unit:
    """The unit with its sensors' zeros as they are in one run.

    `zero_errors` is the most that each channel's zero is off in the recipe, for this machine. The position is
    left as it is: an incremental encoder's zero is its reference mark.
    """
    sensors = dict(unit.sensors)
    for channel, most in zero_errors.items():
        shift = most * (WARM_ZERO.factor(rng) - 1.0)
        if channel in sensors and channel != "position":
            sensor = sensors[channel]
            sensors[channel] = sensor.model_copy(update={"zero": sensor.zero + shift})
    return unit.model_copy(update={"sensors": sensors})
