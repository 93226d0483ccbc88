"""Leak flow over pressure (thesis 5.2): laminar and orifice parts."""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from fdd.identification import Array, huber, jackknife_std
from fdd.identification.balance import GROUPS, LEAST_ROWS, fit_theta
from fdd.identification.experiments import NORMAL_95, Outcome, axes, cloud, curve_line, points
from fdd.identification.hydraulics import LEAKAGE_SHARP
from fdd.identification.record import Record, redundancy_offset
from fdd.identification.volume_steps import STEPS, LogBalances, Term, VolumeSteps, scales
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import Unit

APART = 4.0
"""Times the lowest pressures that the highest must be for laminar and orifice flow to be told apart."""
LEAST_PRESSURE = 2e5
"""Pa between the lowest and the highest pressures: sensors' zeros and friction alone make about as much."""
USUAL_ZERO = 3.0e3
"""Pa, standard deviation of a pressure sensor's zero where nothing else is known of it."""
MODEL = 0.01
"""Of the leak flow: what the volume balance itself leaves out."""
PRESSURES = 12
LIMIT = 4.0
"""Robust standard deviations from which a step counts less."""


class _Rows:
    """Leak flow (m³/s) and pressure (Pa) of the longest steps, and the regression through them."""

    def __init__(self, steps: VolumeSteps, unit: Unit, theta: Array) -> None:
        longest = steps.seconds == STEPS[-1]
        m, seconds = steps.m[longest], steps.seconds[longest]
        # Case leakage in the profile's proportion: few logs tell both apart.
        pump, total = unit.pump, unit.pump.total_leakage
        cross, share = (pump.cross_port_leakage / total, pump.case_leakage / total) if total else (1.0, 0.0)
        laminar = cross * m[:, Term.CROSS] + share * m[:, Term.CASE]
        others = [Term.AREA_2, Term.STIFF, Term.AIR]
        self.pressure = -laminar / (scales(unit)[Term.CROSS] * seconds)
        self.pumped = m[:, Term.DISPLACEMENT] / seconds
        self.arrived = (steps.y[longest] - m[:, others] @ theta[others]) / seconds
        self.block = steps.block[longest]

    def fit(self, *, orifice: bool) -> tuple[Array, Array]:
        """Displacement over the profile's, laminar coefficient, and on wish the orifice's; and their standard
        deviations, jackknifed over blocks of 2 s."""
        pressure, y = self.pressure, self.arrived
        root = np.sign(pressure) * np.sqrt(np.abs(pressure))
        m = np.column_stack([self.pumped, -pressure, *([-root] if orifice else [])])
        scale = np.abs(m).max(axis=0)
        whole, weights = huber(m / scale, y, LIMIT)
        group = np.unique(self.block, return_inverse=True)[1] % GROUPS
        weighted, target = m / scale * weights[:, None], y * weights
        parts = np.array([
            np.linalg.lstsq(weighted[group != g], target[group != g], rcond=None)[0] for g in np.unique(group)
        ])  # fmt: skip
        stretch = float(student.ppf(0.975, max(len(parts) - 1, 1))) / NORMAL_95
        return whole / scale, stretch * jackknife_std(parts) / scale


def leakage(records: list[Record], unit: Unit) -> Outcome:
    """Leak flow out of the chambers over pressure, by the balances of `fdd.identification.volume_steps`.

    Cross-port and case leakage share the whole as in the profile.
    """
    out = Outcome("leakage", "Leak flow over pressure")
    logs = LogBalances(records)
    steps = logs.steps(unit)
    if steps.y.size < LEAST_ROWS:
        out.not_told.append(
            "Leakage: too few steps in which a chamber stays above the accumulator while it moves."
        )
        return out
    rows = _Rows(steps, unit, fit_theta(logs, steps, unit)[0])
    low, high = (float(q) for q in np.quantile(np.abs(rows.pressure), [0.05, 0.95]))
    gain, gain_std = rows.fit(orifice=False)
    # The share that the pressure sensors' zeros may make: less under load.
    zero_pressure = max(USUAL_ZERO, 0.5 * abs(redundancy_offset(records)))
    drops = np.concatenate([r.smooth(r.pressure_1 - r.pressure_2, 0.1)[:: r.rows(0.1)] for r in records])
    zero = zero_pressure / max(float(np.sqrt(np.mean(drops**2))), zero_pressure) * gain[1]
    std = float(np.hypot(np.hypot(gain_std[1], zero), MODEL * gain[1]))
    profile = unit.pump.total_leakage
    if high - low < LEAST_PRESSURE or std > LEAKAGE_SHARP * abs(gain[1]):
        out.not_told.append(
            f"Leakage: pressures run from {low / 1e5:.2g} to {high / 1e5:.2g} bar and give "
            f"{gain[1]:.3g} ± {2 * std:.2g} m³/(s·Pa). Load the actuator, e.g. by throttling."
        )
        return out
    beside, at = f"profile {profile:.4g} m³/(s·Pa)", f"at {high / 1e5:.3g} bar"
    out.tell("leakage coefficient, straight line", gain[1], std, "m^3/(s*Pa)", beside)
    out.tell("leak flow at the highest pressure", gain[1] * high, std * high, "m^3/s", at)
    near = rows.pressure * np.sign(rows.pumped) > 0.9 * high
    if near.any():  # A·ẋ / (D_p·ω) of eq. 5.4, with A·ẋ from eq. 5.3, at the speed that it then drives with
        speed = float(np.median(np.abs(rows.pumped[near]))) / unit.pump.displacement
        share = 1.0 - float(gain[1]) * high / (float(gain[0]) * unit.pump.displacement * speed)
        spread = 100.0 * abs((1.0 - share) / gain[1]) * std
        beside = f"{at} and {30.0 / np.pi * speed:.0f} rpm, thesis eq. 5.4"
        out.tell("volumetric efficiency", 100.0 * share, spread, "%", beside)
    else:
        out.not_told.append("Volumetric efficiency: the pump never drives against the highest pressure.")
    both = _orifice(out, rows, low, high, zero)
    reference = logs.reference_temperature(unit)
    out.notes.append(
        f"Total leakage (cross-port and half of the case leakage, thesis eq. 3.50) at {reference:.0f} °C, "
        "split as in the profile; leakage beside it, pump displacement was fitted: it is "
        f"{100 * gain[0]:.2f} % of the profile's. Intervals hold the pressure sensors' zeros."
    )
    _draw(out, rows, np.append(gain, 0.0) if both is None else both, profile)
    return out


def _orifice(out: Outcome, rows: _Rows, low: float, high: float, zero: float) -> Array | None:
    """Tell both parts; their coefficients where an orifice shows."""
    if high < APART * low:
        out.not_told.append(
            f"Laminar and orifice flow apart: pressures run from {low / 1e5:.2g} to {high / 1e5:.2g} "
            "bar only."
        )
        return None
    both, std = rows.fit(orifice=True)
    root = float(np.sqrt(high))
    reach = float(np.hypot(std[2], MODEL * (both[1] * root + both[2])))
    if both[2] < NORMAL_95 * reach:
        most = 6e7 * root * (max(both[2], 0.0) + NORMAL_95 * reach)
        out.notes.append(f"No orifice flow shows: at {high / 1e5:.3g} bar it is below {most:.3g} mL/min.")
        return None
    laminar_std = float(np.hypot(np.hypot(std[1], zero), MODEL * both[1]))
    out.tell("laminar part, beside an orifice", both[1], laminar_std, "m^3/(s*Pa)")
    out.tell("orifice part", both[2], reach, "m^3/(s*Pa^0.5)")
    return both


def _draw(out: Outcome, rows: _Rows, gain: Array, profile: float) -> None:
    leak = gain[0] * rows.pumped - rows.arrived

    def fitted(p: Array) -> Array:
        return np.asarray(gain[1] * p + gain[2] * np.sign(p) * np.sqrt(np.abs(p)))

    # Means of what the fit leaves, put back on it: pressures differ within a group.
    beside = leak - fitted(rows.pressure)
    edges = np.quantile(rows.pressure, np.linspace(0.0, 1.0, PRESSURES + 1))
    which = np.clip(np.searchsorted(edges, rows.pressure) - 1, 0, PRESSURES - 1)
    p, q, half = [], [], []
    for k in range(PRESSURES):
        inside = which == k
        if np.count_nonzero(inside) < 5:
            continue
        means = [np.mean(beside[inside & (rows.block == b)]) for b in np.unique(rows.block[inside])]
        free = max(len(means) - 1, 1)
        p.append(np.median(rows.pressure[inside]))
        q.append(fitted(p[-1]) + np.mean(means))
        half.append(student.ppf(0.975, free) * np.std(means) / np.sqrt(free))
    pressure, flow, reach = (np.array(x) for x in (p, q, half))
    line = np.linspace(min(float(rows.pressure.min()), 0.0), float(rows.pressure.max()), 60)
    low, high = flow - reach, flow + reach
    out.curves["leak_flow"] = {"pressure": pressure, "flow": flow, "low": low, "high": high}
    data = [
        cloud(1e-5 * rows.pressure, 6e7 * leak, "steps of 0.2 s", tr.GREY),
        points(1e-5 * pressure, 6e7 * flow, 6e7 * low, 6e7 * high, "means, 95 %", tr.BLUE),
        curve_line(1e-5 * line, 6e7 * fitted(line), "fitted", tr.BLUE),
        curve_line(1e-5 * line, 6e7 * profile * line, "profile", tr.VERMILLION, "dash"),
    ]
    layout, note = axes("pressure that drives it (bar)"), "less compression, by the volume balance"
    out.figures.append(Figure("leakage", "Leak flow", data, layout, "mL/min", note, 380, True))
