"""Section 5.2: the leakage coefficient, from strokes at 1000 rpm against the throttled partner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row, Table
from evidence.thesis.runs import PERIOD, THOUSAND_RPM, run_speed, throttled_partner
from fdd.plant.simulate import Simulation
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

SLOPES = {"A": 6.52e-12, "B": 4.27e-12}
"""m³/(s·Pa), section 5.2."""
END_PRESSURE, END_FLOW, DEMANDED_FLOW = 3.36e6, 3.39e-5, 5.76e-5
"""Pa and m³/s of axis A, section 5.2."""
TRIALS = 3
_SHARES = (0.0, 0.045, 0.15)
_THROTTLES = (0.1e6, 0.4e6, 0.9e6, 1.6e6, 2.5e6, 3.5e6, 4.5e6, 6.0e6, 7.4e6)
_START, _END, _WINDOW, _LONGEST = -0.130, 0.130, 0.4, 16.0


@dataclass(frozen=True)
class Strokes:
    """Steady points of one axis, (m,) each: pressure difference (Pa), pump and actuator flow (m³/s)."""

    pressure: Array
    pumped: Array
    arrived: Array

    @property
    def leak(self) -> Array:
        """(m,) m³/s, Dp·ω - A·v of eq. 5.3."""
        return self.pumped - self.arrived

    @property
    def slope(self) -> float:
        """m³/(s·Pa) of a straight line through leak over pressure."""
        return float(np.polyfit(self.pressure, self.leak, 1)[0])

    def flow_at(self, pressure: float) -> float:
        """Flow that arrives at a pressure, m³/s, by a straight line through all points."""
        return float(np.polyval(np.polyfit(self.pressure, self.arrived, 1), pressure))


def strokes(unit: Unit, partner: Unit, seed: int) -> Strokes:
    """Strokes against ever narrower throttles, as far as the relief valves allow.

    A point is the mean over the last 0.4 s before the stroke's end.
    """
    points = []
    for i, throttle in enumerate(_THROTTLES):
        out = _one(unit, partner, throttle, seed + i)
        log = out.samples
        arrived = np.flatnonzero(log["position"] >= _END)
        end = int(arrived[0]) if arrived.size else len(log)
        steady = slice(end - round(_WINDOW / PERIOD), end)
        time = log.time[steady]
        pump = np.polyfit(time, log["pump_angle"][steady], 1)[0]
        actuator = np.polyfit(time, log["position"][steady], 1)[0]
        pressure = float(np.mean(log["pressure_difference"][steady]))
        # A relief valve that has opened on the way stays so until well below its setting.
        if np.max(log["pressure_difference"][:end]) < 0.99 * unit.accumulator.relief_pressure:
            points.append((pressure, unit.pump.displacement * pump, unit.cylinder.area_1 * actuator))
    table = np.array(points)
    return Strokes(table[:, 0], table[:, 1], table[:, 2])


def _one(unit: Unit, partner: Unit, throttle: float, seed: int) -> Simulation:
    command = np.full(round(_LONGEST / PERIOD), THOUSAND_RPM)
    beside = (partner, throttled_partner(unit, partner, throttle))
    return run_speed(unit, command, start=_START, partner=beside, seed=seed)


def holding_leakage(unit: Unit) -> float:
    """ξ + C_ep (m³/(s·Pa)): what the pump makes up under pressure while the low side is refed (mode 2)."""
    return unit.pump.cross_port_leakage + unit.pump.case_leakage


def with_case_share(unit: Unit, share: float) -> Unit:
    """The same leakage coefficient L_T, of which C_ep is a share."""
    changed = unit.model_copy(deep=True)
    changed.pump.cross_port_leakage = (1.0 - 0.5 * share) * unit.pump.total_leakage
    changed.pump.case_leakage = share * unit.pump.total_leakage
    return changed


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Measure leakage over pressure on both axes."""
    units = {"A": axis_a, "B": axis_b}
    others = {"A": axis_b, "B": axis_a}
    trials = {
        name: [strokes(u, others[name], seed + 100 * k) for k in range(TRIALS)] for name, u in units.items()
    }
    slopes = {name: np.array([t.slope for t in found]) for name, found in trials.items()}
    cells = []
    for share in _SHARES:
        by_share = [strokes(with_case_share(u, share), others[name], seed) for name, u in units.items()]
        cells.append(
            (
                f"{100 * share:g} %",
                *(f"{1e12 * s.slope:.2f}" for s in by_share),
                f"{1e5 * by_share[0].flow_at(END_PRESSURE):.2f}",
            )
        )
    flow = float(np.mean([t.flow_at(END_PRESSURE) for t in trials["A"]]))
    demanded = axis_a.pump.displacement * THOUSAND_RPM
    rows = []
    for name, unit in units.items():
        why = (
            "Eq. 5.3 counts oil that the low side gets back over its refeeding valve as arrived: it "
            "shows ξ + C_ep, where L_T is ξ + C_ep/2 (eq. 3.49). The profile has L_T = "
            f"{1e12 * unit.pump.total_leakage:.2f} and C_ep assumed as "
            f"{100 * unit.pump.case_leakage / unit.pump.total_leakage:.1f} % of it; below are others."
        )
        value = 1e12 * float(np.mean(slopes[name]))
        rows.append(
            Row(f"leakage, axis {name}, slope", "5.2", 1e12 * SLOPES[name], value, "10⁻¹² m³/(s·Pa)", why=why)
        )
    end_thesis = (DEMANDED_FLOW - END_FLOW) / END_PRESSURE
    end_plant = (demanded - flow) / END_PRESSURE
    rows += [
        Row("flow at 3.36 MPa, axis A", "5.2", 1e5 * END_FLOW, 1e5 * flow, "10⁻⁵ m³/s"),
        Row(
            "leakage, axis A, single end point", "5.2", 1e12 * end_thesis, 1e12 * end_plant,
            "10⁻¹² m³/(s·Pa)",
            note="The thesis contradicts itself: its end point gives 7.05, its slope 6.52.",
        ),
        Row(
            "flow demanded at 1000 rpm", "5.2", 1e5 * DEMANDED_FLOW, 1e5 * demanded, "10⁻⁵ m³/s",
            note="Dp of Table 4.21, not the 5.50e-7 m³/rad behind the text's figure.",
        ),
    ]  # fmt: skip

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        for k, trial in enumerate(trials["A"]):
            left.plot(1e-6 * trial.pressure, 1e5 * trial.arrived, "oxs"[k], label=f"plant, trial {k + 1}")
        left.plot(1e-6 * END_PRESSURE, 1e5 * END_FLOW, "k*", markersize=11, label="thesis, end point")
        left.set(xlabel="pressure difference (MPa)", ylabel="actuator flow, axis A (10⁻⁵ m³/s)")
        line = np.array([0.0, END_PRESSURE])
        for name, colour in (("A", "C0"), ("B", "C1")):
            for k, trial in enumerate(trials[name]):
                right.plot(
                    1e-6 * trial.pressure, 1e5 * trial.leak, "oxs"[k], color=colour,
                    label=f"plant, axis {name}" if k == 0 else None,
                )  # fmt: skip
            right.plot(
                1e-6 * line, 1e5 * SLOPES[name] * line, "--", color=colour, linewidth=1.0,
                label=f"thesis, slope {1e12 * SLOPES[name]:.2f}e-12",
            )  # fmt: skip
        right.plot(1e-6 * END_PRESSURE, 1e5 * (DEMANDED_FLOW - END_FLOW), "k*", markersize=11)
        right.set(xlabel="pressure difference (MPa)", ylabel="leak flow (10⁻⁵ m³/s)")
        left.legend()
        right.legend()

    spread = ", ".join(f"{name}: {1e12 * np.std(s):.3f}" for name, s in slopes.items())
    return Finding(
        "Leakage coefficient",
        "Section 5.2 drives one axis at 1000 rpm; the other one's pump is shut off and its throttle "
        "valve closed step by step, which raises the pressure up to 3.36 MPa. Leak flow is Dp·ω - A·v "
        f"(eq. 5.3) in steady motion; its slope over pressure is L_T. Here: nine throttles, {TRIALS} "
        "trials, each point the last 0.4 s of a 260 mm stroke, by the encoders and the differential "
        "pressure sensor, on the dual rig: the other axis's ball valve is shut and its cylinder, on the same "
        "rod, drives its oil through its throttling valve.",
        rows,
        tables=[
            Table(
                "The same strokes with other shares of L_T that leave through the case drain",
                (
                    "C_ep over L_T",
                    "slope, A (10⁻¹² m³/(s·Pa))",
                    "slope, B",
                    "flow at 3.36 MPa, A (10⁻⁵ m³/s)",
                ),
                [("thesis", "6.52", "4.27", "3.39"), *cells],
            )
        ],
        remarks=[
            "With the low side refed eq. 5.3 shows ξ + C_ep and the compression of the pumped oil, D·ω/(2β), "
            "where eq. 5.22's L_T is ξ + C_ep/2. The thesis gives no split; the profiles' share of 4.5 % was "
            "chosen by this table: its slopes and the flow at 3.36 MPa, which pull apart, then both agree.",
            f"Standard deviation of the slope over the trials, 10⁻¹² m³/(s·Pa): {spread}.",
        ],
        pictures=[
            Picture("leakage", "Flow and leakage over pressure at 1000 rpm, as figures 5.3 and 5.4.", draw)
        ],
    )
