"""Chapter 5 without friction: hydraulic gain, leakage, bulk modulus and the hydraulic transfer function."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.measures import ATMOSPHERE_PA
from fdd.plant.details import Details
from fdd.plant.faults import FaultScales, FaultSpec
from fdd.plant.oil import stiff_bulk_modulus
from fdd.samples import Samples
from fdd.unit import Oil, Unit
from reports.thesis import runs as rig
from reports.writing import Panel

Array = NDArray[np.float64]

SPEEDS = rig.VOLT * np.array([-10.0, -8.0, -6.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0])
"""rad/s, commanded."""
_TRAVEL = 0.2

SLOPES = {"A": 6.52e-12, "B": 4.27e-12}
"""Leakage (m³/(s·Pa)), section 5.2."""
END_PRESSURE = 3.36e6
"""Pa of axis A, section 5.2."""
TRIALS = 3
_SHARES = (0.0, 0.045, 0.15)
_THROTTLES = (0.1e6, 0.4e6, 0.9e6, 1.6e6, 2.5e6, 3.5e6, 4.5e6, 6.0e6, 7.4e6)
_START, _END, _WINDOW, _LONGEST = -0.130, 0.130, 0.4, 16.0

CHARGES = (0.57, 0.7, 0.85, 1.0, 1.2, 1.43)
"""Charge over the unit's: 275 to 689 kPa."""
MORE_AIR = 0.2
"""Severity of the aeration fault for the second curve."""

VISCOUS = 800.0
"""N·s/m, for the check with damping."""


def speeds_of(unit: Unit, seed: int) -> tuple[Array, Array]:
    """Pump speed (rad/s) and actuator velocity (m/s) at each of `SPEEDS`, over the stroke's second half."""
    found = []
    for i, speed in enumerate(SPEEDS):
        expected = abs(speed) * unit.pump.displacement / unit.cylinder.area_1
        n = round(min(_TRAVEL / expected, 4.0) / rig.PERIOD)
        command = np.concatenate([np.zeros(100), np.full(n, speed)])
        log = rig.run_speed(unit, command, start=-0.5 * _TRAVEL * np.sign(speed), seed=seed + i).samples
        found.append(_rates(log, slice(100 + n // 2, None)))
    pump, actuator = np.array(found).T
    return pump, actuator


def _rates(log: Samples, rows: slice) -> list[float]:
    """Slopes of both encoders, pump and actuator (per s)."""
    return [float(np.polyfit(log.time[rows], log[c][rows], 1)[0]) for c in ("pump_angle", "position")]


def gain(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 5.1: actuator velocity over pump speed without load (m/rad), of both axes."""
    a, b = (float(np.polyfit(*speeds_of(unit, seed), 1)[0]) for unit in (axis_a, axis_b))
    return {"a": a, "b": b}


class Strokes(NamedTuple):
    """Steady points of one axis, (m,) each: pressure difference (Pa), flow that arrives and leak (m³/s), Dp·ω
    less it (eq. 5.3)."""

    pressure: Array
    arrived: Array
    leak: Array

    @property
    def slope(self) -> float:
        """m³/(s·Pa) of a straight line through leak over pressure."""
        return float(np.polyfit(self.pressure, self.leak, 1)[0])

    @property
    def end_flow(self) -> float:
        """Flow that arrives at `END_PRESSURE`, m³/s, by a straight line through all points."""
        return float(np.polyval(np.polyfit(self.pressure, self.arrived, 1), END_PRESSURE))


def strokes(unit: Unit, partner: Unit, seed: int) -> Strokes:
    """Strokes against ever narrower throttles, as far as the relief valves allow; the last 0.4 s of each."""
    points = []
    command = np.full(round(_LONGEST / rig.PERIOD), rig.THOUSAND_RPM)
    for i, throttle in enumerate(_THROTTLES):
        beside = rig.throttled_partner(unit, partner, throttle)
        log = rig.run_speed(unit, command, start=_START, partner=beside, seed=seed + i).samples
        arrived = np.flatnonzero(log["position"] >= _END)
        end = int(arrived[0]) if arrived.size else len(log)
        steady = slice(end - round(_WINDOW / rig.PERIOD), end)
        pump, actuator = _rates(log, steady)
        pumped, moved = unit.pump.displacement * pump, unit.cylinder.area_1 * actuator
        # A relief valve that has opened on the way stays so until well below its setting.
        if np.max(log["pressure_difference"][:end]) < 0.99 * unit.accumulator.relief_pressure:
            points.append((np.mean(log["pressure_difference"][steady]), moved, pumped - moved))
    return Strokes(*np.array(points).T)


def with_case_share(unit: Unit, share: float) -> Unit:
    """The same leakage coefficient L_T, of which C_ep is a share."""
    total = unit.pump.total_leakage
    return rig.changed(
        unit, "pump", cross_port_leakage=(1.0 - 0.5 * share) * total, case_leakage=share * total
    )


def leakage(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 5.2: leakage over pressure, strokes at 1000 rpm against the throttled partner."""
    pairs = {"A": (axis_a, axis_b), "B": (axis_b, axis_a)}
    trials = {name: [strokes(*pair, seed + 100 * k) for k in range(TRIALS)] for name, pair in pairs.items()}
    slopes = {name: np.array([t.slope for t in found]) for name, found in trials.items()}
    shares = []
    for share in _SHARES:
        a, b = (strokes(with_case_share(u, share), other, seed) for u, other in pairs.values())
        shares.append((share, a.slope, b.slope, a.end_flow))
    flow = float(np.mean([t.end_flow for t in trials["A"]]))
    line = np.array([0.0, 1e-6 * END_PRESSURE])
    curves = [
        (1e-6 * t.pressure, 1e5 * t.leak, style, f"plant, axis {name}" if k == 0 else None)
        for name, style in (("A", "C0o"), ("B", "C1o"))
        for k, t in enumerate(trials[name])
    ] + [
        (line, 1e11 * SLOPES[name] * line, style, f"thesis, axis {name}")
        for name, style in (("A", "C0--"), ("B", "C1--"))
    ]
    axes = {"xlabel": "pressure difference (MPa)", "ylabel": "leak flow (10⁻⁵ m³/s)"}
    return {"slopes": slopes, "shares": shares, "flow": flow, "picture": [Panel(curves, axes)]}


def pressurise(unit: Unit, charge: float, seed: int, air: float = 0.0) -> tuple[float, float]:
    """Mean chamber pressure (Pa, gauge) and bulk modulus (Pa) while the pump raises chamber 1.

    Eq. 5.19 in steps: oil that went in, Dp·θ - A·x - L_T·∫ΔP dt, over the chamber's volume against its
    pressure, a straight line through all rows between rest and break-away.
    """
    speed = np.concatenate([np.zeros(100), np.full(350, 6.0)])
    faults = [FaultSpec(fault="aeration", severity=air)] if air > 0.0 else []
    still = Details(pump_ripple=0.0)
    log = rig.run_speed(unit, speed, charge_factor=charge, faults=faults, details=still, seed=seed).samples
    lost = unit.pump.total_leakage * np.cumsum(log["pressure_1"] - log["pressure_2"]) * rig.PERIOD
    moved = unit.cylinder.area_1 * (log["position"] - log["position"][0])
    went_in = (unit.pump.displacement * log["pump_angle"] - moved - lost)[120:]
    pressure = log["pressure_1"][120:]
    return float(np.mean(pressure)), unit.cylinder.volume_1 * float(np.polyfit(went_in, pressure, 1)[0])


def equation_5_20(oil: Oil, stiff: float, air: float, pressure: Array) -> Array:
    """Eq. 5.20 with the oil's polytropic index m where it prints n, at a gauge `pressure`, (…) Pa.

    `stiff`: Pa, bulk modulus β0 of the oil alone. `air`: δ, volume of air at atmospheric pressure over oil's.
    """
    absolute = pressure + ATMOSPHERE_PA
    m = oil.polytropic_index
    ratio = (absolute / ATMOSPHERE_PA) ** (1.0 / m)
    return np.asarray((ratio + air) / (air * stiff / (m * absolute) + ratio) * stiff)


def equation_5_21(stiff: float, air: float, pressure: Array) -> Array:
    """Eq. 5.21, (…) Pa: air that keeps its volume fraction whatever the pressure."""
    return np.asarray(1.0 / ((1.0 - air) / stiff + air / (1.4 * (pressure + ATMOSPHERE_PA))))


def bulk_modulus(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 5.4: oil pumped into a chamber whose piston sticks, at several charges, with more air too."""
    oil = axis_a.oil
    airier = oil.air_fraction + MORE_AIR * FaultScales().free_air
    points, airy = (
        np.mean([[pressurise(axis_a, c, seed + i, air) for c in CHARGES] for i in range(4)], axis=0)
        for air in (0.0, MORE_AIR)
    )
    stiff = stiff_bulk_modulus(oil)
    law = equation_5_20(oil, stiff, oil.air_fraction, points[:, 0])
    fine = np.linspace(0.0, 1.5e6, 300)
    curves = []
    for fraction, found, colour in ((oil.air_fraction, points, "C0"), (airier, airy, "C1")):
        label = f"{100 * fraction:.1f} % air"
        of_air, other = equation_5_20(oil, stiff, fraction, fine), equation_5_21(stiff, fraction, fine)
        curves += [
            (1e-3 * found[:, 0], 1e-6 * found[:, 1], f"{colour}o", f"plant, {label}"),
            (1e-3 * fine, 1e-6 * of_air, f"{colour}-", f"eq. 5.20, {label}"),
            (1e-3 * fine, 1e-6 * other, f"{colour}:", f"eq. 5.21, {label}"),
        ]
    axes = {"xlabel": "static pressure (kPa)", "ylabel": "effective bulk modulus (MPa)", "ylim": (0, 260)}
    return {
        "at_reference": float(np.interp(oil.reference_pressure, points[:, 0], points[:, 1])),
        "air": oil.air_fraction,
        "airier": airier,
        "law_airy": float(np.mean(equation_5_20(oil, stiff, airier, airy[:, 0]))),
        "airy": float(np.mean(airy[:, 1])),
        "worst": float(np.max(np.abs(points[:, 1] / law - 1.0))),
        "picture": [Panel(curves, axes, at_y={210.0: "thesis: 210 MPa"})],
    }


def small_motion(unit: Unit, viscous: float, seed: int) -> tuple[Array, Array]:
    """Pump speed (rad/s) and velocity (m/s), (n,), of a step with viscous friction alone, so small that
    neither refeeding valve opens: then both chambers work, as eq. 5.22 has it."""
    linear = unit.model_copy(deep=True)
    for branch in (linear.friction.forward, linear.friction.reverse):
        branch.coulomb = branch.static = 0.0
        branch.viscous = viscous
    # Valves that open sharply: at its usual width a closed one still passes half as much as the pump leaks.
    # And air that is only compressed, as eq. 5.22 has it: what dissolves and comes out again damps as well.
    details = Details(
        pump_ripple=0.0, pump_coulomb_torque=0.0, seal_damping=0.0, check_width=200.0, air_law="free"
    )
    command = np.concatenate([np.zeros(100), np.full(600, 10.0)])
    truth = rig.run_speed(linear, command, details=details, seed=seed).truth
    return truth["pump_speed"], truth["velocity"]


class Coefficients(NamedTuple):
    """Eq. 5.22 without its integrator: v/ω = numerator / (s² + damping·s + stiffness)."""

    numerator: float
    damping: float
    stiffness: float

    @property
    def natural_hz(self) -> float:
        """Undamped natural frequency."""
        return float(np.sqrt(self.stiffness)) / (2.0 * np.pi)


def from_profile(unit: Unit, viscous: float) -> Coefficients:
    """Eq. 5.22 with the unit's numbers and friction `viscous` (N·s/m)."""
    cylinder, leakage, area = unit.cylinder, unit.pump.total_leakage, unit.cylinder.area_1
    stiffness = unit.oil.bulk_modulus / (0.25 * (cylinder.volume_1 + cylinder.volume_2))  # 2 V_o a side
    return Coefficients(
        numerator=area * stiffness * unit.pump.displacement / cylinder.moving_mass,
        damping=viscous / cylinder.moving_mass + leakage * stiffness,
        stiffness=(area**2 + leakage * viscous) * stiffness / cylinder.moving_mass,
    )


def found_again(unit: Unit, viscous: float, seed: int) -> Coefficients:
    """Coefficients of eq. 5.22 whose response to the pump's speed is nearest to a small step's velocity."""
    model, _ = rig.fit_output_error(*small_motion(unit, viscous, seed), zeros=0, poles=2, delay=0.0)
    return Coefficients(*model.numerator, *model.denominator[1:])


def transfer_function(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Eqs 5.22 to 5.26: recompute the printed coefficients, and find them again in the plant's motion."""
    out = {}
    for name, unit in (("A", axis_a), ("B", axis_b)):
        free, damped = (from_profile(unit, b) for b in (0.0, VISCOUS))
        in_plant, plant_damped = (found_again(unit, b, seed) for b in (0.0, VISCOUS))
        out[name] = {
            "free": free,
            "plant": in_plant,
            "plant_damped": plant_damped,
            "leakage_stiffness": (damped.stiffness - free.stiffness) / VISCOUS,
            "slope": (plant_damped.stiffness - in_plant.stiffness) / VISCOUS,
        }
    return out
