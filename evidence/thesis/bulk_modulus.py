"""Section 5.4: the effective bulk modulus, from oil pumped into a chamber whose piston still sticks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row
from evidence.thesis.runs import PERIOD, run_speed
from fdd.measures import ATMOSPHERE_PA
from fdd.plant.details import Details
from fdd.plant.faults.spec import FaultSpec
from fdd.residuals.oil import air_compliance
from fdd.unit import Oil, Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BULK_MODULUS = 2.10e8
"""Pa, section 5.4, from Chinniah et al."""
CHARGES = (0.57, 0.7, 0.85, 1.0, 1.2, 1.43)
"""Charge over the unit's: 275 to 689 kPa."""
MORE_AIR = 0.2
"""Severity of the aeration fault for the second curve."""
_SPEED, _SECONDS, _REST = 6.0, 0.35, 100
_TRIALS = 4


def pressurise(unit: Unit, charge: float, seed: int, air: float = 0.0) -> tuple[float, float]:
    """Mean chamber pressure (Pa, gauge) and bulk modulus (Pa) while the pump raises chamber 1.

    Eq. 5.19 in steps: oil that went in, Dp·θ - A·x - L_T·∫ΔP dt, over the chamber's volume against its
    pressure, a straight line through all rows between rest and break-away.
    """
    speed = np.concatenate([np.zeros(_REST), np.full(round(_SECONDS / PERIOD), _SPEED)])
    faults = [FaultSpec(fault="aeration", severity=air)] if air > 0.0 else []
    log = run_speed(
        unit, speed, charge_factor=charge, faults=faults, details=Details(pump_ripple=0.0), seed=seed
    ).samples
    lost = unit.pump.total_leakage * np.cumsum(log["pressure_1"] - log["pressure_2"]) * PERIOD
    went_in = (
        unit.pump.displacement * log["pump_angle"]
        - unit.cylinder.area_1 * (log["position"] - log["position"][0])
        - lost
    )
    rising = slice(_REST + 20, None)
    slope = float(np.polyfit(went_in[rising], log["pressure_1"][rising], 1)[0])
    return float(np.mean(log["pressure_1"][rising])), unit.cylinder.volume_1 * slope


def equation_5_20(oil: Oil, stiff: float, air: float, pressure: Array) -> Array:
    """Eq. 5.20 with the index m where it prints n, (…) Pa.

    Parameters
    ----------
    oil : its polytropic index is m.
    stiff : Pa, bulk modulus β0 of the oil alone.
    air : δ, volume of air at atmospheric pressure over that of oil.
    pressure : (…) Pa, gauge.
    """
    absolute = pressure + ATMOSPHERE_PA
    m = oil.polytropic_index
    ratio = (absolute / ATMOSPHERE_PA) ** (1.0 / m)
    return np.asarray((ratio + air) / (air * stiff / (m * absolute) + ratio) * stiff)


def equation_5_21(stiff: float, air: float, pressure: Array) -> Array:
    """Eq. 5.21, (…) Pa: air that keeps its volume fraction whatever the pressure."""
    return np.asarray(1.0 / ((1.0 - air) / stiff + air / (1.4 * (pressure + ATMOSPHERE_PA))))


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Measure the bulk modulus over the range of charge pressures, with the unit's air and with more."""
    oil = axis_a.oil
    more = _air_at(MORE_AIR)
    points = np.array([[pressurise(axis_a, c, seed + i) for c in CHARGES] for i in range(_TRIALS)]).mean(
        axis=0
    )
    airy = np.array([[pressurise(axis_a, c, seed + i, MORE_AIR) for c in CHARGES] for i in range(_TRIALS)])
    airy = airy.mean(axis=0)
    at_reference = float(np.interp(oil.reference_pressure, points[:, 0], points[:, 1]))
    air = oil.air_fraction * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    stiff = 1.0 / (1.0 / oil.bulk_modulus - air)
    law = equation_5_20(oil, stiff, oil.air_fraction, points[:, 0])
    law_airy = equation_5_20(oil, stiff, oil.air_fraction + more, airy[:, 0])
    rows = [
        Row(
            "effective bulk modulus at 482 kPa", "5.4", BULK_MODULUS / 1e6, at_reference / 1e6, "MPa",
            note="Taken over from Chinniah et al.; the thesis did not measure it.",
        ),
        Row(
            f"the same with {100 * (oil.air_fraction + more):.1f} % air, mean over charges", "eq. 5.20",
            float(np.mean(law_airy)) / 1e6, float(np.mean(airy[:, 1])) / 1e6, "MPa",
            note="Eq. 5.20 with the profile's oil, m in place of the printed n.",
        ),
    ]  # fmt: skip

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        fine = np.linspace(0.0, 1.5e6, 300)
        for fraction, found, colour in (
            (oil.air_fraction, points, "C0"), (oil.air_fraction + more, airy, "C1")
        ):  # fmt: skip
            label = f"{100 * fraction:.1f} % air"
            axes.plot(1e-3 * found[:, 0], 1e-6 * found[:, 1], "o", color=colour, label=f"plant, {label}")
            curve = equation_5_20(oil, stiff, fraction, fine)
            axes.plot(1e-3 * fine, 1e-6 * curve, color=colour, linewidth=1.0, label=f"eq. 5.20, {label}")
            axes.plot(
                1e-3 * fine, 1e-6 * equation_5_21(stiff, fraction, fine), ":", color=colour,
                label=f"eq. 5.21, {label}",
            )  # fmt: skip
        axes.plot(
            1e-3 * oil.reference_pressure, 1e-6 * BULK_MODULUS, "k*", markersize=12, label="thesis: 210 MPa"
        )
        axes.set(xlabel="static pressure (kPa, gauge)", ylabel="effective bulk modulus (MPa)")
        axes.set_ylim(0.0, 260.0)
        axes.legend(fontsize=8, ncols=2, loc="lower right")

    worst = float(np.max(np.abs(points[:, 1] / law - 1.0)))
    return Finding(
        "Bulk modulus",
        "Section 5.4 takes 2.10e8 Pa from an earlier rig and relates it to static pressure and air by "
        "eqs 5.20 and 5.21. Here it is measured by eq. 5.19: the pump turns at 6 rad/s against a piston "
        "that still sticks, and chamber 1's pressure is plotted over the oil that went in (encoders, "
        "leakage taken off), at six accumulator charges of 275 to 689 kPa.",
        rows,
        remarks=[
            f"Over the charges the plant follows eq. 5.20 to within {100 * worst:.1f} %. Eq. 5.21 lies "
            "far below: it takes δ as the share of air at the present pressure, eq. 5.20 as that at "
            f"atmospheric pressure. The air itself, {100 * oil.air_fraction:.1f} %, is the profile's "
            "assumption; the thesis could not measure it."
        ],
        pictures=[
            Picture("bulk_modulus", "Effective bulk modulus over static pressure, as figure 5.12.", draw)
        ],
    )


def _air_at(severity: float) -> float:
    """Air that the aeration fault adds."""
    from fdd.plant.faults.spec import FaultScales

    return severity * FaultScales().free_air
