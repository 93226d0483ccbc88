"""Effective bulk modulus over pressure (thesis 5.4, eqs 5.19 to 5.21), by the identification's volume balances.

While its valves are shut, what a chamber takes in and the piston does not sweep has compressed its oil: the slope
of that volume over the pressure it raised, times the chamber's volume, is 1/β (eq. 5.19). Its fall with pressure
is the free air's: ``1/β(p) = 1/β_oil + α·c(p)`` (eqs 5.20 and 5.21, see `fdd.identification.oil`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fdd.identification.balance import GROUPS, LEAST_AIR
from fdd.identification.experiments.leakage import robust
from fdd.identification.experiments.outcome import (
    NORMAL_95,
    Outcome,
    Told,
    axes,
    cloud,
    curve_line,
    points,
)
from fdd.identification.identify import BULK_SHARP, LEAST_SIGNAL, Hydraulics, hydraulics
from fdd.identification.oil import air_compliance, modulus_at, pressure_of_compliance
from fdd.identification.profile import ProfileWriter
from fdd.identification.record import Record
from fdd.identification.volume_steps import (
    AIR,
    AIR_SCALE,
    BLOCK,
    REFEED_MARGIN,
    SMOOTHING,
    STIFF,
    scales,
)
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import Unit

Array = NDArray[np.float64]

AIR_SHARP = 0.5
"""Relative standard deviation of the free air up to which it is a figure."""
CLEAR = 5.0
"""Standard deviations of the pressures' noise that a step must raise the pressure by to count in the pictures."""
BINS = 8
LEAST_STEPS = 20
MPA = 1e-6


def bulk_modulus(records: list[Record], unit: Unit) -> Outcome:
    """Bulk modulus at the logs' usual pressure and over pressure, and the free air behind that.

    Parameters
    ----------
    records : logs of one unit. unit : profile: areas, volumes, polytropic index; its oil is compared with.

    Raises
    ------
    InputError : a gain or pressures that cannot be this unit's.
    """
    out = Outcome("bulk-modulus", "Effective bulk modulus")
    writer = ProfileWriter(unit.model_copy(deep=True), unit, "")
    found = hydraulics(writer, records)
    if found is None:
        out.not_told.append(f"Bulk modulus: {_never_shut(records)}")
        return out
    rows = _Rows(found)
    reference, fit = found.logs.pressure, found.fit
    beta = found.bulk_modulus
    if fit.signal_over_noise < LEAST_SIGNAL or beta.relative > BULK_SHARP or not np.any(rows.clear):
        out.not_told.append(
            f"Bulk modulus: {MPA * beta.value:.0f} ± {NORMAL_95 * MPA * beta.std:.0f} MPa; pressure steps in shut "
            f"chambers are {fit.signal_over_noise:.1f} times the sensors' noise, {LEAST_SIGNAL} are needed. "
            "Record reversals at speed, or throttled or sprung strokes."
        )
        return out
    low, high = (float(q) for q in np.quantile(rows.pressure[rows.clear], [0.02, 0.98]))
    out.told.append(
        Told.normal(f"effective bulk modulus at {reference / 1e5:.3g} bar", beta.value, beta.std, "Pa",
                    f"profile {MPA * modulus_at(unit.oil, reference):.4g} MPa")
    )  # fmt: skip
    _air(out, found, unit, low, high)
    _draw(out, found, rows, unit, low, high)
    out.notes.append(
        f"{fit.rows} steps of {seconds_text(rows)} in which a chamber is neither refed nor relieved; leakage, pump "
        "displacement and free air were fitted with it. Pressures are gauge; air is a fraction of the oil's volume "
        "at atmospheric pressure."
    )
    out.notes += [n for n in writer.result.notes if "volume" in n or "chamber pressures" in n]
    return out


class _Rows:
    """Steps as eq. 5.19 has them: volume compressed, volume times pressure raised, and at what pressure."""

    def __init__(self, found: Hydraulics) -> None:
        steps, fit, unit = found.steps, found.fit, found.base
        area = 0.0 if fit.area_2 is None else fit.area_2.value - unit.cylinder.area_2
        known = np.array([fit.displacement.value, area, fit.cross_port.value, fit.case.value, 0.0, 0.0])
        scale, index = scales(unit), unit.oil.polytropic_index
        self.compressed = steps.m @ (known / scale) - steps.y
        self.raised = -steps.m[:, STIFF] / scale[STIFF]
        bound = 0.5 * float(air_compliance(found.logs.pressure, index))
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = -steps.m[:, AIR] / AIR_SCALE / self.raised - bound
        self.pressure = pressure_of_compliance(mean, index)
        noise = np.sqrt(np.sum((steps.noise[:, :, STIFF] / scale[STIFF]) ** 2, axis=1))
        noise *= np.where(steps.chamber == 1, *found.logs.noise)
        self.clear = np.isfinite(self.pressure) & (np.abs(self.raised) > CLEAR * noise)
        self.block, self.seconds = steps.block, steps.seconds

    def modulus(self, rows: NDArray[np.bool_]) -> tuple[float, float, float]:
        """Slope of these rows alone as a bulk modulus (Pa), with its 95 % interval; jackknifed over time."""
        raised, compressed, block = self.raised[rows, None], self.compressed[rows], self.block[rows]
        slope, weights = robust(raised / raised.std(), compressed)
        del slope
        group = np.unique(block, return_inverse=True)[1] % GROUPS
        sides = np.array(
            [
                [np.sum((weights * raised[:, 0]) ** 2 * (group == g)),
                 np.sum(weights**2 * raised[:, 0] * compressed * (group == g))]
                for g in np.unique(group)
            ]
        )  # fmt: skip
        whole = sides.sum(axis=0)
        parts = (whole - sides)[:, 1] / (whole - sides)[:, 0]
        n, value = len(parts), whole[1] / whole[0]
        half = student.ppf(0.975, max(n - 1, 1)) * np.sqrt((n - 1) / n * np.sum((parts - parts.mean()) ** 2))
        return 1.0 / value, 1.0 / (value + half), 1.0 / max(value - half, 0.1 * value)


def _never_shut(records: list[Record]) -> str:
    """Why there are too few steps."""
    above = np.concatenate(
        [r.smooth(np.maximum(r.pressure_1, r.pressure_2), SMOOTHING) - r.accumulator for r in records]
    )
    share = float(np.mean(above > REFEED_MARGIN))
    return (
        f"the higher chamber is {REFEED_MARGIN / 1e5:.1f} bar above the accumulator, its refeeding valve surely shut, "
        f"in {100 * share:.0f} % of the time, and too seldom while it moves. Load the actuator."
    )


def over_pressure(found: Hydraulics, pressure: Array) -> tuple[Array, Array]:
    """Bulk modulus and its standard deviation (Pa), both (n,), at gauge `pressure` (n,) Pa."""
    index, fit = found.base.oil.polytropic_index, found.fit
    more = air_compliance(pressure, index) - float(air_compliance(found.logs.pressure, index))
    others = np.maximum(fit.compliances[:, :1] + fit.compliances[:, 1:] * more, 1e-14)
    value = np.maximum(1.0 / found.bulk_modulus.value + found.air_fraction.value * more, 1e-14)
    spread = np.sqrt((GROUPS - 1) / GROUPS * np.sum((others - others.mean(axis=0)) ** 2, axis=0))
    # What the jackknife does not see, volumes and reconstructed pressures, is the same share at all pressures.
    n = fit.compliances[:, 0]
    seen = np.sqrt((GROUPS - 1) / GROUPS * np.sum((n - n.mean()) ** 2)) * found.bulk_modulus.value
    unseen = np.sqrt(max(found.bulk_modulus.relative**2 - seen**2, 0.0))
    return 1.0 / value, np.hypot(spread / value, unseen) / value


def _air(out: Outcome, found: Hydraulics, unit: Unit, low: float, high: float) -> None:
    """Free air, and the oil without it, where the logs tell them apart."""
    air, fit = found.air_fraction, found.fit
    span = f"pressures of {low / 1e5:.2g} to {high / 1e5:.2g} bar"
    if not fit.air_known or air.relative > AIR_SHARP or air.value < 1.01 * LEAST_AIR:
        out.not_told.append(
            f"Free air, and with it how bulk modulus changes with pressure: {span} give "
            f"{100 * air.value:.2g} ± {100 * NORMAL_95 * air.std:.1g} % (profile {100 * unit.oil.air_fraction:.2g} %). "
            "Record steps from near the accumulator's pressure to several times it."
        )
        return
    out.told.append(Told.normal("free air at atmospheric pressure", air.value, air.std, "1",
                                f"profile {unit.oil.air_fraction:.4g}"))  # fmt: skip
    for level in (low, high):
        value, std = (float(x[0]) for x in over_pressure(found, np.array([level])))
        out.told.append(Told.normal(f"effective bulk modulus at {level / 1e5:.3g} bar", value, std, "Pa",
                                    f"profile {MPA * modulus_at(unit.oil, level):.4g} MPa"))  # fmt: skip
    at_reference = float(air_compliance(found.logs.pressure, unit.oil.polytropic_index))
    stiff = 1.0 / found.bulk_modulus.value - air.value * at_reference
    if stiff * found.bulk_modulus.value < 0.34:
        out.not_told.append("The oil's own bulk modulus: free air makes up most of what gives.")
        return
    value, std = (float(x[0]) for x in over_pressure(found, np.array([1e12])))
    if std < BULK_SHARP * value:
        out.told.append(Told.normal("bulk modulus of the oil without free air", value, std, "Pa"))


def seconds_text(rows: _Rows) -> str:
    """The steps' lengths."""
    return " or ".join(f"{s:.3g} s" for s in np.unique(rows.seconds))


def _draw(out: Outcome, found: Hydraulics, rows: _Rows, unit: Unit, low: float, high: float) -> None:
    clear = rows.clear
    line = np.array([rows.raised[clear].min(), rows.raised[clear].max()])
    scatter = [
        cloud(10.0 * rows.raised[clear], 1e9 * rows.compressed[clear], "steps", tr.GREY),
        curve_line(10.0 * line, 1e9 * line / found.bulk_modulus.value, "fitted, at the usual pressure", tr.BLUE),
        curve_line(10.0 * line, 1e9 * line / modulus_at(unit.oil, found.logs.pressure), "profile", tr.VERMILLION,
                   "dash"),
    ]  # fmt: skip
    pressure = np.linspace(low, high, 80)
    beta, std = over_pressure(found, pressure)
    band = NORMAL_95 * std
    profile = np.array([modulus_at(unit.oil, float(p)) for p in pressure])
    out.curves["fitted"] = {"pressure": pressure, "bulk_modulus": beta, "low": beta - band, "high": beta + band}
    out.heads = ("pressure", "bulk modulus by these steps alone", "95 %", "fitted", "profile", "steps")
    edges = np.quantile(rows.pressure[clear], np.linspace(0.0, 1.0, BINS + 1))
    table = []
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        inside = clear & (rows.pressure >= a) & (rows.pressure < b)
        if np.count_nonzero(inside) < LEAST_STEPS or np.unique(rows.block[inside]).size < 3:
            continue
        at, (value, least, most) = float(np.median(rows.pressure[inside])), rows.modulus(inside)
        table.append((at, value, least, most))
        fitted = float(over_pressure(found, np.array([at]))[0][0])
        out.rows.append(
            (f"{at / 1e5:.3g} bar", f"{MPA * value:.4g} MPa", f"{MPA * least:.4g} … {MPA * most:.4g}",
             f"{MPA * fitted:.4g} MPa", f"{MPA * modulus_at(unit.oil, at):.4g} MPa",
             str(np.count_nonzero(inside)))
        )  # fmt: skip
    curves = [
        {**tr.band(1e-5 * pressure, MPA * (beta - band), MPA * (beta + band), "", tr.BLUE), "legendgroup": ""},
        curve_line(1e-5 * pressure, MPA * beta, "fitted", tr.BLUE),
        curve_line(1e-5 * pressure, MPA * profile, "profile", tr.VERMILLION, "dash"),
    ]
    if table:
        p, value, least, most = np.array(table).T
        out.curves["steps"] = {"pressure": p, "bulk_modulus": value, "low": least, "high": most}
        curves.append(points(1e-5 * p, MPA * value, MPA * least, MPA * most, "by steps alone, 95 %", tr.GREEN))
    out.figures = [
        Figure("modulus", "Bulk modulus over pressure", curves, axes("gauge pressure (bar)"), "MPa",
               "shaded: 95 % of the fit", 340, True),
        Figure("compression", "Compressed volume", scatter, axes("chamber volume times pressure raised (cm³·bar)"),
               "mm³", "over what raised it; the slope is 1/β (eq. 5.19)", 340, True),
    ]  # fmt: skip
